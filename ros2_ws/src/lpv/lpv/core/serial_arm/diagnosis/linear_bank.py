"""Evidence for all faults that are linear in their size, compiled: one call an evaluation.

Scores and information of the sensors' columns come from the cumulative sums of the horizon, so that
a window costs the same whatever its length; see `bank` for what they are.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.balance import DRIFT, GAIN, OFFSET, RATE, SCALE, TORQUE
from lpv.core.serial_arm.diagnosis.contact import (
    Contact,
    rough_contact,
    watch_noise,
    weigh_residuals,
)
from lpv.core.serial_arm.diagnosis.estimator import ONSET, Horizon, set_residuals
from lpv.core.serial_arm.diagnosis.information import (
    COUNT,
    Posterior,
    Window,
    slot,
    solve_factorised,
    sum_slot,
    whiten,
)
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place

STARTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 1.8, 2.5)
"""Times ago at which a cause may have begun [s]: every one that comes passes each of them."""
DRIFT_STARTS = (3.5, 5.0, 7.0)
"""The same of drifts and biases of rates, which go on growing, and of torques like them."""
JUMP = 6
"""Seventh column: a rate reading jumps at the start, and the momentum seems to, by M S^-1 e_i."""
COLUMNS = 7
"""Columns of a sensor: drift, scale, rate, gain, offset, torque, jump."""


class Kinds(NamedTuple):
    """Hypotheses: K kinds of faults of n sensors."""

    basis: FloatArray  # (K, 7) columns as sums of the seven
    prior: FloatArray  # (K, n) standard deviations of sizes
    applies: FloatArray  # (K, n) 1 where a sensor can have the fault
    windows: IntArray  # (K,) in which each is compared, the shortest ones
    older: FloatArray  # (K, W) by how much a fault is older than its window [s]


class Rows(NamedTuple):
    """Sums of kinematic rows of W windows."""

    span: FloatArray  # (W,) [s]
    weight: FloatArray  # (W, n) inverse variances, 0 where there are none [1/rad2]
    found: FloatArray  # (W, n) [rad]
    reading: FloatArray  # (n,) now, from the point of linearisation on [rad]


class Evidence(NamedTuple):
    """What the balances say, for W windows."""

    kinds: Kinds
    outside: Contact
    rows: Rows
    to_sensors: FloatArray  # (n, n) S
    interval: float  # of the balances [s]
    unseen: FloatArray  # (n,) largest jump of each reading that may not have been seen [rad]
    noise: FloatArray  # (n,) variance of a balance's change of a derived rate, by noise [rad2/s2]
    lengths: IntArray  # (W,) of the windows [balances]
    starts: FloatArray  # (W,) logarithm of the starts that each stands for
    begin: FloatArray  # (W,) [s]
    pose: FloatArray  # (W, n) readings at the begin, from the point of linearisation on [rad]
    score: FloatArray  # (W, n, 7)
    information: FloatArray  # (W, n, 7, 7) the entries that kinds need
    gain: FloatArray  # (K, n, W) logarithms of Bayes factors
    size: FloatArray  # (K, n, W) of faults
    sigma: FloatArray  # (K, n, W) their standard deviations
    contact: FloatArray  # (W,) log Bayes factor of rough torques in the whole window
    common: FloatArray  # (W, n) score of a scale error that noise in both makes, at most
    columns: FloatArray  # (m, 7 n) scratch
    grams: FloatArray  # (n, 6) scratch


def new_evidence(
    kinds: Kinds, outside: Contact, windows: tuple[IntArray, FloatArray], interval: float,
    to_sensors: FloatArray, unknowns: int,
) -> Evidence:  # fmt: skip
    """Room for the evidence of windows, by their lengths and the starts that each stands for."""
    (lengths, starts), (number, n) = windows, kinds.prior.shape
    count = len(lengths)
    gain, size, sigma = np.zeros((3, number, n, count))
    return Evidence(
        kinds, outside, new_rows(count, n), to_sensors, interval, np.zeros(n), np.zeros(n),
        lengths, np.log(starts), np.zeros(count), np.zeros((count, n)),
        np.zeros((count, n, COLUMNS)), np.zeros((count, n, COLUMNS, COLUMNS)),
        gain, size, sigma, np.zeros(count), np.zeros((count, n)), np.zeros((unknowns, COLUMNS * n)),
        np.zeros((n, 6)))  # fmt: skip


def new_rows(windows: int, joints: int) -> Rows:
    """Room for the sums of kinematic rows."""
    shape = windows, joints
    return Rows(np.zeros(windows), np.zeros(shape), np.zeros(shape), np.zeros(joints))


@njit_in_place
def gather(evidence: Evidence, horizon: Horizon, count: int) -> tuple[float, float]:
    """Write the evidence of the first ``count`` windows, which the horizon must hold.

    Residuals under the null hypothesis are written.  Returns the logarithms of the sums of Bayes
    factors over all kinds and starts, and over those of rough torques.
    """
    window, null, outside = horizon.window, horizon.null, evidence.outside
    epoch, n = horizon.balance.epoch[0], null.noise.shape[0]
    longest = evidence.lengths[count - 1]
    set_residuals(window, null, longest + 1)
    evidence.grams[:] = 0.0
    summed = 0
    for w in range(count):
        length = evidence.lengths[w]
        for back in range(summed, max(length - ONSET, 0)):
            _add_grams(evidence.grams, window, null.weights, back)
            summed = back + 1
        first = slot(window, length - 1)
        evidence.begin[w] = window.times[first] - evidence.interval
        map_vector(evidence.to_sensors, window.poses[first], evidence.pose[w])
        _sensor_columns(evidence, window, null, w)
        _jump_columns(evidence, window, null, w)
        whiten(null.factor, evidence.columns)
        _eliminate(evidence, w)
        _add_rows(evidence, window.times[slot(window, 0)] - epoch, w)
    watch_noise(outside, null)
    weigh_residuals(window, null, longest + 1)
    rough_contact(outside, null, 0, longest)
    every, pushed = (-np.inf, 0.0), (-np.inf, 0.0)
    for w in range(count):
        evidence.contact[w] = outside.rough[evidence.lengths[w] - 1]
        pushed = add_logarithm(pushed, evidence.contact[w] + evidence.starts[w])
        for i in range(n):
            for k in range(evidence.gain.shape[0]):
                _compare(evidence, (k, i, w), epoch)
                every = add_logarithm(every, evidence.gain[k, i, w] + evidence.starts[w])
    return every[0] + np.log(every[1]), pushed[0] + np.log(pushed[1])


@njit_in_place
def add_logarithm(total: tuple[float, float], logarithm: float) -> tuple[float, float]:
    """Add to a sum what has this logarithm; the largest one so far, and the sum over its number.

    That takes one exponential, where `numpy.logaddexp` takes a logarithm as well.
    """
    largest, rest = total
    if logarithm > largest:
        return logarithm, rest * np.exp(largest - logarithm) + 1.0
    if logarithm == -np.inf:
        return total
    return largest, rest + np.exp(logarithm - largest)


@njit_in_place
def explain(evidence: Evidence, horizon: Horizon, count: int) -> None:
    """Write what the likeliest fault explains of the residuals of the horizon, after `gather`.

    Faults that kinematic rows show are left out: these have a noise of their own.
    """
    window, null = horizon.window, horizon.null
    window.explained[:] = 0.0
    best, at = 0.0, (0, 0, 0)
    for k, i, w in np.ndindex(evidence.gain[:, :, :count].shape):
        gain = evidence.gain[k, i, w] + evidence.starts[w]
        if gain > best and evidence.rows.weight[w, i] == 0.0:
            best, at = gain, (k, i, w)
    if best == 0.0:
        return
    k, i, w = at
    n, m, moved = null.noise.shape[0], null.mean.shape[0], window.along
    first, basis = window.rows.shape[2] - m, evidence.kinds.basis[k]
    zero = _zero(evidence, at, horizon.balance.epoch[0])
    moved[:] = 0.0
    for back in range(evidence.lengths[w] - ONSET):
        here = slot(window, back)
        for j in range(n):
            row = window.rows[here, j]
            column = -zero * row[1 + OFFSET * n + i]
            for g in range(JUMP):
                column += basis[g] * row[1 + g * n + i]
            window.explained[here, j] = evidence.size[k, i, w] * column
            for a in range(m):
                moved[a] -= row[first + a] * null.weights[here, j] * window.explained[here, j]
    # The estimate of the arm's unknowns would be another one.
    solve_factorised(null.factor, moved)
    for back in range(window.counters[COUNT]):
        here = slot(window, back)
        for j in range(n):
            for a in range(m):
                window.explained[here, j] += window.rows[here, j, first + a] * moved[a]


@njit_in_place
def _zero(evidence: Evidence, place: tuple[int, int, int], epoch: float) -> float:
    """What columns of drifts and scale errors have where these begin, in offsets."""
    (k, i, w), kinds = place, evidence.kinds
    basis, since = kinds.basis[k], evidence.begin[w] - kinds.older[k, w] - epoch
    return float(since * basis[DRIFT] + evidence.pose[w, i] * basis[SCALE])


@njit_in_place
def _add_grams(grams: FloatArray, window: Window, weights: FloatArray, back: int) -> None:
    """Add a balance's products of the columns that no cumulative sums are kept of."""
    at, n = slot(window, back), grams.shape[0]
    for i in range(n):
        row, weight = window.rows[at, i], weights[at, i]
        for j in range(n):
            drift, scale = row[1 + DRIFT * n + j], row[1 + SCALE * n + j]
            rate, gain = row[1 + RATE * n + j], row[1 + GAIN * n + j]
            grams[j, 0] += weight * drift * drift
            grams[j, 1] += weight * scale * scale
            grams[j, 2] += weight * rate * rate
            grams[j, 3] += weight * gain * gain
            grams[j, 4] += weight * drift * rate
            grams[j, 5] += weight * window.momenta[at, i, j] * window.momenta[at, i, j]


