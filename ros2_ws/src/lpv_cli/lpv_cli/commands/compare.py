"""``lpv compare``: two runs of one recording side by side."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from lpv_bag.run.record import BagError, RunRecord, load_run
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.support.errors import ConfigError
from lpv_core.support.formatting import number
from lpv_core.support.resources import bringup_file
from lpv_report.comparison import AlarmPair, Comparison, Tolerances, answer_stamps, compare_runs

_DEFAULTS = Tolerances()


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
    parser.add_argument('--json', action='store_true', help='print JSON in place of tables')
    for name, unit in (
        ('mise', 'relative change of mean squared errors'),
        ('delay', 'change of the time of an alarm [s]'),
        ('signal', 'difference of estimates [rad], [rad/s]'),
        ('flags', 'share of samples with another mode, state or alarm'),
        ('missing', 'share of answers that only one bag has'),
    ):
        parser.add_argument(
            f'--{name}',
            type=float,
            default=getattr(_DEFAULTS, name),
            metavar='X',
            help=f'tolerated {unit} ({getattr(_DEFAULTS, name):g})',
        )
    parser.add_argument(
        '--exact',
        action='store_true',
        help='tolerate nothing: every bit of every answer must agree',
    )


def run(arguments: argparse.Namespace) -> int:
    """Compare, show, write."""
    names = ('mise', 'delay', 'signal', 'flags', 'missing')
    tolerances = Tolerances(**{n: 0.0 if arguments.exact else getattr(arguments, n) for n in names})
    arm = load_any_arm(bringup_file('arms', arguments.arm))
    first, second = load_pair(arguments.bag, arguments.other, arm)
    result = compare_runs(first, second, arm, tolerances)
    text = json.dumps(result.as_dict(), indent=1, allow_nan=False)
    if arguments.json:
        print(text)
    else:
        show(result, Console(soft_wrap=True, highlight=False))
    if arguments.out:
        _write(Path(arguments.out), text, first, second, arm)
    return 0 if result.same else 3


def load_pair(bag: str | Path, other: str | Path, arm: Arm) -> tuple[RunRecord, RunRecord]:
    """Two runs of one recording."""
    records = [
        load_run(path, joint_names=arm.joint_names, answers_only=True) for path in (bag, other)
    ]
    for one, another in (records, records[::-1]):
        for name in ('joint_states', 'ground_truth', 'reference', 'torque_command'):
            if name in one.streams and name not in another.streams:
                another.streams[name], another.stamps[name] = one.streams[name], one.stamps[name]
        another.joint_names = another.joint_names or one.joint_names
    for path, record in zip((bag, other), records):
        if not {'state_estimate', 'fault_estimate'} & set(record.streams):
            raise BagError(f'{path}: holds no answers of the diagnosis; run lpv replay first')
        if 'joint_states' not in record.stamps:  # times then count from the first answer
            record.stamps['joint_states'] = answer_stamps(record)
    return records[0], records[1]


def show(result: Comparison, console: Console) -> None:
    """Show a comparison as tables."""
    console.print(
        f'{result.common} answers in both bags, {result.only_first} in the first alone, '
        f'{result.only_second} in the second alone  ' + _mark(result.complete)
    )
    _table(
        console,
        'figures',
        ('', 'unit', 'first', 'second', ''),
        [
            (f.name, f.unit, number(f.first), number(f.second), _mark(f.same))
            for f in result.figures
        ],
    )
    _table(
        console,
        'largest differences',
        ('', 'unit', 'tolerated', 'found', ''),
        [
            (f.name, f.unit, number(f.first), number(f.second), _mark(f.same))
            for f in result.differences
        ],
    )
    names = {
        'kind': 'kind',
        'raised': 'raised\n[s]',
        'delay': 'delay\n[s]',
        'cleared': 'cleared\n[s]',
        'size': 'size\n[rad]',
    }
    _table(
        console,
        'alarms, first run above second',
        ('sensor', *names.values(), ''),
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
    console: Console, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
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


def _both(pair: AlarmPair, name: str) -> str:
    """Attribute of both alarms, one above the other; once if it reads the same."""
    texts = []
    for episode in (pair.first, pair.second):
        value = getattr(episode, name) if episode is not None else None
        texts.append('-' if value is None else value if isinstance(value, str) else f'{value:.3f}')
    return texts[0] if pair.same and texts[0] == texts[1] else '\n'.join(texts)


def _write(out: Path, text: str, first: RunRecord, second: RunRecord, arm: Arm) -> None:
    from lpv_report.comparison_figures import draw_comparison
    from lpv_report.style import png

    if out.exists() and not out.is_dir():
        raise ConfigError('--out', f'{out} is not a folder')
    out.mkdir(parents=True, exist_ok=True)
    (out / 'comparison.json').write_text(text + '\n', encoding='utf-8')
    for name, figure in draw_comparison(first, second, arm):
        (out / f'{name}.png').write_bytes(png(figure))
