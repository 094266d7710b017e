"""``lpv compare``: two runs of one recording side by side."""

import argparse
import json
from dataclasses import fields
from pathlib import Path

from rich.console import Console

from lpv.core.support.errors import ConfigError
from lpv.core.support.formatting import decimals, number
from lpv.report import comparison
from lpv.report.certificate import find_arm_and_gains
from lpv.report.table import print_grid


def run(arguments: argparse.Namespace) -> int:
    """Compare, show, write; 3 if the runs differ."""
    names = [field.name for field in fields(comparison.Tolerances)]
    chosen = {name: 0.0 if arguments.exact else getattr(arguments, name) for name in names}
    tolerances = comparison.Tolerances(**chosen)
    arm, _, _ = find_arm_and_gains(arguments.bag, arguments.arm, None)
    pair = comparison.load_pair(arguments.bag, arguments.other, arm, arguments.topic)
    result = comparison.compare_runs(*pair, arm, tolerances)
    text = json.dumps(result.as_dict(), indent=1, allow_nan=False)
    if arguments.json:
        print(text)
    else:
        show(result, Console(soft_wrap=True, highlight=False, markup=False))
    if arguments.out:
        out = Path(arguments.out)
        if out.exists() and not out.is_dir():
            raise ConfigError('--out', f'{out} is not a folder')
        out.mkdir(parents=True, exist_ok=True)
        (out / 'comparison.json').write_text(text + '\n', encoding='utf-8')
        comparison.draw_comparison(*pair, arm, out)
    return 0 if result.same else 3


def show(result: comparison.Comparison, console: Console) -> None:
    """Show a comparison as tables."""
    console.print(
        f'{result.common} answers in both bags, {result.only_first} in the first alone, '
        f'{result.only_second} in the second alone  ' + _mark(result.complete)
    )
    rows: list[tuple[str, ...]]
    for title, columns, figures in (
        ('figures', ('>first', '>second'), result.figures),
        ('largest differences', ('>tolerated', '>found'), result.differences),
    ):
        rows = [(f.name, f.unit, number(f.first), number(f.second), _mark(f.same)) for f in figures]
        print_grid(console, ('', 'unit', *columns, '>'), rows, title)
    names = ('kind', 'raised', 'delay', 'cleared')
    heads = ('sensor', 'kind', '>raised\n[s]', '>delay\n[s]', '>cleared\n[s]', '>size', '>')
    rows = [
        (p.sensor, *(_both(p, n) for n in names), _both(p, 'size', p.unit), _mark(p.same))
        for p in result.alarms
    ]
    print_grid(console, heads, rows, 'alarms, first run above second')
    console.print('same' if result.same else 'DIFFERENT beyond the tolerances')


def _mark(same: bool) -> str:
    return '' if same else '<- differs'


def _both(pair: comparison.AlarmPair, name: str, unit: str = '') -> str:
    """Attribute of both alarms, one above the other; once if it reads the same."""
    texts = []
    for episode in (pair.first, pair.second):
        value = getattr(episode, name, None)
        if isinstance(value, float):
            value = f'{value:.{decimals(unit)}f} {unit}'.rstrip()
        texts.append(value or '-')
    return texts[0] if pair.same and texts[0] == texts[1] else '\n'.join(texts)
