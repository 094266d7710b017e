"""Faults that have been named are unknowns from then on: states that are followed.

The size of a fault that changes (drift, scale, slip, stuck) is a state with process noise; every
momentum balance measures it, beside what is known of the arm.  Readings are corrected by the
estimate, so that the next fault is looked for beside this one, and what the estimate may be wrong
by is added to the variance of the balances.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import DRIFT, OFFSET, RATE, SCALE
from lpv.core.serial_arm.diagnosis.bank import Hypothesis
from lpv.core.serial_arm.diagnosis.estimator import STRAIGHT, OffsetEstimator
from lpv.core.serial_arm.diagnosis.information import ROBUST, whiten
from lpv.core.serial_arm.diagnosis.readings import Readings
from lpv.core.serial_arm.diagnosis.sampler import HISTORY, Sampler, block_end, put_back, take_out
from lpv.core.serial_arm.diagnosis.stuck import LINEAR, Course

_REACH = math.sqrt(3.0)
"""Standard deviations of the state at which balances are evaluated: cubature of third degree."""
LARGEST_SCALE = 0.9
"""Largest scale error s that is corrected: y / (1 + s) is at most ten times the reading [-]."""


@dataclass
class FaultFilter:
    """Filter of one sensor's fault while it changes.

    The state is fault, rate and acceleration [rad], [rad/s], [rad/s2], or scale error and offset
    [-], [rad] and nothing; what has been taken out of the readings is its mean.  Only a frozen
    reading's fault accelerates, as its joint does.
    """

    joint: int
    kind: str  # drift, scale, slip or stuck
    begin: float  # when it began to change [s]
    mean: FloatArray = field(default_factory=lambda: np.zeros(3))  # of the state
    covariance: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    updated: float = 0.0  # moment of the state: the end of the newest balance [s]
    acceleration: float = 0.0  # usual one of the fault [rad/s2]
    scale: float = 1.0  # what counts as much as 1 rad, see `SerialJoint.scale` [rad]
    stopped: float | None = None  # when brakes stopped the joint, which rests since then [s]
    rested: float | None = None  # fault when all right readings came to rest, if they do [rad]
    before: 'FaultFilter | None' = None  # at the end of the balance before

    @property
    def is_scale(self) -> bool:
        """Whether the state is a scale error."""
        return self.kind == 'scale'

    @property
    def may_stop(self) -> bool:
        """Whether the joint of a frozen reading moves, as far as is known."""
        return self.kind == 'stuck' and self.stopped is None

    @property
    def unit(self) -> float:
        """Of the first state: scale errors are ratios."""
        return 1.0 if self.is_scale else self.scale

    def fault(self, reading: float, now: float) -> tuple[float, float]:
        """Fault and its standard deviation [rad]."""
        if self.is_scale:
            position = (reading - self.mean[1]) / (1.0 + self.mean[0])
            direction = np.array([position, 1.0, 0.0]) / (1.0 + self.mean[0])
            fault = reading - position
            variance = float(direction @ self.covariance @ direction)
            return fault, math.sqrt(max(variance, 0.0))
        mean, covariance = self._after(now - self.updated)
        return float(mean[0]), math.sqrt(max(covariance[0, 0], 0.0))

    def share(self, reading: float, now: float, sigmas: float) -> float:
        """Share of the fault that is beyond doubt: 1 - (bound / fault)^2, none within its bound.

        The joint of a frozen reading is not where that says, however uncertain the fault is.
        """
        fault, sigma = self.fault(reading, now)
        bound = 0.0 if self.kind == 'stuck' else sigmas * sigma
        return 1.0 - min(1.0, (bound / fault) ** 2) if fault else float(bound == 0.0)

    def rate_sigma(self, rate: float) -> float:
        """Standard deviation of the fault's rate while its joint moves at one [rad/s].

        Of a frozen reading nothing tells it but that rate.
        """
        if self.kind == 'stuck':
            return math.inf
        k = 0 if self.is_scale else 1
        return math.sqrt(self.covariance[k, k]) * (abs(rate) if self.is_scale else 1.0)

    def predict(self, now: float) -> None:
        """Let the state go on until a moment [s]."""
        self.mean, self.covariance = self._after(now - self.updated)
        self.updated = now

    def _after(self, interval: float) -> tuple[FloatArray, FloatArray]:
        """State and its covariance after a time, or before it where that is negative [s]."""
        if self.is_scale:
            grown = priors.SCALE_STEADY**2 * abs(interval)
            return self.mean, self.covariance + np.diag([grown, 0.0, 0.0])
        move, covariance = _motion(interval), self.covariance.copy()
        move[2, 2], bend, change = self._growth(interval)
        covariance[2, 2] += bend
        covariance = move @ covariance @ move.T
        covariance[:2, :2] += change * np.array([
            [interval**2 / 3.0, interval / 2.0], [interval / 2.0, 1.0],
        ])  # fmt: skip
        return move @ self.mean, covariance

    def _growth(self, interval: float) -> tuple[float, float, float]:
        """What is kept of the acceleration, and by what its variance and the rate's grow.

        Less is known of what comes and of what was.
        """
        interval = abs(interval)
        if self.stopped is not None:
            return 1.0, 0.0, 0.0
        if self.kind != 'stuck':
            return 1.0, 0.0, (priors.STEADY * self.scale) ** 2 * interval
        kept, size = math.exp(-interval / priors.STEADY_FOR), abs(float(self.mean[2]))
        if size > 2.0 * self.acceleration:  # a loop that is closed on the reading drives it away
            return 1.0, size**2 * (1.0 - kept**2), 0.0
        return kept, self.acceleration**2 * (1.0 - kept**2), 0.0

    def watch_rest(self, rests: bool) -> None:
        """Note whether all right readings rest in the newest balance, where none tells of it."""
        if not (rests and self.may_stop):
            self.rested = None
        elif self.rested is None:
            self.rested = float((self.before or self).mean[0])

    def since_rest(self, now: float) -> float:
        """How far the joint of a frozen reading went while all others rested [rad].

        It may be at rest as well: brakes that stop slow joints are not told from their own stop.
        """
        return 0.0 if self.rested is None else abs(self.fault(0.0, now)[0] - self.rested)

    def go_on(self, acceleration: float) -> None:
        """Move again, with a usual acceleration [rad/s2], at a rate that is not known."""
        self.stopped, self.acceleration = None, acceleration
        self.covariance[1, 1] = (priors.USUAL_RATE * self.scale) ** 2
        self.covariance[2, 2] = acceleration**2

    def columns(self, estimator: OffsetEstimator, at: int, end: float) -> FloatArray:
        """Derivatives of a balance by the state, shape (n, 3).

        The balance is that at a place of the horizon's ring, and ended at a moment [s].
        """
        balance, interval = estimator.balance, estimator.plan.interval
        rows, n, i = estimator.window.rows[at], estimator.joints, self.joint
        offset = rows[:, 1 + OFFSET * n + i]
        if self.is_scale:
            scale = rows[:, 1 + SCALE * n + i] + balance.reference[i] * offset
            return np.stack([scale, offset, 0.0 * offset], axis=1) / (1.0 + self.mean[0])
        drift = rows[:, 1 + DRIFT * n + i] - (self.updated - balance.epoch[0]) * offset
        # The rate changes by a T from interval to interval, and is on average less than then.
        ago, momentum = self.updated - end + interval, estimator.window.momenta[at, :, i]
        bend = 0.5 * (ago**2 + interval**2 / 6.0) * offset
        bend -= interval * momentum + ago * rows[:, 1 + RATE * n + i]
        return np.stack([offset, drift, bend], axis=1)


def _motion(interval: float) -> FloatArray:
    """How fault, rate and acceleration go on."""
    return np.array([[1.0, interval, 0.5 * interval**2], [0.0, 1.0, interval], [0.0, 0.0, 1.0]])


def _course(state: FloatArray, since: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fault and its rate at times from the state's on, or before it; not of a scale error."""
    fault, rate, acceleration = state
    return fault + (rate + 0.5 * acceleration * since) * since, rate + acceleration * since


