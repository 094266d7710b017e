"""SIGINT and SIGTERM as exceptions that are not lost."""

import contextlib
import signal
import sys
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

_AGAIN = 0.01
"""Delay after which a signal whose exception was lost raises another one [s]."""


@contextlib.contextmanager
def raising_signals() -> Iterator[list[int]]:
    """Context in which SIGINT raises KeyboardInterrupt and SIGTERM SystemExit.

    A signal that falls into a destructor or into a callback of a weak reference raises where
    Python can only print the exception and goes on: a command that waits for messages, which
    makes and drops many such objects, would then wait for ever.  The exception is raised again,
    in what the command does next.
    """
    received: list[int] = []

    def receive(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        _raise(number)

    def report(unraisable: 'sys.UnraisableHookArgs') -> None:
        if not received or not issubclass(unraisable.exc_type, (KeyboardInterrupt, SystemExit)):
            hook(unraisable)
        else:  # not from here, where it would be lost again
            signal.setitimer(signal.ITIMER_REAL, _AGAIN)

    handlers = {
        signal.SIGINT: receive,  # also in the background of a script, which ignores it
        signal.SIGTERM: receive,
        signal.SIGALRM: lambda _number, _frame: _raise(received[-1]),
    }
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    hook, sys.unraisablehook = sys.unraisablehook, report
    try:
        yield received
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _raise(number: int) -> NoReturn:
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)  # through the clean-up of contexts and nodes
