"""What a check says, and how it is shown."""

from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table


class Level(Enum):
    """How bad it is."""

    OK = 'OK'
    WARN = 'WARN'
    ERROR = 'ERROR'


_STYLES = {Level.OK: 'green', Level.WARN: 'yellow', Level.ERROR: 'bold red'}


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    level: Level  # How bad it is
    check: str  # What was checked, a word or two
    text: str  # What was found
    remedy: str = ''  # What to do; empty where nothing is to be done


def ok(check: str, text: str) -> Finding:
    """A finding that all is well."""
    return Finding(Level.OK, check, text)


def warn(check: str, text: str, remedy: str) -> Finding:
    """A finding that may be meant, or that may go wrong."""
    return Finding(Level.WARN, check, text, remedy)


def error(check: str, text: str, remedy: str) -> Finding:
    """A finding that keeps the software from working."""
    return Finding(Level.ERROR, check, text, remedy)


def as_dict(finding: Finding) -> dict[str, Any]:
    """Fields of a finding as plain data."""
    return {**asdict(finding), 'level': finding.level.value}


def show(findings: list[Finding], console: Console) -> None:
    """Print findings as a table, each with its remedy below."""
    table = Table(box=None, pad_edge=False, show_header=False)
    for _ in range(3):
        table.add_column(overflow='fold')
    for finding in findings:
        style = _STYLES[finding.level]
        table.add_row(
            f'[{style}]{finding.level.value}', escape(finding.check), escape(finding.text)
        )
        if finding.remedy:
            table.add_row('', '', Padding(f'-> {escape(finding.remedy)}', (0, 0, 0, 2)))
    console.print(table)
    bad = [f for f in findings if f.level != Level.OK]
    console.print(
        f'{len(bad)} of {len(findings)} checks found something'
        if bad
        else f'{len(findings)} checks, nothing found'
    )
