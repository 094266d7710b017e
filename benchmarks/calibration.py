"""Whether the detector's statistic means what it says: stops on healthy arms against 1/a.

The statistic M of a detector sums likelihood ratios over all times at which a fault may have begun.
On a healthy arm E[M_t] = t after t decisions.  So: watch healthy data, stop whenever M >= a, begin
the sum anew, go on.  If the likelihoods are right there is at most one stop in a decisions, for
every a; a model that is too sure of itself lies above the line 1/a.

    python benchmarks/calibration.py --arm real_arm --recorded --plot calibration.png
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from fault_injection import BY_NAME, Cell, draw
from fault_matrix import add_cell_options, chosen_cells
from rich.console import Console
from scipy.stats import poisson

from lpv.report.table import print_grid

LEVELS = (1e1, 1e2, 1e3, 1e4, 1e5)
"""Values a at which M stops."""


@dataclass(frozen=True)
class Frequency:
    """Stops of one detector at one level."""

    level: float  # a
    decisions: int
    stops: int

    @property
    def per_decision(self) -> float:
        """At most 1/a where likelihoods are right."""
        return self.stops / max(self.decisions, 1)

    @property
    def is_too_high(self) -> bool:
        """Whether chance explains the stops at the rate 1/a in less than 1 of 1000 cases.

        Stops are apart from each other by sums that begin anew, so their number is nearly Poisson.
        """
        expected = self.decisions / self.level
        return bool(poisson.sf(self.stops - 1, expected) < 1e-3)


def count_stops(cell: Cell, k: int, seed: int, level: float) -> tuple[int, int]:
    """Decisions and stops at a level a, in a run of the monitor of a cell without faults."""
    subject, window, _ = draw(cell, k, seed)
    monitor, stream = subject.monitor(), window.stream
    decisions = stops = known = 0
    chunk = max(1, round(0.05 / subject.arm.sample_time))
    for begin in range(0, len(stream.stamps), chunk):
        part = slice(begin, begin + chunk)
        monitor.take_many(stream.stamps[part], *np.moveaxis(stream.samples[part], 1, 0))
        if monitor.log_statistic is None or monitor.decisions == known:
            continue
        known, decisions = monitor.decisions, decisions + 1
        if monitor.log_statistic >= np.log(level):
            stops += 1
            monitor.restart_statistic()
    return decisions, stops


def frequencies(cell: Cell, count: int, seed: int) -> list[Frequency]:
    """Stops over some healthy runs, at each level."""
    result = []
    for level in LEVELS:
        counted = np.sum([count_stops(cell, k, seed, level) for k in range(count)], axis=0)
        result.append(Frequency(level, *counted.tolist()))
    return result


def plot(curves: dict[str, list[Frequency]], file: Path) -> None:
    """Frequencies of stops against 1/a."""
    from matplotlib.figure import Figure

    places: dict[str, dict[str, list[Frequency]]] = {}
    for name, found in curves.items():
        *arm, kind = name.split(maxsplit=3)
        places.setdefault(kind, {})[' '.join(arm)] = found
    arms = list(dict.fromkeys(arm for group in places.values() for arm in group))
    figure = Figure(figsize=(3.2 * len(places) + 2.5, 4.0), layout='constrained')
    line = np.array([min(LEVELS), max(LEVELS)])
    for place, (kind, group) in enumerate(places.items()):
        axes = figure.add_subplot(1, len(places), place + 1, xscale='log', yscale='log')
        axes.plot(line, 1.0 / line, 'k--', label='1/a')
        for arm, found in group.items():
            seen = [one for one in found if one.stops]
            style = dict(color=f'C{arms.index(arm) // 2}', marker='os'[arms.index(arm) % 2])
            axes.plot([one.level for one in seen], [one.per_decision for one in seen],
                      label=arm, **style)  # fmt: skip
        axes.set(title=kind, xlabel='a', ylabel='stops per decision' if place == 0 else None,
                 ylim=(0.5 / line[1], 1.0))  # fmt: skip
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc='outside right', fontsize=7)
    figure.savefig(file)


def print_curves(curves: dict[str, list[Frequency]]) -> None:
    """Stops times a over decisions: at most 1 where likelihoods are right."""
    rows = []
    for name, found in curves.items():
        values = (
            f'{one.per_decision * one.level:.2f} ({one.stops})' + ' !' * one.is_too_high
            for one in found
        )
        rows.append((name, str(found[0].decisions), *values))
    heads = ('', '>decisions', *(f'>a = {level:g}' for level in LEVELS))
    print_grid(Console(width=140), heads, rows, 'stops per decision times a')


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_cell_options(parser)
    parser.add_argument('--kinds', default='healthy,stamps off,gaps,rest 0.1 mrad')
    parser.add_argument('--count', type=int, default=6, help='healthy runs of each arm')
    parser.add_argument('--plot', type=Path, help='picture to write')
    options = parser.parse_args()
    kinds = [BY_NAME[name] for name in options.kinds.split(',')]
    curves = {
        f'{cell.arm} {cell.part} {cell.rates} {cell.kind.name}': frequencies(
            cell, options.count, options.seed
        )
        for cell in chosen_cells(options, kinds)
    }
    if not curves:
        raise SystemExit('there are no such cells')
    print_curves(curves)
    if options.plot:
        plot(curves, options.plot)


if __name__ == '__main__':
    main()
