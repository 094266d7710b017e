"""Readings that rest, or err, while their joints move on, by rates that walk at random.

Where the reading froze out of motion, the balances are evaluated anew along the way that the joint
would have gone at the rate that it had; they hold the momentum that the frozen reading lost.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import OFFSET, RATE
from lpv.core.serial_arm.diagnosis.drift_trial import free_of_drift
from lpv.core.serial_arm.diagnosis.estimator import OffsetEstimator, set_residuals
from lpv.core.serial_arm.diagnosis.information import ROBUST, Posterior, factorise, recent, whiten
from lpv.core.serial_arm.diagnosis.row_noise import UNMEASURED
from lpv.core.serial_arm.diagnosis.sampler import block_end

LINEAR = 1.0
"""Errors beyond are not linear in the balances, which say nothing of them then [rad]: sin(1) is
16 % less."""
_REACH = math.sqrt(math.pi / 2.0)
"""Standard deviations of a normal variable between which the secant of its sign is the best line
through it: E abs(x) = sigma / 1.25."""


class Frozen(NamedTuple):
    """What is known of a reading that rests."""

    time: float  # when it froze [s]
    rate: float  # at which it had moved [rad/s]
    sigma: float  # standard deviation of that [rad/s]
    alive: bool  # whether a reading at rest would go back and forth
    seen: bool = True  # whether it was seen to freeze; else it has rested since the first sample


class Course(NamedTuple):
    """How a joint may have gone on, at the end of the last balance."""

    gain: float  # logarithm of the Bayes factor to a joint that rests, or is held, as it reads
    begin: float  # when it began to move, or its reading froze [s]
    end: float  # of the last balance [s]
    mean: FloatArray  # way, rate and acceleration, shape (3,) [rad], [rad/s], [rad/s2]
    covariance: FloatArray  # of these, shape (3, 3)


def at_rest(rates: FloatArray, scale: FloatArray, sensors: Sequence[int]) -> npt.NDArray[np.bool_]:
    """Whether all joints of some sensors rest, by mean rates of intervals, (..., n) [rad/s]."""
    return np.asarray((np.abs(rates) < priors.SLOW_RATE * scale)[..., sensors].all(-1))


def usual_acceleration(estimator: OffsetEstimator, blocks: FloatArray, joint: int) -> float:
    """Root mean square of a reading's acceleration from interval to interval [rad/s2]."""
    joints, per_interval = estimator.joints, estimator.plan.blocks
    least = priors.LEAST_ACCELERATION * float(estimator.balance.scale[joint])
    whole = len(blocks) // per_interval * per_interval
    time, rate = blocks[len(blocks) - whole :, [3 * joints, joints + joint]].T
    time, rate = time.reshape(-1, per_interval).mean(1), rate.reshape(-1, per_interval).mean(1)
    if len(rate) < 2:
        return least
    change = np.diff(rate) / np.diff(time)
    return max(float(np.sqrt((change**2).mean())), least)


