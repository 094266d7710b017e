"""Drifts of encoders and biases of rates that begin suddenly: the moment itself is evidence.

Where a rate is derived from its reading, a drift d of encoder i that begins at b seems to add
d M(q) e_i to the momentum at once.  The two balances whose hats hold b show it, with weights 1 - s
and s, where s is the place of b in the interval that they share.  A torque from outside would have
to be an impact along a column of the mass matrix, and to act as a drift does from then on.

So does a bias of a rate that has a sensor of its own, where a drift of the encoder beside it leaves
the momentum as it is: what the two read contradicts each other as much, and the jump tells them
apart, if it is sought where it was.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import COULOMB as DRY
from lpv.core.serial_arm.chain import VISCOUS as WET
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import (
    COULOMB,
    COULOMB_PART,
    DRIFT,
    OFFSET,
    RATE,
    VISCOUS,
    VISCOUS_PART,
)
from lpv.core.serial_arm.diagnosis.drift_trial import (
    GAIN,
    balance_of_trials,
    compare_drifts,
    new_found,
    new_trials,
)
from lpv.core.serial_arm.diagnosis.estimator import ONSET, OffsetEstimator, set_residuals
from lpv.core.serial_arm.diagnosis.information import Posterior, recent, whiten
from lpv.core.serial_arm.diagnosis.sampler import block_end

PLACES = (np.arange(25) + 0.5) / 25
"""Places of the onset in its interval that are tried, every 2 ms: 5 ms beside the onset, a momentum
that jumps by 200 standard deviations leaves 20 in both balances that hold it."""
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


class Sudden(NamedTuple):
    """A fault that begins suddenly, by the columns of balances that it adds."""

    kind: str
    group: int  # of the column that goes on
    jumps: bool  # whether the rate, and with it the momentum, seems to jump


DRIFT_OF_BOTH = Sudden('drift', DRIFT, True)
"""Drift of an encoder and of the rate that is derived from it."""
OF_ONE = Sudden('drift', DRIFT, False), Sudden('rate_bias', RATE, True)
"""Faults of an encoder and of a rate sensor beside it: what they read contradicts each other."""


def sudden_drifts(
    estimator: OffsetEstimator, joints: IntArray, last: int, blocks: FloatArray
) -> list[Onset]:
    """The best onset of a drift of each of some encoders whose rates are derived from them.

    So many ``last`` balances are looked at.  ``blocks``, shape (N, 3 n + 4), are those of the
    balances at hand and of the interval before, oldest first.  The gain is -inf while there are too
    few balances.
    """
    prior = priors.SIZE['drift'] * estimator.balance.scale[joints]
    likely = likely_onsets(estimator, joints, block_end(blocks[-1]), prior, last)
    sizes = np.stack([np.zeros(len(joints)), prior])
    return _tried(estimator, joints, DRIFT_OF_BOTH, likely, sizes, blocks)


def _tried(
    estimator: OffsetEstimator,
    joints: IntArray,
    fault: Sudden,
    likely: list[list[Onset]],
    prior: FloatArray,
    blocks: FloatArray,
) -> list[Onset]:
    """The best of likely onsets of a fault of each of some joints, with its true effect.

    ``prior``, shape (2, J), has means and standard deviations of sizes [rad/s]; ``blocks`` are as
    in `sudden_drifts`.
    """
    per_interval, missing = estimator.plan.blocks, max(map(len, likely), default=0)
    whole = len(blocks) // per_interval - 2
    likely = [[one for one in every if one.back <= whole] for every in likely]
    longest = max((one.back for every in likely for one in every), default=0)
    if not longest:
        return [NO_ONSET] * len(joints)
    onsets = np.array([(every + missing * [NO_ONSET])[:missing] for every in likely])
    window, null, friction = estimator.window, estimator.posterior, _learned_friction(estimator)
    blocks, found = blocks[-(longest + 2) * per_interval :], new_found(onsets)
    trials = new_trials(window, null, blocks, per_interval, estimator.joints)
    own = balance_of_trials(estimator.balance, friction)
    parts = float(fault.group == DRIFT), float(fault.jumps)
    estimator.call(compare_drifts, own, trials, null.factor, joints, parts, prior, onsets, found)
    best = (every[every[:, GAIN].argmax()].tolist() for every in found)
    return [
        Onset(gain, size, sigma, begin, int(back)) if gain > -np.inf else NO_ONSET
        for gain, size, sigma, begin, back, *_ in best
    ]


class _Scores(NamedTuple):
    """Of onsets in P places of the last intervals of B balances, for J joints."""

    back: IntArray  # (B,) the older balance that holds the onset, counted from the last one
    begin: FloatArray  # (P, B) [s]
    total: FloatArray  # (P, B, J)
    power: FloatArray  # (P, B, J) variance of the total
    jump: FloatArray  # (P, B, J) what of the total is the momentum's jump
    jump_power: FloatArray  # (P, B, J)


def likely_onsets(
    estimator: OffsetEstimator, joints: IntArray, end: float, prior: FloatArray, last: int
) -> list[list[Onset]]:
    """Likely onsets of drifts of some encoders in the last balances.

    The first one is the best to first order, where friction is what it was.  As that of a joint
    that seems to move turns over, onsets follow at which the momentum jumps most like it.

    All onsets count as equally likely; what that costs belongs to the margin of a decision.
    ``end`` is that of the last balance [s], ``prior``, shape (J,), the standard deviation of drifts
    [rad/s]; else as in `sudden_drifts`.
    """
    one = _scores(estimator, joints, end, last, DRIFT_OF_BOTH)
    when = one.begin, one.back
    likely = _best_onsets((one.total, one.power + prior**-2), prior, when, -np.inf, 1)
    jumps = _best_onsets((one.jump, one.jump_power + prior**-2), prior, when, 0.0, _JUMPS)
    return [found + more for found, more in zip(likely, jumps)]


def onsets_beside_rates(
    estimator: OffsetEstimator,
    joints: IntArray,
    fault: Sudden,
    ways: tuple[FloatArray, FloatArray],
    blocks: FloatArray,
) -> list[tuple[Onset, float]]:
    """The best onset of a fault of each of some joints with rates of their own.

    ``ways`` are sums of the last 1, 2, ... kinematic rows of these joints, and their inverse
    variances, shape (B, J); that of the onset's interval, of which a part counts, is left out.
    ``blocks`` are as in `sudden_drifts`.  With an onset comes the number of those that it stands
    for: one a balance, as likely anywhere in its interval.  Empty while there are too few balances.
    """
    prior = priors.SIZE[fault.kind] * estimator.balance.scale[joints]
    one = _scores(estimator, joints, block_end(blocks[-1]), len(ways[0]), fault)
    if not one.back.size:
        return []
    sums, weight = (part[one.back - 1] for part in ways)
    way = one.back[:, None] * estimator.plan.interval * (-1.0 if fault.group == RATE else 1.0)
    told, known = weight * sums * way, weight * way**2 + prior**-2
    score = one.total - told, one.power + known
    best = _best_onsets(score, prior, (one.begin, one.back), -np.inf, 1)
    every = _gains(score, prior).reshape(-1, len(joints))
    starts = np.logaddexp.reduce(every, initial=-np.inf) - every.max(axis=0, initial=-np.inf)
    starts -= math.log(len(PLACES))
    # What rows tell of the size is known before balances are tried.
    at = [(some[0].back if some else ONSET) - ONSET for some in best], np.arange(len(joints))
    sizes = np.stack([told[at] / known[at], known[at] ** -0.5])
    tried = _tried(estimator, joints, fault, best, sizes, blocks)
    rows = 0.5 * (told[at] ** 2 / known[at] - np.log(known[at] * prior**2))
    found = [some._replace(gain=some.gain + float(gain)) for some, gain in zip(tried, rows)]
    return list(zip(found, np.exp(starts).tolist()))


def _scores(
    estimator: OffsetEstimator, joints: IntArray, end: float, last: int, fault: Sudden
) -> _Scores:
    """Scores of a fault of some joints for all onsets in the last balances, by these alone."""
    window, null = estimator.window, estimator.posterior
    n, interval = estimator.joints, estimator.plan.interval
    back = np.arange(ONSET, last - 1)
    estimator.call(set_residuals, window, null, last)
    at, left = recent(window, last), null.residual[:last, :, None]
    rows, weights = window.rows[at], null.weights[at][:, :, None]
    # Axes: balance, row, joint.  Products with the unknowns' columns are U^-T of them.
    column, offset = (rows[:, :, 1 + group * n + joints] for group in (fault.group, OFFSET))
    offset = offset * (fault.group == DRIFT)
    mass = window.momenta[at[back]][:, :, joints] * fault.jumps
    unknowns = whitened(null, rows[:, :, -len(null.mean) :])
    columns = np.stack([column, offset])
    weighted = weights * columns
    # Sums over the balances behind each onset, for the columns of fault and of offset.
    score = (weighted * left).sum(2).cumsum(1)[:, back - 1]
    squares = np.einsum('pkij,qkij->pqkj', weighted, columns).cumsum(2)[:, :, back - 1]
    cross = (weighted.swapaxes(2, 3) @ unknowns).cumsum(1)[:, back - 1]

    def straddle(held: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """M^T W r, M^T W M and M^T W J U^-1 of balances whose hats hold the onset."""
        pulled = weights[held] * mass
        by_unknowns = pulled.swapaxes(1, 2) @ unknowns[held]
        return (pulled * left[held]).sum(1), (pulled * mass).sum(1), by_unknowns

    older, newer = straddle(back), straddle(back - 1)
    overlap = (mass * weighted[:, back - 1]).sum(2)
    late = window.times[at[0]] - end  # samples wait for a test of jumps
    # Axes: place in the interval, onset's balance, joint.
    s, first = PLACES[:, None, None], window.times[at[back], None] - late - interval
    begin, epoch = first + s * interval, estimator.balance.epoch[0]
    shift = begin - epoch
    jump = -(1.0 - s) * older[0] - s * newer[0]
    total = score[0] - shift * score[1] + jump
    weight = (1.0 - s) ** 2 * older[1] + s**2 * newer[1]
    square = squares[0, 0] - shift * (2.0 * squares[0, 1] - shift * squares[1, 1]) + weight
    square -= 2.0 * s * (overlap[0] - shift * overlap[1])
    # What the unknowns explain is linear in the place.
    known = cross[0] - (first - epoch)[:, :, None] * cross[1] - older[2]
    change = older[2] - newer[2] - interval * cross[1]
    square -= (known**2).sum(2) + s * (2.0 * (known * change).sum(2) + s * (change**2).sum(2))
    return _Scores(back, begin[:, :, 0], total, np.maximum(square, 0.0), jump, weight)


def _gains(score: tuple[FloatArray, FloatArray], prior: FloatArray) -> FloatArray:
    """Logarithms of Bayes factors, of scores and their variances; -inf where they are no number."""
    total, power = score
    gains = 0.5 * (total**2 / power - np.log(power * prior**2))
    return np.where(np.isfinite(gains), gains, -np.inf)


def _best_onsets(
    score: tuple[FloatArray, FloatArray],
    prior: FloatArray,
    when: tuple[FloatArray, IntArray],
    least: float,
    most: int,
) -> list[list[Onset]]:
    """Onsets of each joint with the largest gains beyond the least, at most so many, no neighbours.

    ``score``, shape (places, B, J), has scores and their variances, ``when`` moments and balances.
    """
    (total, power), gains, every = score, _gains(score, prior), list[list[Onset]]()
    for j in range(gains.shape[2]):
        gain, found = gains[:, :, j], list[Onset]()
        for _ in range(most if gain.size else 0):
            at = place, k = divmod(int(gain.argmax()), gain.shape[1])
            if not gain[at] > least:
                break
            precision = float(power[place, k, j])
            size, begin = -float(total[place, k, j]) / precision, float(when[0][at])
            found.append(Onset(float(gain[at]), size, precision**-0.5, begin, int(when[1][k])))
            gain[:, max(k - 1, 0) : k + 2] = -np.inf
        every.append(found)
    return every


def whitened(null: Posterior, rows: FloatArray) -> FloatArray:
    """U^-T of rows of products with the unknowns' columns, shape (..., m)."""
    columns = np.ascontiguousarray(rows.reshape(-1, rows.shape[-1]).T)
    whiten(null.factor, columns)
    return np.asarray(columns.T.reshape(rows.shape))


