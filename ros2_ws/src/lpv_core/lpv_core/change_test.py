"""Changes of a fault estimate that no healthy arm can make: several windows at once.

A position fault enters f^ = y_p - S theta^ undelayed, while theta^ moves by the measured rates and
by a correction whose speed is bounded.  Over a window the estimate of a healthy sensor therefore
changes by no more than noise and that speed times the window; this holds in every configuration,
even where gravity says nothing.  Short windows see abrupt faults in milliseconds, long ones see
drifts before their size does: a generalised likelihood ratio over the time of onset, on a grid.
"""

import math
from statistics import NormalDist

WINDOWS = (0.01, 0.05, 0.2, 1.0)
"""Lengths of the windows [s]."""

_ONSET_RESERVE = 1.5
"""Rates' noise also acts through the observer's correction; over that of the rates alone."""


def sigmas_for(hours, sample_time):
    """Multiple of the standard deviation for a mean time between false alarms by noise.

    Every window of both sensors counts as an independent test at every sample, which is on the
    safe side: neighbouring tests are correlated, and an alarm needs a dwell, too.

    Parameters
    ----------
    hours : float
        Mean time between false alarms [h].
    sample_time : float
        [s].

    Returns
    -------
    float
        Two-sided normal quantile.
    """
    tests = 2 * len(WINDOWS) * hours * 3600.0 / sample_time
    return -NormalDist().inv_cdf(0.5 / tests)


class ChangeTest:
    """Limits of healthy changes for one arm.

    Parameters
    ----------
    arm : ArmParameters
        Noise of its sensors.
    hours : float
        Mean time between false alarms [h].
    smallest : float, optional
        Changes below are of no interest [rad].
    """

    def __init__(self, arm, hours, smallest=0.0):
        self._smallest = smallest
        z = sigmas_for(hours, arm.sample_time)
        self.noise = tuple(
            z * math.sqrt(2.0 * arm.position_noise**2
                          + (_ONSET_RESERVE * arm.velocity_noise) ** 2 * arm.sample_time * window)
            for window in WINDOWS)

    def limit(self, window, speed):
        """Largest healthy change over a window.

        Parameters
        ----------
        window : int
            Index into `WINDOWS`.
        speed : float
            Bound on the speed of the estimate's error [rad/s].

        Returns
        -------
        float
            [rad].
        """
        return max(self._smallest, self.noise[window] + speed * WINDOWS[window])

    def find(self, history, stamp, fault, speed):
        """The shortest window over which the estimate changed too much.

        Parameters
        ----------
        history : History
            Of the sensor.
        stamp : int
            Present [ns].
        fault : float
            Present f^ [rad].
        speed : float
            Bound on the speed of the error [rad/s].

        Returns
        -------
        tuple or None
            Index of the window and f^ before the change [rad].
        """
        for index, window in enumerate(WINDOWS):
            then = stamp - round(window * 1e9)
            sample, limit = history.at(then), self.limit(index, speed)
            if sample is None or abs(fault - sample[1]) <= limit:
                continue
            before = history.median_at(then)
            if abs(fault - before) > limit:
                return index, before
        return None
