"""Encoder against independent rate: which of the two fails slowly.

D = y(t) - y(t - T) - int v dt is zero whatever acts on the arm.  A drift of the encoder and a bias
of the rate both show in it; the balances tell them apart, with the size that D has found:
LLR(s) = I s s^ - I s^2 / 2 for each, s^ being the size that fits best.
"""

import numpy as np

from lpv_core.serial_arm.chain import FloatArray
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.balance import DRIFT, RATE
from lpv_core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv_core.serial_arm.diagnosis.hypotheses import WINDOWS, Explanation, Search

SPAN = 0.5
"""T [s]."""
_SHORTEST = min(WINDOWS)
_SIGMAS = 8.0
_SMALLEST = 0.01
"""Smallest D that is looked at [rad]."""
_MEMORY = 64
"""Balances over which the usual size of D is learned."""
_DWELL = 3


class RateCheck:
    """Check of all joints of an arm whose rates are independent.

    Parameters
    ----------
    arm : SerialArm
        Its sensors.
    plan : HorizonPlan
        Lengths of blocks and intervals.
    """

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        sensors = [joint.sensors for joint in arm.joints]
        self._independent = np.array([one.rates == 'independent' for one in sensors])
        self._usual = np.array([
            2.0 * one.position_noise + one.velocity_noise * np.sqrt(SPAN * arm.sample_time)
            for one in sensors
        ])  # fmt: skip
        self._usual = np.maximum(self._usual, 0.1 * _SMALLEST)
        self._held = np.zeros(len(sensors), int)
        self.intervals = max(2, round(SPAN / plan.interval))
        self.joints = np.zeros(0, int)  # that fail now
        self.rate = np.zeros(len(sensors))  # at which D has grown lately [rad/s]
        self.since = np.zeros(len(sensors))  # for how long, at that rate [s]

    def take(self, blocks: FloatArray) -> None:
        """Test the blocks of the last intervals, rows as of `Sampler.blocks`, oldest first."""
        n = len(self._held)
        if not self._independent.any() or len(blocks) < 2:
            return
        y, v, time = blocks[:, :n], blocks[:, n : 2 * n], blocks[:, 3 * n]
        growth = np.diff(y, axis=0) - 0.5 * (v[1:] + v[:-1]) * np.diff(time)[:, None]
        late = max(1, len(growth) * _DWELL // self.intervals)
        self.rate = growth[-late:].sum(0) / (time[-1] - time[-1 - late])
        size = np.abs(growth.sum(0))
        self.since = size / np.maximum(np.abs(self.rate), 1e-9)
        beyond = self._independent & (size > self._limit())
        self._held = np.where(beyond, self._held + 1, 0)
        bounded = np.minimum(size, 3.0 * self._usual)
        change = (bounded**2 - self._usual**2) / _MEMORY
        self._usual = np.where(beyond, self._usual, np.sqrt(self._usual**2 + change))
        self.joints = np.nonzero(self._held >= _DWELL)[0]

    def _limit(self) -> FloatArray:
        """Largest D of healthy sensors, shape (n,) [rad]."""
        return np.maximum(_SIGMAS * self._usual, _SMALLEST)

    def excludes(self, fault: Explanation, now: float) -> bool:
        """Whether D would have shown a fault of an encoder twice over, and shows nothing.

        Parameters
        ----------
        fault : Explanation
            What balances suggest.
        now : float
            Time of the last balance [s].
        """
        i = fault.joint
        if not fault.is_encoder or not self._independent[i] or self._held[i] > 0:
            return False
        change = {'drift': abs(fault.size) * min(SPAN, now - fault.begin), 'slip': abs(fault.size)}
        return change.get(fault.kind, 0.0) > 2.0 * float(self._limit()[i])

    def explanations(self, search: Search, joint: int, begins: FloatArray) -> list[Explanation]:
        """Drift of the encoder and bias of the rate, the more likely one first.

        Parameters
        ----------
        search : Search
            All of its windows have been evaluated.
        joint : int
            That fails.
        begins : ndarray, shape (W,)
            Of the windows [s]; NaN where they are longer than the horizon.

        Returns
        -------
        list of Explanation
            Their gains are the LLR of the size that was found; empty while no window fits.
        """
        if np.isnan(begins).all():
            return []
        wanted = np.nanmax(begins) + _SHORTEST - min(float(self.since[joint]), SPAN)
        w = int(np.nanargmin(np.abs(begins - wanted)))
        rate, found = float(self.rate[joint]), []
        for kind, group, size in (('drift', DRIFT, rate), ('rate_bias', RATE, -rate)):
            s = group * len(self._held) + joint
            information, best = search.information[w, s], search.size[w, s]
            gain = information * size * (best - 0.5 * size)
            sigma = 2.0 * float(self._usual[joint]) / SPAN
            found.append(Explanation(kind, joint, gain, size, sigma, float(begins[w])))
        return sorted(found, key=lambda one: -one.gain)
