"""What the verbs share on the command line."""

import argparse
from collections.abc import Callable
from typing import Any, TypeVar

_Run = TypeVar('_Run', bound=Callable[[argparse.Namespace], int | None])


class CliError(Exception):
    """What was asked cannot be done; the message is one line for the user."""


def takes(*names: str, **options: Any) -> Callable[[_Run], _Run]:
    """Declare operands of a verb, or one argument of it as `argparse` has it.

    A verb is called as its function without ``run_``, and its help is the docstring.
    """

    def declare(run: _Run) -> _Run:
        own = [(names, options)] if options else [((name,), {}) for name in names]
        vars(run)['arguments'] = [*own, *vars(run).get('arguments', [])]
        return run

    return declare
