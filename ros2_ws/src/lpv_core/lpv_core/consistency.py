"""Do rates, torques and model fit together?  If not, a fault estimate may have another cause.

The observer's rate innovation r = theta^' - v is, in momentum coordinates, what unknown torques and
rate errors leave behind: a position fault does not touch it.  A healthy arm keeps it within the
reachable set and noise.  Where it leaves them, a rate sensor, a torque sensor or the model is
wrong, and which one cannot be told from two encoders and two rates.
"""

import math

import numpy as np

from lpv_core.arm import A_11, C_22
from lpv_core.dynamics import coupling

_FILTERS = (0.02, 0.2)
"""Time constants of the averages [s]: a jump of a rate, and a lasting contradiction."""
_HOLD = 1.0
"""An inconsistency is believed to last so long after it was seen [s]."""


class ConsistencyTest:
    """Averaged momentum innovation against its healthy bound.

    Parameters
    ----------
    arm : ArmParameters
        Its inertia, noise and torque tolerance.
    gains : Gains
        Of method ``exact``.
    sigmas : float
        Standard deviations of noise in the limit.
    """

    def __init__(self, arm, gains, sigmas):
        c = arm.constants()
        self._constants = c
        self._inertia = np.array([c[A_11], c[C_22]])
        off = abs(coupling(0.0, 0.0, c))
        # White rates of both links enter a momentum; relative sensors add theirs up.
        rows = np.hypot(1.0, off / self._inertia) * (1.0 if arm.arrangement == 'absolute'
                                                     else math.sqrt(2.0))
        self._noise = [sigmas * rows * arm.velocity_noise
                       * math.sqrt(arm.sample_time / (2.0 * tau)) for tau in _FILTERS]
        self._tolerance = np.asarray(arm.torque_tolerance) / (
            np.asarray(gains.observer.mu) * self._inertia)
        self.reset()

    def reset(self):
        """Forget the past."""
        self._means = np.zeros((len(_FILTERS), 2))
        self._until = None

    def update(self, estimate, healthy):
        """Judge one sample.

        Parameters
        ----------
        estimate : Estimate
            Latest estimate.
        healthy : ndarray, shape (2,)
            Bound on the scaled momentum error of a healthy arm [rad/s].

        Returns
        -------
        bool
            True if rates, torques and model contradict each other, now or shortly before.
        """
        theta, r = estimate.absolute_position, estimate.innovation
        off = coupling(theta[0], theta[1], self._constants)
        momentum = r + off * r[::-1] / self._inertia
        for mean, noise, tau in zip(self._means, self._noise, _FILTERS):
            mean += min(1.0, estimate.interval / tau) * (momentum - mean)
            if np.any(np.abs(mean) > healthy + self._tolerance + noise):
                self._until = estimate.stamp + round(_HOLD * 1e9)
        return self._until is not None and estimate.stamp < self._until
