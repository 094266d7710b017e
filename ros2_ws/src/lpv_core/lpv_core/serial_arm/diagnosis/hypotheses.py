"""What explains the last balances better than a healthy arm, and how much better.

A hypothesis adds columns A to the rows of a window.  With all balances of the horizon under the
null hypothesis (offsets and parameters x, covariance P), its log-likelihood ratio is

    LLR = s^2 / (2 I) - log(I prior^2) / 2,    s = -(A^T W c + A^T W J x),
    I = A^T W A - A^T W J P J^T W A + prior^-2

(one column A; the second term is what the freedom of its size costs).  If the arm is healthy,
s^2 / I is chi-squared with one degree of freedom.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.serial_arm.diagnosis.balance import EPOCH, OFFSET, RATE
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
free torques, for encoders as for contacts."""
CONTACT_TIME = 0.3
"""Over which a torque from outside is correlated [s]."""
CONTACT_SHARES = (1.0, 0.3, 0.1, 0.03)
"""Amplitudes of torques from outside that are tried, in the largest plausible one."""
CONTACT_PENALTY = 1.4
"""Logarithm of the number of amplitudes."""
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
    """Results and memory of the search through W windows; S = 6 n hypotheses.

    Attributes
    ----------
    lengths : ndarray of int64, shape (W + 1,)
        Of the windows, then of their onsets [balances].
    prior : ndarray, shape (S,)
        Standard deviations of the faults' sizes; 0 of those that cannot be.
    torque : ndarray, shape (n,)
        Standard deviation of torques that may act from outside [N m].
    gain, information, size : ndarray, shape (W, S)
        LLR, I and size of each hypothesis.
    contact : ndarray, shape (W,)
        LLR of torques from outside.
    variance : ndarray, shape (n,)
        Of balances [N2 m2 s2], for which ``shares`` and ``costs`` hold.
    known : ndarray of int64, shape (W + 1,)
        Whether they do.
    values, vectors : ndarray, shapes (W + 1, L) and (W + 1, L, L)
        Of the correlation of torques from outside.
    shares, costs : ndarray, shapes (W + 1, K, n, L) and (W + 1, K, n)
        Factors of squared residuals along eigenvectors, and what the freedom of K amplitudes costs.
    columns, along : ndarray, shapes (m, S) and (L,)
        Scratch.
    """

    lengths: IntArray
    prior: FloatArray
    torque: FloatArray
    gain: FloatArray
    information: FloatArray
    size: FloatArray
    contact: FloatArray
    variance: FloatArray
    known: IntArray
    values: FloatArray
    vectors: FloatArray
    shares: FloatArray
    costs: FloatArray
    columns: FloatArray
    along: FloatArray


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
    count, longest = len(lengths), max(lengths)
    prior = np.concatenate([np.full(n, PRIOR[k]) if k in PRIOR else torque for k in KINDS])
    prior[RATE * n : (RATE + 1) * n] *= estimator.balance.derived == 0.0
    values, vectors = np.zeros((count, longest)), np.zeros((count, longest, longest))
    for w, length in enumerate(lengths):
        place = plan.interval * np.arange(length)
        correlation = np.exp(-np.abs(place - place[:, None]) / CONTACT_TIME)
        values[w, :length], vectors[w, :length, :length] = np.linalg.eigh(correlation)
    values *= plan.interval**2
    results = [np.zeros((count - 1, len(KINDS) * n)) for _ in range(3)]
    shares = len(CONTACT_SHARES)
    return Search(
        np.array(lengths), prior, torque, results[0], results[1], results[2], np.zeros(count - 1),
        np.zeros(n), np.zeros(count, np.int64), values, vectors,
        np.zeros((count, shares, n, longest)), np.zeros((count, shares, n)),
        np.zeros((m, len(KINDS) * n)), np.zeros(longest))  # fmt: skip


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
    _watch_noise(search, null)
    best, longest = -np.inf, 0
    for w in range(first, end):
        longest = max(longest, search.lengths[w])
    last = min(longest + 1, window.counters[COUNT])
    set_residuals(window, null, last)
    _weigh_outliers(null, last)
    for w in range(first, end):
        length = search.lengths[w]
        search.gain[w] = -np.inf
        search.contact[w] = -np.inf
        if window.counters[COUNT] <= length:
            continue
        begin = window.times[slot(window, length - 1)] - interval - epoch
        _faults(search, window, null, begin, w)
        onset = _contact(search, null, search.lengths.shape[0] - 1, length)
        search.gain[w] += onset
        search.contact[w] = _contact(search, null, w, length - 1)
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
    whiten(null.factor, columns)
    for a in range(m):
        own = columns[a]
        for s in range(count):
            information[s] -= own[s] * own[s]
    for s in range(count):
        if search.prior[s] == 0.0:
            gain[s] = -np.inf
            continue
        score, variance = gain[s], search.prior[s] * search.prior[s]
        information[s] = max(information[s], 0.0) + 1.0 / variance
        search.size[w, s] = score / information[s]
        gain[s] = 0.5 * (score * score / information[s] - np.log(information[s] * variance))


