"""Runs the programs of a launch until all have ended."""

import contextlib
import math
import os
import queue
import shlex
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from types import FrameType

from lpv.core.support.limits import PATIENCE

_one_line = threading.Lock()


@dataclass
class Program:
    """A program of a launch, perhaps started several times."""

    name: str
    command: list[str]
    environment: dict[str, str]
    respawn: bool = False
    respawn_delay: float = 0.0  # [s]
    ends_all: bool = False  # when it ends
    grace: float = PATIENCE  # time between SIGTERM and SIGKILL [s]
    process: 'subprocess.Popen[str] | None' = None  # while it runs
    start_at: float | None = None  # steady time of the next start [s]
    kill_at: float = math.inf  # steady time


class Processes:
    """Starts programs, shows what they print, stops them together.

    They lead process groups of their own, so that each gets exactly the signals that are sent here,
    whether SIGINT came from the terminal or from a program.
    """

    def __init__(self, programs: list[Program]) -> None:
        self._programs = programs
        # Its put may interrupt its get, as _on_signal does.
        self._events: queue.SimpleQueue[tuple[Program | None, int]] = queue.SimpleQueue()
        self._stopping = self._failed = False

    def run(self) -> int:
        """Run until all have ended; 1 if one ended with an error before they were stopped."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN or number != signal.SIGHUP:  # of nohup
                signal.signal(number, self._on_signal)
        try:
            for program in self._programs:
                program.start_at = 0.0
            while any(p.process or p.start_at is not None for p in self._programs):
                self._on_time(time.monotonic())
                with contextlib.suppress(queue.Empty):
                    self._handle(*self._events.get(timeout=0.1))
        finally:
            for program in self._programs:  # only after an error in here
                _send(program, signal.SIGKILL)
        return int(self._failed)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        # Only a note: the handler may interrupt whatever the main thread does.
        self._events.put((None, number))

    def _handle(self, program: Program | None, what: int) -> None:
        if program is not None:
            self._ended(program, what)
            return
        name = 'ctrl-c (SIGINT)' if what == signal.SIGINT else signal.Signals(what).name
        again = ' again, ignoring...' if self._stopping else ''
        _note('WARNING', 'launch', f'user interrupted with {name}{again}')
        self._stop()

    def _on_time(self, now: float) -> None:
        for program in self._programs:
            if program.start_at is not None and now >= program.start_at:
                self._start(program)
            if program.process and now > program.kill_at:
                text = f"failed to terminate '{program.grace:g}' seconds after receiving 'SIGTERM'"
                _note('ERROR', program.name, f"{text}, escalating to 'SIGKILL'")
                program.kill_at = math.inf
                _send(program, signal.SIGKILL)

    def _start(self, program: Program) -> None:
        program.start_at = None
        try:
            program.process = subprocess.Popen(
                program.command,
                env=program.environment,
                text=True,
                errors='replace',
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            _note('ERROR', program.name, f'cannot be started: {error}')
            self._failed = True
            self._stop()
            return
        _note('INFO', program.name, f'process started with pid [{program.process.pid}]')
        arguments = (program, program.process)
        threading.Thread(target=self._follow, args=arguments, daemon=True).start()

    def _follow(self, program: Program, process: 'subprocess.Popen[str]') -> None:
        """Thread: hand on the lines of a process, then that it ended."""
        for line in process.stdout or ():
            _print(f'[{program.name}] {line.rstrip()}')
        self._events.put((program, process.wait()))

    def _ended(self, program: Program, code: int) -> None:
        pid = program.process.pid if program.process else 0
        program.process = None
        if code == -signal.SIGTERM and self._stopping:
            _note('INFO', program.name, f'process was stopped before it had started [pid {pid}]')
        elif code == 0:
            _note('INFO', program.name, f'process has finished cleanly [pid {pid}]')
        else:
            what = f"exit code {code}, cmd '{shlex.join(program.command)}'"
            _note('ERROR', program.name, f'process has died [pid {pid}, {what}].')
        if self._stopping:
            return
        self._failed |= code != 0
        if program.respawn:
            program.start_at = time.monotonic() + program.respawn_delay
        elif program.ends_all:
            _note('INFO', 'launch', f'{program.name} has ended: shutting down')
            self._stop()

    def _stop(self) -> None:
        if self._stopping:
            return
        self._stopping = True
        for program in self._programs:
            program.start_at = None
            program.kill_at = time.monotonic() + program.grace
            # SIGINT would make a Python program that is still importing print a traceback.
            _send(program, signal.SIGTERM)


def _send(program: Program, number: signal.Signals) -> None:
    """Send a signal to a program and its children, if it runs."""
    if program.process:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.process.pid, number)


def _note(level: str, name: str, text: str) -> None:
    _print(f'[{level}] [{name}]: {text}')


def _print(line: str) -> None:
    # Each program has a thread that prints, and print writes a line and its end in two steps.
    with _one_line, contextlib.suppress(OSError):  # of a terminal that was closed: go on
        print(line, flush=True)
