"""Tab completion of ``lpv``, by argcomplete."""

import argparse
import os
from collections.abc import Callable, Collection
from typing import Any

from lpv_core.support.errors import LpvError
from lpv_core.support.resources import executable, shipped_files

_PROGRAMS = {
    'lpv_arm_sim': 'simulator',
    'lpv_bag': 'recorder',
    'lpv_tracker': 'tracker',
    'lpv_uio': 'uio',
}
_KINDS = {
    'arm': 'arms',
    'columns': 'columns',
    'gains': 'gains',
    'requirement': 'requirements',
    'scenario': 'scenarios',
    'spec': 'campaigns',
}
"""Folder of shipped files by argument."""


def complete(build_parser: Callable[..., Any], commands: Collection[str]) -> None:
    """Answer a request of the shell for completions and leave; otherwise do nothing."""
    if '_ARGCOMPLETE' not in os.environ:
        return
    import argcomplete

    words = os.environ.get('COMP_LINE', '').split()[1:]
    chosen = next((word for word in words if word in commands), None)
    argcomplete.autocomplete(build_parser(chosen), exclude=['-h', '--help'])


def completed(action: argparse.Action, completer: Callable[..., Any]) -> None:
    """Give an argument its completer, where argcomplete looks for it."""
    action.completer = completer  # type: ignore[attr-defined]


def complete_by_name(parser: argparse.ArgumentParser) -> None:
    """Complete arguments that take a file with the names of shipped ones."""
    for action in parser._actions:
        if action.dest in _KINDS:
            completed(action, shipped(_KINDS[action.dest]))


def shipped(kind: str) -> Callable[..., Any]:
    """Completer: names of shipped files, and YAML files here."""

    def names(prefix: str, **_: object) -> list[str]:
        import argcomplete

        return [
            *_shipped_names(kind),
            *argcomplete.completers.FilesCompleter(('yaml', 'yml'))(prefix),
        ]

    return names


def _shipped_names(kind: str) -> list[str]:
    if kind == 'requirements':
        from lpv_design.requirement import SHIPPED

        return sorted(path.stem for path in SHIPPED.glob('*.yaml'))
    try:
        return list(shipped_files(kind))
    except LpvError:  # not installed
        return []


def packages(**_: object) -> list[str]:
    """Completer: packages with nodes."""
    return list(_PROGRAMS)


def programs(parsed_args: argparse.Namespace, **_: object) -> list[str]:
    """Completer: the programs of the package that was typed."""
    try:
        folder = executable(parsed_args.package, _PROGRAMS[parsed_args.package]).parent
    except (KeyError, LpvError):
        return []
    return sorted(path.name for path in folder.iterdir())
