"""The two observers behind one interface: start, advance, place."""

import numpy as np

from lpv_core.joints import JointMap
from lpv_core.momentum_uio import exact_step
from lpv_core.polytope import slope_range
from lpv_core.state_space import Descriptor, output_matrices, vertex_matrices
from lpv_core.uio import paper_step


class ExactRecursion:
    """Observer of method ``exact``.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : ExactObserverGains
        Its gains.

    Attributes
    ----------
    x : ndarray, shape (6,)
        theta^, theta^', f^; absolute angles and physical sensors.
    held : ndarray of bool, shape (2,)
        Links that are held.
    """

    def __init__(self, arm, gains):
        self._s = np.ascontiguousarray(JointMap(arm).sensor_matrix)
        self._s_inverse = np.linalg.inv(self._s)
        self._kappa = arm.sign * np.asarray(gains.kappa, float)
        self._mu = np.ascontiguousarray(gains.mu)
        self._constants = arm.constants()
        low, high = slope_range(arm)
        # The region ends at |cos| = 1; no rounding of the cosine may leave it.
        self._low = np.where(low <= -1.0, -1.0 - 1e-9, low)
        self._high = np.where(high >= 1.0, 1.0 + 1e-9, high)
        self.x = np.zeros(6)
        self.held = np.zeros(2, dtype=bool)

    def advance(self, y_old, y_new, torque, dt):
        """Advance over one interval.

        Parameters
        ----------
        y_old, y_new : ndarray, shape (4,)
            Outputs at both ends, sensor coordinates [rad], [rad/s].
        torque : ndarray, shape (2,)
            Generalised torques Q over the interval [N m].
        dt : float
            Its length [s].
        """
        exact_step(self.x, self._s_inverse @ y_old[2:], self._s_inverse @ y_new[2:], torque, dt,
                   self._kappa, self._mu, self._constants, self._low, self._high, self.held)
        self.x[4:] = y_new[:2] - self._s @ self.x[:2]

    def place(self, y):
        """Take ``x`` as it was changed from outside; here it is the whole state.

        Parameters
        ----------
        y : ndarray, shape (4,)
            Outputs that belong to it.
        """


class PaperRecursion:
    """Observer of method ``paper``; same interface as `ExactRecursion`.

    Parameters
    ----------
    arm : ArmParameters
        The arm.
    gains : PaperObserverGains
        Its gains.
    """

    def __init__(self, arm, gains):
        self._t1, self._t2 = (np.ascontiguousarray(m) for m in (gains.t1, gains.t2))
        self._k, self._box = (np.ascontiguousarray(m) for m in (gains.k, gains.box))
        self._c = np.ascontiguousarray(np.hstack(output_matrices(arm)))
        a, b = vertex_matrices(self._box, arm.constants(coriolis=False))
        descriptor = Descriptor(a, b, arm)
        self._a, self._b = descriptor.a, descriptor.b
        self._z, self.x = np.zeros(6), np.zeros(6)
        self._work = (np.zeros((5, 6)), np.zeros((6, 4)), np.zeros((6, 6)), np.zeros((6, 2)),
                      np.zeros(8))
        self.held = np.zeros(2, dtype=bool)

    def advance(self, y_old, y_new, torque, dt):
        """As `ExactRecursion.advance`."""
        paper_step(self._z, y_old, y_new, torque, dt, self._k, self._t1, self._t2, self._c,
                   self._a, self._b, self._box, self.x, *self._work)

    def place(self, y):
        """As `ExactRecursion.place`: z follows from x^ = z + T2 y (38)."""
        self._z[:] = self.x - self._t2 @ y


RECURSIONS = {'exact': ExactRecursion, 'paper': PaperRecursion}
