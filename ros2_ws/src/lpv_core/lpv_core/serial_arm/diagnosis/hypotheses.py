"""What explains the last balances better than a healthy arm, and how much better.

A hypothesis adds columns A to the rows of a window.  With all balances of the horizon under the
null hypothesis (offsets and parameters x, covariance P), its log-likelihood ratio is

    LLR = s^2 / (2 I) - log(I prior^2) / 2,    s = -(A^T W c + A^T W J x),
    I = A^T W A - A^T W J P J^T W A + prior^-2

(one column A; the second term is what the freedom of its size costs).  If the arm is healthy,
s^2 / I is chi-squared with one degree of freedom.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from lpv_core.serial_arm.chain import FloatArray, IntArray
from lpv_core.serial_arm.diagnosis.balance import DRIFT, GAIN, OFFSET, RATE, SCALE, TORQUE
from lpv_core.serial_arm.diagnosis.estimator import OffsetEstimator

WINDOWS = (0.3, 1.0, 2.5)
"""Lengths of the windows in which a fault may have begun [s]."""
MORE_WINDOWS = (0.5, 0.7, 1.4, 1.8)
"""Lengths that are looked at, too, once something is suspected [s]."""
ENCODER_KINDS = {'drift': DRIFT, 'slip': OFFSET, 'scale': SCALE}
"""Faults of a position sensor (with the rate that is derived from it), by their columns."""
RATE_KINDS = {'rate_bias': RATE}
TORQUE_KINDS = {'torque_offset': TORQUE, 'torque_gain': GAIN}
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
        return self.kind in ENCODER_KINDS or self.kind == 'stuck'


def explanations(
    estimator: OffsetEstimator,
    torque_prior: FloatArray,
    resting: IntArray,
    speed: FloatArray,
    suspicious: float,
) -> list[Explanation]:
    """All hypotheses for all windows, the best one first.

    Parameters
    ----------
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    torque_prior : ndarray, shape (n,)
        Standard deviation of torques that may act from outside [N m].
    resting : ndarray of int, shape (n,)
        Balances for which each reading has not changed at all.
    speed : ndarray, shape (n,)
        Of each reading before it came to rest [rad/s].
    suspicious : float
        Evidence from which on more windows are looked at.

    Returns
    -------
    list of Explanation
        Sorted by their gain.
    """
    found: list[Explanation] = []
    for seconds in WINDOWS:
        last = round(seconds / estimator.plan.interval)
        if len(estimator.window) > last:
            found += _window(estimator, last, torque_prior)
    if found and max(one.gain for one in found) > suspicious:
        for seconds in MORE_WINDOWS:
            last = round(seconds / estimator.plan.interval)
            if len(estimator.window) > last:
                found += _window(estimator, last, torque_prior)
    for i in np.nonzero(resting)[0]:
        found += [
            stuck_explanation(estimator, int(i), count, 0.1 if count < resting[i] else speed[i])
            for count in {min(count, int(resting[i])) for count in STUCK_FOR}
        ]
    return sorted(found, key=lambda one: -one.gain)


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
    count = min(balances, len(estimator.window))
    rows = estimator.window.last_rows(count)
    residual = estimator.residual(rows)
    weights = estimator.weights(residual)
    columns = _rate_steps(rows, 1 + OFFSET * n + joint, 1 + RATE * n + joint, step)
    score = -np.einsum('kij,ki,ki->j', columns, weights, residual)
    cross = np.einsum('kix,ki,kij->xj', rows[..., null.columns], weights, columns)
    information = np.einsum('kia,ki,kib->ab', columns, weights, columns)
    information -= cross.T @ null.covariance @ cross
    place = np.arange(1.0, count + 1.0)
    walk = (STUCK_ACCELERATION * step) ** 2 * np.minimum(place, place[:, None]) + speed**2
    scaled = walk @ information + np.eye(count)
    rates = np.linalg.solve(scaled, walk @ score)
    gain = 0.5 * (score @ rates - np.linalg.slogdet(scaled)[1])
    begin = estimator.window.times[len(estimator.window) - count] - step
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


def _window(estimator: OffsetEstimator, last: int, torque_prior: FloatArray) -> list[Explanation]:
    """Hypotheses of faults that began with the last balances."""
    n, null = estimator.joints, estimator.posterior
    products = estimator.window.products(last - ONSET)
    begin = estimator.window.times[len(estimator.window) - last] - estimator.plan.interval
    kinds = {**ENCODER_KINDS, **RATE_KINDS, **TORQUE_KINDS}
    names = list(kinds)
    selection = np.concatenate([1 + kinds[name] * n + np.arange(n) for name in names])
    # A drift counts from the start of the window: ramp(t) - begin.
    drift, offset = 1 + DRIFT * n + np.arange(n), 1 + OFFSET * n + np.arange(n)
    products = products.copy()
    products[:, drift] -= begin * products[:, offset]
    products[drift, :] -= begin * products[offset, :]
    cross = products[np.ix_(null.columns, selection)]
    score = -(products[selection, 0] + cross.T @ null.mean)
    reduced = null.covariance @ cross
    prior = np.concatenate([np.full(n, PRIOR[k]) if k in PRIOR else torque_prior for k in names])
    information = products[selection, selection] - (cross * reduced).sum(0) + prior**-2
    gain = 0.5 * score**2 / information - 0.5 * np.log(information * prior**2)
    gain += contact_evidence(estimator, last + 1, torque_prior, ONSET + 1)
    size, sigma = score / information, information**-0.5
    independent = estimator.balance.derived == 0.0
    found = []
    for k, name in enumerate(names):
        for i in range(n):
            if name not in RATE_KINDS or independent[i]:
                j = k * n + i
                found.append(Explanation(name, i, gain[j], size[j], sigma[j], begin))
    gain_of_contact = contact_evidence(estimator, last, torque_prior, last)
    found.append(Explanation(CONTACT, -1, gain_of_contact, 0.0, 0.0, begin))
    return found


def contact_evidence(
    estimator: OffsetEstimator, last: int, torque_prior: FloatArray, count: int
) -> float:
    """Ratio of marginal likelihoods of torques from outside that come, change and go.

    On each joint a torque of unknown amplitude a, correlated over `CONTACT_TIME`; joints that
    need none have none.  With the eigenvalues l_k of the correlation and z_k the residuals along
    its eigenvectors, sum_k [g z_k^2 / s^2 - log(1 + a^2 l_k / s^2)] / 2, g = a^2 l / (s^2 + a^2 l).

    Parameters
    ----------
    estimator : OffsetEstimator
        Its posterior is the null hypothesis.
    last : int
        Length of the window [balances].
    torque_prior : ndarray, shape (n,)
        Largest of the amplitudes that are tried [N m].
    count : int
        Balances of the window that are looked at, from its start on.

    Returns
    -------
    float
        Log-likelihood ratio.
    """
    step = estimator.plan.interval
    rows = estimator.window.last_rows(min(last, len(estimator.window)))[:count]
    residual = estimator.residual(rows)
    values, vectors = _correlation(len(rows), step)
    along = (vectors.T @ residual) ** 2
    noise = estimator.noise**2 * estimator.inflation
    best = np.zeros(estimator.joints)
    for share in CONTACT_SHARES:
        signal = values[:, None] * (share * torque_prior * step) ** 2 / noise
        ratio = 0.5 * (along / noise * signal / (1.0 + signal) - np.log1p(signal)).sum(0)
        best = np.maximum(best, ratio - CONTACT_PENALTY)
    return float(best.sum())


@cache
def _correlation(count: int, step: float) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and eigenvectors of an exponential correlation."""
    place = step * np.arange(count)
    values, vectors = np.linalg.eigh(np.exp(-np.abs(place - place[:, None]) / CONTACT_TIME))
    return values, vectors
