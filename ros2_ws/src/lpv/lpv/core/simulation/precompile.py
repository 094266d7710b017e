"""Compiles ahead what ``lpv demo`` runs: ``python -m lpv.core.simulation.precompile [ARM ...]``.

The machine code is kept (see `lpv.core.support.jit`), so that nodes start in seconds.  Whatever is
not compiled here is compiled at its first use.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from lpv.core.control.estimate_check import ROWS, CorrectionLimit, check_values
from lpv.core.control.tracking import TrackingController
from lpv.core.control.watchdog import DriveWatchdog, TrackerLimits, TrackerWatchdog
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import COMPILED, on_compile
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import Gains, load_gains

_SCENARIOS = {'paper': 'two_faults'}
"""Shipped scenarios of arms that have none of their name."""


def _run_loop(arm: SerialArm, scenario_name: str, gains: Gains | None) -> None:
    """Run what the simulator and the tracker compile."""
    try:
        scenario = load_scenario(bringup_file('scenarios', scenario_name))
    except ConfigError:  # an arm of the user's own
        return
    plant = ArmSimulator(arm, scenario)
    plant.sense()
    plant.step(np.zeros(len(arm.joints)))
    plant.hold()
    still = np.zeros(len(arm.joints))
    TrackingController(arm, gains).answer(
        np.zeros((3, len(still))), still + 0.1, still, still + 0.1, 0.0
    )
    watchdog = TrackerWatchdog(arm, TrackerLimits())
    watchdog.check_estimate(1, 0, 0, True, still, still)
    watchdog.check_motion(1, still, still, still)
    check_values(np.zeros((len(ROWS), len(still))))
    CorrectionLimit(arm).take(1, still, still)
    DriveWatchdog(arm).check(1, 0, True, still)


def _helper(arm: SerialArm, scenario: str, gains: Gains | None) -> Any:
    """A second process, to be started, that compiles what comes last here.

    Whatever one of the two compiles the other one waits for, and loads.
    """
    new = multiprocessing.get_context('spawn')
    return new.Process(target=_help, args=(arm, scenario, gains), daemon=True)


def _help(arm: SerialArm, scenario: str, gains: Gains | None) -> None:
    with suppress(KeyboardInterrupt):  # the other process says so
        _run_loop(arm, scenario, gains)
        SerialSensorMonitor('precompile', arm, gains=gains).compile_ahead()


def _shipped_gains(arm: SerialArm, name: str) -> Gains | None:
    """Gains of an arm with a region for which they were designed, if they are shipped."""
    if arm.lpv is None:
        return None
    try:
        return load_gains(bringup_file('gains', name))
    except ConfigError:
        return None


@contextmanager
def _progress(text: str, helper: Any) -> Iterator[None]:
    """Show what is being compiled: on a terminal each function, elsewhere nothing more.

    The helper starts with the first function, if there is a processor for it.
    """
    begin, count, shown = time.monotonic(), 0, 0.0

    def show(name: str) -> None:
        nonlocal count, shown
        count += 1
        if helper.pid is None and len(os.sched_getaffinity(0)) > 1:
            helper.start()
        if sys.stdout.isatty() and time.monotonic() - shown > 0.2:
            shown = time.monotonic()
            line = f'{text}: {name} ({count} functions, {shown - begin:.0f} s)'
            print(f'\r\033[K{line[:100]}', end='', flush=True)

    with on_compile(show):
        yield
    if count:
        line = f'{text}: {count} functions in {time.monotonic() - begin:.0f} s'
        print(f'\r\033[K{line}' if sys.stdout.isatty() else line, flush=True)


def precompile(name: str, scenario: str = '') -> None:
    """Compile what ``lpv demo`` runs for an arm, and say what is being compiled.

    Parameters
    ----------
    name : str
        Shipped arm, or arm file.
    scenario : str
        Shipped scenario, or scenario file; that of the arm's name if not given.
    """
    arm = load_arm(bringup_file('arms', name))
    scenario = scenario or _SCENARIOS.get(name, name)
    gains = _shipped_gains(arm, name)
    helper = _helper(arm, scenario, gains)
    what = f'compiling for arm {name!r}'
    with _progress(f'{what}: plant, tracking, observers and diagnosis', helper):
        monitor = SerialSensorMonitor('precompile', arm, gains=gains)
        monitor.warm_up()
        _run_loop(arm, scenario, gains)
    with _progress(f'{what}: diagnosis of a fault', helper):
        monitor.warm_up_faults()  # the first one must not wait for this in a node
    if helper.pid is not None:
        helper.join()


def main() -> None:
    """Entry point."""
    if COMPILED:
        for name in sys.argv[1:] or ['paper']:
            precompile(name)


if __name__ == '__main__':
    main()
