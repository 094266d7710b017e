"""How fast closed loops run: against their plant alone, against MuJoCo, and over all cores.

    python benchmarks/campaign_speed.py                          # the paper's arm and the UR10
    python benchmarks/campaign_speed.py --arm ur10 --runs 1000   # and a campaign of its own

Times of loops are processor times, of 20 s, measured in turns with those of the plant alone and of
MuJoCo, which integrates the same arm held by constant torques.  `--runs` measures wall time of
random runs over all cores as `lpv campaign` makes them, each with its path, arm and figures.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from lpv import Gains, Scenario, SerialArm, load_arm, load_scenario
from lpv.campaign.execution.execute import chunks_of, worker_pool
from lpv.campaign.plan.campaign import Campaign, find_gains, resolve
from lpv.core.simulation.arm_simulator import ArmSimulator, integrate, read_sensors
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.jit import njit

ROUNDS = 3
DURATION = 20.0
SCENARIOS = {'paper': 'two_faults', 'real_arm': 'real_arm', 'ur10': 'ur10', 'panda': 'panda'}
"""Shipped scenarios whose plant, noise and path are used."""
KINDS = ['none', 'bias', 'drift', 'stuck', 'scale', 'noise', 'spike', 'dropout']


@njit
def _plant_alone(plant, chances, count):
    for _ in range(count):
        read_sensors(plant, chances.noise, chances.fault)
        integrate(plant, plant.state.torque)


def plant_time(arm: SerialArm, scenario: Scenario) -> float:
    """Seconds that the plant takes for a run, held by constant torques."""
    one = ArmSimulator(arm, replace(scenario, faults=(), plant='nonlinear'))
    one.hold()  # its torques hold the arm
    count = round(DURATION / arm.sample_time)
    start = time.process_time()
    _plant_alone(one.parts, one.chances, count)
    return time.process_time() - start


def mujoco_time(arm: SerialArm, scenario: Scenario) -> float:
    """Seconds that MuJoCo takes for the same."""
    one = ArmSimulator(arm, replace(scenario, faults=(), plant='mujoco'))
    one.hold()
    start = time.process_time()
    for _ in range(round(DURATION / arm.sample_time)):
        one.advance()
    return time.process_time() - start


def loop_time(arm: SerialArm, scenario: Scenario, gains: Gains | None) -> float:
    """Seconds of a run of the whole loop."""
    start = time.process_time()
    run_closed_loop(arm, scenario, gains)
    return time.process_time() - start


def show_loops(name: str) -> None:
    """Print what loops cost, healthy and with the scenario's faults."""
    arm = load_arm(name)
    gains = find_gains(name, arm) if arm.lpv else None
    scenario = replace(load_scenario(SCENARIOS[name]), duration=DURATION)
    cases = {'healthy': replace(scenario, faults=()), 'with faults': scenario}
    for case in cases.values():
        loop_time(arm, case, gains)
    plant_time(arm, scenario)
    samples, other = DURATION / arm.sample_time, mujoco_time(arm, scenario)
    for label, case in cases.items():
        pairs = [(loop_time(arm, replace(case, seed=k), gains), plant_time(arm, case))
                 for k in range(ROUNDS)]  # fmt: skip
        loop, ratio = np.median([a for a, _ in pairs]), np.median([a / b for a, b in pairs])
        print(
            f'{name}, {1.0 / arm.sample_time:g} Hz, {label}: {1e6 * loop / samples:.1f} us a '
            f'sample, loop / plant alone {ratio:.2f}, loop / MuJoCo alone {loop / other:.2f}, '
            f'1000 runs of {DURATION:g} s in {1000 * loop / 60.0:.1f} min on one core '
            f'(median of {ROUNDS})'
        )


def campaign_of(name: str, runs: int) -> Campaign:
    """Random runs with faults of all kinds, each half as long as the run."""
    onset = {'low': 0.25 * DURATION, 'high': 0.5 * DURATION}
    return resolve(
        {
            'name': 'speed', 'arm': name, 'seed': 5, 'duration': DURATION,
            'plan': {'method': 'random', 'runs': runs},
            'factors': {
                'path': 'random', 'fault.kind': KINDS, 'fault.onset': onset,
                'fault.size': {'bias': 0.2, 'scale': 0.3, 'noise': 0.03, 'spike': 0.3},
                'fault.rate': {'drift': 0.1, 'spike': 10.0},
                'fault.duration': 0.25 * DURATION,
            },
        },
        'speed', '.',
    )  # fmt: skip


def show_campaign(name: str, runs: int) -> None:
    """Print the wall time of a campaign, its workers' start included."""
    campaign, begin, done = campaign_of(name, runs), time.monotonic(), 0
    with worker_pool() as do:
        for _, rows in do(campaign, chunks_of(campaign)):
            done += len(rows)
    wall = time.monotonic() - begin
    samples = done * DURATION / load_arm(name).sample_time
    print(
        f'{name}: {done} runs of {DURATION:g} s on all cores in {wall:.1f} s, '
        f'{1e6 * wall / samples:.2f} us a sample'
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--arm', action='append', choices=SCENARIOS, help='paper and ur10')
    parser.add_argument('--runs', type=int, default=0, help='of a campaign on all cores')
    options = parser.parse_args()
    for name in options.arm or ('paper', 'ur10'):
        show_loops(name)
        if options.runs:
            show_campaign(name, options.runs)


if __name__ == '__main__':
    main()
