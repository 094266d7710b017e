"""What explains the last balances better than a healthy arm, and how much better.

A hypothesis adds columns A to the rows of a window.  With all balances of the horizon under the
null hypothesis (offsets and parameters x, covariance P), its log-likelihood ratio is

    LLR = s^2 / (2 I) - log(I prior^2) / 2,    s = -(A^T W c + A^T W J x),
    I = A^T W A - A^T W J P J^T W A + prior^-2

(one column A; the second term is what the freedom of its size costs).  If the arm is healthy,
s^2 / I is chi-squared with one degree of freedom.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.serial_arm.diagnosis.balance import EPOCH, OFFSET, RATE, Balance
from lpv_core.serial_arm.diagnosis.contact import (
    Contact,
    force_levers,
    joint_levers,
    new_contact,
    rough_contact,
    smooth_contact,
    watch_noise,
    weigh_residuals,
)
from lpv_core.serial_arm.diagnosis.estimator import (
    HorizonPlan,
    OffsetEstimator,
    Posterior,
    set_residuals,
)
from lpv_core.serial_arm.diagnosis.information import (
    COUNT,
    Window,
    last_rows,
    slot,
    sum_slot,
    whiten,
)
from lpv_core.serial_arm.diagnosis.onset import Onset, sudden_drift, with_true_effect
from lpv_core.support.jit import njit

WINDOWS = (0.3, 1.0, 2.5)
"""Lengths of the windows in which a fault may have begun [s]."""
MORE_WINDOWS = (0.5, 0.7, 1.4, 1.8)
"""Lengths that are looked at, too, once something is suspected [s]."""
KINDS = ('drift', 'scale', 'rate_bias', 'torque_gain', 'slip', 'torque_offset')
"""Hypotheses, in the order of the balances' columns."""
ENCODER_KINDS = ('drift', 'scale', 'slip', 'stuck')
"""Faults of a position sensor (with the rate that is derived from it)."""
CONTACT = 'contact'
"""Unknown torques on all joints: something pushes or holds the arm, or its load has changed."""
STUCK_FOR = (4, 8, 20)
"""Balances for which a joint may have moved while its reading rests."""
STUCK_ACCELERATION = 10.0
"""Usual acceleration of a joint whose reading rests [rad/s2]."""
ONSET = 2
"""Balances at the start of a window in which a fault may come in any way: they are explained by
free torques, for encoders as for contacts; that it came suddenly is a hypothesis of its own."""
PRIOR = {'drift': 0.3, 'slip': 0.2, 'scale': 0.2, 'rate_bias': 0.3, 'torque_gain': 0.5}
"""Standard deviations of faults' sizes [rad/s], [rad], [-], [rad/s], [-]."""


@dataclass(frozen=True)
class Explanation:
    """One hypothesis and how well it fits."""

    kind: str
    joint: int  # -1 where no joint is named
    gain: float  # logarithm of the ratio of marginal likelihoods
    size: float  # of the fault: [rad/s], [rad], [-], [N m]
    sigma: float  # standard deviation of size
    begin: float  # start of the window [s]

    @property
    def is_encoder(self) -> bool:
        """Whether a position sensor is to blame."""
        return self.kind in ENCODER_KINDS


class Search(NamedTuple):
    """Results and memory of the search through W windows; S = 6 n hypotheses."""

    lengths: IntArray  # (W + 1,) of the windows, then of their onsets [balances]
    prior: FloatArray  # (S,) standard deviations of sizes; 0: cannot be
    outside: Contact  # torques from outside, for the windows and their onsets
    gain: FloatArray  # (W, S) log-likelihood ratio of each hypothesis
    information: FloatArray  # (W, S) information on its size
    size: FloatArray  # (W, S) its size
    contact: FloatArray  # (W,) log-likelihood ratio of torques from outside
    onset: FloatArray  # (W,) the same only at the onset of a fault
    columns: FloatArray  # (m, S) scratch
    shared: FloatArray  # (n,) scratch


