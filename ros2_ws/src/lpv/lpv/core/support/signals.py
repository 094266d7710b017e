"""Handling of SIGINT, SIGTERM and SIGHUP: as a flag, as an exception, or by a handler.

Needs no ROS.
"""

import contextlib
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from types import FrameType

from lpv.core.support.limits import AT_ONCE

Handler = Callable[[int, FrameType | None], object]
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a process to stop; the last one comes when its terminal is closed."""


@contextlib.contextmanager
def handled_signals(handler: Handler, *numbers: int) -> Iterator[None]:
    """Context in which ``handler`` receives signals; what handled them before is restored.

    SIGHUP is left alone where it is ignored, as nohup asks for.
    """
    before = {number: signal.signal(number, handler) for number in _acting(numbers)}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _acting(numbers: Iterable[int]) -> list[int]:
    ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    return [number for number in numbers if number != signal.SIGHUP or not ignored]


def exit_by_signal(number: int, _frame: FrameType | None = None) -> None:
    """Handler: KeyboardInterrupt for SIGINT, otherwise SystemExit with the shell's exit code."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


class StopRequest:
    """`STOPS` from construction to the end of the process.

    At first they raise `exit_by_signal`'s exceptions: a start may last, and there is nothing to
    finish.  From `defer` on they only set a flag.  ``is_set`` says whether one of them came.
    """

    def __init__(self) -> None:
        self.is_set = self._deferred = False
        for number in _acting(STOPS):
            signal.signal(number, self._receive)

    def defer(self) -> None:
        """Raise no more exceptions."""
        self._deferred = True

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not (self._deferred or self.is_set):
            self.is_set = True
            exit_by_signal(number, frame)
        self.is_set = True


@contextlib.contextmanager
def raising_signals() -> Iterator[list[int]]:
    """Context in which SIGINT raises KeyboardInterrupt and SIGTERM SystemExit.

    A signal during a destructor or a callback of a weak reference raises where Python can only
    print the exception and goes on: a command that waits for messages, which creates and drops many
    such objects, would then wait for ever.  The exception is raised again, in what the command
    does next.

    Yields the numbers of the signals so far.
    """
    received: list[int] = []

    def receive(number: int, frame: FrameType | None) -> None:
        received.append(number)
        exit_by_signal(number, frame)

    def report(unraisable: 'sys.UnraisableHookArgs') -> None:
        if not received or not issubclass(unraisable.exc_type, (KeyboardInterrupt, SystemExit)):
            hook(unraisable)
        else:  # not from here, where it would be lost again
            signal.setitimer(signal.ITIMER_REAL, AT_ONCE)

    def retry(_number: int, _frame: FrameType | None) -> None:
        exit_by_signal(received[-1])

    hook, sys.unraisablehook = sys.unraisablehook, report
    try:
        # SIGINT also in the background of a script, where the shell has it ignored.
        with (
            handled_signals(receive, signal.SIGINT, signal.SIGTERM),
            handled_signals(retry, signal.SIGALRM),
        ):
            try:
                yield received
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        sys.unraisablehook = hook
