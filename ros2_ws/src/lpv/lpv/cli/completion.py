"""Tab completion of ``lpv``, by argcomplete."""

import argparse
import contextlib
import os
from collections.abc import Callable, Collection
from typing import Any

from lpv.core.support.errors import LpvError
from lpv.core.support.resources import executable, shipped_files

PROGRAMS = {
    'lpv_arm_sim': 'simulator', 'lpv_node': 'recorder', 'lpv_tracker': 'tracker', 'lpv_uio': 'uio',
}  # fmt: skip
"""Main program of each package with nodes."""
_KINDS = {
    'arm': 'arms', 'campaign': 'campaigns', 'columns': 'columns', 'gains': 'gains',
    'requirement': 'requirements', 'scenario': 'scenarios',
}  # fmt: skip
"""Folder of shipped files by argument."""


def complete(build_parser: Callable[..., Any], commands: Collection[str]) -> None:
    """Answer a request of the shell for completions and leave; otherwise do nothing."""
    if '_ARGCOMPLETE' not in os.environ:
        return
    import argcomplete

    words = os.environ.get('COMP_LINE', '').split()[1:]
    chosen = next((word for word in words if word in commands), None)
    argcomplete.autocomplete(build_parser(chosen), exclude=['-h', '--help'])


def complete_by_name(parser: argparse.ArgumentParser) -> None:
    """Give arguments that name a shipped file, a package or a program their completers."""
    completers = {dest: _shipped(kind) for dest, kind in _KINDS.items()}
    completers |= {'package': lambda **_: list(PROGRAMS), 'program': _programs}
    for action in parser._actions:
        if action.dest in completers:
            action.completer = completers[action.dest]  # type: ignore[attr-defined]


def _shipped(kind: str) -> Callable[..., Any]:
    """Completer: names of shipped files, and YAML files here."""

    def names(prefix: str, **_: object) -> list[str]:
        import argcomplete

        here: list[str] = argcomplete.completers.FilesCompleter(('yaml', 'yml'))(prefix)
        with contextlib.suppress(LpvError):  # not installed
            return [*shipped_files(kind), *here]
        return here

    return names


def _programs(parsed_args: argparse.Namespace, **_: object) -> list[str]:
    try:
        folder = executable(parsed_args.package, PROGRAMS[parsed_args.package]).parent
    except (KeyError, LpvError):
        return []
    return sorted(path.name for path in folder.iterdir())