@njit_in_place
def _sensor_columns(evidence: Evidence, window: Window, null: Posterior, w: int) -> None:
    """Score, information and cross products of the first six columns, from cumulative sums.

    A scale error moves the momentum by the rate, whose noise is in the residual as well: of a joint
    that rests it is all there is, and would be explained by a reading that is too large.
    """
    n, m = evidence.grams.shape[0], null.mean.shape[0]
    last = max(evidence.lengths[w] - ONSET, 0)
    sums = null.sums
    new, old = sums[sum_slot(window, 0)], sums[sum_slot(window, last)]
    width, cross = JUMP * n, evidence.columns
    score, information = evidence.score[w], evidence.information[w]
    # Columns of a row: the constant part, six of each sensor; the last two are unknowns, too.
    for a in range(m):
        for c in range(width):
            cross[a, c] = new[1 + a, 1 + c] - old[1 + a, 1 + c]
    for g in range(JUMP):
        for i in range(n):
            c = g * n + i
            total = new[0, 1 + c] - old[0, 1 + c]
            for a in range(m):
                total += null.mean[a] * cross[a, c]
            score[i, g] = -total
    for i in range(n):
        own = information[i]
        own[:] = 0.0
        for g in range(JUMP):
            own[g, OFFSET] = cross[i, g * n + i]
            own[g, TORQUE] = cross[n + i, g * n + i]
            own[OFFSET, g], own[TORQUE, g] = own[g, OFFSET], own[g, TORQUE]
        for g in range(OFFSET):
            own[g, g] = evidence.grams[i, g]
        own[DRIFT, RATE] = own[RATE, DRIFT] = evidence.grams[i, 4]
        evidence.common[w, i] = evidence.noise[i] * evidence.grams[i, 5]


