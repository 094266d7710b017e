"""How fast a campaign runs: against plain C, by parts, by vertices, and over all cores.

    python benchmarks/campaign_speed.py                 # 200 runs of 20 s at 1 kHz
    python benchmarks/campaign_speed.py --runs 10000

The peer is `closed_loop_floor.c`: the bare arithmetic of a step without faults, decisions, alarms
and recording, compiled by the C compiler of this machine with -O3.
"""

import argparse
import ctypes
import resource
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from lpv_campaign.execution.execute import chunks_of, worker_pool
from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.execution.runs import plan_run, run_one
from lpv_campaign.plan.campaign import Campaign, resolve
from lpv_core.bound.error_bound import update_bound
from lpv_core.control.tracking import TRACKING_STATE, track, tracking_constants
from lpv_core.model.arm import constants_vector
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.monitor import SensorMonitor, monitor_step
from lpv_core.observer.paper_observer import blend
from lpv_core.observer.sampled_observer import observe
from lpv_core.simulation.arm_simulator import (
    ArmSimulator,
    brake,
    integrate,
    read_sensors,
    set_torque,
)
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record

SPEC = {
    'name': 'speed',
    'seed': 5,
    'duration': 20.0,
    'factors': {
        'path': 'random',
        'sample_time': 0.001,
        'fault.kind': ['none', 'bias', 'drift', 'stuck', 'scale', 'noise', 'spike', 'dropout'],
        'fault.sensor': ['link1_angle', 'link2_angle', 'both'],
        'fault.size': {
            'bias': {'low': 0.05, 'high': 0.5},
            'scale': 0.3,
            'noise': 0.03,
            'spike': 0.3,
        },
        'fault.rate': {'drift': 0.1, 'spike': 10.0},
        'fault.onset': {'low': 5.0, 'high': 10.0},
        'fault.duration': 5.0,
        'mass_1': {'low': 0.95, 'high': 1.05},
        'mass_2': {'low': 0.95, 'high': 1.05},
    },
}
ROUNDS = 5


def campaign_of(runs):
    """The campaign with so many runs."""
    return resolve({**SPEC, 'plan': {'method': 'random', 'runs': runs}}, 'speed', '.')


# ------------------------------------------------------------------ the floor in C


def build_floor(folder):
    """Compile the C program; its function."""
    library = Path(folder) / 'floor.so'
    numpy_random = Path(np.random.__file__).parent / 'lib' / 'libnpyrandom.a'
    subprocess.run(
        [
            'cc',
            '-O3',
            '-march=native',
            '-fPIC',
            '-shared',
            '-o',
            str(library),
            str(Path(__file__).with_name('closed_loop_floor.c')),
            str(numpy_random),
            '-lm',
        ],
        check=True,
    )
    function = ctypes.CDLL(str(library)).floor_run
    pointer = np.ctypeslib.ndpointer(float, flags='C_CONTIGUOUS')
    function.argtypes = [
        ctypes.c_long,
        ctypes.c_int,
        ctypes.c_double,
        ctypes.c_double,
        *[pointer] * 7,
    ]
    function.restype = ctypes.c_double
    return function


def floor_time(floor, plan, noise=1.0):
    """Seconds of the C program over a healthy run, and the final state."""
    arm, gains = plan.arm, plan.gains
    times = np.arange(0.0, plan.scenario.duration, arm.sample_time)
    reference, joints = plan.scenario.path(arm).sample(times), JointMap(arm)
    rows = np.hstack(
        [
            joints.absolute_position(reference.position),
            joints.absolute_velocity(reference.velocity),
            joints.absolute_velocity(reference.acceleration),
        ]
    )
    rows = np.ascontiguousarray(rows)
    x = np.concatenate([rows[0, :2], [0.0, 0.0]])
    controller, observer = gains.controller, gains.observer
    began = time.perf_counter()
    floor(
        len(rows),
        plan.substeps,
        arm.sample_time,
        noise,
        constants_vector(plan.scenario.true_arm(arm).constants())[[0, 2, 1, *range(3, 12)]],
        np.ascontiguousarray(observer.kappa),
        np.ascontiguousarray(observer.mu),
        np.ascontiguousarray(controller.m1),
        np.ascontiguousarray(controller.m2),
        rows,
        x,
    )
    return time.perf_counter() - began, x