def new_search(estimator: OffsetEstimator, torque: FloatArray) -> Search:
    """Search for faults of an arm.

    Parameters
    ----------
    estimator : OffsetEstimator
        Of the arm.
    torque : ndarray, shape (n,)
        Standard deviation of torques that may act from outside [N m].

    Returns
    -------
    Search
        Without results.
    """
    plan, n, m = estimator.plan, estimator.joints, len(estimator.prior)
    lengths = [*_lengths(plan, WINDOWS + MORE_WINDOWS), ONSET + 1]
    prior = np.concatenate([np.full(n, PRIOR[k]) if k in PRIOR else torque for k in KINDS])
    prior[RATE * n : (RATE + 1) * n] *= estimator.balance.derived == 0.0
    windows = len(lengths) - 1
    results = [np.zeros((windows, len(KINDS) * n)) for _ in range(3)]
    return Search(
        np.array(lengths), prior, new_contact(lengths, torque, plan.interval, plan.capacity),
        results[0], results[1], results[2], np.zeros(windows), np.zeros(windows),
        np.zeros((m, len(KINDS) * n)), np.zeros(n))  # fmt: skip


def _lengths(plan: HorizonPlan, seconds: tuple[float, ...]) -> list[int]:
    return [max(ONSET + 1, round(one / plan.interval)) for one in seconds]


@njit
def evaluate(
    search: Search,
    window: Window,
    null: Posterior,
    epoch: float,
    interval: float,
    first: int,
    end: int,
) -> float:
    """Evaluate all hypotheses for some windows.

    Parameters
    ----------
    search : Search
        Results are written; those of windows that are longer than the horizon are -inf.
    window : Window
        Balances.
    null : Posterior
        The null hypothesis.
    epoch, interval : float
        Moment from which drifts count, and length of an interval [s].
    first, end : int
        Windows from the first one to that before ``end``.

    Returns
    -------
    float
        The best LLR.
    """
    watch_noise(search.outside, null)
    best, longest = -np.inf, 0
    for w in range(first, end):
        longest = max(longest, search.lengths[w])
    last = min(longest + 1, window.counters[COUNT])
    set_residuals(window, null, last)
    weigh_residuals(window, null, last)
    for w in range(first, end):
        length = search.lengths[w]
        search.gain[w] = -np.inf
        search.contact[w] = -np.inf
        if window.counters[COUNT] <= length:
            continue
        begin = window.times[slot(window, length - 1)] - interval - epoch
        _faults(search, window, null, begin, w)
        search.onset[w] = rough_contact(search.outside, null, search.lengths.shape[0] - 1, length)
        search.gain[w] += search.onset[w]
        search.contact[w] = rough_contact(search.outside, null, w, length - 1)
        best = max(best, search.contact[w], search.gain[w].max())
    return best


@njit
def _faults(search: Search, window: Window, null: Posterior, begin: float, w: int) -> None:
    """Write LLR of the faults that began with a window; a drift counts from its start."""
    n, m, columns = null.sigma.shape[0], null.mean.shape[0], search.columns
    count, gain, information = columns.shape[1], search.gain[w], search.information[w]
    at, before = sum_slot(window, 0), sum_slot(window, search.lengths[w] - ONSET)
    new, old, offset = window.sums[at], window.sums[before], OFFSET * n
    for s in range(count):
        gain[s] = old[0, 1 + s] - new[0, 1 + s]
        if s < offset:
            information[s] = window.squares[at, s] - window.squares[before, s]
        else:
            row = 1 + s - offset
            information[s] = new[row, 1 + s] - old[row, 1 + s]
    for a in range(m):
        own = columns[a]
        for s in range(count):
            own[s] = new[1 + a, 1 + s] - old[1 + a, 1 + s]
    for i in range(n):
        information[i] -= begin * (2.0 * columns[i, i] - begin * columns[i, offset + i])
        gain[i] -= begin * gain[offset + i]
    for a in range(m):
        own = columns[a]
        for i in range(n):
            own[i] -= begin * own[offset + i]
        for s in range(count):
            gain[s] -= own[s] * null.mean[a]
    for i in range(n):
        search.shared[i] = columns[i, i]
    whiten(null.factor, columns)
    for a in range(m):
        own = columns[a]
        for s in range(count):
            information[s] -= own[s] * own[s]
        for i in range(n):
            search.shared[i] -= own[i] * own[offset + i]
    for s in range(count):
        if search.prior[s] == 0.0:
            gain[s] = -np.inf
            continue
        score, variance = gain[s], search.prior[s] * search.prior[s]
        information[s] = max(information[s], 0.0)
        power = information[s] + 1.0 / variance
        gain[s] = 0.5 * (score * score / power - np.log(power * variance))
        search.size[w, s] = score / power
        if s < n and search.prior[RATE * n + s] == 0.0:
            _begin_earlier(search, w, s, (score, gain[offset + s]), information[offset + s])
        information[s] += 1.0 / variance


