"""Drifts of encoders that begin suddenly: the moment itself is evidence.

Where a rate is derived from its reading, a drift d of encoder i that begins at b seems to add
d M(q) e_i to the momentum at once.  The two balances whose hats hold b show it, with weights 1 - s
and s, where s is the place of b in the interval that they share.  A torque from outside would have
to be an impact along a column of the mass matrix, and to act as a drift does from then on.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import COULOMB as DRY
from lpv.core.serial_arm.chain import VISCOUS as WET
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.balance import (
    COULOMB,
    COULOMB_PART,
    DRIFT,
    EPOCH,
    OFFSET,
    VISCOUS,
    VISCOUS_PART,
    Balance,
    friction_columns,
    residuals,
)
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator, Posterior, set_residuals
from lpv.core.serial_arm.diagnosis.information import factorise, recent, whiten
from lpv.core.serial_arm.diagnosis.sampling import block_end

PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Places of the onset in its interval that are tried: the middles of its fifths."""
SHORTEST = 4
"""Balances after an onset before it is looked at; with 2, or 8, 78 of 79 faults are named
alike."""
_SMALLEST = 0.01
"""Change of a drift by which its effect is differentiated, at least [rad/s]."""
_DIVERGED = 100.0
"""Standard deviations of drifts beyond which the search for a size has diverged: they alone cost
more than balances give."""
_STEPS = 2
"""Newton steps for the size of a drift, from each of the trials that are refined."""
_REFINED = 2
"""Trials that are refined: as many as start from one onset."""
_JUMPS = 2
"""Onsets that are tried because the momentum jumps: that of a fault, and one of the model."""


class Onset(NamedTuple):
    """The onset that explains most, of a drift."""

    gain: float  # logarithm of the ratio of marginal likelihoods, -inf if there is none
    size: float  # of the drift [rad/s]
    sigma: float  # standard deviation of the size [rad/s]
    begin: float  # [s]
    back: int  # the older of the two balances that hold it, counted from the last one


NO_ONSET = Onset(-np.inf, 0.0, 0.0, 0.0, 0)


def sudden_drift_of(
    estimator: OffsetEstimator,
    joint: int,
    prior: float,
    last: int,
    blocks: FloatArray,
    mass: FloatArray,
) -> Onset:
    """The best onset of a drift of one encoder whose rate is derived from it.

    ``prior`` is the standard deviation of drifts [rad/s]; so many ``last`` balances are looked at.
    ``blocks``, shape (N, 3 n + 4), are those of the balances at hand and of the interval before,
    oldest first; ``mass``, shape (capacity, n, n), is M S^-1 of each balance, in the ring of the
    horizon.  The gain is -inf while there are too few balances.
    """
    balance, per_interval = estimator.balance, estimator.plan.blocks
    likely = likely_onsets(estimator, joint, block_end(blocks[-1]), prior, last, mass[:, :, joint])
    likely = [one for one in likely if (one.back + 2) * per_interval <= len(blocks)]
    if not likely:
        return NO_ONSET
    longest, friction = max(one.back for one in likely), _learned_friction(estimator)
    blocks, trials = blocks[-(longest + 2) * per_interval :], list[Trial]()
    plain = residuals(balance, blocks, per_interval, friction, estimator.call)
    for onset in likely:
        held = blocks[-(onset.back + 2) * per_interval :], plain[-1 - onset.back :], friction
        trials += with_true_effect(onset, estimator, (joint, prior), held)
    found = [one.onset for one in _refined(trials, prior)]
    return max(found, key=lambda one: one.gain, default=NO_ONSET)


