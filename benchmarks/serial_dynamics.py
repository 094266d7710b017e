"""Cost of the dynamics of serial chains, against Pinocchio in the same run.

Ours is timed inside a compiled loop, as the observer calls it, and one call at a time from Python;
Pinocchio is called from Python.  Both get the same random motions of a chain of n joints.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio

from lpv.core.serial_arm.chain import Chain, body_parameters, workspace
from lpv.core.serial_arm.description import rotation_from_rpy
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics, mass_matrix, momentum_balance
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.jit import njit

SAMPLES = 2000
ROUNDS = 15


def random_arm(joints, rng):
    """A chain, and the same in Pinocchio."""
    rotation = [rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)) for _ in range(joints)]
    bodies = [
        body_parameters(rng.uniform(1, 10), rng.uniform(-0.2, 0.2, 3), 0.1 * np.eye(3))
        for _ in range(joints)
    ]
    chain = Chain(
        np.array(rotation), rng.uniform(-0.5, 0.5, (joints, 3)), np.array(bodies),
        np.zeros((joints, joints)), np.zeros((joints, 5)), np.array([0.0, 0.0, -9.81]), np.eye(3),
        np.zeros(3), np.zeros(joints, bool),
    )  # fmt: skip
    model = pinocchio.Model()
    for i in range(joints):
        place = pinocchio.SE3(chain.rotation[i], chain.translation[i])
        model.addJoint(i, pinocchio.JointModelRZ(), place, f'joint{i}')
        body = pinocchio.Inertia.FromDynamicParameters(chain.inertial[i])
        model.appendBodyToJoint(i + 1, body, pinocchio.SE3.Identity())
    return chain, model


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
    for _ in range(ROUNDS):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return min(times)


def _call_all(function: Callable[..., object], motion: np.ndarray) -> None:
    for row in motion:
        function(*row)


def measure(joints: int, rng: np.random.Generator) -> None:
    """Print microseconds a call of every function, and the ratios."""
    chain, model = random_arm(joints, rng)
    data, motion = model.createData(), rng.uniform(-2.0, 2.0, (SAMPLES, 3, joints))
    work, vector, matrix = workspace(chain), np.empty(joints), np.empty((joints, joints))
    peers = {
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
    for name, (loop, peer) in peers.items():
        ours = seconds(partial(loop, chain, motion, work, vector, matrix)) / SAMPLES
        theirs = seconds(partial(_call_all, peer, motion)) / SAMPLES
        print(
            f'{joints} joints, {name:17s} {1e6 * ours:6.2f} us, Pinocchio from Python '
            f'{1e6 * theirs:6.2f} us, ratio {ours / theirs:.2f}'
        )
    single = seconds(lambda: [inverse_dynamics(chain, *row, work, vector) for row in motion])
    print(
        f'{joints} joints, inverse dynamics, one call from Python: {1e6 * single / SAMPLES:.2f} us'
    )


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--joints', type=int, nargs='+', default=[2, 6, 7])
    for joints in parser.parse_args().joints:
        measure(joints, np.random.default_rng(joints))


if __name__ == '__main__':
    main()
