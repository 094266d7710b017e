"""Which kind of fault a confirmed one is, from its time profile since the onset."""

import math

import numpy as np

from lpv_core.decision.fault_kinds import BIAS, DRIFT, NOISE, SCALE, STUCK, UNCLASSIFIED
from lpv_core.residual.noise_estimation import noise_level
from lpv_core.residual.sample_buffer import ALLOWANCE, READING, RESIDUAL, SampleBuffer
from lpv_core.support.jit import njit
from lpv_core.support.timestamps import NANOSECONDS

_SETTLED = 0.1
"""Shortest time since the onset for a decision on the time profile [s]."""
_STUCK_SAMPLES, _STILL = 20, 0.2
"""A reading stands still if so many samples stay within that part of its standard deviation."""
_MOVED = 6.0
"""Motion that a reading must show, over its standard deviation, beside errors of the rates; a step
of an encoder whose noise is stated as its standard deviation, step/sqrt(12), is 3.5 of them."""
_TELLING = 10.0
"""Drifts and scale errors show in a change of so many standard deviations of a reading: the
residual of a healthy sensor changes, too; and beyond what stated errors of the rates may add."""
_EXPLAINED = 0.1
"""Part of the change that a scale error may leave unexplained."""
_CLEARLY = 4.0
"""Ratio of residuals at which one time profile fits clearly better than another."""


@njit
def span(values: np.ndarray) -> float:
    """Largest minus smallest of some values."""
    low = high = values[0]
    for k in range(1, len(values)):
        low, high = min(low, values[k]), max(high, values[k])
    return high - low


@njit
def is_stuck(limits: np.record, buffer: SampleBuffer) -> bool:
    """Whether a reading has stood still while the arm moved.

    Parameters
    ----------
    limits : numpy.record
        Of type `lpv_core.decision.sensor_state.SENSOR_LIMITS`.
    buffer : SampleBuffer
        The sensor's past.

    Returns
    -------
    bool
        False without enough motion to tell: an encoder reads the same within a step, and errors of
        the rates add up while it rests.
    """
    # Noise alone moves a healthy reading from sample to sample.
    stamps, values, count = buffer.stamps, buffer.values, buffer.used[0]
    first = count - _STUCK_SAMPLES
    if first < 0 or span(values[first:count, READING]) >= _STILL * limits.noise:
        return False
    row, last = standstill(limits, buffer), count - 1
    moved = (
        values[last, READING]
        - values[last, RESIDUAL]
        - values[row, READING]
        + values[row, RESIDUAL]
    )
    elapsed = (stamps[last] - stamps[row]) / NANOSECONDS
    error = (
        limits.changes.walk * math.sqrt(elapsed) + values[last, ALLOWANCE] - values[row, ALLOWANCE]
    )
    return abs(moved) > _MOVED * limits.noise + error


@njit
def standstill(limits: np.record, buffer: SampleBuffer) -> int:
    """First of the latest rows over which a reading has stood still."""
    values, row = buffer.values, buffer.used[0] - 1
    last = values[row, READING]
    while row > 0 and abs(values[row - 1, READING] - last) < _STILL * limits.noise:
        row -= 1
    return row


@njit
def classify(
    limits: np.record, buffer: SampleBuffer, first: int, onset: int, baseline: float
) -> int:
    """Kind of a fault that still acts.

    Parameters
    ----------
    limits : numpy.record
        Of type `lpv_core.decision.sensor_state.SENSOR_LIMITS`.
    buffer : SampleBuffer
        The sensor's past.
    first : int
        First row since the onset.
    onset : int
        [ns].
    baseline : float
        r before the onset [rad].

    Returns
    -------
    int
        Of `lpv_core.decision.fault_kinds.FaultKind`; ``UNCLASSIFIED`` while it cannot be told.
    """
    stamps, values, end = buffer.stamps, buffer.values, buffer.used[0]
    count = end - first
    if is_stuck(limits, buffer):
        return STUCK
    recent = values[max(first, end - 50) : end]
    if count >= 25 and noise_level(recent, RESIDUAL) > 3.0 * limits.scatter:
        return NOISE
    if count < 10 or (stamps[end - 1] - onset) / NANOSECONDS < _SETTLED:
        return UNCLASSIFIED
    time = (stamps[first:end] - onset) / NANOSECONDS
    return _time_profile(time, values[first:end], baseline, limits.noise)


