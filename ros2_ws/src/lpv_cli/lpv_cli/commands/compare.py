"""``lpv compare``: two runs of one recording side by side."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lpv_cli.options import flag

if TYPE_CHECKING:
    from rich.console import Console

    from lpv_report.comparison import AlarmPair, Comparison

_TOLERANCES = {
    'mise': (0.05, 'relative change of mean squared errors'),
    'delay': (0.02, 'change of the time of an alarm [s]'),
    'signal': (1e-3, 'difference of estimates [rad], [rad/s]'),
    'flags': (0.002, 'share of samples with another mode, state or alarm'),
    'missing': (0.0, 'share of answers that only one bag has'),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('bag', help='first bag: recorded, or a result of lpv replay')
    parser.add_argument(
        'other',
        help='second bag, of the same measurements; what one bag does '
        'not hold (after lpv replay --estimates-only) is taken from the other',
    )
    parser.add_argument('--arm', default='paper', help='arm file, or name of a shipped arm (paper)')
    parser.add_argument('--out', help='folder for comparison.json and pictures')
    flag(parser, '--json', 'print JSON in place of tables')
    for name, (value, what) in _TOLERANCES.items():
        text = f'tolerated {what} ({value:g})'
        parser.add_argument(f'--{name}', type=float, default=value, metavar='X', help=text)
    flag(parser, '--exact', 'tolerate nothing: every bit of every answer must agree')


def run(arguments: argparse.Namespace) -> int:
    """Compare, show, write.

    Exit code: 0; 3 if the runs differ.
    """
    from rich.console import Console

    from lpv_core.serial_arm.arm_file import load_arm
    from lpv_core.support.errors import ConfigError
    from lpv_core.support.resources import bringup_file
    from lpv_report.comparison import Tolerances, compare_runs, draw_comparison, load_pair

    chosen = {name: 0.0 if arguments.exact else getattr(arguments, name) for name in _TOLERANCES}
    tolerances = Tolerances(**chosen)
    arm = load_arm(bringup_file('arms', arguments.arm))
    pair = load_pair(arguments.bag, arguments.other, arm)
    result = compare_runs(*pair, arm, tolerances)
    text = json.dumps(result.as_dict(), indent=1, allow_nan=False)
    if arguments.json:
        print(text)
    else:
        show(result, Console(soft_wrap=True, highlight=False))
    if arguments.out:
        out = Path(arguments.out)
        if out.exists() and not out.is_dir():
            raise ConfigError('--out', f'{out} is not a folder')
        out.mkdir(parents=True, exist_ok=True)
        (out / 'comparison.json').write_text(text + '\n', encoding='utf-8')
        draw_comparison(*pair, arm, out)
    return 0 if result.same else 3


def show(result: 'Comparison', console: 'Console') -> None:
    """Show a comparison as tables."""
    from lpv_core.support.formatting import number

    console.print(
        f'{result.common} answers in both bags, {result.only_first} in the first alone, '
        f'{result.only_second} in the second alone  ' + _mark(result.complete)
    )
    for title, columns, figures in (
        ('figures', ('first', 'second'), result.figures),
        ('largest differences', ('tolerated', 'found'), result.differences),
    ):
        rows = [(f.name, f.unit, number(f.first), number(f.second), _mark(f.same)) for f in figures]
        _table(console, title, ('', 'unit', *columns, ''), rows)
    names = ('kind', 'raised', 'delay', 'cleared', 'size')
    heads = ('kind', 'raised\n[s]', 'delay\n[s]', 'cleared\n[s]', 'size\n[rad]')
    _table(
        console,
        'alarms, first run above second',
        ('sensor', *heads, ''),
        [
            (
                next(e.sensor for e in (p.first, p.second) if e),
                *(_both(p, name) for name in names),
                _mark(p.same),
            )
            for p in result.alarms
        ],
    )
    console.print('same' if result.same else 'DIFFERENT beyond the tolerances')


def _table(
    console: 'Console', title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    if not rows:
        return
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify='left')
    # Names may wrap in a narrow terminal, figures must not.
    for place, column in enumerate(columns):
        width = None if place else min(12, max(len(row[0]) for row in rows))
        table.add_column(escape(column), no_wrap=place > 0, overflow='fold', min_width=width)
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)


def _mark(same: bool) -> str:
    return '' if same else '<- differs'


def _both(pair: 'AlarmPair', name: str) -> str:
    """Attribute of both alarms, one above the other; once if it reads the same."""
    texts = []
    for episode in (pair.first, pair.second):
        value = getattr(episode, name) if episode is not None else None
        texts.append('-' if value is None else value if isinstance(value, str) else f'{value:.3f}')
    return texts[0] if pair.same and texts[0] == texts[1] else '\n'.join(texts)
