"""Noise of the rows of balances: rows do not share it, and its size is learned.

What a healthy arm leaves of a balance, r, has the covariance

    C = k M S^-1 V S^-T M^T + D,

where V are variances of the readings' rates, as the file states them, and D is of all else, joint
by joint: noise of one reading moves the momenta of several joints.  Rows are L r in place of r,
with the L that makes L C L^T diagonal, has ones on its own diagonal and zeros above.  k and D are
learned: only noise of readings lets residuals of two joints agree in the way of the mass matrix.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.balance import Balance
from lpv.core.serial_arm.diagnosis.information import (
    COUNT,
    NEXT,
    ROBUST,
    Posterior,
    Window,
    select,
    slot,
)
from lpv.core.serial_arm.dynamics.momentum import mass_matrix
from lpv.core.support.jit import njit_in_place
from lpv.core.support.limits import LARGEST

NOISE_SAMPLES = 20
"""Balances after which what is seen of the noise counts as much as what is expected."""
FEW = 10
"""Balances from which the size of noise is learned; after as many it is learned anew."""
LAGS = 8
"""Balances over which what the model does not explain is correlated."""
_SHARED = 2
"""Balances later whose noise has something of the same readings: changes of rates are second
differences of readings.  So it averages out, where what the model misses does not."""
_LARGEST_INFLATION = 2.0 * LAGS - 1.0
"""1 + 2 sum of autocorrelations of one each: what never changes over these lags."""
_LARGEST_FACTOR = 10.0
"""What is learned of the noise is that of the file within this factor: beyond, file or units are
wrong, which `misfit` reports."""
UNMEASURED = LARGEST**2
"""Variance of a balance of an effort that was missing: it may have been any [N2 m2 s2]."""


class RowNoise(NamedTuple):
    """What is known of the noise of balances of n joints, and scratch."""

    rates: FloatArray  # (n,) V: variances of the change of the mean rate of a reading [rad2/s2]
    stated: FloatArray  # (n,) D before any balance was seen [N2 m2 s2]
    other: FloatArray  # (n,) D as learned [N2 m2 s2]
    share: FloatArray  # (1,) k as learned
    more: FloatArray  # (n,) more variance of the rates of the balance that is taken [rad2/s2]
    usual: FloatArray  # (n,) root mean squares of the noise of rows, as predicted [N m s]
    matrix: FloatArray  # (n, n) scratch: covariance
    joints: FloatArray  # (capacity, n) scratch: residuals of joints
    common: FloatArray  # (capacity, n, n) scratch: covariances by noise of readings
    seen: FloatArray  # (n,) scratch: sizes of residuals of joints that move, 0 where few are
    power: FloatArray  # (n,) scratch: variances of rates


def new_row_noise(
    rates: FloatArray, stated: FloatArray, usual: FloatArray, capacity: int
) -> RowNoise:
    """Noise of rows before any balance; arguments are as in `RowNoise`."""
    n = len(rates)
    return RowNoise(
        rates, stated, stated.copy(), np.ones(1), np.zeros(n), usual.copy(), np.zeros((n, n)),
        np.zeros((capacity, n)), np.zeros((capacity, n, n)), *np.zeros((2, n)))  # fmt: skip


@njit_in_place
def decorrelate(
    noise: RowNoise, window: Window, balance: Balance, dry: FloatArray, at: int
) -> None:
    """Let the rows of a balance that has joined the window share no noise.

    ``dry``, shape (n,), is usual friction at rest [N m s].
    """
    rows, mixing, momenta = window.rows[at], window.mixing[at], window.momenta[at]
    mass_matrix(balance.chain, window.poses[at], balance.work, mixing)
    n, covariance = mixing.shape[0], noise.matrix
    for i in range(n):
        for j in range(n):
            momenta[i, j] = 0.0
            for k in range(n):
                momenta[i, j] += mixing[i, k] * balance.to_joints[k, j]
    for k in range(n):
        noise.power[k] = noise.share[0] * noise.rates[k] + noise.more[k]
    _set_common(momenta, noise.power, covariance)
    for i in range(n):
        for j in range(n):
            mixing[i, j] = 1.0 if i == j else 0.0
        covariance[i, i] += noise.other[i] + window.extra[at, i]
        covariance[i, i] += window.rest[at, i] * dry[i] * dry[i]
    for k in range(n):
        for i in range(k + 1, n):
            share = covariance[i, k] / covariance[k, k]
            if share != 0.0:
                for c in range(rows.shape[1]):
                    rows[i, c] -= share * rows[k, c]
                for j in range(n):
                    covariance[i, j] -= share * covariance[k, j]
                    mixing[i, j] -= share * mixing[k, j]
                    momenta[i, j] -= share * momenta[k, j]
    for i in range(n):
        window.relative[at, i] = np.sqrt(_variance(noise, window, dry, at, i)) / noise.usual[i]


@njit_in_place
def _set_common(momenta: FloatArray, power: FloatArray, covariance: FloatArray) -> None:
    """Write the covariance that rates of these variances give momenta, of each by unit rates."""
    n = power.shape[0]
    for i in range(n):
        for j in range(n):
            covariance[i, j] = 0.0
            for k in range(n):
                covariance[i, j] += momenta[i, k] * power[k] * momenta[j, k]


@njit_in_place
def _variance(noise: RowNoise, window: Window, dry: FloatArray, at: int, i: int) -> float:
    """Predicted variance of a row, but for its own joint's friction at rest [N2 m2 s2]."""
    momenta, mixing, total = window.momenta[at, i], window.mixing[at, i], noise.other[i]
    for k in range(momenta.shape[0]):
        total += noise.share[0] * momenta[k] * momenta[k] * noise.rates[k]
    for j in range(i):
        rest = window.rest[at, j] * dry[j] * dry[j]
        total += mixing[j] * mixing[j] * (noise.other[j] + rest)
    return float(total)


