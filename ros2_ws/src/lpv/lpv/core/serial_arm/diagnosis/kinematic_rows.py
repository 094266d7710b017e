"""Kinematic rows: what readings say of the way of their joints, less what their own rates do."""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import BoolArray, FloatArray, IntArray
from lpv.core.serial_arm.description import RATE_BIAS, SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.information import ROBUST, factorise, whiten
from lpv.core.serial_arm.diagnosis.linear_bank import DRIFT_STARTS, Rows
from lpv.core.serial_arm.diagnosis.sampler import DELAY, LATE, NOISE_MEMORY
from lpv.core.support.jit import njit_in_place

NEGLIGIBLE = 5e-4
"""Errors of readings, and of rates in a quarter of a second, that are no faults, however little
noise the file states [rad], times `SerialJoint.scale`."""
_BEFORE = 1e-12
"""Least variance of a row [rad2]: those of readings without any noise are not divided by zero."""


class Kinematics(NamedTuple):
    """Kinematic rows of n sensors; of the first arrays, the last entries hold the rows at hand."""

    rows: FloatArray  # (most, n) D, oldest first [rad]
    variances: FloatArray  # (most, n) of jumps in them [rad2]
    edges: FloatArray  # (most + 1, n) rates where rows begin and end [rad/s]
    held: IntArray  # (1,) rows at hand
    jumps: FloatArray  # (rows, n) variances of jumps in rows to come, the next one first [rad2]
    independent: BoolArray  # (n,) whether the rate has a sensor of its own
    trusted: BoolArray  # (n,) whether it has, and its rows count
    stated: FloatArray  # (n,) variance of a row by the readings at its ends, by the file [rad2]
    # (n,) variance of a row by what a followed fault takes out, infinite where none does [rad2]
    followed: FloatArray
    ends: FloatArray  # (n,) the same, at least by the rounding that readings show [rad2]
    walk: FloatArray  # (n,) of int v dt, per second [rad2/s]
    bias: FloatArray  # (n,) standard deviation of the rate's bias [rad/s]
    inflation: FloatArray  # (n,) factor of the variance, as seen
    lag: FloatArray  # (1,) of rates behind readings, as differences and filtered ones do [s]
    lag_known: FloatArray  # (1,) its information [1/s2]
    stamps: FloatArray  # (1,) usual variance of a block's time [s2]
    late: FloatArray  # (most + 1,) more of it where stamps are known to be wrong [s2]
    latest: float  # the largest of these that is plausible [s2]
    matrix: FloatArray  # (2, n, n) scratch


@njit_in_place
def take_row(own: Kinematics, blocks: FloatArray, interval: float) -> None:
    """Add the row of the last interval; ``blocks`` are those of two intervals, oldest first."""
    n, last, first = own.ends.shape[0], blocks.shape[0] - 1, blocks.shape[0] // 2 - 1
    usual = interval / (last - first)
    most = own.rows.shape[0]
    if own.held[0] == 0:
        for i in range(n):
            own.edges[most, i] = blocks[first, n + i]
        own.late[most] = blocks[first, 3 * n + 3] ** 2
    own.held[0] = min(own.held[0] + 1, most)
    for k in range(most - own.held[0], most):
        own.late[k] = own.late[k + 1]
        for i in range(n):
            own.edges[k, i] = own.edges[k + 1, i]
            if k + 1 < most:
                own.rows[k, i], own.variances[k, i] = own.rows[k + 1, i], own.variances[k + 1, i]
    own.late[most] = blocks[last, 3 * n + 3] ** 2
    for i in range(n):
        own.edges[most, i] = blocks[last, n + i]
        row, missing = blocks[last, i] - blocks[first, i], 0.0
        for k in range(first, last):
            length = blocks[k + 1, 3 * n] - blocks[k, 3 * n]
            row -= 0.5 * (blocks[k, n + i] + blocks[k + 1, n + i]) * length
            # Where samples are missing, the rate is hardly known.
            gap = max(blocks[k + 1, 3 * n + 1] - usual, 0.0)
            missing += (0.5 * gap * blocks[k + 1, n + i]) ** 2
        change = own.edges[most, i] - own.edges[most - 1, i]
        own.rows[most - 1, i] = row - own.lag[0] * change
        own.variances[most - 1, i] = own.jumps[0, i] + missing
        for k in range(own.jumps.shape[0]):
            own.jumps[k, i] = own.jumps[k + 1, i] if k + 1 < own.jumps.shape[0] else 0.0
    _see_late(own, interval)
    _learn_lag(own, interval)


