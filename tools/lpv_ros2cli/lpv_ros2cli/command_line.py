"""What the verbs share on the command line."""

import argparse
from collections.abc import Callable
from typing import Any


class CliError(Exception):
    """What was asked cannot be done; the message is one line for the user."""


def add_verb(
    verbs: Any, run: Callable[[argparse.Namespace], int | None], text: str, *names: str
) -> argparse.ArgumentParser:
    """Declare a verb that is called as its function without ``run_``, with its operands."""
    verb: argparse.ArgumentParser = verbs.add_parser(run.__name__[4:], help=text, description=text)
    for name in names:
        verb.add_argument(name)
    verb.set_defaults(run=run)
    return verb