def check_floor(floor, plan):
    """Largest difference between the two final states without noise and disturbance."""
    quiet = replace(plan, scenario=replace(plan.scenario, noise=False, disturbance=False))
    run, joints = quiet.simulate(), JointMap(plan.arm)
    ours = np.concatenate(
        [joints.absolute_position(run.position[-1]), joints.absolute_velocity(run.velocity[-1])]
    )
    return float(np.abs(floor_time(floor, quiet, 0.0)[1] - ours).max())


# ------------------------------------------------------------------ the parts


@njit
def _plant(c, s, faults, noise, push, chance, torque, braked, sense, to):
    for k in range(len(torque)):
        if sense:
            read_sensors(c, s, faults, noise, chance)
            for i in range(2):
                to[k, i], to[k, 2 + i] = s.measured_position[i], s.measured_velocity[i]
                to[k, 4 + i] = s.torque[i]
        if braked[k]:
            brake(c, s)
        else:
            set_torque(c, s, torque[k, 0], torque[k, 1], push)
            integrate(c, s)


@njit
def _monitor(c, s, buffers, answer, measured, period, part, position, velocity, effort):
    for k in range(len(measured)):
        for i in range(2):
            position[i], velocity[i] = measured[k, i], measured[k, 2 + i]
            effort[i] = measured[k, 4 + i]
        if part == 2:
            monitor_step(c, s, buffers, answer, round(k * period * 1e9), position, velocity, effort)
            continue
        observe(
            c.observer, s.observer, s.estimate, round(k * period * 1e9), position, velocity, effort
        )
        if part == 1:
            update_bound(c.diagnosis.bound, s.diagnosis.bound, s.estimate, s.diagnosis.reckoning)


@njit
def _track(params, state, motion, measured, rate, period):
    for k in range(len(motion)):
        track(params, state, motion[k], measured[k], rate[k], measured[k], period)


def timed(function, *arguments):
    """Seconds of one call."""
    began = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - began


def part_times(plan):
    """Seconds of each part of a healthy run, played again on the same signals."""
    run, arm = plan.simulate(), plan.arm
    measured = np.zeros((len(run.time), 6))

    def plant(sense):
        p = ArmSimulator(arm, plan.scenario, plan.substeps)
        return timed(
            _plant,
            p.constants,
            p.state,
            p.injector.records,
            p.noise,
            p.push,
            p.injector.generator,
            run.torque,
            run.braked,
            sense,
            measured,
        )

    def monitor(part):
        parts = SensorMonitor('speed', arm, plan.gains).parts
        return timed(
            _monitor, *parts, measured, arm.sample_time, part, np.empty(2), np.empty(2), np.empty(2)
        )

    reference = plan.scenario.path(arm).sample(run.time)

    def tracking():
        return timed(
            _track,
            tracking_constants(arm, plan.gains),
            new_record(TRACKING_STATE),
            np.stack([reference.position, reference.velocity, reference.acceleration], axis=1),
            run.measured,
            run.estimated_velocity,
            arm.sample_time,
        )

    def whole():
        return timed(plan.simulate)

    def kept():
        return timed(figures, plan, run)

    def prepared():
        return timed(plan_run, *plan_run_arguments)

    plan_run_arguments = (campaign_of(1), 0)
    actions = {
        'plant': lambda: plant(False),
        'plant and sensors': lambda: plant(True),
        'observer': lambda: monitor(0),
        'observer and bound': lambda: monitor(1),
        'monitor': lambda: monitor(2),
        'tracking': tracking,
        'whole': whole,
        'figures': kept,
        'plan': prepared,
    }
    for action in actions.values():
        action()
    best = {name: min(action() for _ in range(ROUNDS)) for name, action in actions.items()}
    return {
        'plant (two RK4 steps, disturbance)': best['plant'],
        'sensors (noise, faults)': best['plant and sensors'] - best['plant'],
        'observer': best['observer'],
        'bound (set of errors)': best['observer and bound'] - best['observer'],
        'decisions': best['monitor'] - best['observer and bound'],
        'tracking': best['tracking'],
        'references, recording, the rest': best['whole']
        - best['plant and sensors']
        - best['monitor']
        - best['tracking'],
        'one run': best['whole'],
        'path and factors': best['plan'],
        'figures': best['figures'],
    }