@njit_in_place
def _see_late(own: Kinematics, interval: float) -> None:
    """Doubt the times of both ends of the last row where readings of all joints are late alike.

    Smoothed by who resampled them, they were so for longer than a sample shows.  What one sensor's
    fault makes is explained by its own joint as well, but for the noise of the others.  Readings
    that are corrected by a fault that is followed show it, too.
    """
    most, power, found, largest = own.rows.shape[0], 0.0, 0.0, 0.0
    for i in range(own.ends.shape[0]):
        if own.trusted[i] or own.followed[i] < np.inf:
            variance = own.inflation[i] * (own.ends[i] + own.walk[i] * interval)
            variance += 0.0 if own.trusted[i] else own.followed[i]
            variance = max(variance + own.variances[most - 1, i], _BEFORE)
            row, rate = own.rows[most - 1, i], own.edges[most, i]
            power += rate * rate / variance
            found += rate * row / variance
            largest = max(largest, row * row / variance)
    if found * found > (largest + ROBUST**2) * power:
        late = (found / power) ** 2
        own.late[most], own.late[most - 1] = own.late[most] + late, own.late[most - 1] + late


@njit_in_place
def _learn_lag(own: Kinematics, interval: float) -> None:
    """Learn by how much rates lag behind their readings, and take it out of all rows.

    A lag d moves a row by d times the change of its rate, which no fault does.  A driver filters
    all rates alike: it is learned from the rows of all joints, outliers bounded.
    """
    n, most, found, before = own.ends.shape[0], own.rows.shape[0], 0.0, own.lag_known[0]
    late, old = own.stamps[0] + own.late[most], own.stamps[0] + own.late[most - 1]
    for i in range(n):
        if own.trusted[i]:
            now, then = own.edges[most, i], own.edges[most - 1, i]
            variance = own.inflation[i] * (own.ends[i] + own.walk[i] * interval)
            variance += own.variances[most - 1, i] + late * now * now + old * then * then
            variance, change = max(variance, _BEFORE), now - then
            bound = ROBUST * np.sqrt(variance + change * change / before)
            own.lag_known[0] += change * change / variance
            found += min(max(own.rows[most - 1, i], -bound), bound) * change / variance
    step = found / own.lag_known[0]
    own.lag[0] += step
    for k in range(most - own.held[0], most):
        for i in range(n):
            own.rows[k, i] -= step * (own.edges[k + 1, i] - own.edges[k, i])


@njit_in_place
def loudest_window(own: Kinematics, interval: float) -> float:
    """Largest evidence against healthy sensors of the sums of any number of last rows."""
    most, largest = own.rows.shape[0], 0.0
    for i in range(own.rows.shape[1]):
        if not own.trusted[i]:
            continue
        total, jumps = 0.0, 0.0
        for k in range(own.held[0]):
            at, span = most - 1 - k, interval * (k + 1)
            total += own.rows[at, i]
            jumps += own.variances[at, i]
            variance = own.inflation[i] * (own.ends[i] + own.walk[i] * span)
            variance += (own.bias[i] * span) ** 2 + jumps
            largest = max(largest, 0.5 * total * total / max(variance, _BEFORE))
    return largest


@njit_in_place
def sum_rows(own: Kinematics, interval: float, lengths: IntArray, rows: Rows) -> None:
    """Write the sums of the rows of windows; see `KinematicRows.sums`."""
    n, most, held = own.ends.shape[0], own.rows.shape[0], own.held[0]
    for w in range(lengths.shape[0]):
        count = min(lengths[w], held)
        if count == 0:
            continue
        rows.span[w] = interval * count
        for i in range(n):
            if own.trusted[i]:
                jumps = 0.0
                for k in range(most - 1, most - 1 - count, -1):
                    rows.found[w, i] += own.rows[k, i]
                    jumps += own.variances[k, i]
                variance = own.inflation[i] * (own.ends[i] + own.walk[i] * rows.span[w])
                variance = max(variance + (own.bias[i] * rows.span[w]) ** 2 + jumps, _BEFORE)
                # As the readings turned: a rate that is wrong from some moment on is not late.
                turned = own.edges[most, i] - own.edges[most - count, i]
                before = own.rows[most - 1 - count, i] if count < held else 0.0
                turned += (own.rows[most - 1, i] - before) / interval
                # All but filters of first order add d^2 / 2 times the change of the acceleration.
                bent = own.edges[most, i] - own.edges[most - 1, i]
                bent -= own.edges[most - count + 1, i] - own.edges[most - count, i]
                variance += (0.5 * own.lag[0] * own.lag[0] / interval * bent) ** 2
                rows.weight[w, i] = 1.0 / (variance + turned * turned / own.lag_known[0])
        _doubt_stamps(own, count, rows.weight[w], rows.found[w])