@njit
def _weigh_outliers(null: Posterior, last: int) -> None:
    """Shrink large residuals as the weights of least squares do (soft L1).

    A torque from outside must not gain from outliers what the faults' columns do not.
    """
    for back in range(last):
        for i in range(null.noise.shape[0]):
            ratio = null.residual[back, i] / (3.0 * null.noise[i])
            null.residual[back, i] /= (1.0 + ratio * ratio) ** 0.25


@njit
def _watch_noise(search: Search, null: Posterior) -> None:
    """Forget what depends on the noise, where that has changed."""
    for i in range(null.noise.shape[0]):
        variance = null.noise[i] * null.noise[i] * null.inflation[i]
        if search.variance[i] != variance:
            search.variance[i] = variance
            search.known[:] = 0


@njit
def _contact(search: Search, null: Posterior, w: int, oldest: int) -> float:
    """Ratio of marginal likelihoods of torques from outside that come, change and go.

    On each joint a torque of unknown amplitude a, correlated over `CONTACT_TIME`; joints that
    need none have none.  With the eigenvalues l_k of the correlation and z_k the residuals along
    its eigenvectors, sum_k [g z_k^2 / s^2 - log(1 + a^2 l_k / s^2)] / 2, g = a^2 l / (s^2 + a^2 l).
    The residuals begin ``oldest`` balances before the last one.
    """
    if search.known[w] == 0:
        _set_shares(search, w)
    total, length, along = 0.0, search.lengths[w], search.along
    for i in range(search.torque.shape[0]):
        along[:length] = 0.0
        for j in range(length):
            residual, vector = null.residual[oldest - j, i], search.vectors[w, j]
            for k in range(length):
                along[k] += residual * vector[k]
        for k in range(length):
            along[k] *= along[k]
        best = 0.0
        for c in range(search.costs.shape[1]):
            ratio, shares = -search.costs[w, c, i], search.shares[w, c, i]
            for k in range(length):
                ratio += shares[k] * along[k]
            best = max(best, ratio)
        total += best
    return total


@njit
def _set_shares(search: Search, w: int) -> None:
    """Write what `_contact` needs for a window at the present noise."""
    for i in range(search.torque.shape[0]):
        variance = search.variance[i]
        for c in range(len(CONTACT_SHARES)):
            amplitude = CONTACT_SHARES[c] * search.torque[i]
            cost = CONTACT_PENALTY
            for k in range(search.lengths[w]):
                signal = search.values[w, k] * amplitude * amplitude / variance
                search.shares[w, c, i, k] = 0.5 * signal / ((1.0 + signal) * variance)
                cost += 0.5 * np.log1p(signal)
            search.costs[w, c, i] = cost
    search.known[w] = 1


def explanations(
    search: Search,
    estimator: OffsetEstimator,
    rest: tuple[IntArray, FloatArray],
    conspicuous: IntArray,
    suspicious: float,
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
    ratio = residual / (3.0 * null.noise)
    weights = 1.0 / (null.noise**2 * null.inflation * np.sqrt(1.0 + ratio**2))
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
    begin = estimator.times(count)[0] - step
    sigma = step * np.sqrt(max(float(np.linalg.solve(scaled, walk).sum()), 0.0))
    return Explanation('stuck', joint, float(gain), float(step * rates.sum()), float(sigma), begin)


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