@njit
def _begin_earlier(search: Search, w: int, i: int, score: tuple[float, float], slip: float) -> None:
    """Let the drift of encoder i have begun at any time: an offset at the window's start is free.

    ``slip`` is the information on that offset.  What explains more is kept.
    """
    n = search.shared.shape[0]
    first, second = search.prior[i] ** -2.0, search.prior[OFFSET * n + i] ** -2.0
    a, b, c = search.information[w, i] + first, search.shared[i], max(slip, 0.0) + second
    determinant = max(a * c - b * b, first * second)
    fit = c * score[0] ** 2 - 2.0 * b * score[0] * score[1] + a * score[1] ** 2
    gain = 0.5 * (fit / determinant - np.log(determinant / (first * second)))
    if gain > search.gain[w, i]:
        search.gain[w, i] = gain
        search.size[w, i] = (c * score[0] - b * score[1]) / determinant
        search.information[w, i] = determinant / c - first


@njit
def _explained_at_onsets(search: Search, window: Window, null: Posterior) -> FloatArray:
    """What torques from outside at an onset alone explain, by the older balance that holds it.

    Onsets are within the longest window that is always looked at.
    """
    last = min(search.lengths[len(WINDOWS) - 1] + 2, window.counters[COUNT])
    set_residuals(window, null, last)
    weigh_residuals(window, null, last)
    free, onset = np.zeros(last), search.lengths.shape[0] - 1
    for back in range(1, last - 1):
        free[back] = rough_contact(search.outside, null, onset, back + 1)
    return free


@njit
def _sudden_drift(
    window: Window,
    null: Posterior,
    balance: Balance,
    fault: tuple[int, float],
    interval: float,
    free: FloatArray,
    blocks: FloatArray,
    per_interval: int,
) -> Onset:
    """The best onset of a drift; ``fault`` is the joint and the prior's deviation [rad/s]."""
    joint, prior = fault
    newest, n = blocks[blocks.shape[0] - 1], null.sigma.shape[0]
    times = balance.clock[EPOCH], newest[3 * n] + 0.5 * newest[3 * n + 1], interval, prior
    best = sudden_drift(window, null, balance, joint, times, free)
    needed = (best.back + 2) * per_interval
    if best.gain == -np.inf or needed > blocks.shape[0]:
        return best
    effect = joint, prior, free[best.back]
    return with_true_effect(best, window, null, balance, effect, blocks[-needed:], per_interval)


def sudden_drifts(
    search: Search, estimator: OffsetEstimator, blocks: FloatArray
) -> list[Explanation]:
    """Drifts that began suddenly, of encoders whose rates are derived from them.

    Parameters
    ----------
    search : Search
        Some windows have been evaluated.
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    blocks : ndarray, shape (N, 3 n + 3)
        Those of the horizon, oldest first.

    Returns
    -------
    list of Explanation
        One of each encoder; its gain is -inf while the horizon is too short.
    """
    window, null, balance = estimator.window, estimator.posterior, estimator.balance
    plan, found = estimator.plan, []
    free = _explained_at_onsets(search, window, null)
    for i in np.nonzero(balance.derived)[0]:
        fault = int(i), float(search.prior[i])
        one = _sudden_drift(
            window, null, balance, fault, plan.interval, free, blocks, plan.blocks)  # fmt: skip
        found.append(Explanation('drift', int(i), one.gain, one.size, one.sigma, one.begin))
    return found


def excludes_contact(
    search: Search, estimator: OffsetEstimator, fault: Explanation, margin: float
) -> bool:
    """Whether a fault explains more than smooth torques from outside do, in any window.

    As for a fault, what came at the onset is explained by free torques.

    Parameters
    ----------
    search : Search
        All windows have been evaluated.
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    fault : Explanation
        What is to be named.
    margin : float
        By which it must explain more.

    Returns
    -------
    bool
        False as soon as one course of torques explains too much.
    """
    null, window, outside = estimator.posterior, estimator.window, search.outside
    windows = np.nonzero(search.contact > -np.inf)[0]
    begins = np.array([estimator.times(int(search.lengths[w]))[0] for w in windows])
    for w in windows[np.argsort(np.abs(begins - fault.begin))]:
        last = int(search.lengths[w]) - ONSET
        for levers in _levers(search, estimator, last):
            for courses in outside.smooth:
                gain = search.onset[w] + smooth_contact(courses, levers, window, null, last)
                if gain > fault.gain - margin:
                    return False
    return True


