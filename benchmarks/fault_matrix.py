"""What the diagnosis finds: kind of fault x rates x arm, recorded and simulated.

    python benchmarks/fault_matrix.py --arm real_arm --recorded \\
        --kinds drift,stuck --count 8 --json out.json

Every line is one cell: faults of one kind, of random joint, sign and time, `--count` of them; half
of them end and are followed by a second one, in the other half a second one comes while the first
acts.  `first` = the first alarm names the faulty sensor, `in time` = within the limit of the line,
`kind` = the last kind named while the fault acts is right, `size` = estimate within 0.1 rad 2 s
after the onset, `trusted` = estimates beyond that which were said to be trustworthy, `beyond` =
those that are outside their bound, too, `other` = runs that blame a healthy sensor, `cleared` = no
alarm 3 s after the end, of what was ever alarmed, `outside` = answers after the end that are
trusted with an estimate outside its bound, `second` and `both` = the second fault found in time,
after the end of the first one and beside it, `crash` = runs in which the monitor raised an
exception.

`--bound` runs no diagnosis: it prints the shares of offsets from the start, of drifts and of scale
errors, rates derived, that the data show in time, and of drifts that they tell from a push, too, as
of `limits`.  `--prior` tells what half and twice of priors of the diagnosis change in the means of
all cells; they are numbers that Python alone reads, as compiled functions keep theirs.

Constants of the diagnosis may be chosen on the tuned part of the recordings.  The untouched part is
run with `--untouched` alone, to report, not to choose.
"""

import argparse
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from itertools import product, starmap
from multiprocessing import Pool
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from fault_injection import ARMS, CLOSE, KINDS, Cell, Kind, Verdict, cells, run
from limits import LESS_NOISE, needed, shown
from rich.console import Console

from lpv.core.serial_arm.diagnosis import priors
from lpv.report.table import print_grid

Row = dict[str, Any]
BAR = Path(__file__).with_name('fault_matrix_bar.json')
"""The better of the two engines that the one engine replaced, cell by cell."""
RATES = ('independent', 'derived')
KEY = ('part', 'arm', 'rates', 'kind')
SHARES: dict[str, Callable[[Verdict], float | None]] = {
    'first': lambda v: v.delay is not None,
    'in_time': lambda v: v.in_time,
    'kind_right': lambda v: v.kind_right,
    'size': lambda v: None if v.error is None else v.error <= CLOSE,
    'trusted': lambda v: None if v.error is None else v.error > CLOSE and v.trusted,
    'beyond': lambda v: None if v.error is None else v.error > max(CLOSE, v.bound) and v.trusted,
    'other': lambda v: v.other,
    'cleared': lambda v: v.cleared,
    'outside': lambda v: v.outside,
    'second': lambda v: v.second,
    'both': lambda v: v.both,
    'crash': lambda v: bool(v.crash),
}
"""Of a run; None where there is nothing to say."""
OF_HEALTHY = ('other', 'crash')


def _known(of: Callable[[Verdict], float | None], verdicts: Iterable[Verdict]) -> list[float]:
    return [value for value in map(of, verdicts) if value is not None]


def summary(cell: Cell, verdicts: Sequence[Verdict]) -> Row:
    """One row of the matrix; shares in per cent."""
    row: Row = {
        'part': cell.part,
        'arm': cell.arm,
        'rates': cell.rates,
        'kind': cell.kind.name,
        'count': len(verdicts),
        'events': round(float(np.mean([v.events for v in verdicts])), 2),
        'seconds': round(sum(v.seconds for v in verdicts), 1),
    }
    for name in OF_HEALTHY if cell.kind.healthy else SHARES:
        known = _known(SHARES[name], verdicts)
        row[name] = round(100.0 * float(np.mean(known)), 1) if known else None
    if not cell.kind.healthy:
        for name, most in (('delay', np.inf), ('error', 1e3)):
            known = _known(attrgetter(name), verdicts)
            row[name] = round(min(float(np.median(known)), most), 4) if known else None
        row['named'] = dict(Counter(v.kind or '-' for v in verdicts))
    return row


COMPARED = {'in_time': 1, 'kind_right': 1, 'cleared': 1, 'second': 1, 'both': 1, 'other': -1,
            'crash': -1}  # fmt: skip
"""Shares that are compared with the bar, and which way is better."""
CLOSE_ENOUGH = 1.5
"""Shares that differ by less than so many runs are the same."""


def compared(row: Row, other: Row) -> dict[str, tuple[float, float]]:
    """Shares of a cell, and the bar's, that differ by more than chance of single runs does."""
    one_run = 100.0 / min(row['count'], other['count'])
    found = {}
    for name in COMPARED:
        ours, theirs = row.get(name), other.get(name)
        if ours is None or theirs is None:
            continue
        if abs(ours - theirs) > CLOSE_ENOUGH * one_run:
            found[name] = ours, theirs
    return found