def course_of_frozen(
    estimator: OffsetEstimator, joint: int, frozen: Frozen, balances: int, blocks: FloatArray,
    others: bool = False,
) -> Course | None:  # fmt: skip
    """How likely a joint went on while its reading rests, and where it is then.

    The joint may have moved in so many last ``balances``; 0 means ever since the reading froze.
    ``blocks``, shape (N, 3 n + 4), are those of the horizon, oldest first, in which ``others`` that
    froze, too, may go on.  None while no balance holds the time since.
    """
    plan, null = estimator.plan, estimator.posterior
    end = block_end(blocks[-1])
    since = balances * plan.interval if balances else end - frozen.time
    begin, first = end - since, 0.0 if balances else frozen.rate
    count = min(int(np.ceil(since / plan.interval - 1e-6)), len(estimator))
    if count < 1 or len(blocks) < (count + 1) * plan.blocks:
        return None
    step = usual_acceleration(estimator, blocks, joint) * plan.interval
    scale = float(estimator.balance.scale[joint])
    blocks = blocks[-(count + 1) * plan.blocks :]
    at = recent(estimator.window, count)[::-1]
    estimator.call(set_residuals, estimator.window, null, count)
    left = before = null.residual[:count][::-1]
    old = rows = estimator.window.rows[at]
    if others:
        rows = estimator.rows_of(blocks)
        before = rows[:, :, 0] + rows[:, :, -len(null.mean) :] @ null.mean
    if first != 0.0:
        rows = _rows_along(estimator, joint, blocks, begin, frozen)
    unknowns = rows[:, :, rows.shape[2] - len(null.mean) :]
    after = rows[:, :, 0] + unknowns @ null.mean
    # Sizes of what is left: of joints that move where the reading lies, else as they rest.
    moved = np.flatnonzero(estimator.balance.to_joints[:, joint])
    resting = estimator.usual_sizes(at)
    size = resting.copy()
    size[:, moved] = null.noise[moved] * estimator.window.relative[at][:, moved]
    inflation = null.inflation
    weights = np.minimum(_weights(before, size, inflation), _weights(after, size, inflation))
    weights[estimator.window.extra[at] >= UNMEASURED] = 0.0
    columns = _rate_steps(rows, joint, estimator.window.momenta[at], plan.interval)
    every = np.concatenate([(after - before)[:, :, None], columns], axis=2)
    root, free = np.sqrt(weights).reshape(-1, 1), unknowns.reshape(-1, len(null.mean))
    every, forced = root * every.reshape(-1, 1 + count), weights.reshape(-1, 1) * free
    cross = (root * free).T @ every
    # What the unknowns explain: by these balances as evaluated anew, in place of as they were.
    upper, old = np.triu(null.factor), old.reshape(-1, rows.shape[2])[:, -free.shape[1] :]
    held = null.weights[at].reshape(-1, 1) * old
    known = upper.T @ upper + forced.T @ free - held.T @ old
    # By these weights they are others than estimated.
    slope = forced.T @ before.reshape(-1, 1) - held.T @ left.reshape(-1, 1)
    factorise(known, null.least)
    whiten(known, cross)
    whiten(known, slope)
    with np.errstate(over='ignore', invalid='ignore'):
        information = every.T @ every - cross.T @ cross
        score = (cross.T @ slope)[:, 0] - every.T @ (root[:, 0] * before.ravel())
    if not np.isfinite(information).all():  # a fault that is followed ran away
        return None
    # A joint begins to move slowly while its reading rests.
    spread = priors.SLOW_RATE * scale if balances else frozen.sigma
    pull = score[1:] - information[1:, 0]
    # Rates are those of the middles of intervals; the last one changes as it did since the one
    # before, or since the beginning.
    bend = np.eye(count)[-1] - np.eye(count)[-2] if count > 1 else np.array([2.0])
    ends = np.eye(count)[-1] + 0.5 * bend
    sums = np.stack([plan.interval * np.ones(count), ends, bend / plan.interval]) @ np.tri(count)
    tried = [
        _likely(information[1:, 1:], pull, _walk(count, size * step, spread), sums)
        for size in priors.ACCELERATIONS
    ]
    # The larger an acceleration, the rarer.
    evidence = np.array([one[0] for one in tried]) - np.log(priors.ACCELERATIONS)
    _, change, covariance = tried[int(np.argmax(evidence))]
    gain = score[0] - 0.5 * information[0, 0]
    gain += np.logaddexp.reduce(evidence) - np.log(sum(1.0 / size for size in priors.ACCELERATIONS))
    rivals = [resting[:, moved]]
    if not frozen.alive:
        rivals.append(np.hypot(resting, plan.interval * priors.PUSH * estimator.typical)[:, moved])
    least = min(_at_rest(before[:, moved], one, weights[:, moved], null, moved) for one in rivals)
    gain += min(least + 0.5 * float((slope**2).sum()), 0.0)
    if not abs(change[0]) < LINEAR * scale:
        return None
    way = np.array([first * since, first, 0.0]) - change
    return Course(float(gain), begin, end, way, covariance)


def blocks_along(
    estimator: OffsetEstimator, joint: int, blocks: FloatArray, begin: float, frozen: Frozen
) -> FloatArray:
    """Blocks whose joint went on from a moment on, at the rate that its reading had."""
    gone, derived = np.empty(blocks.shape), estimator.balance.derived[joint]
    free_of_drift(blocks, joint, (1.0, derived), begin, -frozen.rate, gone)
    return gone


def _rows_along(
    estimator: OffsetEstimator, joint: int, blocks: FloatArray, begin: float, frozen: Frozen
) -> FloatArray:
    """Rows of balances whose joint went on from a moment on, at the rate that its reading had.

    Where the joint may have been turning round, columns of errors of the rate are secants over what
    is unknown of it, with friction as estimated: a tangent to its sign would hold the joint.
    """
    n, null, reach = estimator.joints, estimator.posterior, _REACH * frozen.sigma
    gone = blocks_along(estimator, joint, blocks, begin, frozen)
    if abs(frozen.rate) > frozen.sigma:
        return estimator.rows_of(gone)
    after, ends = gone[:, 3 * n] > begin, []
    for side in (-reach, reach):
        moved = gone.copy()
        moved[after, n + joint] += side
        ends.append(estimator.rows_of(moved))
    rows, change = 0.5 * (ends[0] + ends[1]), ends[1] - ends[0]
    change = change[:, :, 0] + change[:, :, rows.shape[2] - len(null.mean) :] @ null.mean
    rows[:, :, 1 + RATE * n + joint] = -change / (2.0 * reach)
    return rows


