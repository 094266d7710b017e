"""Runs the programs of a launch until all have ended."""

import asyncio
import contextlib
import os
import shlex
import signal
from asyncio.subprocess import DEVNULL, PIPE, STDOUT
from dataclasses import dataclass
from types import FrameType

from lpv.core.support.limits import PATIENCE

_LONGEST_LINE = 1 << 20
"""Bytes of a line beyond which it is not printed."""


@dataclass(frozen=True)
class Program:
    """A program of a launch, perhaps started several times."""

    name: str
    command: list[str]
    environment: dict[str, str]
    respawn: bool = False
    respawn_delay: float = 0.0  # [s]
    ends_all: bool = False  # when it ends
    grace: float = PATIENCE  # time between SIGTERM and SIGKILL [s]


class Processes:
    """Starts programs, shows what they print, stops them together.

    They lead process groups of their own, so that each gets exactly the signals that are sent here,
    whether SIGINT came from the terminal or from a program.
    """

    def __init__(self, programs: list[Program]) -> None:
        self._programs, self._failed = programs, False

    def run(self) -> int:
        """Run until all have ended; 1 if one ended with an error before they were stopped."""
        asyncio.run(self._run_all())
        return int(self._failed)

    async def _run_all(self) -> None:
        loop, self._stop = asyncio.get_running_loop(), asyncio.Event()

        def on_signal(number: int, _frame: FrameType | None) -> None:
            with contextlib.suppress(RuntimeError):  # all has ended
                loop.call_soon_threadsafe(self._interrupt, number)

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) != signal.SIG_IGN or number != signal.SIGHUP:  # of nohup
                signal.signal(number, on_signal)
        await asyncio.gather(*map(self._keep, self._programs))

    def _interrupt(self, number: int) -> None:
        name = 'ctrl-c (SIGINT)' if number == signal.SIGINT else signal.Signals(number).name
        again = ' again, ignoring...' if self._stop.is_set() else ''
        _note('WARNING', 'launch', f'user interrupted with {name}{again}')
        self._stop.set()

    async def _keep(self, program: Program) -> None:
        """Run a program, and again where it is to be respawned, until all are to stop."""
        while not self._stop.is_set():
            try:
                code = await self._run_once(program)
            except OSError as error:
                _note('ERROR', program.name, f'cannot be started: {error}')
                self._failed = True
                self._stop.set()
            if self._stop.is_set():
                return
            self._failed |= code != 0
            if program.ends_all and not program.respawn:
                _note('INFO', 'launch', f'{program.name} has ended: shutting down')
                self._stop.set()
            if not program.respawn:
                return
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._stop.wait(), program.respawn_delay)

    async def _run_once(self, program: Program) -> int:
        """Run a program and hand on its lines; its exit code."""
        process = await asyncio.create_subprocess_exec(
            *program.command,
            env=program.environment,
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=STDOUT,
            start_new_session=True,
            limit=_LONGEST_LINE,
        )
        pid, name, code = process.pid, program.name, None
        _note('INFO', name, f'process started with pid [{pid}]')
        ending = asyncio.ensure_future(self._end(program, pid))
        try:
            # Children of it may go on where it has ended.
            while process.stdout and (line := await _read_line(process.stdout)):
                _print(f'[{name}] {line.decode(errors="replace").rstrip()}')
            code = await process.wait()
        finally:
            ending.cancel()
            if code is None:  # after an error in here
                _send(pid, signal.SIGKILL)
        if code == -signal.SIGTERM and self._stop.is_set():
            _note('INFO', name, f'process was stopped before it had started [pid {pid}]')
        elif code == 0:
            _note('INFO', name, f'process has finished cleanly [pid {pid}]')
        else:
            what = f"exit code {code}, cmd '{shlex.join(program.command)}'"
            _note('ERROR', name, f'process has died [pid {pid}, {what}].')
        return code

    async def _end(self, program: Program, pid: int) -> None:
        """Once all are to stop, tell a process so, and kill it if it does not end."""
        await self._stop.wait()
        # SIGINT would make a Python program that is still importing print a traceback.
        _send(pid, signal.SIGTERM)
        await asyncio.sleep(program.grace)
        text = f"failed to terminate '{program.grace:g}' seconds after receiving 'SIGTERM'"
        _note('ERROR', program.name, f"{text}, escalating to 'SIGKILL'")
        _send(pid, signal.SIGKILL)


async def _read_line(output: asyncio.StreamReader) -> bytes:
    """The next line, empty at the end; of one that is too long, that it was."""
    try:
        return await output.readline()
    except ValueError:
        return f'(more than {_LONGEST_LINE} bytes without an end of line)'.encode()


def _send(group: int, number: signal.Signals) -> None:
    """Send a signal to a program and its children, if they run."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, number)


def _note(level: str, name: str, text: str) -> None:
    _print(f'[{level}] [{name}]: {text}')


def _print(line: str) -> None:
    with contextlib.suppress(OSError):  # of a terminal that was closed: go on
        print(line, flush=True)
