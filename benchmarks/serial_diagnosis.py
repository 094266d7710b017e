"""Cost of the diagnosis of a serial arm, against Newton-Euler passes in the same run.

A simulated arm of n joints, rates independent, model wrong by some per cent, is watched by
`SerialSensorMonitor`: many samples at once, as a replay does, and one by one, as a node does.  The
unit of the ratios are three compiled passes of the inverse dynamics of the same arm; all times are
processor time, so that other load on the machine matters less.
"""

import argparse
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from fault_injection import Stream, motion_range, simulate
from rich.console import Console
from rich.table import Table

from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import Chain, FloatArray, body_parameters, compile_chain, workspace
from lpv.core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
    Uncertainty,
)
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit

WARM = 6000
"""Samples before the clock starts: the horizon is full."""
ROUNDS = 3


def random_arm(joints: int) -> SerialArm:
    """An arm like an industrial one: axes that alternate, links that get lighter."""
    parts = []
    for i in range(joints):
        mass, length = 12.0 * 0.75**i, 0.35
        body = body_parameters(mass, (0.5 * length, 0.0, 0.0), 0.02 * mass * np.eye(3))
        limit = 20.0 * mass
        parts.append(SerialJoint(
            f'joint{i + 1}', (length if i else 0.0, 0.0, 0.0), (np.pi / 2 * (i % 2), 0.0, 0.0),
            (0.0, 0.0, 1.0), LinkInertia.from_vector(body),
            JointFriction(0.0, 0.01 * limit, 0.01 * limit, 50.0), rotor_inertia=0.002 * limit,
            limits=JointLimits(-2.5, 2.5, 3.0, limit),
            sensors=JointSensors(f'encoder{i + 1}', 1e-4, 0.0, 'independent', 1e-2)))  # fmt: skip
    return SerialArm('bench', tuple(parts), uncertainty=Uncertainty(1.0, 0.3), sample_time=0.002)


@njit
def loop_newton_euler(chain: Chain, motion: FloatArray, work: FloatArray, out: FloatArray) -> None:
    for k in range(motion.shape[0]):
        for _ in range(3):
            inverse_dynamics(chain, motion[k, 0], motion[k, 1], motion[k, 2], work, out)


def seconds(function: Callable[[], object]) -> float:
    """Shortest of some rounds."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def warm_monitor(arm: SerialArm, run: Stream) -> SerialSensorMonitor:
    """A monitor whose horizon is full."""
    monitor = SerialSensorMonitor('bench', arm)
    monitor.take_many(run.stamps[:WARM], *run.samples[:WARM].swapaxes(0, 1))
    return monitor


def one_by_one(monitor: SerialSensorMonitor, run: Stream) -> None:
    """The samples behind the warm ones, each for itself."""
    for stamp, (position, velocity, effort) in zip(run.stamps[WARM:], run.samples[WARM:]):
        message = SimpleNamespace(
            name=monitor.arm.joint_names, position=position, velocity=velocity, effort=effort
        )
        monitor.take(int(stamp), message)


def measure(joints: int, duration: float, table: Table) -> None:
    """One row of the table."""
    arm = random_arm(joints)
    chain, rng = compile_chain(arm), np.random.default_rng(joints)
    run = simulate(arm, motion_range(arm, 0.5), joints, duration=duration)
    count = len(run.stamps) - WARM
    motion, work = rng.uniform(-2.0, 2.0, (2000, 3, joints)), workspace(chain)
    loop_newton_euler(chain, motion, work, np.empty(joints))
    unit = seconds(lambda: loop_newton_euler(chain, motion, work, np.empty(joints))) / 2000
    rest = run.stamps[WARM:], *run.samples[WARM:].swapaxes(0, 1)
    many, single, alarms = [], [], 0
    for _ in range(ROUNDS):
        monitor = warm_monitor(arm, run)
        start = time.process_time()
        answers = monitor.take_many(*rest)
        many.append((time.process_time() - start) / count)
        alarms = len(answers.events)
        monitor = warm_monitor(arm, run)
        start = time.process_time()
        one_by_one(monitor, run)
        single.append((time.process_time() - start) / count)
    hour = 3600.0 / arm.sample_time * min(many)
    table.add_row(
        str(joints), f'{1e6 * unit:.2f}', f'{1e6 * min(many):.1f}', f'{min(many) / unit:.1f}',
        f'{hour:.1f}', f'{1e6 * min(single):.1f}', f'{min(single) / unit:.1f}',
        str(alarms))  # fmt: skip


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--joints', type=int, nargs='+', default=[2, 6, 7])
    parser.add_argument('--duration', type=float, default=40.0, help='simulated time [s]')
    options = parser.parse_args()
    table = Table(title='Cost of a sample')
    for name in (
        'joints', '3 Newton-Euler passes [us]', 'replay [us]', 'ratio', '1 h at 500 Hz [s]',
        'one by one [us]', 'ratio', 'alarms',
    ):  # fmt: skip
        table.add_column(name)
    for joints in options.joints:
        measure(joints, options.duration, table)
    Console(width=120).print(table)


if __name__ == '__main__':
    main()
