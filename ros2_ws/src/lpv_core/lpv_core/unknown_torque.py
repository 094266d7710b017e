"""How large the generalised torques are that the model of a healthy arm does not know."""

import math

import numpy as np

from lpv_core.arm import A_11, B_12, C_22, COUL_1, COUL_2, COUL_SLOPE, G_1, G_2
from lpv_core.dynamics import coupling
from lpv_core.jit import njit


@njit
def unknown_torque(theta, rate, acc, margin, arm, model_error, payload, lengths, gravity, share,
                   push, out):
    """Bound on the unknown generalised torques abs(q_i).

    Parameters
    ----------
    theta, rate, acc : ndarray, shape (2,)
        Absolute angles, rates, accelerations [rad], [rad/s], [rad/s2].
    margin : ndarray, shape (2,)
        Bound on the angle errors, for what is quadratic in them [rad].
    arm : ndarray, shape (12,)
        Constants of the arm.
    model_error : float
        Relative error of masses and inertias.
    payload : float
        Largest unknown mass at the tip [kg].
    lengths : ndarray, shape (2,)
        L1, L2 [m].
    gravity : float
        g [m/s2].
    share : float
        Relative uncertainty of Coulomb friction at speed; at rest it is unknown altogether.
    push : ndarray, shape (2,)
        Mean disturbance Bd2 abs(d) [rad/s2].
    out : ndarray, shape (2,)
        Receives the bounds [N m].
    """
    cosine, sine = abs(math.cos(theta[0] - theta[1])), abs(math.sin(theta[0] - theta[1]))
    off = abs(coupling(theta[0], theta[1], arm))
    # The model's own accelerations are wrong by as much as the model is.
    a_1, a_2 = abs(acc[0]) * (1.0 + 2.0 * model_error), abs(acc[1]) * (1.0 + 2.0 * model_error)
    s_1, s_2 = rate[0] * rate[0], rate[1] * rate[1]
    lift_1 = min(1.0, abs(math.sin(theta[0])) + margin[0])
    lift_2 = min(1.0, abs(math.sin(theta[1])) + margin[1])
    swing_1, swing_2 = cosine * a_2 + sine * s_2, cosine * a_1 + sine * s_1
    # Every entry of Xi, h and g is a sum of products with one mass or inertia each.
    wrong_1 = arm[A_11] * a_1 + arm[B_12] * swing_1 + arm[G_1] * lift_1
    wrong_2 = arm[C_22] * a_2 + arm[B_12] * swing_2 + arm[G_2] * lift_2
    l_1, l_2 = lengths[0], lengths[1]
    load_1 = l_1 * (l_1 * a_1 + l_2 * swing_1 + gravity * lift_1)
    load_2 = l_2 * (l_2 * a_2 + l_1 * swing_2 + gravity * lift_2)
    relative = rate[1] - rate[0]
    # A joint at rest sticks: its friction is anything up to the Coulomb torque.
    slip_1 = abs(math.atan(arm[COUL_SLOPE] * rate[0])) * 2.0 / math.pi
    slip_2 = abs(math.atan(arm[COUL_SLOPE] * relative)) * 2.0 / math.pi
    rub_1 = arm[COUL_1] * (1.0 - slip_1 * (1.0 - share))
    rub_2 = arm[COUL_2] * (1.0 - slip_2 * (1.0 - share))
    out[0] = (model_error * wrong_1 + payload * load_1 + rub_1 + rub_2
              + arm[A_11] * push[0] + off * push[1])
    out[1] = (model_error * wrong_2 + payload * load_2 + rub_2
              + off * push[0] + arm[C_22] * push[1])
    # What linearised gravity, inertia and Coriolis terms leave out (Taylor's theorem).
    both = 0.5 * arm[B_12] * (margin[0] + margin[1]) ** 2
    out[0] += 0.5 * arm[G_1] * lift_1 * margin[0] ** 2 + both * (s_2 + a_2)
    out[1] += 0.5 * arm[G_2] * lift_2 * margin[1] ** 2 + both * (s_1 + a_1)


class UnknownTorque:
    """`unknown_torque` for one arm.

    Parameters
    ----------
    arm : ArmParameters
        Model error, payload, friction and disturbance that a healthy arm may have.
    friction_uncertainty : float
        ``share`` of `unknown_torque`.
    """

    def __init__(self, arm, friction_uncertainty):
        self.constants = arm.constants()
        self._lengths = np.array(arm.lengths)
        self._push = np.abs(arm.disturbance_mean * np.asarray(arm.disturbance_direction))
        self._arm, self._share = arm, friction_uncertainty
        self._out = np.zeros(2)

    def __call__(self, theta, rate, acceleration, margin):
        """Bounds at one state.

        Parameters
        ----------
        theta, rate, acceleration : ndarray, shape (2,)
            Absolute [rad], [rad/s], [rad/s2].
        margin : ndarray, shape (2,)
            Bound on the angle errors [rad].

        Returns
        -------
        ndarray, shape (2,)
            abs(q_i) [N m]; the next call overwrites it.
        """
        arm = self._arm
        unknown_torque(theta, rate, acceleration, margin, self.constants, arm.model_error,
                       arm.payload, self._lengths, arm.gravity, self._share, self._push, self._out)
        return self._out
