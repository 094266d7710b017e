"""Runs the processes of a launch until all have ended."""

import itertools
import os
import queue
import shlex
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path
from types import FrameType
from typing import IO

from lpv_ros2cli.launch.log import LaunchLog
from lpv_ros2cli.launch.node_action import ProcessSpec
from lpv_ros2cli.launch.parameters import file_content

_ESCALATION = {signal.SIGINT: signal.SIGTERM, signal.SIGTERM: signal.SIGKILL}


class _Process:
    """One process of a launch, perhaps started several times."""

    def __init__(self, spec: ProcessSpec, number: int) -> None:
        self.spec, self.name = spec, f'{spec.name}-{number}'
        self.popen: subprocess.Popen[str] | None = None
        self.pid = 0
        self.retries = 0
        self.stopped_early = False
        self.start_at: float | None = None
        self.signal_sent: signal.Signals | None = None
        self.escalate_at: float | None = None

    @property
    def running(self) -> bool:
        return self.popen is not None

    @property
    def is_starting(self) -> bool:
        """Whether this is a node that has not reached its own signal handlers.

        A Python node is importing then: SIGINT would make it print a traceback.
        """
        return self.running and self.spec.is_node and not _catches(self.pid, signal.SIGTERM)

    def stop(self) -> None:
        """Tell the process to end; one that is still starting has nothing to clean up."""
        self.stopped_early = self.is_starting
        self.send(signal.SIGTERM if self.stopped_early else signal.SIGINT)

    def send(self, number: signal.Signals) -> None:
        """Send a signal to the process and its children, if it runs."""
        if not self.running:
            return
        self.signal_sent = number
        timeout = {
            signal.SIGINT: self.spec.sigterm_timeout,
            signal.SIGTERM: self.spec.sigkill_timeout,
        }.get(number)
        self.escalate_at = None if timeout is None else time.monotonic() + timeout
        try:
            os.killpg(self.pid, number)
        except ProcessLookupError:
            self.escalate_at = None


