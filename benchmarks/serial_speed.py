"""Cost of the dynamics and of the diagnosis of a serial arm of n joints.

The dynamics are timed inside a compiled loop, as the observer calls them, and one call at a time
from Python, beside Pinocchio, which is called from Python with the same random motions.  The
diagnosis watches the arm, simulated, rates independent, model wrong by some per cent: many samples
at once, as a replay does, and one by one, as a node does; the unit of its ratios are three compiled
passes of the inverse dynamics.  All times are processor time, so that other load on the machine
matters less.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio
from fault_injection import Stream, motion_range, random_arm, simulate
from rich.console import Console

from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics, mass_matrix, momentum_balance
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit
from lpv.report.table import print_grid

WARM = 6000
"""Samples before the clock starts: the horizon is full."""
ROUNDS, CALLS = 3, 15
"""Of which the shortest counts, of the diagnosis and of the dynamics."""
MOTIONS = 2000
"""Of which the dynamics are computed."""


def model_of(chain: Chain) -> pinocchio.Model:
    """The same in Pinocchio."""
    model = pinocchio.Model()
    for i in range(len(chain.inertial)):
        place = pinocchio.SE3(chain.rotation[i], chain.translation[i])
        kind = pinocchio.JointModelPZ if chain.prismatic[i] else pinocchio.JointModelRZ
        model.addJoint(i, kind(), place, f'joint{i}')
        body = pinocchio.Inertia.FromDynamicParameters(chain.inertial[i])
        model.appendBodyToJoint(i + 1, body, pinocchio.SE3.Identity())
    model.armature = np.diag(chain.motor).copy()
    model.gravity.linear = chain.gravity
    return model


@njit
def loop_inverse_dynamics(chain, motion, work, vector, matrix):
    for k in range(motion.shape[0]):
        inverse_dynamics(chain, motion[k, 0], motion[k, 1], motion[k, 2], work, vector)


@njit
def loop_momentum_balance(chain, motion, work, vector, matrix):
    for k in range(motion.shape[0]):
        momentum_balance(chain, motion[k, 0], motion[k, 1], work, vector, matrix[0])


@njit
def loop_mass_matrix(chain, motion, work, vector, matrix):
    for k in range(motion.shape[0]):
        mass_matrix(chain, motion[k, 0], work, matrix)


@njit
def loop_forward_dynamics(chain, motion, work, vector, matrix):
    for k in range(motion.shape[0]):
        forward_dynamics(chain, motion[k, 0], motion[k, 1], motion[k, 2], work, matrix, vector)


def seconds(function: Callable[[], object]) -> float:
    """Shortest of some rounds; the first call compiles."""
    function()
    times = []
    for _ in range(CALLS):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return min(times)


def _call_all(function: Callable[..., object], motion: FloatArray) -> None:
    for row in motion:
        function(*row)


def measure_dynamics(chain: Chain, rng: np.random.Generator) -> float:
    """Print microseconds a call, and ratios; returns those of the inverse dynamics [s]."""
    model, joints = model_of(chain), len(chain.inertial)
    data, motion = model.createData(), rng.uniform(-2.0, 2.0, (MOTIONS, 3, joints))
    work, vector, matrix = workspace(chain), np.empty(joints), np.empty((joints, joints))
    peers: dict[str, tuple[Any, Callable[..., object]]] = {
        'inverse dynamics': (
            loop_inverse_dynamics,
            lambda q, v, a: pinocchio.rnea(model, data, q, v, a),
        ),
        'momentum balance': (
            loop_momentum_balance,
            lambda q, v, a: (
                pinocchio.crba(model, data, q),
                pinocchio.computeCoriolisMatrix(model, data, q, v),
                pinocchio.computeGeneralizedGravity(model, data, q),
            ),
        ),
        'mass matrix': (loop_mass_matrix, lambda q, v, a: pinocchio.crba(model, data, q)),
        'forward dynamics': (
            loop_forward_dynamics,
            lambda q, v, a: pinocchio.aba(model, data, q, v, a),
        ),
    }
    found = []
    for name, (loop, peer) in peers.items():
        ours = seconds(partial(loop, chain, motion, work, vector, matrix)) / MOTIONS
        theirs = seconds(partial(_call_all, peer, motion)) / MOTIONS
        found.append(ours)
        print(
            f'{joints} joints, {name:17s} {1e6 * ours:6.2f} us, Pinocchio from Python '
            f'{1e6 * theirs:6.2f} us, ratio {ours / theirs:.2f}'
        )
    single = seconds(lambda: [inverse_dynamics(chain, *row, work, vector) for row in motion])
    print(
        f'{joints} joints, inverse dynamics, one call from Python: {1e6 * single / MOTIONS:.2f} us'
    )
    return found[0]


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


def measure(joints: int, duration: float) -> list[str]:
    """Dynamics; one row of the table."""
    arm = random_arm(joints)
    unit = 3.0 * measure_dynamics(compile_chain(arm), np.random.default_rng(joints))
    run = simulate(arm, motion_range(arm, 0.5), joints, duration=duration)
    count = len(run.stamps) - WARM
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
    return [
        str(joints), f'{1e6 * unit:.2f}', f'{1e6 * min(many):.1f}', f'{min(many) / unit:.1f}',
        f'{hour:.1f}', f'{1e6 * min(single):.1f}', f'{min(single) / unit:.1f}',
        str(alarms)]  # fmt: skip


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--joints', type=int, nargs='+', default=[2, 6, 7])
    parser.add_argument('--duration', type=float, default=40.0, help='simulated time [s]')
    options = parser.parse_args()
    rows = [measure(joints, options.duration) for joints in options.joints]
    heads = ('>joints', '>3 Newton-Euler passes [us]', '>replay [us]', '>ratio',
             '>1 h at 500 Hz [s]', '>one by one [us]', '>ratio', '>alarms')  # fmt: skip
    print_grid(Console(width=120), heads, rows, 'Cost of a sample')


if __name__ == '__main__':
    main()