@njit_in_place
def is_due(window: Window) -> bool:
    """Whether k and D are to be learned anew: whenever twice as much is known, or all is new."""
    taken, capacity = window.counters[NEXT], window.times.shape[0]
    if taken >= capacity:
        return bool(taken % capacity == 0)
    due = NOISE_SAMPLES
    while due < taken:
        due *= 2
    return bool(due == taken)


@njit_in_place
def learn_covariance(noise: RowNoise, window: Window, null: Posterior) -> None:
    """Learn k and D from what an estimate leaves of the window; ``null`` must hold the residuals.

    Balances of joints that rest are left out: friction may be anything then.
    """
    for back in range(window.counters[COUNT]):
        _undo(noise, window, null, back)
    for i in range(noise.other.shape[0]):
        k = 0
        for back in range(window.counters[COUNT]):
            if _moves(window, slot(window, back), i):
                null.sizes[k] = abs(noise.joints[back, i])
                k += 1
        noise.seen[i] = _usual_value(null.sizes[:k]) if k >= FEW else 0.0
    _learn_share(noise, window)
    _learn_other(noise, window)
    _predict(noise, window, null.dry)


@njit_in_place
def _learn_share(noise: RowNoise, window: Window) -> None:
    """Learn k from what the residuals of two joints have in common."""
    seen = noise.seen
    # What was known has a standard deviation of 1.
    product, square = noise.share[0], 1.0
    for back in range(window.counters[COUNT]):
        at = slot(window, back)
        for i in range(seen.shape[0]):
            for j in range(i):
                both = seen[i] * seen[j]
                if both > 0.0 and _moves(window, at, i) and _moves(window, at, j):
                    one = min(max(noise.joints[back, i] / seen[i], -ROBUST), ROBUST)
                    other = min(max(noise.joints[back, j] / seen[j], -ROBUST), ROBUST)
                    common = noise.common[back, i, j] / both
                    product += one * other * common
                    square += common * common
    noise.share[0] = max(product / square, 0.0)


@njit_in_place
def _learn_other(noise: RowNoise, window: Window) -> None:
    """Learn D from what noise of readings leaves of the residuals' sizes."""
    for i in range(noise.other.shape[0]):
        k, power = 0, 0.0
        for back in range(window.counters[COUNT]):
            if _moves(window, slot(window, back), i):
                power += noise.share[0] * noise.common[back, i, i]
                k += 1
        if noise.seen[i] > 0.0:
            least, weight = noise.stated[i] / (_LARGEST_FACTOR * _LARGEST_FACTOR), _share(k)
            left = max(noise.seen[i] * noise.seen[i] - power / k, least)
            noise.other[i] += weight * (left - noise.other[i])


@njit_in_place
def _predict(noise: RowNoise, window: Window, dry: FloatArray) -> None:
    """Write usual and relative sizes of the rows' noise, by k and D."""
    count = window.counters[COUNT]
    for i in range(noise.other.shape[0]):
        power = 0.0
        for back in range(count):
            at = slot(window, back)
            variance = _variance(noise, window, dry, at, i)
            power += variance
            window.relative[at, i] = np.sqrt(variance)
        noise.usual[i] = np.sqrt(power / count)
        for back in range(count):
            window.relative[slot(window, back), i] /= noise.usual[i]