class Runner:
    """Starts processes, shows what they print, stops them together.

    Processes lead groups of their own, so that each gets exactly the signals that are sent here,
    whether SIGINT came from the terminal or from a program.
    """

    def __init__(self, specs: list[ProcessSpec], log: LaunchLog) -> None:
        self._log = log
        numbers = itertools.count(1)
        self._processes = [_Process(spec, next(numbers)) for spec in specs]
        # Its put may interrupt its get, as _on_signal does.
        self._events: queue.SimpleQueue[tuple[_Process | None, int]] = queue.SimpleQueue()
        self._stopping = False
        self._failed = False

    def run(self) -> int:
        """Run until all have ended; signals that come later change nothing."""
        # SIGHUP, too: the processes do not notice that the terminal closes.
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # of nohup
                signal.signal(number, self._on_signal)
        try:
            with tempfile.TemporaryDirectory(prefix='launch_params_') as folder:
                self._folder = Path(folder)
                for process in self._processes:
                    self._start(process)
                self._loop()
        finally:
            for process in self._processes:  # only after an error in here
                process.send(signal.SIGKILL)
        return int(self._failed)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        # Only a note: the handler may interrupt whatever the main thread does.
        self._events.put((None, number))

    def _loop(self) -> None:
        while any(p.running or p.start_at is not None for p in self._processes):
            try:
                process, what = self._events.get(timeout=0.1)
            except queue.Empty:
                pass
            else:
                if process is None:
                    self._interrupted(signal.Signals(what))
                else:
                    self._ended(process, what)
            self._on_time()

    def _on_time(self) -> None:
        now = time.monotonic()
        for process in self._processes:
            last = process.signal_sent
            if last and process.escalate_at is not None and now > process.escalate_at:
                self._escalate(process, last)
            if process.start_at is not None and now >= process.start_at:
                process.start_at = None
                self._start(process)

    def _start(self, process: _Process) -> None:
        command = self._write_parameters(process)
        try:
            process.popen = popen = subprocess.Popen(
                command,
                env=process.spec.environment,
                cwd=process.spec.cwd,
                text=True,
                errors='replace',
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            self._log.note('ERROR', process.name, f'cannot be started: {error}')
            self._failed = True
            if process.spec.shutdown_on_exit:
                self._shut_down('process cannot be started')
            return
        process.pid, process.signal_sent, process.escalate_at = popen.pid, None, None
        self._log.note('INFO', process.name, f'process started with pid [{popen.pid}]')
        self._log.debug(process.name, shlex.join(command))
        threading.Thread(target=self._follow, args=(process, popen), daemon=True).start()

    def _write_parameters(self, process: _Process) -> list[str]:
        command = []
        for index, word in enumerate(process.spec.command):
            if isinstance(word, dict):
                path = self._folder / f'{process.name}_{index}.yaml'
                path.write_text(file_content(word), encoding='utf-8')
                word = str(path)
            command.append(word)
        return command

    def _follow(self, process: _Process, popen: 'subprocess.Popen[str]') -> None:
        """Thread: hand on the lines of a process, then that it ended."""
        pumps = [
            threading.Thread(target=self._pump, args=(process, stream, is_error), daemon=True)
            for stream, is_error in ((popen.stdout, False), (popen.stderr, True))
            if stream is not None
        ]
        for pump in pumps:
            pump.start()
        code = popen.wait()
        for pump in pumps:  # a grandchild may keep the pipes open
            pump.join(timeout=1.0)
        self._events.put((process, code))

    def _pump(self, process: _Process, stream: IO[str], is_error: bool) -> None:
        for line in stream:
            self._log.line(process.name, process.spec.output, line.rstrip('\n'), is_error)

    def _ended(self, process: _Process, code: int) -> None:
        process.popen = process.escalate_at = None
        if process.stopped_early and code == -signal.SIGTERM:
            text = f'process was stopped before it had started [pid {process.pid}]'
            self._log.note('INFO', process.name, text)
        elif code == 0:
            self._log.note(
                'INFO', process.name, f'process has finished cleanly [pid {process.pid}]'
            )
        else:
            words = [w if isinstance(w, str) else '(parameters)' for w in process.spec.command]
            self._log.note(
                'ERROR',
                process.name,
                f"process has died [pid {process.pid}, exit code {code}, cmd '{' '.join(words)}'].",
            )
        if self._stopping:
            return
        self._failed |= code != 0
        spec = process.spec
        if spec.respawn and not 0 <= spec.respawn_max_retries <= process.retries:
            process.retries += 1
            process.start_at = time.monotonic() + spec.respawn_delay
        elif spec.shutdown_on_exit:
            self._shut_down(f'{process.name} has ended')

    def _interrupted(self, number: signal.Signals) -> None:
        name = 'ctrl-c (SIGINT)' if number == signal.SIGINT else number.name
        again = ' again, ignoring...' if self._stopping else ''
        self._log.note('WARNING', 'launch', f'user interrupted with {name}{again}')
        self._shut_down()

    def _shut_down(self, reason: str | None = None) -> None:
        if self._stopping:
            return
        self._stopping = True
        if reason is not None:
            self._log.note('INFO', 'launch', f'{reason}: shutting down')
        for process in self._processes:
            process.start_at = None
            if process.running:
                process.stop()

    def _escalate(self, process: _Process, last: signal.Signals) -> None:
        following = _ESCALATION[last]
        timeout = (
            process.spec.sigterm_timeout if last == signal.SIGINT else process.spec.sigkill_timeout
        )
        self._log.note(
            'ERROR',
            process.name,
            f"process[{process.name}] failed to terminate '{timeout:g}' seconds after "
            f"receiving '{last.name}', escalating to '{following.name}'",
        )
        process.send(following)


def _catches(pid: int, number: signal.Signals) -> bool:
    """Whether a process has a handler for a signal; True where that cannot be told."""
    try:
        status = Path(f'/proc/{pid}/status').read_text(encoding='ascii')
        mask = int(status.split('SigCgt:')[1].split()[0], 16)
    except (OSError, ValueError, IndexError):
        return True
    return bool(mask >> (number - 1) & 1)
