"""Least squares over sliding windows of balances, from cumulative sums of their products.

Every balance adds A^T W A of its rows A = [c, J]; the sum over the last L balances is a difference
of two cumulative sums, so that any window costs the same.  Of A^T W A only what estimates and
hypotheses need is kept: the rows of the constant part and of the unknowns.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.support.jit import njit_in_place

ROBUST = 3.0
"""Residuals beyond so many standard deviations are outliers: one in 370 of normal ones."""
NEXT, COUNT = range(2)
"""Entries of `Window.counters`: balances that ever joined the window, balances in it."""
_NEVER = 700.0
"""Logarithm of odds beyond which a probability is 0, or 1."""


def probability(odds: float) -> float:
    """Probability of what has the logarithm of its odds."""
    return 1.0 / (1.0 + math.exp(min(-odds, _NEVER)))


class Window(NamedTuple):
    """The last balances of an arm; rings.

    Columns of a row are the constant part, h columns of faults, m columns of unknowns.
    """

    rows: FloatArray  # (capacity, n, 1 + h + m) of each balance
    times: FloatArray  # (capacity,) end of each [s]
    trust: FloatArray  # (capacity,) factor of weights, small where something acted from outside
    poses: FloatArray  # (capacity, n) positions in its middle [rad]
    # (capacity, n, n) L of rows L r in place of r: noise of one reading is in several joints' r
    mixing: FloatArray
    momenta: FloatArray  # (capacity, n, n) those by unit rates of the readings there, L M S^-1
    relative: FloatArray  # (capacity, n) predicted size of a row's noise over what is usual
    rest: FloatArray  # (capacity, n) 1 where the joint rests or reverses
    rested: IntArray  # (n,) balances for which the joint has rested so far
    # (capacity, n) variance by noise, and by errors of readings that are followed [N2 m2 s2]
    extra: FloatArray
    late: FloatArray  # (capacity, n) variance by stamps that were wrong there [N2 m2 s2]
    loads: FloatArray  # (L, m) unit changes of the load, by the unknowns
    changed: FloatArray  # (capacity,) 1 where the load was another one until this balance
    carried: FloatArray  # (capacity, L) change of the load since, as estimated and taken out
    explained: FloatArray  # (capacity, n) what the likeliest fault adds to residuals [N m s]
    along: FloatArray  # (m,) scratch
    counters: IntArray  # (2,)


class Posterior(NamedTuple):
    """Estimate of m offsets and parameters of n joints from all balances of the horizon."""

    mean: FloatArray  # (m,) offsets [rad], then parameters, in the order of the columns of balances
    factor: FloatArray  # U of the information matrix U^T U, shape (m, m)
    sigma: FloatArray  # standard deviations of the offsets, shape (n,) [rad]
    least: FloatArray  # information of the prior, shape (m,)
    noise: FloatArray  # (n,) usual size of what is left of a balance [N m s]
    expected: FloatArray  # (n,) the same before any was seen [N m s]
    inflation: FloatArray  # (n,) factor of its variance, since it is correlated in time
    # (n,) as `noise` where a joint rests or reverses, over `noise`: friction of any size
    rest: FloatArray
    expected_rest: FloatArray  # (n,) the same before any was seen
    dry: FloatArray  # (n,) usual size of friction in a long rest [N m s]
    systematic: FloatArray  # (n,) smallest variance, with correlation in time [N2 m2 s2]
    residual: FloatArray  # what the estimate leaves, newest first, shape (capacity, n) [N m s]
    # (capacity, n) rings: inverse variance of each balance, trust included, and for how many
    # balances a joint's friction there stays as it is
    weights: FloatArray
    lasting: FloatArray
    # (capacity + 1, 1 + m, 1 + h + m) ring: sum of A^T W A before each balance, rows of the
    # constant part and of the unknowns; with columns of faults where they are wanted
    sums: FloatArray
    # (1 + m, 1 + h + m) of balances that have left; its columns of faults mean nothing
    past: FloatArray
    recalled: FloatArray  # (1 + m, m) what is remembered of the arm
    total: FloatArray  # (1 + m, m) scratch
    inverse: FloatArray  # (m, n) scratch
    sizes: FloatArray  # (capacity,) scratch


def new_window(joints: int, faults: int, unknowns: int, capacity: int, loads: FloatArray) -> Window:
    """Empty window of balances of n joints, with h columns of faults and m of unknowns.

    ``loads`` are as in `Window`.
    """
    each = capacity, joints
    rest, extra, late, explained = np.zeros((4, *each))
    mixing, momenta = np.zeros((2, *each, joints))
    return Window(
        np.zeros((*each, 1 + faults + unknowns)), np.zeros(capacity), np.ones(capacity),
        np.zeros(each), mixing, momenta, np.ones(each), rest,
        np.zeros(joints, np.int64), extra, late,
        np.ascontiguousarray(loads), np.zeros(capacity), np.zeros((capacity, len(loads))),
        explained, np.zeros(unknowns), np.zeros(2, np.int64))  # fmt: skip


@njit_in_place
def slot(window: Window, back: int) -> int:
    """Index in the ring of the balance ``back`` before the last one."""
    return (window.counters[NEXT] - 1 - back) % window.times.shape[0]


@njit_in_place
def sum_slot(window: Window, last: int) -> int:
    """Index in the ring of the sum before the last balances."""
    return (window.counters[NEXT] - last) % (window.times.shape[0] + 1)


@njit_in_place
def join(
    window: Window, every: tuple[Posterior, ...], time: float, rows: FloatArray, past: float
) -> None:
    """Append a balance; `add_products` adds its products.

    ``rows``, shape (n, 1 + h + m), hold the constant part and derivatives.  Where a balance leaves
    the window, what was remembered is multiplied by abs(``past``), and the balance is remembered,
    too, unless ``past`` is negative.
    """
    capacity = window.times.shape[0]
    if window.counters[COUNT] == capacity:
        for null in every:
            _remember_oldest(window, null, past)
        window.counters[COUNT] -= 1
    window.counters[NEXT] += 1
    window.counters[COUNT] += 1
    at = slot(window, 0)
    for i in range(rows.shape[0]):
        for c in range(rows.shape[1]):
            window.rows[at, i, c] = rows[i, c]
    window.times[at] = time
    window.trust[at] = 1.0
    window.extra[at] = 0.0
    window.late[at] = 0.0
    window.changed[at] = 0.0
    window.carried[at] = 0.0
    window.explained[at] = 0.0
    for null in every:
        null.lasting[at] = 0.0


@njit_in_place
def _remember_oldest(window: Window, null: Posterior, past: float) -> None:
    """Let a balance leave the sums of a full window, as of `join`."""
    capacity = window.times.shape[0]
    if window.changed[slot(window, capacity - 1)] == 1.0:
        forget_load(window, null.past)
    gone = null.sums[sum_slot(window, capacity)]
    kept = null.sums[sum_slot(window, capacity - 1)]
    for a in range(gone.shape[0]):
        for b in range(gone.shape[1]):
            null.past[a, b] *= abs(past)
            if past > 0.0:
                null.past[a, b] = null.past[a, b] + kept[a, b] - gone[a, b]


@njit_in_place
def forget_load(window: Window, total: FloatArray) -> None:
    """Let a total of products say nothing of the load: it has changed since, nobody knows how.

    A change of unit covariance along each g of ``loads`` is added to the unknowns: the information
    K becomes K - K g g^T K / (1 + g^T K g).  ``total`` is as `Posterior.past`, or has its columns
    of the unknowns alone.
    """
    m, along = window.along.shape[0], window.along
    first = total.shape[1] - m
    for load in window.loads:
        size, right = 1.0, 0.0
        for a in range(m):
            along[a] = 0.0
            for b in range(m):
                along[a] += total[1 + a, first + b] * load[b]
            size += load[a] * along[a]
            right += total[0, first + a] * load[a]
        for b in range(m):
            total[0, first + b] -= right * along[b] / size
            for a in range(m):
                total[1 + a, first + b] -= along[a] * along[b] / size
    if first > 0:
        for a in range(m):
            total[1 + a, 0] = total[0, first + a]


@njit_in_place
def add_balances(window: Window, null: Posterior, total: FloatArray) -> None:
    """Add all balances to a total as of `forget_load`, of unknowns with the load of now."""
    oldest = window.counters[COUNT]
    for back in range(oldest - 1, -1, -1):
        if window.changed[slot(window, back)] == 1.0:
            _add_sums(window, null, total, back + 1, oldest)
            forget_load(window, total)
            oldest = back + 1
    _add_sums(window, null, total, 0, oldest)


@njit_in_place
def _add_sums(window: Window, null: Posterior, total: FloatArray, newest: int, oldest: int) -> None:
    """Add the last ``oldest`` balances but for the last ``newest`` ones."""
    new, old = null.sums[sum_slot(window, newest)], null.sums[sum_slot(window, oldest)]
    first = new.shape[1] - total.shape[1]
    for a in range(total.shape[0]):
        for b in range(total.shape[1]):
            total[a, b] += new[a, first + b] - old[a, first + b]


@njit_in_place
def add_products(window: Window, null: Posterior, back: int) -> None:
    """Write the sum behind a balance, from the sum before it, by its weights.

    ``back`` balances come after it.
    """
    at, old, new = slot(window, back), sum_slot(window, back + 1), sum_slot(window, back)
    unknowns, columns = null.past.shape
    first = window.rows.shape[2] - columns  # columns of faults that the sums leave out
    for a in range(unknowns):
        for b in range(columns):
            null.sums[new, a, b] = null.sums[old, a, b]
    for i in range(window.rows.shape[1]):
        row, own, weight = window.rows[at, i], window.rows[at, i, first:], null.weights[at, i]
        for a in range(unknowns):
            entry = row[0] if a == 0 else own[columns - unknowns + a]
            factor, into = weight * entry, null.sums[new, a]
            if factor != 0.0:
                into[0] += factor * row[0]
                for b in range(1, columns):
                    into[b] += factor * own[b]


@njit_in_place
def move_drifts(
    window: Window, null: Posterior, drift: int, offset: int, joints: int, shift: float
) -> None:
    """Let drifts count from a moment that is later by ``shift``, and sums from the oldest balance.

    A drift's column is t - epoch times the offset's: both stay small over days.  ``drift`` and
    ``offset`` are the first columns of either; offsets are the first unknowns.
    """
    last = window.counters[COUNT]
    oldest = sum_slot(window, last)
    for back in range(last + 1):  # the oldest one last: it becomes zero
        one = null.sums[sum_slot(window, back)]
        for a in range(one.shape[0]):
            for b in range(one.shape[1]):
                one[a, b] -= null.sums[oldest, a, b]
        _shift_drifts(one, drift, offset, joints, shift)
    for at in range(window.rows.shape[0]):
        _shift_drifts(window.rows[at], drift, offset, joints, shift)


@njit_in_place
def _shift_drifts(rows: FloatArray, drift: int, offset: int, joints: int, shift: float) -> None:
    for row in rows:
        for j in range(joints):
            row[drift + j] -= shift * row[offset + j]


def recent(window: Window, last: int) -> IntArray:
    """Places of the last balances in the ring, newest first."""
    return np.asarray((window.counters[NEXT] - 1 - np.arange(last)) % len(window.times))


@njit_in_place
def factorise(matrix: FloatArray, least: FloatArray) -> None:
    """Factor U of A = U^T U, in place of the upper triangle of the positive definite A.

    ``least``, shape (m,), are the smallest pivots, against rounding errors.
    """
    m = least.shape[0]
    for k in range(m):
        pivot = np.sqrt(max(matrix[k, k], least[k]))
        row = matrix[k]
        for j in range(k + 1, m):
            row[j] /= pivot
        row[k] = pivot
        for i in range(k + 1, m):
            factor, other = row[i], matrix[i]
            for j in range(i, m):
                other[j] -= factor * row[j]


@njit_in_place
def solve_factorised(factor: FloatArray, right: FloatArray) -> None:
    """Solve U^T U x = b in place of b, with U from `factorise`."""
    m = right.shape[0]
    whiten(factor, right.reshape((m, 1)))
    for k in range(m - 1, -1, -1):
        for i in range(k + 1, m):
            right[k] -= factor[k, i] * right[i]
        right[k] /= factor[k, k]


@njit_in_place
def whiten(factor: FloatArray, columns: FloatArray) -> None:
    """Solve U^T Y = B in place of B."""
    m, count = columns.shape
    for k in range(m):
        own = columns[k]
        for c in range(count):
            own[c] /= factor[k, k]
        for i in range(k + 1, m):
            share, other = factor[k, i], columns[i]
            for c in range(count):
                other[c] -= share * own[c]


@njit_in_place
def select(values: FloatArray, place: int) -> float:
    """Value at a place of the sorted ones, which are ordered as far as needed (Hoare's method).

    What NumPy offers takes seconds to compile.
    """
    first, last = 0, values.shape[0] - 1
    while first < last:
        pivot, j, k = values[place], first, last
        while j <= k:
            while values[j] < pivot:
                j += 1
            while values[k] > pivot:
                k -= 1
            if j <= k:
                values[j], values[k] = values[k], values[j]
                j, k = j + 1, k - 1
        if k < place:
            first = j
        if place < j:
            last = k
    return float(values[place])


@njit_in_place
def median(values: FloatArray) -> float:
    """Median of an odd number of values, few of them; 0 where some are no numbers."""
    for one in values:
        smaller, equal = 0, 0
        for other in values:
            smaller += other < one
            equal += other == one
        if smaller <= len(values) // 2 < smaller + equal:
            return float(one)
    return 0.0


@njit_in_place
def median_distance(values: FloatArray, centre: float) -> float:
    """Median distance of values, as of `median`, from one of them."""
    for one in values:
        distance, smaller, equal = abs(one - centre), 0, 0
        for other in values:
            smaller += abs(other - centre) < distance
            equal += abs(other - centre) == distance
        if smaller <= len(values) // 2 < smaller + equal:
            return float(distance)
    return 0.0