@njit_in_place
def _doubt_stamps(own: Kinematics, count: int, weight: FloatArray, found: FloatArray) -> None:
    """Let sums say what they do where stamps of both ends of their window may be wrong.

    These are common to all sensors: their covariance is s v v^T.  What is known to be late was read
    at any moment of an interval, over which rates change by dv: that adds s dv dv^T / 3.  Rates
    that wrap change more, and are not late.
    """
    n, most, matrix, inverse = weight.shape[0], own.rows.shape[0], own.matrix[0], own.matrix[1]
    now, then = own.edges[most], own.edges[most - count]
    before, after = own.edges[most - 1], own.edges[most - count + 1]
    late, old = own.stamps[0] + own.late[most], own.stamps[0] + own.late[most - count]
    if late + old == 0.0:
        return
    for i in range(n):
        for j in range(n):
            counts = weight[i] > 0.0 and weight[j] > 0.0
            both = late * now[i] * now[j] + old * then[i] * then[j]
            both += own.late[most] / 3.0 * (now[i] - before[i]) * (now[j] - before[j])
            both += own.late[most - count] / 3.0 * (after[i] - then[i]) * (after[j] - then[j])
            both = both if counts else 0.0
            matrix[i, j], inverse[i, j] = both, 1.0 if i == j else 0.0
        matrix[i, i] += 1.0 / weight[i] if weight[i] > 0.0 else 1.0
    factorise(matrix, own.ends)  # no pivot is smaller than what readings alone leave
    whiten(matrix, inverse)
    for k in range(n):  # U^-T times the sums, in place of a column of the factor
        matrix[k, 0] = 0.0
        for j in range(k + 1):
            matrix[k, 0] += inverse[k, j] * found[j]
    for i in range(n):
        if weight[i] > 0.0:
            weight[i], total = 0.0, 0.0
            for k in range(i, n):
                weight[i] += inverse[k, i] * inverse[k, i]
                total += inverse[k, i] * matrix[k, 0]
            found[i] = total / weight[i]


@njit_in_place
def learn_rows(own: Kinematics, interval: float) -> None:
    """Learn how much rows scatter; constant errors of rates do not count as scatter."""
    n, most, power, late = own.ends.shape[0], own.rows.shape[0], 0.0, 0.0
    for i in range(n):
        expected = max(3.0 * own.ends[i] + 2.0 * own.walk[i] * interval, _BEFORE)
        change = own.rows[most - 1, i] - own.rows[most - 2, i]
        bounded = min(change * change / expected, ROBUST**2 * own.inflation[i])
        own.inflation[i] = max(own.inflation[i] + (bounded - own.inflation[i]) / NOISE_MEMORY, 1.0)
        if own.trusted[i]:
            rate = own.edges[most - 1, i]
            power += rate * rate / expected
            late += rate / expected * change
    # An error d of a stamp moves the rows of all sensors by their rates.  The difference of two
    # rows holds d of three blocks, once, twice and once.
    # Where the joints are slow it says little of them.
    known = 6.0 * power * priors.WRONG_STAMPS * own.latest
    if known > 0.0:
        seen = min(((late / power) ** 2 - 1.0 / power) / 6.0, own.latest)
        share = (known / (1.0 + known)) ** 2 / NOISE_MEMORY
        own.stamps[0] = max(own.stamps[0] + share * (seen - own.stamps[0]), 0.0)


