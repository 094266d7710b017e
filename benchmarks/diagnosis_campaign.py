"""How good is the diagnosis: false alarms, delays, kinds, tracking, over random closed-loop runs.

    python benchmarks/diagnosis_campaign.py --hours 2 --faults 1050 --steps 1000 --wild 1000

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

from lpv_campaign.plan.arms import random_path
from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.arm import load_arm
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement

PAYLOAD = 0.25
"""The model has this payload, the true arm between nothing and twice as much [kg]."""
LENGTH = 20.0
"""Length of a run [s]."""
KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout')
RISES, RATE_STEPS = (0.0, 0.03, 0.06, 0.1, 0.15, 0.25, 0.5, 1.5), 12
"""Times that rates take to go wrong [s], in so many steps."""
DIVERGED = 1.0
"""True tracking error that counts as lost control [rad]."""


def prepare():
    """The paper's arm with the stated spread of healthy arms, its gains, the base scenario."""
    arm = load_arm(bringup_file('arms', 'paper')).with_payload(PAYLOAD)
    arm = replace(arm, payload=PAYLOAD, coulomb=(1.0, 0.5), viscous=(0.5, 0.3))
    gains = design(arm, load_requirement('paper')).gains
    return arm, gains, load_scenario(bringup_file('scenarios', 'two_faults'))


def random_scenario(arm, base, rng, error=0.05, spread=True):
    """A healthy run on a random path of an arm that the model does not know exactly."""
    times, points = random_path(arm, rng, LENGTH)
    factors = rng.uniform(1.0 - error, 1.0 + error, 4) if spread else np.ones(4)
    return replace(
        base,
        duration=LENGTH,
        seed=int(rng.integers(2**31)),
        times=times,
        points=points,
        obstacle=None,
        faults=(),
        mass_factors=tuple(factors[:2]),
        inertia_factors=tuple(factors[2:]),
        payload=float(rng.uniform(-PAYLOAD, PAYLOAD)) if spread else 0.0,
        friction_factor=float(rng.uniform(0.7, 1.3)) if spread else 1.0,
    )


def random_fault(rng, kind, sensors):
    """A fault of a kind, of a size that matters."""
    sign = rng.choice([-1.0, 1.0])
    size = {
        'bias': sign * rng.uniform(0.1, 0.5),
        'scale': sign * rng.uniform(0.2, 0.5),
        'noise': rng.uniform(0.01, 0.05),
        'spike': rng.uniform(0.1, 0.5),
    }.get(kind, 0.0)
    rate = {'drift': sign * rng.uniform(0.08, 0.3), 'spike': rng.uniform(5.0, 30.0)}.get(kind, 0.0)
    return Fault(
        str(rng.choice(sensors)), kind, float(rng.uniform(2.0, LENGTH - 6.0)), 5.0, size, rate
    )


def tracking_error(arm, run):
    """True tracking error of the absolute angles [rad], shape (n, 2)."""
    joints = JointMap(arm)
    return joints.absolute_position(run.position) - joints.absolute_position(run.reference)


def tracking_rms(arm, run, since=1.0, until=LENGTH):
    """RMS of the true tracking error over a part of the run [rad]."""
    part = (run.time >= since) & (run.time < until)
    return float(np.sqrt(np.mean(tracking_error(arm, run)[part] ** 2)))


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


def events_of(run, fault):
    """Alarm events of a fault's own sensor while it acts."""
    begin, end = fault.onset * 1e9, (fault.onset + fault.duration) * 1e9
    return [
        a
        for a in run.alarms
        if a.sensor == fault.sensor and a.onset >= begin - 1e8 and a.detected < end
    ]


def fault_run(number, kind=None, rate=None):
    """What one random fault leads to, beside the same run without it."""
    arm, gains, base = _shared
    rng = np.random.default_rng([2, number])
    kind = KINDS[number % len(KINDS)] if kind is None else kind
    scenario = random_scenario(arm, base, rng)
    fault = random_fault(rng, kind, arm.sensor_names)
    if rate is not None:
        fault = replace(fault, rate=rate, size=0.0)
    run = run_closed_loop(arm, gains, replace(scenario, faults=(fault,)))
    own = events_of(run, fault)
    wrong = [a for a in run.alarms if a.sensor != fault.sensor and a.event == AlarmEvent.RAISED]
    found = own[0] if own else None
    kinds = [a.kind for a in own if a.event != AlarmEvent.CLEARED]
    result = {
        'kind': kind,
        'said': kinds[-1] if kinds else 'nothing',
        'wrong': len(wrong),
        'delay': (found.detected / 1e9 - fault.onset) if found else np.nan,
        'size': abs(found.size) if found else np.nan,
        'error': (abs(found.size - fault.size) if found and kind == 'bias' else np.nan),
        'ratio': np.nan,
        'after': np.nan,
    }
    if found:
        twin = run_closed_loop(arm, gains, scenario)
        for name, since in (('ratio', 0.0), ('after', found.detected / 1e9)):
            until = fault.onset + fault.duration if since else LENGTH
            result[name] = tracking_rms(arm, run, since, until) / tracking_rms(
                arm, twin, since, until
            )
    return result