def _levers(search: Search, estimator: OffsetEstimator, last: int) -> tuple[FloatArray, FloatArray]:
    """Of torques on single joints, and of a force on the tip."""
    torque, chain = search.outside.torque, estimator.balance.chain
    return joint_levers(torque, last), force_levers(chain, torque, estimator.window, last)


def offset_against_contact(search: Search, estimator: OffsetEstimator, joint: int) -> float:
    """Log-likelihood ratio of an offset of one encoder to torques over the whole horizon.

    Parameters
    ----------
    search : Search
        Of the arm.
    estimator : OffsetEstimator
        Its posterior holds the offset.
    joint : int
        Of the encoder.

    Returns
    -------
    float
        Positive where the offset explains more; offsets of other encoders are free.
    """
    null, window = estimator.posterior, estimator.window
    upper = np.triu(null.factor)
    column = np.linalg.solve(upper.T @ upper, np.eye(len(null.mean))[joint])
    variance, offset = column[joint], null.mean[joint]
    held = upper.T @ upper
    held[joint, joint] += 1e6 / variance
    without = null._replace(
        mean=null.mean - column * offset / variance,
        factor=np.ascontiguousarray(np.linalg.cholesky(held).T),
    )
    gain = 0.5 * (offset**2 / variance - np.log(estimator.prior[joint] ** 2 / variance))
    last, courses = len(estimator), search.outside.horizon
    return float(gain) - max(
        smooth_contact(courses, levers, window, without, last)
        for levers in _levers(search, estimator, last)
    )


def explanations(
    search: Search,
    estimator: OffsetEstimator,
    rest: tuple[IntArray, FloatArray],
    conspicuous: IntArray,
    suspicious: float,
    blocks: Callable[[int], FloatArray],
) -> list[Explanation]:
    """Hypotheses for all windows, the best one first; none where none is worth a look.

    Parameters
    ----------
    search : Search
        Of the arm.
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    rest : tuple of ndarray, shape (n,)
        Balances for which each reading has not changed at all, and its speed before [rad/s].
    conspicuous : ndarray of int
        Joints whose readings are looked at in any case.
    suspicious : float
        Evidence from which on more windows are looked at.
    blocks : callable
        Blocks of so many last intervals, oldest first.

    Returns
    -------
    list of Explanation
        Sorted by their gain.
    """
    state = search, estimator.window, estimator.posterior
    times = estimator.balance.clock[EPOCH], estimator.plan.interval
    some, all_of_them = len(WINDOWS), len(search.contact)
    best = evaluate(*state, *times, 0, some)
    resting, speed = rest
    found: list[Explanation] = []
    if best > suspicious:
        evaluate(*state, *times, some, all_of_them)
        found = _found(search, estimator)
        found += sudden_drifts(search, estimator, blocks(len(estimator) + 1))
        conspicuous = np.arange(estimator.joints)
    for i in conspicuous:
        if resting[i] > 0 and len(estimator) > 0:
            found += [
                stuck_explanation(estimator, int(i), one, 0.1 if one < resting[i] else speed[i])
                for one in {min(one, int(resting[i])) for one in STUCK_FOR}
            ]
    if found and best <= suspicious:
        found += _found(search, estimator, some)
    return sorted(found, key=lambda one: -one.gain)


def all_windows(search: Search, estimator: OffsetEstimator) -> FloatArray:
    """Evaluate all windows; their begins, NaN of those that are longer than the horizon [s]."""
    times = estimator.balance.clock[EPOCH], estimator.plan.interval
    evaluate(search, estimator.window, estimator.posterior, *times, 0, len(search.contact))
    begins = np.full(len(search.contact), np.nan)
    for w in np.nonzero(search.contact > -np.inf)[0]:
        begins[w] = estimator.times(int(search.lengths[w]))[0] - estimator.plan.interval
    return begins


