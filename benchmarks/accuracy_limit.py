"""How near our estimates are to the best that any estimator could do on the same data.

    python benchmarks/accuracy_limit.py                      # under 2 minutes on one core
    python benchmarks/accuracy_limit.py --runs 20 --jobs 2   # the table of docs/accuracy-limit.md

Random closed-loop runs as in diagnosis_campaign.py: the true arm differs from the model within what
the arm file states.  The first tables put our estimates beside FilterPy's EKF and UKF, a
full-information smoother and Cramer-Rao bounds; the others say where the gap comes from, by
changing one thing at a time.  Every figure is the root of a mean square over all runs [mrad].
"""

import argparse
import multiprocessing
import time
from dataclasses import replace

import numpy as np
from diagnosis_campaign import LENGTH, prepare, random_scenario
from rich.console import Console
from rich.table import Table

from lpv_campaign.accuracy import NAMES, limit_figures, windows
from lpv_campaign.arm_knowledge import known_within_priors
from lpv_campaign.fault_knowledge import random_walks
from lpv_campaign.limit import accuracy_limit
from lpv_core.closed_loop import run_closed_loop
from lpv_core.faults import Fault

ONSET, LASTING = 6.0, 8.0
FIRST, SECOND = 0, 1
EXACT = {'mass_factors': (1.0, 1.0), 'inertia_factors': (1.0, 1.0), 'payload': 0.0,
         'friction_factor': 1.0}
BIASES = ((FIRST, 'bias', 0.2), (SECOND, 'bias', -0.2))
CASES = {
    'healthy, model exact': ((), EXACT),
    'healthy': ((), {}),
    'bias on 1, model exact': (((FIRST, 'bias', 0.2),), EXACT),
    'bias on 1': (((FIRST, 'bias', 0.2),), {}),
    'bias on 2': (((SECOND, 'bias', 0.2),), {}),
    'bias on both': (BIASES, {}),
    'drift on 1': (((FIRST, 'drift', 0.25, 0.08),), {}),
    'scale on 2': (((SECOND, 'scale', 0.3),), {}),
    'stuck 2': (((SECOND, 'stuck'),), {}),
    'noise on 1': (((FIRST, 'noise', 0.03),), {}),
    'dropout of 1': (((FIRST, 'dropout'),), {}),
}
"""Faults and changes of the random scenario."""
COLUMNS = {
    'ours': 'ours', 'ours, confirmed': 'confirmed', 'EKF': 'ekf', 'UKF': 'ukf',
    'adaptive': 'adaptive', 'smoother': 'smoother', 'limit: arm known': 'limit_arm_known',
    'limit: within priors': 'limit_within_priors',
    'limit, any fault: arm known': 'limit_any_fault_arm_known',
    'limit, any fault: within priors': 'limit_any_fault_within_priors'}
NO_MEAN = {'disturbance_mean': 0.0}
VARIANTS = {
    'as stated': ({}, {}, 1.0),
    'masses and inertias exact': ({}, {n: EXACT[n] for n in ('mass_factors', 'inertia_factors')},
                                  1.0),
    'payload known': ({}, {'payload': 0.0}, 1.0),
    'friction known': ({}, {'friction_factor': 1.0}, 1.0),
    'disturbance without mean': (NO_MEAN, {}, 1.0),
    'no disturbance': ({}, {'disturbance': False}, 1.0),
    'rates without noise': ({'velocity_noise': 1e-5}, {}, 1.0),
    'model exact': ({}, EXACT, 1.0),
    'model exact, no mean (*)': (NO_MEAN, EXACT, 1.0),
    '(*), rates without noise': ({**NO_MEAN, 'velocity_noise': 1e-5}, EXACT, 1.0),
    '(*), no disturbance': ({}, {**EXACT, 'disturbance': False}, 1.0),
    '(*), neither': ({'velocity_noise': 1e-5}, {**EXACT, 'disturbance': False}, 1.0),
    '(*), gain / 10': (NO_MEAN, EXACT, 0.1),
    '(*), gain / 4': (NO_MEAN, EXACT, 0.25),
    '(*), gain x 4': (NO_MEAN, EXACT, 4.0),
    'as stated, gain / 4': ({}, {}, 0.25),
    'as stated, gain x 4': ({}, {}, 4.0),
}
"""Changes of the arm file (and so of the simulation), of the true arm; factor of kappa."""


def make_fault(arm, sensor, kind, size=0.0, rate=0.0):
    """A fault of a case."""
    return Fault(arm.sensor_names[sensor], kind, ONSET, LASTING, size, rate)