def print_comparison(rows: Iterable[Row], bar: Iterable[Row], console: Console) -> None:
    """Cells that are worse or better than the bar, share by share."""
    known, lines = {tuple(row[name] for name in KEY): row for row in bar}, []
    for row in rows:
        other = known.get(tuple(row[name] for name in KEY))
        found = compared(row, other) if other else {}
        cells = {
            sign: ', '.join(f'{name} {a:.0f} ({b:.0f})' for name, (a, b) in found.items()
                            if (a - b) * COMPARED[name] * sign > 0)
            for sign in (-1, 1)
        }  # fmt: skip
        if found:
            place = ' '.join(row[name] for name in KEY)
            lines.append((place, str(row['count']), cells[-1], cells[1]))
    title = 'per cent, and the better of the two engines before'
    print_grid(console, ('cell', '>n', 'worse', 'better'), lines, title)


HEADINGS = {
    'kind': 'kind', 'count': 'n', 'first': 'first', 'in_time': 'in time',
    'kind_right': 'kind', 'delay': 'delay [s]', 'size': 'size', 'error': 'error [rad]',
    'trusted': 'trusted', 'beyond': 'beyond', 'other': 'other', 'events': 'events',
    'cleared': 'cleared', 'outside': 'outside',
    'second': 'second', 'both': 'both', 'crash': 'crash',
}  # fmt: skip


def _text(name: str, value: Any) -> str:
    if value is None:
        return '-'
    return f'{value:.0f}' if name in SHARES else f'{value:g}' if name != 'kind' and isinstance(
        value, float) else str(value)  # fmt: skip


def print_rows(rows: Sequence[Row], console: Console) -> None:
    """One table for each arm, part and source of rates."""
    groups: dict[str, list[list[str]]] = {}
    for row in rows:
        title = f'{row["arm"]}, {row["part"]}, rates {row["rates"]}'
        cells = [_text(name, row.get(name)) for name in HEADINGS]
        groups.setdefault(title, []).append(cells)
    for title, members in groups.items():
        print_grid(console, tuple(HEADINGS.values()), members, title)


def _kinds(text: str) -> list[Kind]:
    """Kinds whose names begin with one of the words; all without any."""
    words = [word.strip() for word in text.split(',') if word.strip()]
    chosen = [
        kind for kind in KINDS
        if not words or any(kind.name.startswith(word) or kind.kind == word for word in words)
    ]  # fmt: skip
    if not chosen:
        raise SystemExit('--kinds: none of ' + ', '.join(kind.name for kind in KINDS))
    return chosen


def _changed(kind: Kind, limit: float | None, lead: float | None) -> Kind:
    """A kind with another limit, which its faults outlast, and another time before the onset."""
    if limit is not None:
        kind = replace(kind, limit=limit, duration=max(kind.duration, limit + 0.5))
    return kind if lead is None else replace(kind, lead=lead)


def add_cell_options(parser: argparse.ArgumentParser) -> None:
    """Options of scripts that run cells."""
    arms = f'{", ".join(ARMS)} (all if none are given), ur10e, or ur10e_N, robot N, identified'
    parser.add_argument('--arm', action='append', type=_arm, help=arms)
    parser.add_argument('--recorded', action='store_true', help='recordings alone')
    parser.add_argument('--simulated', action='store_true', help='simulations alone')
    parser.add_argument('--untouched', action='store_true', help='the part not tuned to')
    parser.add_argument('--seed', type=int, default=1)


def _arm(name: str) -> str:
    if name not in ARMS and not re.fullmatch(r'ur10e(_\d+)?', name):
        raise argparse.ArgumentTypeError(f'there is no arm {name}')
    return name


def chosen_cells(
    options: argparse.Namespace, kinds: Sequence[Kind], rates: Sequence[str] = RATES
) -> Iterator[Cell]:
    """Cells of the options."""
    recorded = [True] * options.recorded + [False] * options.simulated or [False, True]
    parts = [True] if options.untouched else recorded
    return cells(options.arm or ARMS, parts, rates, kinds, options.untouched)


def measure(
    chosen: Sequence[Cell], runs: Sequence[int], seed: int, say: Any, jobs: int = 1
) -> Iterable[Row]:
    """Rows of cells, one by one."""
    _SHARED.update(cells=chosen, seed=seed)  # processes inherit them: streams are functions
    each = Pool(jobs).starmap if jobs > 1 else starmap
    for number, cell in enumerate(chosen):
        begin = time.process_time()
        row = summary(cell, list(each(_run_cell, [(number, k) for k in runs])))
        say(' '.join(f'{name}={_text(name, row[name])}' for name in dict.fromkeys((*KEY, *HEADINGS))
                     if name in row and row[name] is not None)
            + f' {row.get("named", "")} cpu {time.process_time() - begin:.1f} s')  # fmt: skip
        yield row


def bound(cell: Cell, runs: Sequence[int], seed: int) -> str:
    """What the data of a cell allow, in one line."""
    found, arms = [shown(cell, k, seed) for k in runs], [one.arm for one in cell.subjects]
    least = np.array([needed(arms[k % len(arms)], cell.kind.kind) for k in runs])
    beyond = np.array([powers for powers, _ in found]) > least[:, None]
    shares = zip(LESS_NOISE, beyond.mean(0))
    text = ', '.join(f'/ {factor:g} {share:.0%}' for factor, share in shares)
    named = np.mean([is_named for _, is_named in found])
    drift = f'; named by what was measured {named:.0%}' if cell.kind.kind == 'drift' else ''
    place = f'{cell.arm} {cell.part} {cell.kind.name}, {len(runs)} runs'
    return f'{place}: noise variance {text}{drift}'