def begin_filter(
    fault: Hypothesis, now: float, origin: float, spread: float = 0.0, scale: float = 1.0
) -> FaultFilter:
    """Filter of a fault that has just been named, at the end of the newest balance [s].

    ``origin`` is the reading when the fault began to change, as corrected so far [rad], and
    ``spread`` the standard deviation of that moment [s].  ``scale`` is that of `SerialJoint`.
    """
    size, sigma = fault.size, fault.sigma
    one = FaultFilter(fault.joint, fault.kind, fault.begin, updated=now, scale=scale)
    if fault.kind == 'drift':
        past = now - fault.begin
        one.mean[:2] = size * np.array([past, 1.0])
        one.covariance[:2, :2] = sigma**2 * np.array([[past**2, past], [past, 1.0]])
        one.covariance[0, 0] += (size * spread) ** 2
    elif fault.kind == 'scale':
        one.mean[:2] = size, -size * origin
        one.covariance = np.diag([sigma**2, (priors.WIDEST_LEVEL * scale) ** 2, 0.0])
    else:
        one.mean[0] = size
        one.covariance = np.diag([sigma**2, (priors.STEADY * scale) ** 2, 0.0])
    return one


def begin_frozen(joint: int, course: Course, acceleration: float, scale: float) -> FaultFilter:
    """Filter of a reading that rests, whose joint's way and rate are known.

    ``acceleration`` is the usual one [rad/s2], ``scale`` that of `SerialJoint`.
    """
    state = -course.mean, course.covariance
    return FaultFilter(joint, 'stuck', course.begin, *state, course.end, acceleration, scale)


