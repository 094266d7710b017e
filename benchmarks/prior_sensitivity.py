"""What half and twice of a prior of the diagnosis change, in per cent of runs of the fault matrix.

    python benchmarks/prior_sensitivity.py STEADY OFFSET_PRIOR "SIZE['drift']" PUSH

Numbers that Python alone reads are replaced; compiled functions keep `SLOW_RATE`, `AMPLITUDES` and
the times of poses as they were compiled.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fault_injection import BY_NAME, cells, run
from fault_matrix import COMPARED, summary

from lpv.core.serial_arm.diagnosis import priors

ARMS = ('real_arm', 'chain3', 'ur10')
KINDS = ('offset 0.5', 'drift 0.3', 'scale 20 %', 'stuck', 'push', 'payload')
COMPILED = {'SLOW_RATE', 'AMPLITUDES', 'POSE_TIME'}


@contextmanager
def scaled(name: str, factor: float) -> Iterator[None]:
    """A prior times a factor, in all modules that have read it; ``SIZE['drift']`` is an entry."""
    base, key = (re.findall(r'\w+', name) + [''])[:2]
    if base in COMPILED:
        raise SystemExit(f'{base} is compiled')
    if key:
        entries = getattr(priors, base)
        holders: list[tuple[Any, str]] = [(entries, key)]
    else:
        old = getattr(priors, base)
        modules = [one for path, one in sys.modules.items() if path.startswith('lpv.core.')]
        holders = [(vars(one), base) for one in modules if vars(one).get(base) is old]
    before = holders[0][0][holders[0][1]]
    now = tuple(factor * one for one in before) if isinstance(before, tuple) else factor * before
    for holder, entry in holders:
        holder[entry] = now
    try:
        yield
    finally:
        for holder, entry in holders:
            holder[entry] = before


def shares(count: int) -> dict[str, float]:
    """Means of shares over all cells; those of healthy encoders count as `other` alone."""
    found: dict[str, list[float]] = {}
    for cell in cells(ARMS, [False, True], ['independent', 'derived'], [BY_NAME[k] for k in KINDS]):
        row = summary(cell, [run(cell, k, 1) for k in range(count)])
        for name in (*COMPARED, 'size'):
            if row.get(name) is not None:
                found.setdefault(name, []).append(row[name])
    return {name: sum(values) / len(values) for name, values in found.items()}


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument(
        'names', nargs='*', help='of `lpv.core.serial_arm.diagnosis.priors`; all single numbers'
    )
    parser.add_argument('--count', type=int, default=1, help='runs of a cell')
    options = parser.parse_args()
    usual = shares(options.count)
    print('as they are:', {name: round(value, 1) for name, value in usual.items()})
    numbers = (name for name, value in vars(priors).items() if isinstance(value, (int, float)))
    for name in options.names or [name for name in numbers if name not in COMPILED]:
        for factor in (0.5, 2.0):
            with scaled(name, factor):
                now = shares(options.count)
            changed = {k: round(v - usual[k], 1) for k, v in now.items() if v != usual[k]}
            print(f'{factor:g} {name}: {changed or "the same"}', flush=True)


if __name__ == '__main__':
    main()