COMPILED = {'SLOW_RATE', 'AMPLITUDES', 'POSE_TIME', 'WRONG_STAMPS', 'COARSEST_ROUNDING'}
"""Priors that compiled functions keep; of `STEADY_FOR` it is what readings are corrected by."""


@contextmanager
def scaled_prior(name: str, factor: float) -> Iterator[None]:
    """A prior times a factor; ``SIZE['drift']`` is an entry."""
    base, key = (re.findall(r'\w+', name) + [''])[:2]
    if base in COMPILED or not hasattr(priors, base):
        raise SystemExit(f'--prior: {base} is compiled, or none')
    holder, entry = (getattr(priors, base), key) if key else (vars(priors), base)
    before = holder[entry]
    holder[entry] = (
        tuple(factor * one for one in before) if isinstance(before, tuple) else factor * before
    )
    yield
    holder[entry] = before


def means(rows: Iterable[Row]) -> dict[str, float]:
    """Means of shares over cells; those of healthy encoders count as `other` alone."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for name in SHARES:
            if row.get(name) is not None:
                found.setdefault(name, []).append(row[name])
    return {name: round(float(np.mean(values)), 1) for name, values in found.items()}


def prior_sensitivity(names: Sequence[str], measured: Callable[[], Iterable[Row]]) -> None:
    """Print what half and twice of priors change in the means of what is measured."""
    usual = means(measured())
    print('as they are:', usual)
    for name, factor in product(names, (0.5, 2.0)):
        with scaled_prior(name, factor):
            now = means(measured())
        changed = {share: round(now[share] - usual[share], 1) for share in now}
        differ = {share: change for share, change in changed.items() if change}
        print(f'{factor:g} {name}: {differ or "the same"}', flush=True)


_SHARED: dict[str, Any] = {}


def _run_cell(number: int, k: int) -> Verdict:
    return run(_SHARED['cells'][number], k, _SHARED['seed'])


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_cell_options(parser)
    parser.add_argument('--rates', action='append', choices=RATES)
    parser.add_argument('--kinds', default='', help='beginnings of names, with commas between')
    parser.add_argument('--limit', type=float, help='in which faults are to be named [s]')
    parser.add_argument('--lead', type=float, help='healthy time before an onset [s]')
    parser.add_argument('--first', type=int, default=0, help='number of the first run of a cell')
    parser.add_argument('--count', type=int, default=8, help='runs of a cell')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--json', type=Path, help='file for rows')
    parser.add_argument('--resume', action='store_true', help='leave out cells that the file has')
    parser.add_argument('--bar', type=Path, default=BAR, help='rows to compare with')
    parser.add_argument('--show', action='store_true', help='show the rows of --json, run nothing')
    parser.add_argument('--bound', action='store_true', help='print what the data allow')
    parser.add_argument('--prior', nargs='+', help="of `priors`, STEADY or SIZE['drift']")
    parser.add_argument('--alarms', action='store_true', help='print every alarm event')
    options = parser.parse_args()
    kinds = [_changed(kind, options.limit, options.lead) for kind in _kinds(options.kinds)]
    chosen = list(chosen_cells(options, kinds, options.rates or RATES))
    runs = range(options.first, options.first + options.count)
    if not chosen:
        raise SystemExit('there are no such cells (recordings: see $LPV_RECORDINGS)')
    rows: list[Row] = []
    if (options.resume or options.show) and options.json and options.json.is_file():
        rows = json.loads(options.json.read_text())
        done = {tuple(row[name] for name in KEY) for row in rows}
        chosen = [c for c in chosen
                  if (c.part, c.arm, c.rates, c.kind.name) not in done]  # fmt: skip

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    if options.alarms:
        for cell in chosen:
            for k in runs:
                verdict = asdict(run(cell, k, options.seed))
                say(f'{cell.arm} {cell.kind.name} {k}: {verdict}')
        return
    if options.bound:
        for cell in chosen:
            judged = cell.kind.from_start or cell.kind.kind in ('drift', 'scale')
            if cell.rates == 'derived' and judged:
                print(bound(cell, runs, options.seed), flush=True)
        return
    if options.prior:
        cells = chosen, runs, options.seed, lambda _: None, options.jobs
        prior_sensitivity(options.prior, partial(measure, *cells))
        return
    for row in measure([] if options.show else chosen, runs, options.seed, say, options.jobs):
        rows.append(row)
        if options.json:
            options.json.write_text('[\n' + ',\n'.join(map(json.dumps, rows)) + '\n]\n')
    console = Console(width=170)
    print_rows(rows, console)
    if options.bar.is_file():
        print_comparison(rows, json.loads(options.bar.read_text()), console)


if __name__ == '__main__':
    main()
