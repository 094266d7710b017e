"""Options of commands in one line each."""

import argparse
from typing import Any


def flag(parser: argparse._ActionsContainer, name: str, text: str) -> None:
    """An option that is there or not."""
    parser.add_argument(name, action='store_true', help=text)


def number(
    parser: argparse._ActionsContainer, name: str, default: float, text: str, **others: Any
) -> None:
    """An option with a number, of the type of its default, which its help ends with."""
    text += f' ({default:g})'
    parser.add_argument(name, type=type(default), default=default, help=text, **others)
