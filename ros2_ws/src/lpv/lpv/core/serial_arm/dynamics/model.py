"""The dynamics for callers that want arrays returned; hot loops call the compiled functions."""

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import Chain, FloatArray, joint_count, workspace
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics, mass_matrix, momentum_balance
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.serial_arm.dynamics.regressor import momentum_regressor, regressor
from lpv.core.support.errors import SampleError


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

    def _vector(self, name: str, values: npt.ArrayLike) -> FloatArray:
        """A contiguous vector of n finite numbers."""
        vector = np.ascontiguousarray(values, dtype=float)
        if vector.shape != (self.joints,):
            raise SampleError(f'{name} must have {self.joints} numbers, got {vector.shape}')
        if not np.isfinite(vector).all():
            raise SampleError(f'{name} must be finite')
        return vector

    def inverse_dynamics(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> FloatArray:
        """Torques of a motion without friction [N m]; see `newton_euler.inverse_dynamics`."""
        torque = np.empty(self.joints)
        motion = [self._vector(name, values) for name, values in zip('qva', (q, v, a))]
        inverse_dynamics(self.chain, *motion, self._work, torque)
        return torque

    def torque(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> FloatArray:
        """Torques of a motion, friction included [N m]."""
        rigid = self.inverse_dynamics(q, v, a)
        friction = np.empty(self.joints)
        friction_torque(self.chain, self._vector('v', v), rigid, friction)
        return rigid + friction

    def gravity(self, q: npt.ArrayLike) -> FloatArray:
        """Torques g(q) [N m]."""
        still = np.zeros(self.joints)
        return self.inverse_dynamics(q, still, still)

    def mass_matrix(self, q: npt.ArrayLike) -> FloatArray:
        """M(q), rotors included [kg m2]."""
        matrix = np.empty((self.joints, self.joints))
        mass_matrix(self.chain, self._vector('q', q), self._work, matrix)
        return matrix

    def momentum_balance(self, q: npt.ArrayLike, v: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """p = M v [N m s] and C^T v - g [N m]."""
        momentum, force = np.empty(self.joints), np.empty(self.joints)
        motion = self._vector('q', q), self._vector('v', v)
        momentum_balance(self.chain, *motion, self._work, momentum, force)
        return momentum, force

    def acceleration(self, q: npt.ArrayLike, v: npt.ArrayLike, torque: npt.ArrayLike) -> FloatArray:
        """Accelerations that torques less friction cause [rad/s2].

        Raises
        ------
        SampleError
            If M(q) is not positive definite.
        """
        result = np.empty(self.joints)
        matrix = np.empty((self.joints, self.joints))
        motion = self._vector('q', q), self._vector('v', v), self._vector('torque', torque)
        if not forward_dynamics(self.chain, *motion, self._work, matrix, result):
            raise SampleError('the mass matrix is not positive definite')
        return result

    def regressor(self, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike) -> FloatArray:
        """Y(q, v, a), shape (n, 10 n)."""
        matrix = np.empty((self.joints, 10 * self.joints))
        motion = [self._vector(name, values) for name, values in zip('qva', (q, v, a))]
        regressor(self.chain, *motion, self._work, matrix)
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