def correct_since(one: FaultFilter, readings: Readings) -> None:
    """Take a fault that has just been named out of the readings since it began."""
    sampler, estimator, _ = readings
    n, i = estimator.joints, one.joint
    last = int((estimator.times(len(estimator)) > one.begin).sum())
    places = readings.places(last + 1)
    blocks = sampler.blocks[places]
    ended = block_end(blocks[-1])
    uncorrected = replace(one, mean=np.zeros(3))
    newest = sampler.time, sampler.samples[:, 0, i], sampler.samples[:, 1, i]
    for time, reading, velocity in ((blocks[:, 3 * n], blocks[:, i], blocks[:, n + i]), newest):
        after = time > one.begin
        part = reading[after], velocity[after]
        _correct(uncorrected, one.mean, time[after], part, sampler.derived[i])
        reading[after], velocity[after] = part
    sampler.blocks[places] = blocks
    if one.is_scale:  # a share of the readings as they come: an offset beside it is a part of it
        one.mean[1] += sampler.correction[i]
        sampler.correction[i] = 0.0
    _note(one, sampler)
    window = estimator.window
    for back in range(min(last, len(estimator))):
        at = estimator.place(back)
        columns = one.columns(estimator, at, ended + window.times[at] - estimator.times(1)[0])
        window.extra[at] += ((columns @ one.covariance) * columns).sum(1)
    estimator.replace_last(blocks)


def follow_all(
    filters: Sequence[FaultFilter],
    readings: Readings,
    kinematic: Sequence[tuple[float, float] | None],
    stopped: float | None,
) -> None:
    """Update faults by the newest balance, and the correction of the readings.

    The variance of the balance is raised by what is left unknown of them.  ``kinematic`` holds that
    of each, as of `_follow`.  ``stopped`` is as of `Readings.stopped`.
    """
    estimator, end = readings.estimator, readings.ended()
    for one, way in zip(filters, kinematic):
        last, before = replace(one, before=None), one.before
        one.before = last
        one.predict(end)
        # A rate of its own would tell.
        if stopped is not None and one.may_stop and way is None:
            clean = before if before is not None and stopped < last.updated else last
            _stop(one, clean, stopped, readings)
    spreads = [_spread(one, estimator) for one in filters]
    for k, one in enumerate(filters):
        # Errors that last count as often as noise that is as large, and new in each balance.
        lasting = 2.0 * priors.STEADY_FOR / estimator.plan.interval
        others = lasting * sum(spreads[:k] + spreads[k + 1 :], np.zeros_like(spreads[k]))
        # What stopped the arm is in its balances, and no effort tells it.
        if one.stopped is None or one.stopped < end - 2.0 * estimator.plan.interval:
            _follow(one, others, readings, kinematic[k])
        spreads[k] = _spread(one, estimator)
    estimator.window.extra[estimator.place(0)] += np.diag(sum(spreads))
    estimator.weigh_again(1)


def _stop(one: FaultFilter, before: FaultFilter, moment: float, readings: Readings) -> None:
    """Let a joint rest where it was at a moment [s], by its state ``before``."""
    mean, covariance = before._after(moment - before.updated)
    one.stopped, one.covariance = moment, np.diag([covariance[0, 0], 0.0, 0.0])
    _change(one, np.array([mean[0], 0.0, 0.0]) - one.mean, readings, moment)