def free_course(
    estimator: OffsetEstimator, joint: int, last: int, moves: bool
) -> tuple[float, float, float]:
    """How much a fault of one reading explains of the last balances, whatever its course.

    It has been there before them, of any size, and goes on at a rate that walks at random if it
    ``moves``.  The arm's unknowns are held, as for rough torques from outside.  Returns the
    logarithm of the Bayes factor, and the fault now with its standard deviation [rad].
    """
    n, step, null = estimator.joints, estimator.plan.interval, estimator.posterior
    scale = float(estimator.balance.scale[joint])
    at = recent(estimator.window, last)[::-1]
    rows, derived = estimator.window.rows[at], estimator.balance.derived[joint]
    left, size = (part[::-1] for part in estimator.left_over(last))
    weights = _weights(left, size, null.inflation, estimator.window.extra[at])
    root = np.sqrt(weights).reshape(-1, 1)
    before = rows[:, :, 1 + OFFSET * n + joint, None]
    steps = _rate_steps(rows, joint, estimator.window.momenta[at], step, derived)
    columns = root * np.concatenate([before, steps], axis=2).reshape(-1, 1 + last)
    information, pull = columns.T @ columns, -columns.T @ (root[:, 0] * left.ravel())
    if not np.isfinite(information).all() or not np.isfinite(pull).all():
        return -math.inf, 0.0, 0.0  # a fault that is followed ran away
    way, found = np.append(1.0, step * np.arange(last, 0.0, -1.0))[None], []
    for larger in priors.ACCELERATIONS if moves else (0.0,):
        slow = priors.SLOW_RATE if moves else 0.0
        walk = _walk(last, larger * priors.USUAL_ACCELERATION * step, slow)
        sizes = scale * np.append(priors.OFFSET_PRIOR, walk)
        gain, fault, variance = _likely(information, pull, sizes, way)
        found.append((gain - math.log(max(larger, 1.0)), float(fault[0]), variance[0, 0] ** 0.5))
    return max(found)


def _walk(count: int, step: float, spread: float) -> FloatArray:
    """Standard deviations of the changes of a rate that walks at random, in steps [rad/s].

    ``spread`` is what is unknown of the first rate beside a step [rad/s].
    """
    sizes = np.full(count, step)
    sizes[0] = math.hypot(step, spread)
    return sizes


def _likely(
    information: FloatArray, pull: FloatArray, sizes: FloatArray, sums: FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Evidence of unknowns with these standard deviations; mean and covariance of sums of them."""
    right = sizes[:, None] * np.column_stack([pull, sums.T])
    factor = sizes[:, None] * information * sizes + np.eye(len(sizes))
    # Pivots below 1 are rounding's: the covariance stays positive.
    factorise(factor, np.ones(len(sizes)))
    whiten(factor, right)
    mean, ways = right[:, 0], right[:, 1:]
    evidence = 0.5 * float(mean @ mean) - float(np.log(np.diag(factor)).sum())
    return evidence, mean @ ways, ways.T @ ways


def _weights(
    residual: FloatArray, size: FloatArray, inflation: FloatArray, extra: FloatArray | float = 0.0
) -> FloatArray:
    """Inverse variances of balances, outliers with less weight; shape (last, n)."""
    variance = size**2 * inflation + extra
    return np.asarray(1.0 / (variance * np.sqrt(1.0 + (residual / (ROBUST * size)) ** 2)))


def _at_rest(
    residual: FloatArray, size: FloatArray, weights: FloatArray, null: Posterior, joints: IntArray
) -> float:
    """Change of the log-likelihood ratio where joints rest as the reading says, or are held.

    What rests or is held leaves more of a balance than what moves; at most what was counted against
    it is taken back.
    """
    resting = _weights(residual, size, null.inflation[joints])
    change = (
        0.5 * (residual**2 * (resting - weights)).sum() + np.log(size / null.noise[joints]).sum()
    )
    return float(change)


def _rate_steps(
    rows: FloatArray, joint: int, momenta: FloatArray, step: float, derived: float = 1.0
) -> FloatArray:
    """Columns of changes of the error of the rate, from the newer interval of each balance on.

    An error u in an interval is u in its rate and u T in all angles after it.  The momentum changes
    by M e_i times the difference of the rates of both intervals, the rest takes the mean of both;
    the angle at their junction is off by the difference of these times T / 6.  Rates that are not
    ``derived`` from the reading are right.  Shape (count, n, count).
    """
    count, n = rows.shape[:2]
    place, change = np.arange(count), np.eye(count)
    since = place[:, None] - place  # intervals
    angle = step * (np.maximum(since, 0.0) + change / 6.0)
    offset, rate = rows[:, :, 1 + OFFSET * n + joint], rows[:, :, 1 + RATE * n + joint]
    columns = offset[:, :, None] * angle[:, None, :]
    columns += derived * rate[:, :, None] * ((since >= 0) - 0.5 * change)[:, None, :]
    columns[place, :, place] -= derived * momenta[:, :, joint]
    return columns
