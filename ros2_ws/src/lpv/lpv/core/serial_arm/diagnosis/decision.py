"""What is computed at every decision, compiled; `monitor` decides."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.balance import OFFSET
from lpv.core.serial_arm.diagnosis.estimator import Posterior
from lpv.core.serial_arm.diagnosis.information import Window, slot
from lpv.core.serial_arm.diagnosis.sampling import Sampler
from lpv.core.support.jit import njit_in_place


@njit_in_place
def reading_noise(sampler: Sampler, i: int) -> float:
    """Variance of a noisy reading [rad2]."""
    # e is made of two readings, of four where the rates are derived from them.
    return float(sampler.noise[1, i] / (3.5 if sampler.derived[i] == 1.0 else 2.0))


@njit_in_place
def add_noise(
    window: Window,
    null: Posterior,
    sampler: Sampler,
    momenta: FloatArray,
    interval: tuple[float, int],
) -> bool:
    """Balances of readings that are noisy, or rounded, say less than others.

    Parameters
    ----------
    window : Window
        The variance of its last balance is raised.
    null : Posterior
        With the usual size of what is left of a balance.
    sampler : Sampler
        What is known of the readings.
    momenta : ndarray, shape (n, n)
        By unit rates of the readings, at that balance.
    interval : tuple
        Its length [s], and the samples in it.

    Returns
    -------
    bool
        Whether the last balance says less.
    """
    n, at, less = sampler.scale.shape[0], slot(window, 0), False
    for i in range(n):
        rounded, noisy = 0.0, 0.0
        for j in range(n):
            # Means of derived rates hold the errors of the readings where two intervals begin and
            # end.
            rates = 6.0 * sampler.derived[j] * (momenta[i, j] / interval[0]) ** 2
            if np.isfinite(sampler.grain[j]):
                rounded += rates * sampler.grain[j] * sampler.grain[j] / 12.0
            if sampler.noisy[j] == 1:
                mean = window.rows[at, i, 1 + OFFSET * n + j] ** 2 / interval[1]
                noisy += reading_noise(sampler, j) * (mean + rates)
        # As learned, most of what is left may be rounding.
        extra = max(rounded - null.noise[i] * null.noise[i], 0.0) + noisy
        window.extra[at, i] += extra
        less = less or extra > 0.0
    return less


@njit_in_place
def find_levels(
    level: Posterior,
    prior: FloatArray,
    known: FloatArray,
    certified: tuple[FloatArray, FloatArray],
    scales: FloatArray,
    limits: tuple[float, float, float, float, float, float, float],
    beyond: FloatArray,
) -> bool:
    """Which offsets are beyond what a healthy arm shows.

    Parameters
    ----------
    level : Posterior
        The estimate of the offsets.
    prior : ndarray, shape (m,)
        Standard deviations of which nothing is known; the offsets' come first [rad].
    known : ndarray, shape (n,)
        For how long each offset has been diagnosable; changed [s].
    certified : tuple of ndarray, shape (n,)
        Offsets by an observer that certifies them, and the bounds of a healthy arm [rad].
    scales : ndarray, shape (n,)
        Of thresholds.
    limits : tuple
        Standard deviation that says nothing, smallest level [rad]; standard deviations in a bound;
        length of an interval, of the horizon [s]; log Bayes factors needed within the first
        horizon, and later.
    beyond : ndarray, shape (2, n)
        Written: log Bayes factors of those that are beyond, by the horizon; 1 where the other
        observer excludes a healthy arm, and the horizon does not contradict; else 0.

    Returns
    -------
    bool
        Whether there is any.
    """
    widest, smallest, sigmas, interval, horizon, at_start, later = limits
    some = False
    for i in range(known.shape[0]):
        offset, sigma, least = level.mean[i], level.sigma[i], smallest * scales[i]
        beyond[0, i], beyond[1, i] = 0.0, 0.0
        if sigma < widest * scales[i]:
            known[i] += interval
            ratio = offset / sigma
            gain = 0.5 * ratio * ratio - np.log(prior[i] / sigma)
            # An offset may have been there before the first sample; later ones come at any time,
            # and every horizon is another chance of a false alarm.
            if gain > (at_start if known[i] < horizon else later) and abs(offset) > least:
                beyond[0, i], some = gain, True
        fault, bound = certified[0][i], certified[1][i]
        if abs(fault) > max(bound, least) and abs(offset - fault) < bound + sigmas * sigma:
            beyond[1, i], some = 1.0, True
    return some