def _spread(one: FaultFilter, estimator: OffsetEstimator) -> FloatArray:
    """Covariance of the newest balance by what is unknown of a fault, shape (n, n)."""
    columns = one.columns(estimator, estimator.place(0), one.updated)
    return columns @ one.covariance @ columns.T


def _follow(
    one: FaultFilter, others: FloatArray, readings: Readings, kinematic: tuple[float, float] | None
) -> None:
    """Update a fault by the newest balance, and the correction of the readings.

    The sampler's corrections and last blocks are changed.  ``others``, shape (n, n), is the
    covariance of the balance by other faults.  ``kinematic`` is D of the last interval, of readings
    as corrected, and its variance [rad], [rad2], where the rate has a sensor of its own.
    """
    sampler, estimator, _ = readings
    window, null, interval = estimator.window, estimator.posterior, estimator.plan.interval
    sigma = one.fault(float(sampler.raw[one.joint]), float(sampler.time[-1]))[1]
    if sigma > priors.OFFSET_PRIOR * one.scale:  # nothing is known of it
        _lose(one, sampler)
        return
    at = estimator.place(0)
    rows, m = window.rows[at], len(null.mean)
    columns = one.columns(estimator, at, one.updated)
    unknowns = rows[:, rows.shape[1] - m :]
    known = np.ascontiguousarray(unknowns.T)
    whiten(null.factor, known)
    noise = estimator.usual_sizes(at)
    # Neighbouring balances share an interval: each counts half.
    variance = 2.0 * np.diag(noise**2 * null.inflation) + known.T @ known
    variance += np.diag(window.extra[at] + window.late[at]) + others
    # In a balance the acceleration is not that of its end: half the change of an interval.
    variance += 0.25 * one._growth(interval)[1] * np.outer(columns[:, 2], columns[:, 2])
    residual = rows[:, 0] + unknowns @ null.mean
    root = _root(one.covariance)
    slope, bend = columns @ root, np.zeros(columns.shape)
    # Else tangents do, and keep friction of joints that rest.
    if 3.0 * root[0, 0] > STRAIGHT * one.unit:
        slope, bend = _secants(one, root, readings, residual)
    residual = residual + 0.5 * bend.sum(1)
    variance += 0.5 * bend @ bend.T
    spread, common = slope @ slope.T, root @ slope.T
    ratio = np.abs(residual) / (ROBUST * np.sqrt(np.diag(spread + variance)))
    factor = np.sqrt(np.maximum(ratio, 1.0))
    # Of outliers the variance is raised, so that what is known never becomes negative.
    innovation = spread + variance * factor[:, None] * factor
    gain = common @ np.linalg.inv(innovation)
    change = -gain @ residual
    if not abs(change[0]) < LINEAR * one.unit:
        one.covariance[0, 0] += 4.0 * (LINEAR * one.unit) ** 2  # more than what is lost
        _lose(one, sampler)
        return
    one.covariance = one.covariance - gain @ common.T
    if kinematic is not None and not one.is_scale:
        middle = float(readings.blocks(1)[-1, 3 * estimator.joints]) - 0.5 * interval
        column = interval * np.array([0.0, 1.0, middle - one.updated])
        gain = one.covariance @ column / (column @ one.covariance @ column + kinematic[1])
        change += gain * (kinematic[0] - column @ change)
        one.covariance = one.covariance - np.outer(gain, column) @ one.covariance
    one.covariance = 0.5 * (one.covariance + one.covariance.T)
    _change(one, change, readings)


def _root(covariance: FloatArray) -> FloatArray:
    """Lower triangular root of a covariance; columns are zero where rounding left no variance."""
    root = np.zeros(covariance.shape)
    for j in range(len(root)):
        left = covariance[j:, j] - root[j:, :j] @ root[j, :j]
        if left[0] > np.finfo(float).eps * covariance[j, j]:
            root[j:, j] = left / math.sqrt(left[0])
    return root