class KinematicRows:
    """D = y(t) - y(t - T) - int v dt of every interval, for sensors with rates of their own."""

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        noise, step, rate, independent = arm.sensors()
        self._interval, n, reading = plan.interval, len(noise), noise**2 + step**2 / 12.0
        least, most = NEGLIGIBLE * arm.scales(), round(DRIFT_STARTS[-1] / plan.interval) + 1
        stated = 2.0 * reading / plan.per_block + least**2
        latest = (LATE * arm.sample_time) ** 2 / plan.per_block
        self.parts = Kinematics(
            np.zeros((most, n)), np.zeros((most, n)), np.zeros((most + 1, n)),
            np.zeros(1, np.int64), np.zeros((2 + DELAY // plan.per_interval, n)),
            independent, independent.copy(),
            stated, np.full(n, np.inf), stated.copy(), rate**2 * arm.sample_time,
            np.maximum(RATE_BIAS * rate, 4.0 * least), np.ones(n), np.zeros(1),
            np.array([1.0 / priors.RATE_LAG**2]), np.array([priors.WRONG_STAMPS * latest]),
            np.zeros(most + 1),
            latest, np.zeros((2, n, n)))  # fmt: skip
        self._independent, self.trusted = self.parts.independent, self.parts.trusted

    @property
    def _rows(self) -> FloatArray:
        """Rows at hand, oldest first."""
        return self.parts.rows[len(self.parts.rows) - self.parts.held[0] :]

    def restart(self) -> None:
        """Forget the rows so far, after a gap."""
        self.parts.held[:] = 0
        self.parts.jumps[:] = 0.0

    def note_jump(self, joint: int, variance: float) -> None:
        """A jump was taken out of readings that are still to come, with some error [rad2]."""
        # It may belong to any row that holds samples which wait.
        self.parts.jumps[:, joint] += variance

    def leave_out(self, joint: int, out: bool) -> None:
        """Do without the rows of a joint one of whose sensors has failed, or with those to come."""
        self.trusted[joint] = self._independent[joint] and not out
        self.parts.followed[joint] = np.inf
        self.forget(joint)

    def follow(self, joint: int, sigma: float) -> None:
        """Readings of a joint are corrected, at a rate that is off by a standard deviation."""
        if self._independent[joint]:
            self.parts.followed[joint] = (sigma * self._interval) ** 2

    def forget(self, joint: int) -> None:
        """Do without the rows of a joint so far."""
        self._rows[:, joint] = 0.0

    def last(self, joint: int) -> tuple[float, float] | None:
        """Last row of a joint and its variance [rad], [rad2]; None where there is none."""
        if not self._independent[joint] or len(self._rows) == 0:
            return None
        return self._told(joint, 1)

    @property
    def held(self) -> int:
        """Rows at hand."""
        return len(self._rows)

    def way(self, joint: int, count: int) -> tuple[float, float] | None:
        """How far the rate sensor of a joint says that it went while its reading rested.

        Way in the last ``count`` intervals and its standard deviation [rad]; None without a rate
        of its own.
        """
        count = min(max(count, 1), self.held)
        if not self.trusted[joint] or count == 0:
            return None
        total, variance = self._told(joint, count)
        return -total, variance**0.5

    def explained(self, joint: int, count: int) -> float:
        """What a reading that rests explains of the last rows: all of it."""
        way = self.way(joint, count)
        return 0.0 if way is None else 0.5 * (way[0] / way[1]) ** 2

    def _told(self, joint: int, count: int) -> tuple[float, float]:
        """Sum of so many last rows of a joint and its variance [rad], [rad2].

        If intervals were not as long as their stamps say, all rows are off by the rates: what the
        other joints show of it is taken out.
        """
        own, rows = self.parts, self._rows[-count:]
        rates, jumps = 0.5 * (own.edges[1:] + own.edges[:-1])[-count:], own.variances[-count:]
        usual = own.inflation * (own.ends + own.walk * self._interval) + jumps
        weights = self.trusted * rates / np.maximum(usual, _BEFORE)
        weights[:, joint] = 0.0
        known = (weights * rates).sum(1) + 1.0 / own.latest
        late, rate = (weights * rows).sum(1) / known, rates[:, joint]
        span, jumped = self._interval * count, float(jumps[:, joint].sum())
        variance = own.inflation * (own.ends + own.walk * span) + (own.bias * span) ** 2
        by_stamps = float((rate**2 / known).sum())
        total = float((rows[:, joint] - late * rate).sum())
        return total, max(float(variance[joint]) + jumped + by_stamps, _BEFORE)

    def agrees(self, joint: int, taken_out: float) -> float:
        """For how long the rows of late are those of healthy sensors, 0 where they are not [s].

        What is taken out of the rate [rad/s] is not in the rows.  They go back for a pose at
        least, and until they tell a rate that is right again from one that is not.
        """
        count = min(round(priors.POSE_TIME / self._interval), self.held)
        while count > 0:
            total, variance = self._told(joint, count)
            error = taken_out * count * self._interval
            if error**2 > (2.0 * ROBUST) ** 2 * variance or error == 0.0 or count == self.held:
                left = abs(total - error)
                is_right = left < ROBUST * variance**0.5 and left <= abs(total)
                return count * self._interval if is_right else 0.0
            count = min(2 * count, self.held)
        return 0.0