@njit
def fits_better(
    kind: int, than: int, time: np.ndarray, values: np.ndarray, baseline: float
) -> bool:
    """Whether one time profile of a fault is to replace another one that was found before.

    Parameters
    ----------
    kind, than : int
        What `classify` says now, and what was said.
    time : ndarray, shape (n,)
        Since the onset [s].
    values : ndarray, shape (n, 4)
        Rows of a `SampleBuffer`.
    baseline : float
        r before the onset [rad].

    Returns
    -------
    bool
        A scale error shows late, in motion; it does not turn into a bias by standing still.
    """
    fault = values[:, RESIDUAL] - baseline
    angle = values[:, READING] - fault  # by dead reckoning
    if kind == SCALE:
        return than == BIAS or _CLEARLY * _residual(angle, fault) < _residual(time, fault)
    if kind != BIAS or than != SCALE:
        return False
    return _CLEARLY * _residual(np.ones(len(fault)), fault) < _residual(angle, fault)


@njit
def _time_profile(
    time: np.ndarray, values: np.ndarray, baseline: float, position_noise: float
) -> int:
    """Bias, drift or scale: the model that leaves the smallest residual, simplest first."""
    fault = values[:, RESIDUAL] - baseline
    angle = values[:, READING] - fault
    allowed = values[-1, ALLOWANCE] - values[0, ALLOWANCE]
    floor = len(time) * (position_noise**2 + 0.25 * allowed**2)
    bias = _residual(np.ones(len(time)), fault)
    drift, scale = _residual(time, fault), _residual(angle, fault)
    # Has the arm moved so far that a scale error would have shown itself, also where it is none?
    shown = abs(_weight(angle, fault)) * span(angle)
    if shown > _TELLING * position_noise + allowed and scale < _EXPLAINED * bias and scale < drift:
        return SCALE
    best, left = BIAS, bias
    if drift < left and bias >= drift + 2.0 * floor:
        best, left = DRIFT, drift
    middle = time - _mean(time, 0, len(time))
    growth = _weight(middle, fault) * (time[-1] - time[0])
    if abs(growth) > _TELLING * position_noise + allowed and left > 4.0 * (
        _residual(middle, fault - _mean(fault, 0, len(fault))) + floor
    ):
        # Neither fits alone, a ramp from an offset does: it grows, whatever it started from.
        return DRIFT
    return best


@njit
def _mean(values: np.ndarray, first: int, last: int) -> float:
    # In one fixed order of additions, which NumPy's own does not promise.
    total = 0.0
    for k in range(first, last):
        total += values[k]
    return total / (last - first)


@njit
def step_height(stamps: np.ndarray, values: np.ndarray, row: int) -> float:
    """Height of a step: two levels with one common slope, by least squares.

    The slope is that of the residual's healthy error, which goes on beside the fault.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        Samples before and after the step [ns].
    values : ndarray, shape (n, 4)
        Their rows of a `SampleBuffer`.
    row : int
        First sample after the step, with some on either side.

    Returns
    -------
    float
        [rad].
    """
    time, fault = (stamps - stamps[row]) / NANOSECONDS, values[:, RESIDUAL]
    square = cross = height = middle = 0.0
    for first, last, sign in ((0, row, -1.0), (row, len(time), 1.0)):
        mean_time, mean = _mean(time, first, last), _mean(fault, first, last)
        for k in range(first, last):
            square += (time[k] - mean_time) * (time[k] - mean_time)
            cross += (time[k] - mean_time) * (fault[k] - mean)
        height += sign * mean
        middle += sign * mean_time
    return height - middle * cross / square


@njit
def _weight(basis: np.ndarray, values: np.ndarray) -> float:
    """Multiple of ``basis`` that comes closest to ``values``."""
    power = cross = 0.0
    for k in range(len(basis)):
        power += basis[k] * basis[k]
        cross += basis[k] * values[k]
    return cross / power if power > 0.0 else 0.0


@njit
def _residual(basis: np.ndarray, values: np.ndarray) -> float:
    """Sum of squares that a multiple of ``basis`` leaves of ``values``."""
    weight = _weight(basis, values)
    total = 0.0
    for k in range(len(basis)):
        rest = values[k] - weight * basis[k]
        total += rest * rest
    return total
