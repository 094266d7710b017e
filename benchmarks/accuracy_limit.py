"""How near our estimates are to the best that any estimator could do on the same data.

    python benchmarks/accuracy_limit.py                      # under 2 minutes on one core
    python benchmarks/accuracy_limit.py --runs 8 --jobs 2    # the tables of docs/accuracy-limit.md

Random closed-loop runs as in diagnosis_campaign.py: the true arm differs from the model within what
the arm file states.  The first tables put our estimates beside FilterPy's EKF and UKF, a
full-information smoother and Cramer-Rao bounds; the others say where the gap of the level comes
from, by changing one thing at a time: of the data, of our tuning, of what a filter that learns the
arm is told.  Every figure is the root of a mean square over all runs [mrad].
"""

import argparse
import multiprocessing
import time
from dataclasses import replace

import numpy as np
from diagnosis_campaign import LENGTH, prepare, random_scenario
from rich.console import Console
from rich.table import Table

from lpv_campaign.limit.accuracy import NAMES, limit_figures, windows
from lpv_campaign.limit.arm_prior import known_within_priors
from lpv_campaign.limit.cramer_rao_bound import accuracy_limit
from lpv_campaign.limit.fault_prior import anything, random_walks
from lpv_campaign.limit.problem import Problem
from lpv_campaign.limit.smoother import filter_adaptively
from lpv_core.decision.diagnosis import AlarmEvent, DiagnosisParameters
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault

ONSET, LASTING = 6.0, 8.0
FIRST, SECOND = 0, 1
EXACT = {
    'mass_factors': (1.0, 1.0),
    'inertia_factors': (1.0, 1.0),
    'payload': 0.0,
    'friction_factor': 1.0,
}
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
    'ours': 'ours',
    'ours, confirmed': 'confirmed',
    'EKF': 'ekf',
    'UKF': 'ukf',
    'adaptive': 'adaptive',
    'smoother': 'smoother',
    'limit: arm known': 'limit_arm_known',
    'limit: within priors': 'limit_within_priors',
    'limit, any fault: arm known': 'limit_any_fault_arm_known',
    'limit, any fault: within priors': 'limit_any_fault_within_priors',
}
NO_MEAN = {'disturbance_mean': 0.0}
VARIANTS = {
    'as stated': ({}, {}, 1.0),
    'masses and inertias exact': (
        {},
        {n: EXACT[n] for n in ('mass_factors', 'inertia_factors')},
        1.0,
    ),
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


DRIFTS = {
    'as stated': ({}, {}),
    'threshold half': ({}, {'threshold_factor': 0.5}),
    'stated payload half': ({'payload': 0.125}, {}),
    'stated payload and model error a tenth': ({'payload': 0.025, 'model_error': 0.005}, {}),
}
"""Changes of the arm file and of the diagnosis; the simulated arm stays the same."""
TOLD = {
    'the truth': ({}, {}),
    'no mean disturbance': (NO_MEAN, {}),
    'torques 2 % too large': ({}, {'torque': 1.02}),
    'rates 1 % too large': ({}, {'measured_velocity': 1.01}),
    'half the noise of the rates': ({'velocity_noise': 0.005}, {}),
    'payload known within 0.05 kg': ({'payload': 0.05}, {}),
    'masses, inertias and payload as nominal': ({'payload': 0.0, 'model_error': 0.0}, {}),
}
"""Changes of what the filter is told of the arm; factors of the data that it sees."""


def make_fault(arm, sensor, kind, size=0.0, rate=0.0):
    """A fault of a case."""
    return Fault(arm.sensor_names[sensor], kind, ONSET, LASTING, size, rate)


def simulate(number, faults, changes, arm_changes=None, gain=1.0, tuning=None):
    """Run a random scenario; the arm, the scenario and the run."""
    arm, gains, base = _shared
    scenario = random_scenario(arm, base, np.random.default_rng([5, number]))
    scenario = replace(scenario, faults=tuple(make_fault(arm, *f) for f in faults), **changes)
    arm = replace(arm, **(arm_changes or {}))
    observer = replace(gains.observer, kappa=tuple(gain * k for k in gains.observer.kappa))
    # The certificate is of the arm as stated; here the same gains meet another one.
    gains = replace(gains, arm_sha256=arm.sha256(), observer=observer)
    run = run_closed_loop(arm, gains, scenario, parameters=DiagnosisParameters(**(tuning or {})))
    return arm, scenario, run


def case_run(job):
    """Figures of one run of a case."""
    name, number = job
    arm, scenario, run = simulate(number, *CASES[name])
    return name, limit_figures(arm, scenario, run)


def variant_run(job):
    """Figures of one healthy run of a variant."""
    name, number = job
    arm_changes, changes, gain = VARIANTS[name]
    arm, scenario, run = simulate(number, (), changes, arm_changes, gain)
    found = limit_figures(arm, scenario, run, peers=False, smoother=False)
    known = known_within_priors(arm, scenario)
    walk = accuracy_limit(Problem(arm, scenario, run, known, random_walks(arm, run)))
    found['fault_walk'] = np.sqrt(np.mean(walk.fault[windows(arm, scenario, run)[0]] ** 2))
    return name, found


def drift_run(job):
    """Error of a drift's confirmed part, by tuning of the diagnosis."""
    name, number = job
    arm_changes, tuning = DRIFTS[name]
    arm, scenario, run = simulate(number, CASES['drift on 1'][0], {}, arm_changes, 1.0, tuning)
    found = limit_figures(arm, scenario, run, peers=False, smoother=False)
    found['false alarms'] = sum(
        a.event == AlarmEvent.RAISED and (a.detected < ONSET * 1e9 or a.sensor_index != FIRST)
        for a in run.alarms
    )
    found['threshold'] = run.threshold[run.time >= ONSET, FIRST].mean()
    return name, found


def told_run(job):
    """Error of the filter that learns the arm, by what it is told."""
    name, number = job
    arm_changes, factors = TOLD[name]
    arm, scenario, run = simulate(number, BIASES, {})
    for signal, factor in factors.items():
        run = replace(run, **{signal: factor * getattr(run, signal)})
    told = replace(arm, **arm_changes)
    known = known_within_priors(told, scenario)
    fault, _ = filter_adaptively(Problem(told, scenario, run, known, anything(run)))
    mask = windows(arm, scenario, run)[0]
    error = (fault - run.fault)[mask]
    return name, {'fault': np.sqrt(np.mean(error**2)), 'largest': np.abs(error).max()}


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
    for quantity, title in (
        ('fault', 'error of the faults of position sensors'),
        ('angle', 'error of the absolute joint angles'),
    ):
        table = Table(title=f'{title}, RMS, mrad')
        for name in (
            '',
            *COLUMNS,
            'ours/limit',
            'confirmed/limit',
            'ours/limit any fault',
            'EKF/limit',
        ):
            table.add_column(name, justify='right' if name else 'left')
        for name in CASES:
            found = pooled(results, name)
            values = {key: found[f'{quantity}_{key}'] for key in COLUMNS.values()}
            least, free = values['limit_within_priors'], values['limit_any_fault_within_priors']
            ratios = (
                values['ours'] / least,
                values['confirmed'] / least,
                values['ours'] / free,
                values['ekf'] / least,
            )
            if np.isfinite(values['ours']):
                table.add_row(name, *map(cell, values.values()), *(f'{r:.3g}' for r in ratios))
        console.print(table)


def show_variants(results, console):
    """What the gap is made of."""
    table = Table(title='healthy: error of the level, RMS, mrad')
    columns = {
        'ours': 'ours',
        'limit: arm known': 'limit_arm_known',
        'limit: within priors': 'limit_within_priors',
        'limit, random walk: within priors': 'walk',
        'limit, any fault: within priors': 'limit_any_fault_within_priors',
        'limit, any fault: arm known': 'limit_any_fault_arm_known',
    }
    for name in ('', *columns):
        table.add_column(name, justify='right' if name else 'left')
    for name in VARIANTS:
        found = pooled(results, name)
        table.add_row(name, *(cell(found[f'fault_{key}']) for key in columns.values()))
    console.print(table)


def show_drifts(results, console):
    """What the threshold costs."""
    table = Table(title='drift on 1: error of the faults, RMS, mrad')
    for name in ('', 'ours', 'ours, confirmed', 'mean threshold', 'wrong alarms'):
        table.add_column(name, justify='right' if name else 'left')
    for name in DRIFTS:
        found = pooled(results, name)
        wrong = sum(figures['false alarms'] for case, figures in results if case == name)
        table.add_row(
            name,
            cell(found['fault_ours']),
            cell(found['fault_confirmed']),
            cell(found['threshold']),
            str(wrong),
        )
    console.print(table)


def show_told(results, console):
    """What a filter that learns the arm rests on."""
    table = Table(title='filter that learns the arm, biases on both sensors, mrad')
    for name in ('what it is told', 'RMS', 'largest error in any run'):
        table.add_column(name, justify='right' if name != 'what it is told' else 'left')
    for name in TOLD:
        largest = max(figures['largest'] for case, figures in results if case == name)
        table.add_row(name, cell(pooled(results, name)['fault']), cell(largest))
    console.print(table)


_shared = None


def _start(shared):
    global _shared
    _shared = shared


def main():
    """Run all cases and print what they show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=1, help='runs of each case (1)')
    parser.add_argument(
        '--variants',
        type=int,
        default=None,
        help='runs of each variant of the gap analysis (as --runs)',
    )
    parser.add_argument('--jobs', type=int, default=1, help='processes (1)')
    arguments = parser.parse_args()
    console, began = Console(width=200), time.monotonic()
    variants = arguments.runs if arguments.variants is None else arguments.variants
    with multiprocessing.Pool(arguments.jobs, _start, (prepare(),)) as pool:
        jobs = [(name, number) for name in CASES for number in range(arguments.runs)]
        results = pool.map(case_run, jobs, chunksize=1)
        broken = {key for _, found in results for key in NAMES if np.isnan(found[key])}
        console.print(
            f'{arguments.runs} runs of {LENGTH:g} s a case; figures that not every run '
            f'has: {", ".join(sorted(broken)) or "none"}'
        )
        show_cases(results, console)
        jobs = [(name, number) for name in VARIANTS for number in range(variants)]
        if jobs:
            show_variants(pool.map(variant_run, jobs, chunksize=1), console)
            for names, work, show in (
                (DRIFTS, drift_run, show_drifts),
                (TOLD, told_run, show_told),
            ):
                jobs = [(name, number) for name in names for number in range(variants)]
                show(pool.map(work, jobs, chunksize=1), console)
    console.print(f'{time.monotonic() - began:.0f} s')


if __name__ == '__main__':
    main()