@njit_in_place
def _undo(noise: RowNoise, window: Window, null: Posterior, back: int) -> None:
    """Write residuals of the joints in place of rows, and their covariance by noise of readings."""
    at, n = slot(window, back), noise.other.shape[0]
    mixing, momenta = window.mixing[at], noise.matrix
    for i in range(n):
        left = null.residual[back, i]
        for j in range(n):
            momenta[i, j] = window.momenta[at, i, j]
        for k in range(i):
            left -= mixing[i, k] * noise.joints[back, k]
            for j in range(n):
                momenta[i, j] -= mixing[i, k] * momenta[k, j]
        noise.joints[back, i] = left
    _set_common(momenta, noise.rates, noise.common[back])


@njit_in_place
def _moves(window: Window, at: int, i: int) -> bool:
    """Whether a balance shows noise of a joint that moves."""
    return bool(is_trusted(window, at, i) and window.rest[at, i] == 0.0)


@njit_in_place
def usual_size(window: Window, null: Posterior, back: int, i: int) -> float:
    """Usual size of what is left of a balance of joint i [N m s].

    In a long rest friction may be anything up to that of the file, whatever was seen in others.
    """
    at = slot(window, back)
    moving = null.noise[i] * window.relative[at, i]
    size = moving * (1.0 + (null.rest[i] - 1.0) * window.rest[at, i])
    if null.lasting[at, i] > 0.0:
        size = max(size, np.hypot(moving, null.dry[i]))
    return size


@njit_in_place
def learn_noise(noise: RowNoise, window: Window, null: Posterior) -> None:
    """Size and correlation in time of what is not explained, from the residuals of the horizon."""
    count, n, values = window.counters[COUNT], null.noise.shape[0], null.sizes
    for i in range(n):
        moving = values[: _sizes(window, null, i, 0.0, values)]
        size = max(_learned_size(moving, null.expected[i]), noise.usual[i] / _LARGEST_FACTOR)
        null.noise[i] = min(size, _LARGEST_FACTOR * null.expected[i])
        resting = values[: _sizes(window, null, i, 1.0, values)]
        rest = _learned_size(resting, null.expected_rest[i] * null.noise[i])
        null.rest[i] = min(max(rest / null.noise[i], 1.0), _LARGEST_FACTOR)
        k = 0
        for back in range(count):
            if is_trusted(window, slot(window, back), i):
                ratio = null.residual[back, i] / usual_size(window, null, back, i)
                values[k] = min(max(ratio, -ROBUST), ROBUST)
                k += 1
        if k >= FEW:
            learned = min(1.0 + 2.0 * _correlation(values[:k]), _LARGEST_INFLATION)
            null.inflation[i] = (1.0 - _share(k)) * 2.0 + _share(k) * learned


@njit_in_place
def is_trusted(window: Window, at: int, i: int) -> bool:
    """Whether nothing from outside acted on a balance of a joint whose effort was measured."""
    return bool(window.trust[at] == 1.0 and window.extra[at, i] < UNMEASURED)


@njit_in_place
def _sizes(window: Window, null: Posterior, i: int, rest: float, values: FloatArray) -> int:
    """Write sizes of residuals of a joint where it moves, or rests; their number."""
    count = 0
    for back in range(window.counters[COUNT]):
        at = slot(window, back)
        if is_trusted(window, at, i) and window.rest[at, i] == rest:
            values[count] = abs(null.residual[back, i]) / window.relative[at, i]
            count += 1
    return count


@njit_in_place
def _share(count: int) -> float:
    """Weight of what was seen in so many balances, beside what is expected."""
    return count * count / (NOISE_SAMPLES * NOISE_SAMPLES + count * count)


@njit_in_place
def _learned_size(sizes: FloatArray, expected: float) -> float:
    """Usual size of residuals, from their absolute values, whose order is changed."""
    if len(sizes) < FEW:
        return expected
    size, share = _usual_value(sizes), _share(len(sizes))
    return float(np.sqrt((1.0 - share) * expected * expected + share * size * size))


@njit_in_place
def _usual_value(sizes: FloatArray) -> float:
    """Standard deviation of normal values of these sizes, whose order is changed."""
    count = len(sizes)
    middle = 0.5 * (select(sizes, (count - 1) // 2) + select(sizes, count // 2))
    return float(1.4826 * middle)  # 1 / Phi^-1(3/4)


@njit_in_place
def _correlation(values: FloatArray) -> float:
    """Sum of the autocorrelations, 0 at least; of lags at which noise shares no readings, of the
    positive ones, as what the model misses lasts."""
    count, power, total = len(values), 0.0, 0.0
    for k in range(count):
        power += values[k] * values[k]
    power = max(power / count, np.finfo(np.float64).tiny)
    for lag in range(1, min(LAGS, count // 2)):
        product = 0.0
        for k in range(lag, count):
            product += values[k] * values[k - lag]
        share = product / (count - lag) / power
        total += share if lag <= _SHARED else max(share, 0.0)
    return max(total, 0.0)