def _found(search: Search, estimator: OffsetEstimator, windows: int = 99) -> list[Explanation]:
    """What was found in the windows."""
    n, found = estimator.joints, []
    for w in range(min(windows, len(search.contact))):
        if search.contact[w] == -np.inf:
            continue
        begin = estimator.times(int(search.lengths[w]))[0] - estimator.plan.interval
        for s in np.nonzero(search.gain[w] > -np.inf)[0]:
            kind, sigma = KINDS[s // n], search.information[w, s] ** -0.5
            found.append(Explanation(
                kind, int(s % n), search.gain[w, s], search.size[w, s], sigma, begin))  # fmt: skip
        found.append(Explanation(CONTACT, -1, search.contact[w], 0.0, 0.0, begin))
    return found


def stuck_explanation(
    estimator: OffsetEstimator, joint: int, balances: int, speed: float
) -> Explanation:
    """A reading that rests while the joint moves, at a rate that changes from balance to balance.

    The gain is the ratio of marginal likelihoods: log det(prior I)/2 is taken off for the freedom
    of the rates, which walk at random.

    Parameters
    ----------
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    joint : int
        Whose reading rests.
    balances : int
        For how many of the last balances it may have moved.
    speed : float
        Usual rate to begin with [rad/s].

    Returns
    -------
    Explanation
        Of kind ``stuck``; its size is the way that the joint has gone since [rad].
    """
    n, null, step = estimator.joints, estimator.posterior, estimator.plan.interval
    count = min(balances, len(estimator))
    rows = last_rows(estimator.window, count)
    set_residuals(estimator.window, null, count)
    residual = null.residual[:count][::-1]
    size = _usual_sizes(estimator, count)
    at_rest = size[:, joint].copy()
    size[:, joint] = null.noise[joint]  # if the reading lies, the joint moves
    weights = _weights(residual, size, null)
    columns = _rate_steps(rows, 1 + OFFSET * n + joint, 1 + RATE * n + joint, step)
    score = -np.einsum('kij,ki,ki->j', columns, weights, residual)
    unknowns = rows[..., rows.shape[2] - len(null.mean) :]
    cross = np.einsum('kix,ki,kij->xj', unknowns, weights, columns)
    whiten(null.factor, cross)
    information = np.einsum('kia,ki,kib->ab', columns, weights, columns) - cross.T @ cross
    place = np.arange(1.0, count + 1.0)
    walk = (STUCK_ACCELERATION * step) ** 2 * np.minimum(place, place[:, None]) + speed**2
    scaled = walk @ information + np.eye(count)
    rates = np.linalg.solve(scaled, walk @ score)
    gain = 0.5 * (score @ rates - np.linalg.slogdet(scaled)[1])
    gain += _rest_instead(residual[:, joint], at_rest, weights[:, joint], null, joint)
    begin = estimator.times(count)[0] - step
    sigma = step * np.sqrt(max(float(np.linalg.solve(scaled, walk).sum()), 0.0))
    return Explanation('stuck', joint, float(gain), float(step * rates.sum()), float(sigma), begin)


def _weights(residual: FloatArray, size: FloatArray, null: Posterior) -> FloatArray:
    """Inverse variances of balances, outliers with less weight; shape (last, n)."""
    variance = size**2 * null.inflation
    return np.asarray(1.0 / (variance * np.sqrt(1.0 + (residual / (3.0 * size)) ** 2)))


def _rest_instead(
    residual: FloatArray, size: FloatArray, weights: FloatArray, null: Posterior, joint: int
) -> float:
    """Change of the log-likelihood ratio where the joint rests as its reading says.

    Its friction explains more then than in motion; at most what was counted against it.
    """
    resting = 1.0 / (size**2 * null.inflation[joint])
    resting /= np.sqrt(1.0 + (residual / (3.0 * size)) ** 2)
    change = 0.5 * residual**2 @ (resting - weights) + np.log(size / null.noise[joint]).sum()
    return min(float(change), 0.0)


def _usual_sizes(estimator: OffsetEstimator, last: int) -> FloatArray:
    """Usual sizes of what is left of the last balances, oldest first, shape (last, n) [N m s]."""
    window, null = estimator.window, estimator.posterior
    rest = window.rest[[slot(window, back) for back in range(last - 1, -1, -1)]]
    return np.asarray(null.noise * (1.0 + (null.rest - 1.0) * rest))


def _rate_steps(rows: FloatArray, offset: int, rate: int, step: float) -> FloatArray:
    """Columns of errors of the rate, one for each balance, with the angles that follow from them.

    An error u during balance j is u in its rate and u T in all angles after it, half of that in
    its own.  Shape (count, n, count).
    """
    count = len(rows)
    later = np.tri(count, k=-1) + 0.5 * np.eye(count)
    columns = step * later[:, None, :] * rows[:, :, offset, None]
    for j in range(count):
        columns[j, :, j] += rows[j, :, rate]
    return columns