@njit_in_place
def _jump_columns(evidence: Evidence, window: Window, null: Posterior, w: int) -> None:
    """Score, information and cross products of the seventh column.

    A jump inside an interval shows in the two balances that hold it: their sum has all of it.  Of
    the last window, the second one is still to come.
    """
    n, m, length = evidence.grams.shape[0], null.mean.shape[0], evidence.lengths[w]
    first = window.rows.shape[2] - m
    at = JUMP * n
    for j in range(n):
        evidence.score[w, j, JUMP] = 0.0
        evidence.columns[:, at + j] = 0.0
    if length < ONSET:
        return
    older, newer = slot(window, length - 1), slot(window, length - ONSET)
    mass, weights = window.momenta[older], null.weights
    for i in range(n):
        # Something that acted from outside may have taken all weight.
        both = weights[older, i] + weights[newer, i]
        weight = weights[older, i] * weights[newer, i] / both if both > 0.0 else 0.0
        left = null.residual[length - 1, i] + null.residual[length - ONSET, i]
        for j in range(n):
            # Without the error of its rate, the momentum is less by M S^-1 e_j.
            share = -weight * mass[i, j]
            evidence.score[w, j, JUMP] -= share * left
            evidence.information[w, j, JUMP, JUMP] -= share * mass[i, j]
            for a in range(m):
                known = window.rows[older, i, first + a] + window.rows[newer, i, first + a]
                evidence.columns[a, at + j] += share * known


