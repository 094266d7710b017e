"""Attempts to break the thresholds: six arms at three sample rates, each searched by `lpv falsify`.

Gains are designed for every case from the shipped requirements.  Each search looks for the healthy
run within the arm file that brings an estimate nearest to its threshold; a ratio of 1 or more
breaks the bound, and the exit code says so.  Cheap cases come first, and every finished case is
printed at once, its worst run kept: a search that is stopped loses one case only.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from lpv import load_arm
from lpv.campaign.falsify.attack import Attacker
from lpv.campaign.falsify.search import search, write_worst
from lpv.core.serial_arm.two_links import Link, two_link_arm
from lpv.core.uio.planar import planar_model
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

SAMPLE_RATES = (100, 500, 1000)


def _rods(masses: tuple[float, float], length: float) -> tuple[Link, Link]:
    """Two slender rods."""
    one, two = (Link(m, length, 0.5 * length, m * length**2 / 3.0) for m in masses)
    return one, two


ARMS: dict[str, dict[str, Any]] = {
    'paper': {},
    'real_arm': {},
    # 0.1 kg in all, 0.2 m long; its disturbance scales with it.
    'light': {'links': _rods((0.06, 0.04), 0.1), 'torque_limit': (0.5, 0.15)},
    # 100 kg in all, 2 m long.
    'heavy': {'links': _rods((60.0, 40.0), 1.0), 'torque_limit': (6e3, 2e3)},
    # Coulomb friction of a sixth and a quarter of the largest gravity torques.
    'rubbing': {'coulomb': (16.0, 6.0), 'viscous': (1.0, 0.5), 'payload': 0.2},
    # Sensors and surroundings without much noise, a model that is 15 % wrong.
    'quiet': {
        'position_noise': 1e-5, 'velocity_noise': 1e-4, 'disturbance_variance': 1e-4,
        'model_error': 0.15,
    },
}  # fmt: skip
"""Arms, by what differs from the shipped arm of that name, or else from the paper's."""


def attack(name: str, rate: int, options: argparse.Namespace) -> dict[str, object]:
    """Design one case, search it, keep its worst run; ``cpu_time`` is that of the search [s]."""
    shipped = name if name == 'real_arm' else 'paper'
    changes = {'name': name, 'sample_time': 1.0 / rate, **ARMS[name]}
    arm = two_link_arm(replace(planar_model(load_arm(shipped)), **changes))
    gains = design(arm, load_requirement(shipped)).gains
    attacker = Attacker(arm, options.duration, gains)
    start = time.process_time()
    found = search(attacker, options.evaluations, options.seed)
    spent, worst = time.process_time() - start, found[0]
    write_worst(attacker, worst, Path(options.out) / f'{name}_{rate}')
    return {
        'arm': name,
        'rate': rate,
        'runs': options.evaluations,
        'worst_ratio': round(worst.ratio, 4),
        'sensor': arm.sensor_names[worst.sensor],
        'threshold': round(float(worst.thresholds[worst.sensor]), 6),
        'crossings': sum(one.ratio >= 1.0 for one in found),
        'cpu_time': round(spent, 1),
    }


def main() -> int:
    """Attack all cases, cheapest first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--evaluations', type=int, default=20_000, help='runs of each case')
    parser.add_argument('--duration', type=float, default=6.0, help='of a run [s]')
    parser.add_argument('--seed', type=int, default=0, help='of the searches')
    parser.add_argument('--arms', nargs='+', choices=ARMS, default=list(ARMS))
    parser.add_argument('--rates', nargs='+', type=int, default=list(SAMPLE_RATES), help='[Hz]')
    parser.add_argument('--out', default='out/falsifier', help='folder of worst runs')
    options = parser.parse_args()
    broken = 0
    for rate in sorted(options.rates):
        for name in options.arms:
            try:
                row = attack(name, rate, options)
            except InfeasibleError as error:
                print(f'{name} at {rate} Hz: not designed: {error}', file=sys.stderr)
                broken += 1
                continue
            broken += int(str(row['crossings']))
            print(' '.join(f'{key}={value}' for key, value in row.items()), flush=True)
    return min(broken, 1)


if __name__ == '__main__':
    sys.exit(main())