def likely_onsets(
    estimator: OffsetEstimator, joint: int, end: float, prior: float, last: int, mass: FloatArray
) -> list[Onset]:
    """Likely onsets of a drift of one encoder in the last balances.

    The first one is the best to first order, where friction is what it was.  As that of a joint
    that seems to move turns over, onsets follow at which the momentum jumps most like it.

    All onsets count as equally likely; what that costs belongs to the margin of a decision.
    ``end`` is that of the last balance [s]; ``mass``, shape (capacity, n), has momenta by a unit
    rate of the encoder's reading, in the ring of the horizon; else as in `sudden_drift_of`.
    """
    window, null = estimator.window, estimator.posterior
    n, interval = estimator.joints, estimator.plan.interval
    back = np.arange(SHORTEST, last - 1)
    if len(back) == 0:
        return []
    estimator.call(set_residuals, window, null, last)
    at, left = recent(window, last), null.residual[:last]
    rows, weights = window.rows[at], window.weights[at]
    columns = rows[:, :, [1 + DRIFT * n + joint, 1 + OFFSET * n + joint]]
    unknowns, weighted = rows[:, :, -len(null.mean) :], weights[:, :, None] * columns
    # Sums over the balances behind each onset, for the columns of drift and of offset.
    score = np.cumsum((weighted * left[:, :, None]).sum(1), 0)[back - 1]
    squares = np.cumsum(np.einsum('kip,kiq->kpq', weighted, columns), 0)[back - 1]
    cross = np.cumsum(np.einsum('kip,kim->kpm', weighted, unknowns), 0)[back - 1]
    mass = mass[at[back]]

    def straddle(held: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """M^T W r, M^T W M and M^T W J of balances whose hats hold the onset."""
        pulled = weights[held] * mass
        by_unknowns = np.einsum('ki,kim->km', pulled, unknowns[held])
        return (pulled * left[held]).sum(1), (pulled * mass).sum(1), by_unknowns

    older, newer = straddle(back), straddle(back - 1)
    overlap = np.einsum('ki,kip->kp', mass, weighted[back - 1])
    late = window.times[at[0]] - end  # samples wait for a test of jumps
    # Axes: onset's balance, place in its interval.
    s, begin = np.array(PLACES), window.times[at[back], None] - late - interval
    begin = begin + s * interval
    shift = begin - estimator.balance.clock[EPOCH]
    total = score[:, :1] - shift * score[:, 1:]
    jump = -(1.0 - s) * older[0][:, None] - s * newer[0][:, None]
    total = total + jump
    square = squares[:, 0, :1] - shift * (2.0 * squares[:, 0, 1:] - shift * squares[:, 1, 1:])
    weight = (1.0 - s) ** 2 * older[1][:, None] + s**2 * newer[1][:, None]
    square += weight
    square -= 2.0 * s * (overlap[:, :1] - shift * overlap[:, 1:])
    own = cross[:, None, 0] - shift[:, :, None] * cross[:, None, 1]
    own -= (1.0 - s)[:, None] * older[2][:, None] + s[:, None] * newer[2][:, None]
    square -= (whitened(null, own) ** 2).sum(-1)
    power = np.maximum(square, 0.0) + prior**-2
    found = _best_onsets((total, power), prior, (begin, back), 1)
    jumps = _best_onsets((jump, weight + prior**-2), prior, (begin, back), _JUMPS)
    return found + [one for one in jumps if one.gain > 0.0]


def _best_onsets(
    score: tuple[FloatArray, FloatArray], prior: float, when: tuple[FloatArray, IntArray], most: int
) -> list[Onset]:
    """Onsets with the largest gains, at most so many, no neighbours.

    ``score``, shape (B, places), has scores and their variances, ``when`` moments and balances.
    """
    total, power = score
    gain = 0.5 * (total**2 / power - np.log(power * prior**2))
    gain, found = np.where(np.isfinite(gain), gain, -np.inf), list[Onset]()
    while len(found) < most and np.max(gain) > -np.inf:
        k, place = np.unravel_index(np.argmax(gain), gain.shape)
        size, sigma = -total[k, place] / power[k, place], power[k, place] ** -0.5
        begin, back = when[0][k, place], when[1][k]
        best = gain[k, place]
        found.append(Onset(float(best), float(size), float(sigma), float(begin), int(back)))
        gain[max(k - 1, 0) : k + 2] = -np.inf
    return found


def whitened(null: Posterior, rows: FloatArray) -> FloatArray:
    """U^-T of rows of products with the unknowns' columns, shape (..., m)."""
    columns = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]).T)
    whiten(null.factor, columns)
    return np.asarray(columns.T.reshape(rows.shape))