def _secants(
    one: FaultFilter, root: FloatArray, readings: Readings, residual: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Slopes and second derivatives of the newest balance along a root of the covariance.

    Where the fault is uncertain, a link may hang on either side of the horizontal, and gravity is
    the same: the tangent would be sure of one of them.  Shapes (n, 3).
    """
    (sampler, estimator, _), n, blocks = readings, len(residual), readings.blocks(2)
    null, (slope, bend) = estimator.posterior, np.zeros((2, len(residual), 3))
    for k, way in enumerate(_REACH * root.T):
        if not way.any():
            continue
        ends = []
        for sign in (-1.0, 1.0):
            moved = blocks.copy()
            part = moved[:, one.joint], moved[:, n + one.joint]
            _correct(one, sign * way, moved[:, 3 * n], part, sampler.derived[one.joint])
            row = estimator.rows_of(moved)[-1]
            ends.append(row[:, 0] + row[:, row.shape[1] - len(null.mean) :] @ null.mean)
        slope[:, k] = 0.5 * (ends[1] - ends[0]) / _REACH
        bend[:, k] = (ends[0] + ends[1] - 2.0 * residual) / _REACH**2
    return slope, bend


def _correct(
    one: FaultFilter, change: FloatArray, time: FloatArray, readings: tuple[FloatArray, FloatArray],
    derived: float,
) -> None:  # fmt: skip
    """Take a change of the state out of readings, and of the rates that are derived from them."""
    reading, velocity = readings
    if one.is_scale:
        grown = max(1.0 + one.mean[0] + change[0], 1.0 - LARGEST_SCALE)
        ratio = (1.0 + one.mean[0]) / grown
        reading *= ratio
        reading -= change[1] / grown
        velocity *= 1.0 + derived * (ratio - 1.0)
    else:
        fault, rate = _course(change, time - one.updated)
        reading -= fault
        velocity -= derived * rate


def doubt_ended(one: FaultFilter, estimator: OffsetEstimator) -> None:
    """Raise the variance of the newest balance, a part of whose readings had the fault.

    The state is that when the fault ended: what the rate of its reading was thought to be until
    then jumped to what it is, if that is derived.
    """
    window, i = estimator.window, one.joint
    at = estimator.place(0)
    offset = window.rows[at, :, 1 + OFFSET * estimator.joints + i]
    momentum = estimator.balance.derived[i] * window.momenta[at, :, i]
    window.extra[at] += one.covariance[0, 0] * offset**2 + one.covariance[1, 1] * momentum**2
    estimator.weigh_again(1)


def _lose(one: FaultFilter, sampler: Sampler) -> None:
    """Stay where the fault is: balances, linearised at the estimate, say nothing any more."""
    if not one.is_scale:
        one.mean[0] = sampler.followed[one.joint]
    one.mean[1:] = 0.0
    _note(one, sampler)


def _change(
    one: FaultFilter, change: FloatArray, readings: Readings, since: float = -math.inf
) -> None:
    """Add a change to the state and take it out of the last readings since a moment [s]."""
    sampler, estimator, _ = readings
    n, i, places = estimator.joints, one.joint, readings.places(2)
    blocks = sampler.blocks[places]
    if one.is_scale:
        scale = min(max(one.mean[0] + change[0], -LARGEST_SCALE), LARGEST_SCALE)
        change = np.array([scale - one.mean[0], *change[1:]])
    after = blocks[:, 3 * n] > since
    part = blocks[after, i], blocks[after, n + i]
    _correct(one, change, blocks[after, 3 * n], part, sampler.derived[i])
    blocks[after, i], blocks[after, n + i] = part
    sampler.blocks[places] = blocks
    put_back(sampler, i, HISTORY)
    one.mean = one.mean + change
    _note(one, sampler)
    take_out(sampler, i, HISTORY)
    estimator.replace_last(blocks)


def _note(one: FaultFilter, sampler: Sampler) -> None:
    """Let the sampler take the fault out of the samples to come."""
    i = one.joint
    if one.is_scale:
        sampler.share[i] = one.mean[0] / (1.0 + one.mean[0])
        sampler.followed[i] = one.mean[1] / (1.0 + one.mean[0])
    else:
        ahead = _motion(float(sampler.time[-1]) - one.updated)
        sampler.followed[i], sampler.drift[i], sampler.curve[i] = ahead @ one.mean


def correct_rates_since(joint: int, since: float, error: float, readings: Readings) -> None:
    """Take an error of a rate sensor [rad/s] out of its readings since a moment [s]."""
    sampler, estimator, _ = readings
    n = estimator.joints
    last = int((estimator.times(len(estimator)) > since).sum())
    places = readings.places(last + 1)
    blocks = sampler.blocks[places]
    blocks[blocks[:, 3 * n] > since, n + joint] -= error
    sampler.blocks[places] = blocks
    sampler.samples[sampler.time > since, 1, joint] -= error
    estimator.replace_last(blocks)