# ------------------------------------------------------------------ vertices


@njit
def _blend_often(rho, k, a, b, k_out, a_out, b_out, count):
    for _ in range(count):
        blend(rho, k, k_out)
        blend(rho, a, a_out)
        blend(rho, b, b_out)


def vertex_times():
    """Seconds of the interpolation of eq. (25) for one sample, by the number of vertices."""
    rng, count, times = np.random.default_rng(1), 20_000, {}
    for vertices in (2, 4, 8, 16, 32, 64):
        stacks = [rng.normal(size=(vertices, 6, width)) for width in (4, 6, 2)]
        outs = [np.zeros((6, width)) for width in (4, 6, 2)]
        rho = np.full(vertices, 1.0 / vertices)
        _blend_often(rho, *stacks, *outs, 1)
        times[vertices] = (
            min(timed(_blend_often, rho, *stacks, *outs, count) for _ in range(ROUNDS)) / count
        )
    return times


# ------------------------------------------------------------------ all cores


def on_all_cores(campaign):
    """Wall time of a campaign, with its workers' start, and peaks of memory [MB]."""
    began, done, early = time.monotonic(), 0, 0
    with worker_pool() as do:
        for _, rows in do(campaign, chunks_of(campaign)):
            done += len(rows)
            if not early and done >= campaign.spec.runs // 10:
                early = _peak()
    return time.monotonic() - began, early, _peak()


def _peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def show_parts(plan, floor, console):
    """Table of parts, and the ratio to the floor."""
    steps = round(plan.scenario.duration / plan.arm.sample_time) + 1
    times = part_times(plan)
    floor_time(floor, plan)
    bare = min(floor_time(floor, plan)[0] for _ in range(ROUNDS))
    table = Table(title=f'one healthy run, {steps} steps')
    for name in ('part', 'us a step', 'share'):
        table.add_column(name, justify='left' if name == 'part' else 'right')
    for name, seconds in times.items():
        table.add_row(name, f'{1e6 * seconds / steps:.3f}', f'{seconds / times["one run"]:.0%}')
    table.add_row('floor in C', f'{1e6 * bare / steps:.3f}', f'{bare / times["one run"]:.0%}')
    console.print(table)
    console.print(
        f'one run / floor in C: {times["one run"] / bare:.2f}; final states without '
        f'noise differ by {check_floor(floor, plan):.1e}'
    )


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=200, help='runs on all cores (200)')
    arguments = parser.parse_args()
    console, campaign = Console(width=110), campaign_of(arguments.runs)
    number = (
        next(n for n in range(10_000) if campaign.values(n)['fault.kind'] == 'none')
        if arguments.runs >= 20
        else 0
    )
    plan = plan_run(campaign, number)
    plan = replace(plan, scenario=replace(plan.scenario, faults=()))
    with tempfile.TemporaryDirectory() as folder:
        show_parts(plan, build_floor(folder), console)
    times = vertex_times()
    slope = (times[64] - times[8]) / 56
    console.print(
        'method paper, interpolation of K, A, B (us a sample) by vertices: '
        + ', '.join(f'{h}: {1e6 * t:.2f}' for h, t in times.items())
        + f'; {1e9 * slope:.0f} ns a vertex. Method exact has no vertices.'
    )
    run_one(Campaign(campaign.text), 0)
    wall, early, late = on_all_cores(campaign)
    steps = campaign.spec.runs * (round(20.0 / 0.001) + 1)
    console.print(
        f'{campaign.spec.runs} runs of 20 s at 1 kHz on all cores: {wall:.1f} s, '
        f'{1e6 * wall / steps:.2f} us a step; 10 000 runs at this rate: '
        f'{wall / campaign.spec.runs * 1e4 / 60:.1f} min; peak memory of the main '
        f'process {early} MB after a tenth, {late} MB at the end'
    )


if __name__ == '__main__':
    main()