class Trial(NamedTuple):
    """A drift of some size that was compared, and where a Newton step leads from it."""

    onset: Onset
    rival: '_Rival'
    next: float  # size [rad/s]
    promise: float  # gain there, to second order


def with_true_effect(
    onset: Onset,
    estimator: OffsetEstimator,
    fault: tuple[int, float],
    held: tuple[FloatArray, FloatArray, FloatArray],
) -> list[Trial]:
    """Trials of an onset with the drift's true effect: friction turns over where a joint is slow.

    Friction that turns over is as large for a small drift as for a large one, so that trials begin
    with the size to first order, and with that by which the joint would rest.  ``fault`` is the
    joint with the standard deviation of drifts [rad/s].  ``held`` are the blocks, shape
    (N, 3 n + 4), of the balances that hold the onset, and of all after them, oldest first; these
    balances' residuals, and the friction of the joints that they are evaluated with.
    """
    joint, prior = fault
    rival = _Rival(estimator, joint, onset.begin, *held)
    return _try(rival, onset, [onset.size, rival.apparent_rate()], prior)


def _try(rival: '_Rival', onset: Onset, sizes: list[float], prior: float) -> list[Trial]:
    """Compare drifts of these sizes; gains are -inf where they are no numbers."""
    trials = []
    for size, (fit, slope, curvature) in zip(sizes, rival.compare(np.array(sizes))):
        power = curvature + prior**-2
        gain = fit - 0.5 * (size / prior) ** 2 - 0.5 * math.log(power * prior * prior)
        step = (slope - size / prior**2) / power
        gain = gain if math.isfinite(gain + step) else -math.inf
        tried = Onset(gain, size, power**-0.5, onset.begin, onset.back)
        trials.append(Trial(tried, rival, size + step, gain + 0.5 * power * step**2))
    return trials


def _refined(trials: list[Trial], prior: float) -> list[Trial]:
    """The trials, and Newton steps from the most promising ones."""
    trials = [one for one in trials if one.onset.gain > -np.inf]
    found = trials.copy()
    likely = [one for one in trials if one.promise > 0.0]
    for one in sorted(likely, key=lambda one: -one.promise)[:_REFINED]:
        for _ in range(_STEPS):
            if not abs(one.next) < _DIVERGED * prior:
                break
            (one,) = _try(one.rival, one.onset, [one.next], prior)
            found.append(one)
    return found


