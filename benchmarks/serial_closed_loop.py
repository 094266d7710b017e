"""Cost of the closed loop of the UR10: simulator, diagnosis and tracker, offline.

Processor times.  The loop's time a sample is compared, in the same run, with that of its plant
alone (what diagnosis, tracking and recording add) and with MuJoCo integrating the same arm.  The
figure of 1000 runs is the measured one of a few, scaled; ``--campaign N`` measures runs of the
shipped campaign instead, each with its path, arm and figures, as ``lpv campaign ur10`` does.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from lpv_campaign.execution.runs import run_one
from lpv_campaign.plan.campaign import resolve
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.serial_closed_loop import run_serial_loop
from lpv_core.simulation.serial_simulator import SerialArmSimulator, integrate, read_sensors
from lpv_core.support.config import read_yaml
from lpv_core.support.jit import njit
from lpv_core.support.resources import bringup_file

ROUNDS = 3
DURATION = 20.0


@njit
def _plant_alone(chain, params, state, faults, generator, scratch, matrix, count):
    for _ in range(count):
        read_sensors(params, state, faults, generator, generator)
        integrate(chain, params, state, scratch, matrix)


def plant(arm, scenario):
    """Seconds that the plant takes for a run, held by constant torques."""
    simulator = SerialArmSimulator(arm, scenario)
    simulator.hold()  # its torques hold the arm
    count = round(DURATION / arm.sample_time)
    start = time.process_time()
    _plant_alone(
        simulator.chain, simulator.constants, simulator.state, simulator.injector.records,
        simulator.noise, simulator.scratch, simulator.matrix, count,
    )  # fmt: skip
    return time.process_time() - start


def mujoco(arm, scenario):
    """Seconds that MuJoCo takes for the same."""
    simulator = SerialArmSimulator(arm, replace(scenario, plant='mujoco'))
    simulator.hold()
    state, period = simulator.state, arm.sample_time
    motion, torque, substeps = state.motion, state.torque, int(simulator.constants.substeps)
    start = time.process_time()
    for _ in range(round(DURATION / period)):
        simulator.engine.advance(motion, torque, period, substeps)
    return time.process_time() - start


def loop(arm, scenario):
    """Seconds of a run of the loop."""
    start = time.process_time()
    run_serial_loop(arm, scenario)
    return time.process_time() - start


def campaign_runs(count):
    """Seconds of runs of the shipped campaign, with their figures."""
    file = bringup_file('campaigns', 'ur10')
    campaign = resolve(read_yaml(file), str(file), file.parent)
    run_one(campaign, 0)
    start = time.process_time()
    for number in range(1, count + 1):
        run_one(campaign, number)
    return time.process_time() - start


def main():
    """Measure in turns, and print medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--campaign', type=int, default=0, metavar='N')
    options = parser.parse_args()
    arm = load_any_arm(bringup_file('arms', 'ur10'))
    scenario = load_any_scenario(bringup_file('scenarios', 'ur10'), arm)
    cases = {'healthy': replace(scenario, faults=()), 'two faults': scenario}
    for case in cases.values():
        loop(arm, replace(case, duration=12.0))
    plant(arm, scenario)
    samples = DURATION / arm.sample_time
    other = mujoco(arm, scenario)
    for name, case in cases.items():
        pairs = [(loop(arm, replace(case, seed=k)), plant(arm, case)) for k in range(ROUNDS)]
        times, ratios = [a for a, _ in pairs], [a / b for a, b in pairs]
        print(
            f'UR10, 500 Hz, {name}: loop / plant alone {np.median(ratios):.2f}, '
            f'loop / MuJoCo alone {np.median(times) / other:.2f}, '
            f'{1e6 * np.median(times) / samples:.1f} us a sample, 1000 runs of {DURATION:g} s in '
            f'{1000 * np.median(times) / 60.0:.1f} min on one core (median of {ROUNDS})'
        )
    if options.campaign:
        one = campaign_runs(options.campaign) / options.campaign
        print(
            f'campaign ur10: {one:.3f} s a run, {one / other:.2f} times MuJoCo alone, 1000 runs in '
            f'{1000 * one / 60.0:.1f} min on one core ({options.campaign} runs)'
        )


if __name__ == '__main__':
    main()