def weigh_errors(
    estimator: OffsetEstimator, null: Posterior, errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Score and information of errors of the last balances, unknowns integrated out, shape (...).

    ``errors``, shape (..., L, n), are those of the newest balance first.
    """
    last, m, window = errors.shape[-2], len(null.mean), estimator.window
    estimator.call(set_residuals, window, null, last)
    at = recent(window, last)
    weighted = (null.weights[at] * errors).reshape(*errors.shape[:-2], -1)
    cross = whitened(null, weighted @ window.rows[at, :, -m:].reshape(-1, m))
    own = (weighted * errors.reshape(weighted.shape)).sum(-1)
    left = null.residual[:last].ravel()
    return -weighted @ left, np.maximum(own - (cross**2).sum(-1), 0.0)


def _learned_friction(estimator: OffsetEstimator) -> FloatArray:
    """Friction of the chain with what the null hypothesis has learned of it."""
    balance, null = estimator.balance, estimator.posterior
    n, friction = len(balance.reference), balance.chain.friction.copy()
    for group, column, part in ((VISCOUS, WET, VISCOUS_PART), (COULOMB, DRY, COULOMB_PART)):
        friction[:, column] += null.mean[(group - OFFSET) * n :][:n]
        friction[:, column] += null.mean[4 * n :] @ balance.drives[:, :, part]
    return friction
