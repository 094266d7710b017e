"""Tracking controllers: computed torque, and designed gains, eqs. (57)-(66).

Computed torque, for all arms, is inverse dynamics with PD and integral action:

tau = M(q) a + C(q, v) v + g(q) + F(v_r), a = q_r'' + kd (v_r - v) + kp (q_r - q) + ki eps,
eps' = q_r - q.

With the true model the error of every joint has three poles at -w, w the bandwidth: kd = 3 w,
kp = 3 w^2, ki = w^3.  For a wrong model see `lpv.core.serial_arm.certificate`.
"""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from lpv.core.control.tracking_law import AT_REFERENCE, AT_STATE, NO_MODEL, LawParts, track
from lpv.core.serial_arm.chain import compile_chain, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import Entries
from lpv.core.support.limits import MAX_DELAY
from lpv.core.uio.certificate.conditions import controller_loop, delayed_radius, discretised
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.joints import J_INVERSE, JointMap
from lpv.core.uio.planar import planar_model

BANDWIDTH = 10.0
"""Default [rad/s]."""
FEEDBACK_FIELDS = {
    'off': 'measured_position',
    'confirmed': 'compensated_position',
    'always': 'position',
}
"""Field of lpv_msgs/StateEstimate that the loop closes on: as measured, with confirmed faults
removed, or as estimated."""
COMPENSATION = tuple(FEEDBACK_FIELDS)


class TrackingController:
    """The tracking law of an arm: the designed one where gains are given, else computed torque.

    Designed is state feedback u = M1 x + M2 eps (65), eps' = w - y (59).  Method ``exact`` closes
    the loop on the deviation from the reference and adds the torque that the arm needs along it
    (inverse dynamics with Coriolis terms and friction):
    u = u_ref(w, w', w'') + M1 (x - x_ref) + M2 eps.  Method ``paper`` is (65) literally.  Gains
    are turned into those of the joints once.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    gains : Gains, optional
        Designed gains of this arm, which is planar.
    bandwidth : float, optional
        Of computed torque: distance of the loop's three poles from zero, with a true model [rad/s].

    Attributes
    ----------
    torque : ndarray, shape (n,)
        Joint torques of the last command [N m].
    parts : LawParts
        Of `lpv.core.control.tracking_law.track`.
    tolerated_latency : float
        As of `loop_latency` [s].
    integrates_measurement : bool
        Whether eq. (59) is taken literally: eps integrates the faulty measurement.

    Raises
    ------
    ConfigError
        If the gains belong to another arm, or the sampled loop with this bandwidth is not stable.
    """

    def __init__(
        self, arm: SerialArm, gains: Gains | None = None, bandwidth: float = BANDWIDTH
    ) -> None:
        if gains is not None:
            gains.check_arm(arm)
        self.tolerated_latency = loop_latency(arm, gains, bandwidth)
        self.integrates_measurement = gains is not None and gains.controller.method == 'paper'
        n, chain = len(arm.joints), compile_chain(arm)
        feedback, zero, pole = np.zeros((n, 3 * n)), np.zeros(n), np.zeros(3)
        if gains is None:
            if self.tolerated_latency < arm.sample_time:
                reason = f'{bandwidth:g} rad/s is unstable at {arm.sample_time:g} s a sample'
                raise ConfigError('bandwidth', reason)
            model, pole = AT_STATE, _triple_pole(bandwidth)
        else:
            model = NO_MODEL if self.integrates_measurement else AT_REFERENCE
            # Of absolute angles, theta = J^-1 q, to their torques Q = J^T tau.
            to_absolute = np.kron(np.eye(3), J_INVERSE)
            feedback[:] = J_INVERSE.T @ gains.controller.feedback @ to_absolute
            zero[:] = JointMap(planar_model(arm)).joint_position(np.zeros(2))
        ki, kp, kd = pole.tolist()
        self.parts = LawParts(
            chain, workspace(chain), model, ki, kp, kd, feedback, zero,
            np.array(arm.torque_limit, float), np.zeros(1, bool), np.zeros(3 * n),
            *np.zeros((5, n)),
        )  # fmt: skip
        self.torque: np.ndarray = self.parts.torque
        self._call = Entries()

    def reset(self) -> None:
        """Empty the integrator."""
        self.parts.integral[:] = 0.0

    def answer(
        self,
        reference: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        integrated: np.ndarray,
        interval: float,
    ) -> None:
        """Write the command for the present sample into ``torque``.

        Arguments are as of `track`, arrays contiguous and of floats.
        """
        self._call(track, self.parts, reference, position, velocity, integrated, interval)


def loop_latency(arm: SerialArm, gains: Gains | None = None, bandwidth: float = BANDWIDTH) -> float:
    """Longest constant latency from measurement to torque with which the loop is stable [s].

    Computed for the sampled loop with the torque held between samples: the spectral radius of the
    loop with d samples of delay is below 1 for all d up to the result.  With designed gains it is
    linear at each vertex of the controller's polytope: that is an eigenvalue check at the vertices,
    no proof for an arm that moves between them.  Computed torque is taken with a true model.
    """
    if gains is None:
        a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # of eps, q, v
        b = np.array([[0.0], [0.0], [1.0]])
        return _latency([(a, b)], -_triple_pole(bandwidth)[None], arm.sample_time)
    controller = gains.controller
    feedback = controller.feedback.tobytes()
    return _at_vertices(planar_model(arm), controller.method, controller.sinc_min, feedback)


def _triple_pole(bandwidth: float) -> np.ndarray:
    """ki, kp, kd."""
    return bandwidth**3 * np.array([1.0, 3.0 / bandwidth, 3.0 / bandwidth**2])


@lru_cache(maxsize=16)
def _at_vertices(arm: ArmParameters, method: str, sinc_min: float, gain: bytes) -> float:
    """Kept: campaigns ask for each of their runs."""
    loops = zip(*controller_loop(arm, method, sinc_min))
    return _latency(loops, np.frombuffer(gain).reshape(2, -1), arm.sample_time)


def _latency(
    loops: Iterable[tuple[np.ndarray, np.ndarray]], m: np.ndarray, sample_time: float
) -> float:
    """Of loops x' = A x + B u, u = M x, one pair A, B for each vertex."""
    sampled = [discretised(a, b, sample_time) for a, b in loops]
    delay = 0
    while delay < MAX_DELAY and all(delayed_radius(a, b, m, delay + 1) < 1.0 for a, b in sampled):
        delay += 1
    return delay * sample_time
