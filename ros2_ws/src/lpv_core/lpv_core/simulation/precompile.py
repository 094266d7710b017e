"""Compiles ahead what ``lpv demo`` runs: ``python -m lpv_core.simulation.precompile [ARM ...]``.

The machine code is kept (see `lpv_core.support.jit`), so that nodes start in seconds.  Whatever is
not compiled here is compiled at its first use.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from lpv_core.certificate.gains import load_gains
from lpv_core.control.tracking import TrackingController
from lpv_core.control.watchdog import DriveLimits, DriveWatchdog, TrackerLimits, TrackerWatchdog
from lpv_core.model.arm import ArmParameters
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.observer.sampled_observer import Mode
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.scenario import load_scenario
from lpv_core.simulation.serial_closed_loop import run_serial_loop
from lpv_core.simulation.serial_scenario import SerialScenario
from lpv_core.simulation.serial_simulator import SerialArmSimulator
from lpv_core.support.errors import ConfigError
from lpv_core.support.jit import COMPILED, on_compile
from lpv_core.support.resources import bringup_file

_FIRST_DECISIONS = 1.0
"""Length of a run after which the diagnosis of a serial arm has decided [s]."""


def two_link_parts(arm: ArmParameters) -> Iterator[str]:
    """Run what the nodes of a two-link arm and a replay compile; name each part before it."""
    gains = load_gains(bringup_file('gains', arm.name))
    scenario = load_scenario(bringup_file('scenarios', 'two_faults'))
    yield 'plant and sensors'
    plant = ArmSimulator(arm, scenario)
    plant.sense()
    plant.step((0.0, 0.0))
    plant.hold()
    yield 'tracking'
    still = np.zeros(2)
    controller = TrackingController(arm, gains)
    controller.answer(np.zeros((3, 2)), still + 0.1, still, still + 0.1, 0.0)
    watchdog = TrackerWatchdog(arm, TrackerLimits())
    watchdog.check_estimate(1, 0, 0, True, still, still)
    watchdog.check_motion(1, still, still)
    DriveWatchdog(arm, DriveLimits()).check(1, 0, True, still)
    yield 'observer and diagnosis'
    monitor = SensorMonitor('precompile', arm, gains)
    monitor.warm_up()
    monitor.status(Mode.NO_ESTIMATE)
    yield 'replay'
    stamps = np.arange(1, 4, dtype=np.int64) * round(1e9 * arm.sample_time)
    monitor.take_many(stamps, *np.zeros((3, 3, 2)))


def serial_parts(arm: SerialArm) -> Iterator[str]:
    """Run what the nodes of a serial arm compile; some functions are per number of joints."""
    yield 'plant, computed torque, observer and diagnosis'
    try:
        scenario = load_any_scenario(bringup_file('scenarios', arm.name), arm)
    except ConfigError:  # an arm of the user's own
        SerialSensorMonitor('precompile', arm).warm_up()
        return
    if not isinstance(scenario, SerialScenario):
        return
    plant = SerialArmSimulator(arm, scenario)
    plant.sense()
    plant.hold()
    run = run_serial_loop(arm, replace(scenario, duration=_FIRST_DECISIONS))
    yield 'diagnosis of a fault'  # the first one must not wait for this in a node
    diagnosis = SerialMonitor(arm)
    stamps = (1e9 * run.time).astype('int64')
    rows = np.stack([run.measured, run.measured_velocity, run.torque], axis=1)
    diagnosis.update_many(stamps, rows)
    diagnosis.warm_up()
    SerialSensorMonitor('precompile', arm).warm_up()


@contextmanager
def _progress(text: str) -> Iterator[None]:
    """Show what is being compiled: on a terminal each function, elsewhere nothing more."""
    begin, count, shown = time.monotonic(), 0, 0.0

    def show(name: str) -> None:
        nonlocal count, shown
        count += 1
        if sys.stdout.isatty() and time.monotonic() - shown > 0.2:
            shown = time.monotonic()
            line = f'{text}: {name} ({count} functions, {shown - begin:.0f} s)'
            print(f'\r\033[K{line[:100]}', end='', flush=True)

    with on_compile(show):
        yield
    if count:
        line = f'{text}: {count} functions in {time.monotonic() - begin:.0f} s'
        print(f'\r\033[K{line}' if sys.stdout.isatty() else line, flush=True)


def precompile(name: str) -> None:
    """Compile what ``lpv demo`` runs for an arm, and say what is being compiled.

    Parameters
    ----------
    name : str
        Shipped arm, or arm file.
    """
    arm = load_any_arm(bringup_file('arms', name))
    parts = two_link_parts(arm) if isinstance(arm, ArmParameters) else serial_parts(arm)
    part = next(parts, None)
    while part is not None:
        with _progress(f'compiling for arm {name!r}: {part}'):
            part = next(parts, None)


def main() -> None:
    """Entry point."""
    if COMPILED:
        for name in sys.argv[1:] or ['paper']:
            precompile(name)


if __name__ == '__main__':
    main()