def simulate(number, faults, changes, arm_changes=None, gain=1.0):
    """Run a random scenario; the arm, the scenario and the run."""
    arm, gains, base = _shared
    scenario = random_scenario(arm, base, np.random.default_rng([5, number]))
    scenario = replace(scenario, faults=tuple(make_fault(arm, *f) for f in faults), **changes)
    arm = replace(arm, **(arm_changes or {}))
    observer = replace(gains.observer, kappa=tuple(gain * k for k in gains.observer.kappa))
    # The certificate is of the arm as stated; here the same gains meet another one.
    gains = replace(gains, arm_sha256=arm.sha256(), observer=observer)
    return arm, scenario, run_closed_loop(arm, gains, scenario)


def case_run(job):
    """Figures of one run of a case."""
    name, number = job
    arm, scenario, run = simulate(number, *CASES[name])
    return name, limit_figures(arm, scenario, run)


def variant_run(job):
    """Figures of one run of a variant, with biases on both sensors."""
    name, number = job
    arm_changes, changes, gain = VARIANTS[name]
    arm, scenario, run = simulate(number, BIASES, changes, arm_changes, gain)
    found = limit_figures(arm, scenario, run, peers=False, smoother=False)
    walk = accuracy_limit(arm, scenario, run, known_within_priors(arm, scenario),
                          random_walks(arm, run))
    found['fault_walk'] = np.sqrt(np.mean(walk.fault[windows(arm, scenario, run)[0]] ** 2))
    return name, found


def pooled(results, name):
    """Root of the mean square over the runs of a case that have a value."""
    found = {}
    for key in results[0][1]:
        values = np.array([figures[key] for case, figures in results if case == name])
        values = values[np.isfinite(values)]
        found[key] = np.sqrt(np.mean(values**2)) if len(values) else np.nan
    return found


def cell(value):
    """Milliradians with three digits; nothing where there is nothing."""
    return f'{1e3 * value:.3g}' if np.isfinite(value) else '-'


def show_cases(results, console):
    """Ours, peers and limits."""
    for quantity, title in (('fault', 'error of the faults of position sensors'),
                            ('angle', 'error of the absolute joint angles')):
        table = Table(title=f'{title}, RMS [mrad]')
        for name in ('', *COLUMNS, 'ours/limit', 'confirmed/limit', 'ours/limit any fault',
                     'EKF/limit'):
            table.add_column(name, justify='right' if name else 'left')
        for name in CASES:
            found = pooled(results, name)
            values = {key: found[f'{quantity}_{key}'] for key in COLUMNS.values()}
            least, free = values['limit_within_priors'], values['limit_any_fault_within_priors']
            ratios = (values['ours'] / least, values['confirmed'] / least, values['ours'] / free,
                      values['ekf'] / least)
            if np.isfinite(values['ours']):
                table.add_row(name, *map(cell, values.values()), *(f'{r:.3g}' for r in ratios))
        console.print(table)


def show_variants(results, console):
    """What the gap is made of."""
    table = Table(title='biases on both sensors: error of the faults, RMS [mrad]')
    columns = {'ours': 'ours', 'ours, confirmed': 'confirmed',
               'limit: arm known': 'limit_arm_known', 'limit: within priors': 'limit_within_priors',
               'limit, random walk: within priors': 'walk',
               'limit, any fault: within priors': 'limit_any_fault_within_priors',
               'limit, any fault: arm known': 'limit_any_fault_arm_known'}
    for name in ('', *columns):
        table.add_column(name, justify='right' if name else 'left')
    for name in VARIANTS:
        found = pooled(results, name)
        table.add_row(name, *(cell(found[f'fault_{key}']) for key in columns.values()))
    console.print(table)


_shared = None


def _start(shared):
    global _shared
    _shared = shared


def main():
    """Run all cases and print what they show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=2, help='runs of each case (2)')
    parser.add_argument('--variants', type=int, default=None,
                        help='runs of each variant of the gap analysis (as --runs)')
    parser.add_argument('--jobs', type=int, default=1, help='processes (1)')
    arguments = parser.parse_args()
    console, began = Console(width=200), time.monotonic()
    variants = arguments.runs if arguments.variants is None else arguments.variants
    with multiprocessing.Pool(arguments.jobs, _start, (prepare(),)) as pool:
        jobs = [(name, number) for name in CASES for number in range(arguments.runs)]
        results = pool.map(case_run, jobs, chunksize=1)
        broken = {key for _, found in results for key in NAMES if np.isnan(found[key])}
        console.print(f'{arguments.runs} runs of {LENGTH:g} s a case; figures that not every run '
                      f'has: {", ".join(sorted(broken)) or "none"}')
        show_cases(results, console)
        jobs = [(name, number) for name in VARIANTS for number in range(variants)]
        if jobs:
            show_variants(pool.map(variant_run, jobs, chunksize=1), console)
    console.print(f'{time.monotonic() - began:.0f} s')


if __name__ == '__main__':
    main()
