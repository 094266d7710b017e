"""The dynamics for callers that want arrays returned; hot loops call the compiled functions."""

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import Chain, FloatArray, joint_count, workspace
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.momentum import mass_matrix
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.serial_arm.dynamics.regressor import momentum_regressor
from lpv.core.support.errors import SampleError
from lpv.core.support.jit import njit_in_place as njit


@njit
def _each_rigid(
    chain: Chain, q: FloatArray, v: FloatArray, a: FloatArray, work: FloatArray, torque: FloatArray
) -> None:
    for k in range(len(q)):
        inverse_dynamics(chain, q[k], v[k], a[k], work, torque[k])


@njit
def _each_friction(chain: Chain, v: FloatArray, load: FloatArray, torque: FloatArray) -> None:
    for k in range(len(v)):
        friction_torque(chain, v[k], load[k], torque[k])


class SerialModel:
    """Dynamics of a serial chain; not for several threads at once.

    Parameters
    ----------
    chain : Chain
        The arm.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self.joints = joint_count(chain)
        self._work = workspace(chain)

    def _vector(self, name: str, values: npt.ArrayLike, many: bool = False) -> FloatArray:
        """A contiguous vector of n finite numbers; or many of them, shape (N, n)."""
        vector = np.ascontiguousarray(values, dtype=float)
        if vector.shape[vector.ndim == 2 and many :] != (self.joints,):
            raise SampleError(f'{name} must have {self.joints} numbers, got {vector.shape}')
        if not np.isfinite(vector).all():
            raise SampleError(f'{name} must be finite')
        return np.atleast_2d(vector) if many else vector

    def inverse_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> FloatArray:
        """Torques of a motion without friction [N m]; see `newton_euler.inverse_dynamics`.

        Of one sample, shape (n,), or of many, shape (N, n).
        """
        motion = [self._vector(name, values, True) for name, values in zip('qva', (q, v, a))]
        torque = np.empty(motion[0].shape)
        if len({one.shape for one in motion}) > 1:
            raise SampleError('q, v and a must be of the same samples')
        _each_rigid(self.chain, *motion, self._work, torque)
        return torque.reshape(np.shape(q))

    def torque(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> FloatArray:
        """Torques of a motion, friction included [N m]; shapes as of `inverse_dynamics`."""
        rigid = self.inverse_dynamics(q, v, a)
        load, friction = np.atleast_2d(rigid), np.empty(rigid.shape)
        _each_friction(self.chain, self._vector('v', v, True), load, np.atleast_2d(friction))
        return rigid + friction

    def gravity(self, q: npt.ArrayLike) -> FloatArray:
        """Torques g(q) [N m]; shapes as of `inverse_dynamics`."""
        still = np.zeros(np.shape(q))
        return self.inverse_dynamics(q, still, still)

    def mass_matrix(self, q: npt.ArrayLike) -> FloatArray:
        """M(q), rotors included [kg m2]."""
        matrix = np.empty((self.joints, self.joints))
        mass_matrix(self.chain, self._vector('q', q), self._work, matrix)
        return matrix

    def momentum_regressor(
        self, q: npt.ArrayLike, v: npt.ArrayLike
    ) -> tuple[FloatArray, FloatArray]:
        """Y_p(q, v) and Y_f(q, v), each of shape (n, 10 n)."""
        momentum = np.empty((self.joints, 10 * self.joints))
        force = np.empty_like(momentum)
        motion = self._vector('q', q), self._vector('v', v)
        momentum_regressor(self.chain, *motion, self._work, momentum, force)
        return momentum, force