@njit_in_place
def _eliminate(evidence: Evidence, w: int) -> None:
    """Take off the information what the arm's unknowns could explain as well."""
    m, n = evidence.columns.shape[0], evidence.grams.shape[0]
    for i in range(n):
        own = evidence.information[w, i]
        for g in range(COLUMNS):
            for h in range(g, COLUMNS):
                total = 0.0
                for a in range(m):
                    total += evidence.columns[a, g * n + i] * evidence.columns[a, h * n + i]
                own[g, h] -= total
                own[h, g] = own[g, h]


@njit_in_place
def _add_rows(evidence: Evidence, elapsed: float, w: int) -> None:
    """Add what kinematic rows say; time since the epoch of drifts."""
    rows = evidence.rows
    for i in range(rows.reading.shape[0]):
        weight = rows.weight[w, i]
        if weight == 0.0:
            continue
        score, information = evidence.score[w, i], evidence.information[w, i]
        column = (elapsed, rows.reading[i], -rows.span[w], 0.0, 1.0)
        for g in range(5):
            score[g] += weight * rows.found[w, i] * column[g]
            for h in range(5):
                information[g, h] += weight * column[g] * column[h]


@njit_in_place
def _compare(evidence: Evidence, place: tuple[int, int, int], epoch: float) -> None:
    """Logarithm of a Bayes factor, with size and standard deviation.

    Columns of drifts and scale errors are zero where these begin.
    """
    (k, i, w), kinds, unseen = place, evidence.kinds, evidence.unseen[place[1]]
    evidence.gain[k, i, w] = -np.inf
    if kinds.applies[k, i] == 0.0 or w >= kinds.windows[k]:
        return
    basis, score, information = kinds.basis[k], evidence.score[w, i], evidence.information[w, i]
    zero = _zero(evidence, place, epoch)
    z, own, across = -zero * score[OFFSET], 0.0, -zero * information[OFFSET, OFFSET]
    for g in range(COLUMNS):
        if basis[g] == 0.0:
            continue
        z += basis[g] * score[g]
        across += basis[g] * information[OFFSET, g]
        own -= basis[g] * zero * information[g, OFFSET]
        for h in range(COLUMNS):
            if basis[h] != 0.0:
                own += basis[g] * basis[h] * information[g, h]
    own -= zero * across
    if basis[SCALE] != 0.0:
        z -= min(max(z, 0.0), evidence.common[w, i])
    prior = kinds.prior[k, i]
    # A larger slip, or scale error, would have shown as a jump, when it came: few are as small.
    largest = np.inf
    if basis[OFFSET] != 0.0:
        largest = unseen
    if basis[SCALE] != 0.0:
        largest = unseen / max(abs(evidence.pose[w, i]), 1e-6)
    share = min(largest / prior, 1.0)
    prior *= share
    first, right = max(prior * prior * own, 0.0) + 1.0, prior * z
    mean, spread = right / first, 1.0 / np.sqrt(first)
    gain = 0.5 * (right * mean - np.log(first)) + np.log(share)
    if np.isfinite(gain):
        evidence.gain[k, i, w] = gain
        evidence.size[k, i, w], evidence.sigma[k, i, w] = prior * mean, prior * spread
