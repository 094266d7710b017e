"""Compiles what nodes and replays call ahead of its first use.

``python -m lpv_core.simulation.precompile`` after an installation lets nodes start in seconds: the
machine code is kept (see `lpv_core.support.jit`).
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np

from lpv_core.certificate.gains import Gains, load_gains
from lpv_core.control.tracking import TrackingController
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.residual.rate_independence import rate_source
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.hypotheses import offset_against_contact, sudden_drifts
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.scenario import Scenario, load_scenario
from lpv_core.simulation.serial_closed_loop import run_serial_loop
from lpv_core.simulation.serial_scenario import SerialScenario
from lpv_core.simulation.serial_simulator import SerialArmSimulator
from lpv_core.support.jit import COMPILED
from lpv_core.support.resources import bringup_file

_FIRST_DECISIONS = 1.0
"""Length of a run after which the diagnosis of a serial arm has decided [s]."""


def precompile(arm: ArmParameters, gains: Gains, scenario: Scenario) -> None:
    """Run every compiled function once, on any arm with its gains and a scenario."""
    short = replace(scenario, duration=3 * arm.sample_time)
    run = run_closed_loop(arm, gains, short)
    monitor = SensorMonitor('precompile', arm, gains)
    monitor.warm_up()
    stamps = (1e9 * run.time).astype('int64') + 1
    monitor.take_many(stamps, run.measured, run.velocity, run.torque)
    plant, controller = ArmSimulator(arm, short), TrackingController(arm, gains)
    measurement, _ = plant.sense()
    command = controller.update(
        short.path(arm).sample(0.0),
        measurement.position,
        measurement.velocity,
        measurement.position,
        0.0,
    )
    plant.step(command.torque)
    plant.hold()
    rate_source(stamps, run.measured[:, 0], run.velocity[:, 0])


def precompile_serial(arm: SerialArm, scenario: SerialScenario) -> None:
    """Run the compiled functions of a serial arm once; some are per number of joints."""
    plant = SerialArmSimulator(arm, scenario)
    plant.sense()
    plant.hold()
    run = run_serial_loop(arm, replace(scenario, duration=_FIRST_DECISIONS))
    diagnosis = SerialMonitor(arm)
    stamps = (1e9 * run.time).astype('int64')
    rows = np.stack([run.measured, run.measured_velocity, run.torque], axis=1)
    diagnosis.update_many(stamps, rows)
    # The first fault must not wait for this in a node.
    search, estimator = diagnosis.search, diagnosis.estimator
    offset_against_contact(search, estimator, 0)
    estimator.balance.derived[:] = 1.0
    sudden_drifts(search, estimator, diagnosis.sampler.blocks[: 2 * estimator.plan.blocks])
    SerialSensorMonitor('precompile', arm).warm_up()


def _two_link() -> None:
    precompile(
        load_arm(bringup_file('arms', 'paper')),
        load_gains(bringup_file('gains', 'paper')),
        load_scenario(bringup_file('scenarios', 'two_faults')),
    )


def _serial() -> None:
    arm = load_any_arm(bringup_file('arms', 'ur10'))
    scenario = load_any_scenario(bringup_file('scenarios', 'ur10'))
    if isinstance(arm, SerialArm) and isinstance(scenario, SerialScenario):
        precompile_serial(arm, scenario)


def main() -> None:
    """Entry point: both kinds of arms side by side, which share next to nothing."""
    if COMPILED:
        kinds: tuple[Callable[[], None], ...] = (_two_link, _serial)
        with ProcessPoolExecutor(len(kinds)) as pool:
            for done in [pool.submit(kind) for kind in kinds]:
                done.result()


if __name__ == '__main__':
    main()
