"""How good is the diagnosis: false alarms, delays, kinds, tracking, over random closed-loop runs.

    python benchmarks/diagnosis_campaign.py --hours 2 --faults 1000

Runs on all cores; every run follows from its number alone.  Paths are random inside the certified
region; the true arm differs from the model within what the arm file states: masses and inertias
+-5 %, payload 0 to 0.5 kg, friction 70 to 130 %.
"""

import argparse
import multiprocessing
import time
from collections import Counter, defaultdict
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from lpv_core.arm import load_arm
from lpv_core.closed_loop import run_closed_loop
from lpv_core.diagnosis import AlarmEvent
from lpv_core.errors import LpvError
from lpv_core.faults import Fault
from lpv_core.joints import JointMap
from lpv_core.kinematics import forward
from lpv_core.resources import bringup_file
from lpv_core.scenario import load_scenario
from lpv_design.pipeline import design
from lpv_design.requirement import load_requirement

PAYLOAD = 0.25
"""The model has this payload, the true arm between nothing and twice as much [kg]."""
LENGTH = 20.0
"""Length of a run [s]."""
KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout')


def prepare():
    """The paper's arm with the stated spread of healthy arms, its gains, the base scenario."""
    arm = load_arm(bringup_file('arms', 'paper')).with_payload(PAYLOAD)
    arm = replace(arm, payload=PAYLOAD, coulomb=(1.0, 0.5), viscous=(0.5, 0.3))
    gains = design(arm, load_requirement('paper')).gains
    return arm, gains, load_scenario(bringup_file('scenarios', 'two_faults'))


def random_scenario(arm, base, rng, error=0.05, spread=True):
    """A healthy run on a random path of an arm that the model does not know exactly."""
    joints = JointMap(arm)
    while True:
        count = int(rng.integers(3, 7))
        times = np.linspace(0.5, LENGTH - 0.5, count)
        one = rng.uniform(-0.8, 0.5, count)
        theta = np.column_stack([one, one + rng.uniform(0.25, 0.8, count)])
        points = forward(joints.joint_position(theta), arm.lengths)
        factors = rng.uniform(1.0 - error, 1.0 + error, 4) if spread else np.ones(4)
        scenario = replace(
            base, duration=LENGTH, seed=int(rng.integers(2**31)), times=tuple(times),
            points=tuple(map(tuple, points)), obstacle=None, faults=(),
            mass_factors=tuple(factors[:2]), inertia_factors=tuple(factors[2:]),
            payload=float(rng.uniform(-PAYLOAD, PAYLOAD)) if spread else 0.0,
            friction_factor=float(rng.uniform(0.7, 1.3)) if spread else 1.0)
        try:
            path = scenario.path(arm).sample(np.linspace(0.0, LENGTH, 400))
        except LpvError:
            continue
        inside = np.cos(joints.absolute_position(path.position)).min() > 0.45
        if inside and np.abs(path.velocity).max() < 2.0:
            return scenario


def random_fault(rng, kind, sensors):
    """A fault of a kind, of a size that matters."""
    sign = rng.choice([-1.0, 1.0])
    size = {'bias': sign * rng.uniform(0.1, 0.5), 'scale': sign * rng.uniform(0.2, 0.5),
            'noise': rng.uniform(0.01, 0.05), 'spike': rng.uniform(0.1, 0.5)}.get(kind, 0.0)
    rate = {'drift': sign * rng.uniform(0.08, 0.3), 'spike': rng.uniform(5.0, 30.0)}.get(kind, 0.0)
    return Fault(str(rng.choice(sensors)), kind, float(rng.uniform(2.0, LENGTH - 6.0)), 5.0, size,
                 rate)


def tracking_rms(arm, run, after=1.0):
    """RMS of the true tracking error, absolute angles [rad]."""
    joints = JointMap(arm)
    error = joints.absolute_position(run.position) - joints.absolute_position(run.reference)
    return float(np.sqrt(np.mean(error[run.time > after] ** 2)))


def healthy_run(number, spread=True):
    """Alarms and slack of one healthy run."""
    arm, gains, base = _shared
    scenario = random_scenario(arm, base, np.random.default_rng([1, number]), spread=spread)
    run = run_closed_loop(arm, gains, scenario)
    slack = np.max(np.abs(run.fault_estimate) / run.threshold)
    return [(a.sensor, a.kind) for a in run.alarms if a.event == AlarmEvent.RAISED], float(slack)


def exact_run(number):
    """`healthy_run` of an arm without model error."""
    return healthy_run(number, spread=False)