class _Rival:
    """Balances without a drift of one encoder, compared with those of the null hypothesis.

    What the arm's unknowns explain, friction of the joints that the encoder tells of among them, is
    that of the rates without the drift: a joint that rests has no friction to be learned.
    """

    def __init__(
        self,
        estimator: OffsetEstimator,
        joint: int,
        begin: float,
        blocks: FloatArray,
        plain: FloatArray,
        friction: FloatArray,
    ) -> None:
        self._estimator, self._joint, self._begin, self._blocks = estimator, joint, begin, blocks
        window, null, n = estimator.window, estimator.posterior, estimator.joints
        self._plain, self._friction = plain, friction
        self._per_size = blocks - without_drift(blocks, estimator.balance, joint, begin, 1.0)
        at = recent(window, len(plain))[::-1]
        rows = window.rows[at].reshape(-1, window.rows.shape[2])
        self._weights, self._unknowns = window.weights[at].ravel(), rows[:, -len(null.mean) :]
        self._left = rows[:, 0] + self._unknowns @ null.mean
        pulled = self._weights * self._left
        self._score, self._level = self._unknowns.T @ pulled, float(pulled @ self._left)
        # Of the unknowns' columns, a drift changes those of the friction of the joints that move.
        self._moved = np.flatnonzero(estimator.balance.to_joints[:, joint])
        own = [(group - OFFSET) * n + self._moved for group in (VISCOUS, COULOMB)]
        self._own, upper = np.concatenate(own), np.triu(null.factor)
        self._information = upper.T @ upper
        old = self._weights[:, None] * self._unknowns[:, self._own]
        self._others = self._information[self._own] - old.T @ self._unknowns
        self._freedom = 2.0 * float(np.log(np.diag(upper)).sum())

    def apparent_rate(self) -> float:
        """Mean rate since the onset, by the readings: that of the drift, if the joint rests."""
        n = self._estimator.joints
        since = self._blocks[:, 3 * n] > self._begin
        return float(self._blocks[since, n + self._joint].mean()) if since.any() else 0.0

    def compare(self, sizes: FloatArray) -> list[tuple[float, float, float]]:
        """Logarithms of likelihood ratios of drifts of these sizes, their slopes and curvatures."""
        estimator, count = self._estimator, len(sizes)
        about = estimator.balance, estimator.plan.blocks
        changes = np.copysign(np.maximum(0.1 * np.abs(sizes), _SMALLEST), sizes)
        every = np.concatenate([sizes, sizes + changes])
        freed = self._blocks - every[:, None, None] * self._per_size
        left = residuals(about[0], freed, about[1], self._friction, estimator.call) - self._plain
        left = self._left + left.reshape(len(every), -1)
        by_size = (left[count:] - left[:count]) / changes[:, None]
        friction = friction_columns(about[0], freed[:count], about[1], self._moved)
        return [self._compare(friction[:, k], left[k], by_size[k]) for k in range(count)]

    def _compare(
        self, friction: FloatArray, left: FloatArray, by_size: FloatArray
    ) -> tuple[float, float, float]:
        """The same of one drift: columns of friction, residuals, and how its size changes these."""
        columns, information = self._unknowns.copy(), self._information.copy()
        for column, c, i in zip(friction, self._own, [*self._moved, *self._moved]):
            columns[:, c] = 0.0
            columns[i :: self._estimator.joints, c] = column
        own = self._others + (self._weights[:, None] * columns[:, self._own]).T @ columns
        information[self._own], information[:, self._own] = own, own.T
        factorise(information, self._estimator.posterior.least)
        weighted = self._weights * by_size
        both = columns.T @ np.stack([self._weights * left, weighted], axis=1)
        both[:, 0] = self._score - both[:, 0]
        whiten(information, both)
        across = both.T @ both
        fit = self._level - float(self._weights @ left**2) + across[0, 0] + self._freedom
        fit -= 2.0 * float(np.log(np.diag(information)).sum())
        slope, curvature = -float(weighted @ left) - across[0, 1], float(weighted @ by_size)
        return 0.5 * float(fit), float(slope), max(float(curvature - across[1, 1]), 0.0)


def _learned_friction(estimator: OffsetEstimator) -> FloatArray:
    """Friction of the chain with what the null hypothesis has learned of it."""
    balance, null = estimator.balance, estimator.posterior
    n, friction = len(balance.reference), balance.chain.friction.copy()
    for group, column, part in ((VISCOUS, WET, VISCOUS_PART), (COULOMB, DRY, COULOMB_PART)):
        friction[:, column] += null.mean[(group - OFFSET) * n :][:n]
        friction[:, column] += null.mean[4 * n :] @ balance.drives[:, :, part]
    return friction


def without_drift(
    blocks: FloatArray, balance: Balance, joint: int, begin: float, size: float
) -> FloatArray:
    """Blocks whose reading, and the rate that is derived from it, are freed of a drift."""
    n, freed = len(balance.reference), blocks.copy()
    middle, length = blocks[:, 3 * n], blocks[:, 3 * n + 1]
    after = np.clip(middle + 0.5 * length - begin, 0.0, length)
    share = after / length
    freed[:, joint] -= size * np.maximum(middle - begin, 0.5 * after) * share
    freed[:, n + joint] -= balance.derived[joint] * size * share
    return freed