def step_run(number):
    """Steps just above what is guaranteed to be detected, on one sensor or on both at once."""
    arm, gains, base = _shared
    rng = np.random.default_rng([3, number])
    scenario = random_scenario(arm, base, rng)
    onset = float(rng.uniform(2.0, LENGTH - 3.0))
    healthy = run_closed_loop(arm, gains, scenario)
    # A step of twice the threshold is beyond it whatever the estimate's healthy error is.
    sizes = 2.0 * healthy.threshold[round(onset / arm.sample_time)] * rng.uniform(1.0, 1.2, 2)
    hit = [(0,), (1,), (0, 1)][number % 3]
    faults = tuple(
        Fault(arm.sensor_names[i], 'bias', onset, 2.0, float(sizes[i] * rng.choice([-1.0, 1.0])))
        for i in hit
    )
    run = run_closed_loop(arm, gains, replace(scenario, faults=faults))
    delays = []
    for fault in faults:
        own = events_of(run, fault)
        delays.append(own[0].detected / 1e9 - onset if own else np.inf)
    sensors = {a.sensor_index for a in run.alarms if a.event == AlarmEvent.RAISED}
    return max(delays), sensors == set(hit), len(hit)


def wild_run(number):
    """A random fault of any kind, rate sensors included, on an arm with +-10 % of model error."""
    arm, gains, base = _shared
    rng = np.random.default_rng([4, number])
    scenario = random_scenario(arm, base, rng, error=0.1)
    kind = (*KINDS, 'rate_bias')[number % (len(KINDS) + 1)]
    if kind == 'rate_bias':
        fault = Fault(
            str(rng.choice(arm.sensor_names)),
            kind,
            float(rng.uniform(2.0, 14.0)),
            5.0,
            float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 1.0)),
        )
    else:
        fault = random_fault(rng, kind, arm.sensor_names)
    run = run_closed_loop(arm, gains, replace(scenario, faults=(fault,)))
    largest = float(np.abs(tracking_error(arm, run)).max())
    stops = int(np.sum(np.diff(run.braked.astype(int)) == 1))
    before = sum(
        a.event == AlarmEvent.RAISED and a.detected < fault.onset * 1e9 for a in run.alarms
    )
    finite = np.isfinite(run.position).all() and np.isfinite(run.torque).all()
    return kind, largest if finite else np.inf, stops, before


def rate_run(number):
    """A rate sensor that goes wrong suddenly or little by little."""
    arm, gains, base = _shared
    rng = np.random.default_rng([6, number])
    scenario, rise = random_scenario(arm, base, rng), RISES[number % len(RISES)]
    size = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.01), np.log(1.0)))
    sensor, onset = str(rng.choice(arm.sensor_names)), float(rng.uniform(2.0, 14.0))
    faults = tuple(
        Fault(
            sensor,
            'rate_bias',
            onset + rise * (k + 0.5) / RATE_STEPS,
            5.0,
            float(size / RATE_STEPS),
        )
        for k in range(RATE_STEPS)
    )
    run = run_closed_loop(arm, gains, replace(scenario, faults=faults))
    kinds = {a.kind for a in run.alarms}
    return (
        rise,
        'inconsistent' in kinds,
        bool(kinds - {'inconsistent'}),
        float(np.abs(tracking_error(arm, run)).max()),
    )


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
        table.add_row(
            kind,
            *(str(said[n] or '') for n in names),
            f'{np.nanmedian(delays):.0f}',
            f'{np.nanmax(delays):.0f}',
            str(sum(r['wrong'] > 0 for r in group)),
        )
    console.print(table)
    console.print(f'largest error of a bias {np.nanmax([r["error"] for r in results]):.4f} rad')
    table = Table(title='true tracking RMS over that of the same run without the fault')
    for name in (
        'fault',
        'while confirmed: median',
        '95 %',
        'max',
        'whole run: median',
        '95 %',
        'max',
    ):
        table.add_column(name, justify='right')
    for kind, group in by_kind.items():
        row = []
        for name in ('after', 'ratio'):
            values = np.array([r[name] for r in group])
            values = values[np.isfinite(values)]
            row += (
                [f'{v:.2f}' for v in (np.median(values), np.percentile(values, 95), values.max())]
                if len(values)
                else [''] * 3
            )
        table.add_row(kind, *row)
    console.print(table)


def show_steps(results, console):
    """Detection of steps above the guaranteed size."""
    delays = np.array([delay for delay, _, _ in results])
    right = sum(ok for _, ok, _ in results)
    both = sum(count == 2 for _, _, count in results)
    console.print(
        f'steps above the guaranteed size: {len(results)} runs, {both} of them with both '
        f'sensors; detected {np.isfinite(delays).sum()}, all and only the right sensors '
        f'{right}, largest delay {1e3 * delays.max():.0f} ms'
    )


