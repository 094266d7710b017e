"""Motion of a serial arm under torques: friction, Runge-Kutta steps."""

import numpy as np

from lpv.core.serial_arm.chain import COULOMB, LOAD, SLOPE, VISCOUS, Chain, FloatArray, workspace
from lpv.core.serial_arm.dynamics.friction import drive_friction
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import njit_in_place as njit

MAX_SUBSTEPS = 64
"""Runge-Kutta steps of a sample: files that ask for more would stop the simulator."""
_STABLE = 2.78
"""Largest rate of decay, over that of the steps, with which classical Runge-Kutta is stable."""
_FOUND = 0.6
"""Share of the largest decay that the search for it is taken to find: 0.59 to 1 of that in 3000
postures, of 120 random chains of 2 to 9 joints."""


@njit
def plant_step(
    chain: Chain,
    state: FloatArray,
    torque: FloatArray,
    step: float,
    count: int,
    scratch: FloatArray,
    matrix: FloatArray,
    push: FloatArray | None = None,
) -> bool:
    """Advance the arm by a number of Runge-Kutta steps with held torques.

    ``state``, shape (2, n), are positions and rates, changed [rad], [rad/s]; ``torque`` is of
    drives and from outside [N m], ``push`` has accelerations by a disturbance [rad/s2], both of
    shape (n,); ``step`` is of integration [s].  ``scratch`` is of `plant_scratch`, ``matrix`` of
    shape (n, n).  False if the mass matrix was not positive definite.
    """
    n = torque.shape[0]
    work = scratch[:n]
    vectors = scratch[n:].reshape(-1)
    rate, position = vectors[:n], vectors[n : 2 * n]
    friction, net = vectors[2 * n : 3 * n], vectors[3 * n : 4 * n]
    slopes = vectors[4 * n : 12 * n].reshape((8, n))
    for _ in range(count):
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            for i in range(n):
                position[i], rate[i] = state[0, i], state[1, i]
                if stage > 0:
                    position[i] += share * step * slopes[2 * stage - 2, i]
                    rate[i] += share * step * slopes[2 * stage - 1, i]
            drive_friction(chain, rate, torque, friction)
            for i in range(n):
                net[i] = torque[i] - friction[i]
                slopes[2 * stage, i] = rate[i]
            if not forward_dynamics(
                chain, position, rate, net, work, matrix, slopes[2 * stage + 1]
            ):
                return False
            if push is not None:
                for i in range(n):
                    slopes[2 * stage + 1, i] += push[i]
        for part in range(2):
            for i in range(n):
                state[part, i] += (step / 6.0) * (
                    slopes[part, i] + 2.0 * slopes[2 + part, i] + 2.0 * slopes[4 + part, i]
                    + slopes[6 + part, i])  # fmt: skip
    return True


def plant_scratch(chain: Chain) -> FloatArray:
    """Scratch memory of `plant_step`."""
    return np.zeros((11 * len(chain.translation), workspace(chain).shape[1]))


def integration_step(chain: Chain, period: float) -> tuple[float, int]:
    """Step and steps a sample for which the friction at rest, the stiffest part, is stable.

    Parameters
    ----------
    chain : Chain
        The true arm.
    period : float
        Sample time [s].

    Returns
    -------
    tuple
        Length of a Runge-Kutta step [s], and their number, 2 to `MAX_SUBSTEPS`.

    Raises
    ------
    ConfigError
        If viscous friction is too large for the inertia of a joint, as without its rotor.
    """
    model = SerialModel(chain)
    postures = np.random.default_rng(0).uniform(-3, 3, (20, len(chain.translation)))
    carried = np.abs(model.gravity(postures)).max(axis=0)
    dry = chain.friction[:, COULOMB] + chain.friction[:, LOAD] * carried
    viscous = chain.friction[:, VISCOUS]
    slope = viscous + 2.0 / np.pi * dry * np.maximum(chain.friction[:, SLOPE], 1.0)
    decay = _fastest_decay(model, slope, period)[0]
    if decay > _STABLE * MAX_SUBSTEPS:  # dry friction alone chatters
        fastest, i = _fastest_decay(model, viscous, period)
        if fastest > _STABLE * MAX_SUBSTEPS:
            # Whatever the posture and the other joints do, so much is enough.
            least = float(viscous[i]) * period / (_STABLE * MAX_SUBSTEPS)
            reason = f'is too small for the viscous friction: at least {least:.2g} can be simulated'
            raise ConfigError(f'joints[{i}].rotor_inertia', reason)
    count = min(max(int(np.ceil(decay / (_FOUND * _STABLE))), 2), MAX_SUBSTEPS)
    return period / count, count


def _fastest_decay(model: SerialModel, slope: FloatArray, period: float) -> tuple[float, int]:
    """Largest decay by friction in a sample time, and the joint that moves most in it.

    Light joints that move each other are stopped much faster in some postures than in most: where
    decay matters, those are searched for.  ``slope``, shape (n,), is of friction, ``period`` the
    sample time [s].
    """
    rng, root = np.random.default_rng(0), np.sqrt(np.maximum(slope, 0.0))
    postures, largest, joints = rng.uniform(-3, 3, (40, len(root))), np.zeros(40), np.zeros(40, int)
    for spread in np.append(0.0, 0.7 ** np.arange(12.0)):
        tried = postures + spread * rng.normal(size=postures.shape)
        inverse = np.linalg.inv([model.mass_matrix(q) for q in tried])
        decays, modes = np.linalg.eigh(period * root[:, None] * inverse * root)
        better = decays[:, -1] > largest
        largest[better], postures[better] = decays[better, -1], tried[better]
        joints[better] = np.abs(modes[better, :, -1]).argmax(axis=1)
        if largest.max() < 1.0:
            break  # of two steps a sample, the least, none is near its limit
    worst = int(largest.argmax())
    return float(largest[worst]), int(joints[worst])
