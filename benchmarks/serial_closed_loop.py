"""Cost of the closed loop of the UR10: simulator, diagnosis and tracker, offline.

Processor times.  The loop's time a sample is compared with that of its plant alone in the
same run: what diagnosis, tracking and recording add.  The figure of 1000 runs is the measured
one of a few, scaled.
"""

import time
from dataclasses import replace

import numpy as np

from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.serial_closed_loop import run_serial_loop
from lpv_core.simulation.serial_simulator import SerialArmSimulator, integrate, read_sensors
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


def loop(arm, scenario):
    """Seconds of a run of the loop."""
    start = time.process_time()
    run_serial_loop(arm, scenario)
    return time.process_time() - start


def main():
    """Measure in turns, and print medians."""
    arm = load_any_arm(bringup_file('arms', 'ur10'))
    scenario = load_any_scenario(bringup_file('scenarios', 'ur10'), arm)
    cases = {'healthy': replace(scenario, faults=()), 'two faults': scenario}
    for case in cases.values():
        loop(arm, replace(case, duration=2.0))
    plant(arm, scenario)
    samples = DURATION / arm.sample_time
    for name, case in cases.items():
        pairs = [(loop(arm, replace(case, seed=k)), plant(arm, case)) for k in range(ROUNDS)]
        times, ratios = [a for a, _ in pairs], [a / b for a, b in pairs]
        print(
            f'UR10, 500 Hz, {name}: loop / plant alone {np.median(ratios):.2f}, '
            f'{1e6 * np.median(times) / samples:.1f} us a sample, 1000 runs of {DURATION:g} s in '
            f'{1000 * np.median(times) / 60.0:.1f} min on one core (median of {ROUNDS})'
        )


if __name__ == '__main__':
    main()