def fault_run(number, kind=None, rate=None):
    """What one random fault leads to."""
    arm, gains, base = _shared
    rng = np.random.default_rng([2, number])
    kind = KINDS[number % len(KINDS)] if kind is None else kind
    scenario = random_scenario(arm, base, rng)
    fault = random_fault(rng, kind, arm.sensor_names)
    if rate is not None:
        fault = replace(fault, rate=rate, size=0.0)
    run = run_closed_loop(arm, gains, replace(scenario, faults=(fault,)))
    before = [a for a in run.alarms if a.detected < fault.onset * 1e9]
    own = [a for a in run.alarms if a.sensor == fault.sensor and a.onset >= fault.onset * 1e9 - 1e8
           and a.detected < (fault.onset + fault.duration) * 1e9]
    wrong = [a for a in run.alarms if a.sensor != fault.sensor and a.event == AlarmEvent.RAISED]
    found = own[0] if own else None
    kinds = [a.kind for a in own if a.event != AlarmEvent.CLEARED]
    return {'kind': kind, 'said': kinds[-1] if kinds else 'nothing', 'wrong': len(wrong),
            'early': len(before), 'rms': tracking_rms(arm, run),
            'delay': (found.detected / 1e9 - fault.onset) if found else np.nan,
            'size': abs(found.size) if found else np.nan,
            'error': (abs(found.size - fault.size) if found and kind == 'bias' else np.nan)}


def drift_run(job):
    """`fault_run` of a drift of a given rate."""
    number, rate = job
    return rate, fault_run(number, 'drift', rate)


_shared = None


def _start(shared):
    global _shared
    _shared = shared


def show_faults(results, console):
    """Confusion matrix, delays and sizes."""
    table = Table(title='faults (rows) and what was said of them')
    names = [*KINDS, 'inconsistent', 'unclassified', 'nothing']
    for name in ('fault', *names, 'delay median [ms]', 'delay max [ms]', 'other sensor'):
        table.add_column(name, justify='right')
    by_kind = defaultdict(list)
    for result in results:
        by_kind[result['kind']].append(result)
    for kind, group in by_kind.items():
        said = Counter(r['said'] for r in group)
        delays = 1e3 * np.array([r['delay'] for r in group])
        table.add_row(kind, *(str(said[n] or '') for n in names), f'{np.nanmedian(delays):.0f}',
                      f'{np.nanmax(delays):.0f}', str(sum(r['wrong'] > 0 for r in group)))
    console.print(table)
    rms = np.array([r['rms'] for r in results])
    console.print(f'true tracking RMS over all faults: median {np.median(rms):.4f}, 95 % '
                  f'{np.percentile(rms, 95):.4f}, max {rms.max():.4f} rad; largest error of a '
                  f'bias {np.nanmax([r["error"] for r in results]):.4f} rad')


def show_drifts(results, console):
    """Delay and size at detection by rate."""
    table = Table(title='drifts')
    for name in ('rate [rad/s]', 'detected', 'delay mean [s]', 'delay max [s]', 'size mean [rad]'):
        table.add_column(name, justify='right')
    by_rate = defaultdict(list)
    for rate, result in results:
        by_rate[rate].append(result)
    for rate, group in sorted(by_rate.items()):
        delay = np.array([r['delay'] for r in group])
        size = np.array([r['size'] for r in group])
        found = np.isfinite(delay)
        row = ([f'{np.mean(delay[found]):.2f}', f'{delay[found].max():.2f}',
                f'{np.mean(size[found]):.3f}'] if found.any() else ['', '', ''])
        table.add_row(f'{rate:g}', f'{found.sum()}/{len(group)}', *row)
    console.print(table)


def main():
    """Run all parts and print what they show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=0.05, help='healthy motion [h] (0.05)')
    parser.add_argument('--faults', type=int, default=42, help='random faults of all kinds (42)')
    parser.add_argument('--drifts', type=int, default=4, help='drifts of each rate (4)')
    arguments = parser.parse_args()
    console, began = Console(width=160), time.monotonic()
    runs = max(1, round(arguments.hours * 3600.0 / LENGTH))
    with multiprocessing.Pool(initializer=_start, initargs=(prepare(),)) as pool:
        healthy = pool.map(healthy_run, range(runs), chunksize=1)
        alarms = Counter(alarm for found, _ in healthy for alarm in found)
        console.print(f'healthy, model error, payload, friction: {runs} runs of {LENGTH:g} s = '
                      f'{runs * LENGTH / 3600:.2f} h, alarms: {dict(alarms) or "none"}, largest '
                      f'estimate over threshold {max(s for _, s in healthy):.2f}')
        few = pool.map(exact_run, range(max(1, runs // 10)), chunksize=1)
        console.print(f'healthy, exact model: {len(few)} runs, alarms: '
                      f'{sum(len(f) for f, _ in few)}, largest estimate over threshold '
                      f'{max(s for _, s in few):.2f}')
        show_faults(pool.map(fault_run, range(arguments.faults), chunksize=1), console)
        rates = (0.02, 0.05, 0.1, 0.2)
        jobs = [(n, rate) for rate in rates for n in range(arguments.drifts)]
        show_drifts(pool.map(drift_run, jobs, chunksize=1), console)
    console.print(f'{time.monotonic() - began:.0f} s')


if __name__ == '__main__':
    main()