def show_wild(results, console):
    """Robustness: divergence and safe stops."""
    table = Table(title=f'+-10 % model error, {len(results)} runs')
    for name in (
        'fault',
        'runs',
        'lost control',
        'largest error [rad]',
        'runs with safe stops',
        'safe stops',
        'alarms before the fault',
    ):
        table.add_column(name, justify='right')
    by_kind = defaultdict(list)
    for kind, *rest in results:
        by_kind[kind].append(rest)
    for kind, group in by_kind.items():
        error, stops, before = (np.array(column) for column in zip(*group))
        table.add_row(
            kind,
            str(len(group)),
            str(int(np.sum(error > DIVERGED))),
            f'{error.max():.3f}',
            str(int(np.sum(stops > 0))),
            str(int(stops.sum())),
            str(int(before.sum())),
        )
    console.print(table)


def show_rates(results, console):
    """Who is blamed for rates that go wrong, by how gradually they do."""
    table = Table(title='rate sensors that go wrong by 0.01 to 1 rad/s')
    for name in ('within [s]', 'runs', 'inconsistent', 'position blamed', 'largest error [rad]'):
        table.add_column(name, justify='right')
    for rise in RISES:
        group = [result for result in results if result[0] == rise]
        if group:
            _, found, blamed, errors = zip(*group)
            table.add_row(
                f'{rise:g}',
                str(len(group)),
                str(sum(found)),
                str(sum(blamed)),
                f'{max(errors):.3f}',
            )
    console.print(table)


def show_drifts(results, console):
    """Delay and size at detection by rate."""
    table = Table(title='drifts')
    for name in (
        'rate [rad/s]',
        'detected',
        'delay mean [s]',
        'delay max [s]',
        'size mean [rad]',
        'named drift',
    ):
        table.add_column(name, justify='right')
    by_rate = defaultdict(list)
    for rate, result in results:
        by_rate[rate].append(result)
    for rate, group in sorted(by_rate.items()):
        delay = np.array([r['delay'] for r in group])
        size = np.array([r['size'] for r in group])
        found = np.isfinite(delay)
        row = (
            [
                f'{np.mean(delay[found]):.2f}',
                f'{delay[found].max():.2f}',
                f'{np.mean(size[found]):.3f}',
            ]
            if found.any()
            else ['', '', '']
        )
        row.append(str(sum(r['said'] == 'drift' for r in group)))
        table.add_row(f'{rate:g}', f'{found.sum()}/{len(group)}', *row)
    console.print(table)


def main():
    """Run all parts and print what they show."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=0.05, help='healthy motion [h] (0.05)')
    parser.add_argument('--faults', type=int, default=42, help='random faults of all kinds (42)')
    parser.add_argument('--rates', type=int, default=40, help='faults of rate sensors (40)')
    parser.add_argument('--drifts', type=int, default=4, help='drifts of each rate (4)')
    parser.add_argument('--steps', type=int, default=30, help='steps of guaranteed size (30)')
    parser.add_argument('--wild', type=int, default=40, help='runs with +-10 % model error (40)')
    arguments = parser.parse_args()
    console, began = Console(width=160), time.monotonic()
    runs = max(1, round(arguments.hours * 3600.0 / LENGTH))
    with multiprocessing.Pool(initializer=_start, initargs=(prepare(),)) as pool:
        healthy = pool.map(healthy_run, range(runs), chunksize=1)
        alarms = Counter(alarm for found, _ in healthy for alarm in found)
        console.print(
            f'healthy, model error, payload, friction: {runs} runs of {LENGTH:g} s = '
            f'{runs * LENGTH / 3600:.2f} h, alarms: {dict(alarms) or "none"}, largest '
            f'estimate over threshold {max(s for _, s in healthy):.2f}'
        )
        few = pool.map(exact_run, range(max(1, runs // 10)), chunksize=1)
        console.print(
            f'healthy, exact model: {len(few)} runs, alarms: '
            f'{sum(len(f) for f, _ in few)}, largest estimate over threshold '
            f'{max(s for _, s in few):.2f}'
        )
        show_faults(pool.map(fault_run, range(arguments.faults), chunksize=1), console)
        show_steps(pool.map(step_run, range(arguments.steps), chunksize=1), console)
        show_wild(pool.map(wild_run, range(arguments.wild), chunksize=1), console)
        show_rates(pool.map(rate_run, range(arguments.rates), chunksize=1), console)
        rates = (0.02, 0.05, 0.1, 0.2)
        jobs = [(n, rate) for rate in rates for n in range(arguments.drifts)]
        show_drifts(pool.map(drift_run, jobs, chunksize=1), console)
    console.print(f'{time.monotonic() - began:.0f} s')


if __name__ == '__main__':
    main()
