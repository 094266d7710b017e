"""What a check says, and how it is shown."""

from dataclasses import dataclass
from enum import Enum
from functools import partial


class Level(Enum):
    """How bad it is, and its colour."""

    OK = 'green'
    WARN = 'yellow'
    ERROR = 'bold red'


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    level: Level
    check: str  # what was checked, a word or two
    text: str  # what was found
    remedy: str = ''  # what to do; empty where nothing is to be done


ok, warn, error = (partial(Finding, level) for level in Level)


def show(findings: list[Finding]) -> None:
    """Print findings as a table, each with its remedy below."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, show_header=False)
    for _ in range(3):
        table.add_column(overflow='fold')
    for found in findings:
        level = f'[{found.level.value}]{found.level.name}'
        table.add_row(level, escape(found.check), escape(found.text))
        if found.remedy:
            table.add_row('', '', f'  -> {escape(found.remedy)}')
    bad = sum(found.level != Level.OK for found in findings)
    console = Console(soft_wrap=True, highlight=False)
    console.print(table)
    end = f' of {len(findings)} checks found something' if bad else ' checks, nothing found'
    console.print(f'{bad or len(findings)}{end}')
