"""How large a confirmed fault is, how well that is known, and what to remove from the reading."""

import math

from lpv_core.change_origin import AROUND
from lpv_core.change_test import least_change
from lpv_core.fault_kind import BIAS, NOISE, SCALE, SPIKE, step_of
from lpv_core.history import first_since
from lpv_core.jit import njit
from lpv_core.observer import NANOSECONDS
from lpv_core.scale_filter import follow_scale
from lpv_core.sensor_record import IMPOSSIBLE, MEASURED

_APART, _REST_SHARE = 2.0, 0.02
"""A residual that differs from the height of its step by so much in the mean, over the noise of a
reading, is no bias; share of a sample in that mean."""


@njit
def removable(c, s):
    """What is to be removed from the reading of a sensor with an alarm.

    A step whose height is known leaves a reading as good as that of a healthy sensor; of noise, its
    mean remains; spikes go one by one; else all that the residual has changed, so that the loop
    closes on dead reckoning from before the fault.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.

    Returns
    -------
    float
        [rad].
    """
    if s.kind == SPIKE:
        away = s.amount - s.average
        return away if abs(away) > least_change(c.changes) else 0.0
    if s.kind == NOISE:
        return s.amount - s.average
    if s.kind == SCALE and s.filter.used:
        return s.amount - s.filter.astray
    return s.height if s.kind == BIAS and s.measured == MEASURED else s.amount


@njit
def size_error(c, s):
    """How far ``amount`` may be from the fault, if that was seen as a change.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.

    Returns
    -------
    float
        Noise, and what errors of the rates can have added up to since before the fault [rad].
    """
    return c.changes.noise[0] + growth(c, s)


@njit
def growth(c, s):
    """What errors of the rates can have added to the residual since before the fault [rad].

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.

    Returns
    -------
    float
        Noise, bias and scale, as stated.
    """
    elapsed = max(0.0, (s.sample.stamp - s.onset) / NANOSECONDS)
    return c.changes.walk * math.sqrt(elapsed) + s.sample.allowance - s.allowance_before


@njit
def measure_step(s, stamps, values):
    """Measure the height of a step from the samples around it.

    Parameters
    ----------
    s, stamps, values
        See `lpv_core.sensor_record`.
    """
    row = first_since(stamps, s.end, s.onset)
    first = max(row - AROUND, 0, s.end - len(stamps) // 2)
    if row - first < AROUND // 2 or s.end - row < AROUND // 2:
        s.measured = IMPOSSIBLE
        return
    last = min(row + AROUND, s.end)
    s.height = step_of(stamps[first:last], values[first:last], row - first)
    s.measured, s.rest = MEASURED, 0.0


@njit
def follow_fault(c, s):
    """Follow the mean of noise; drop the height of a step when r leaves it: the fault is over, or
    another one has come.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.
    """
    away = abs(s.amount - s.average) > least_change(c.changes)
    if s.kind == SPIKE and away:
        s.spikes[0] = s.sample.stamp
    elif s.kind == NOISE or s.kind == SPIKE:
        # The gain of a Kalman filter at rest: what the rates add in one sample over the scatter.
        moved = c.step + s.sample.allowance - s.last_allowance
        share = moved / max(s.scatter, c.noise, moved)
        s.average += share * (s.amount - s.average)
    elif s.kind == SCALE and s.filter.used:
        follow_scale(c, s)
    if s.measured == MEASURED:
        rest = s.amount - s.height
        s.rest += _REST_SHARE * (rest - s.rest)
        if (abs(rest) > least_change(c.changes)
                or abs(s.rest) > _APART * c.noise + 0.5 * growth(c, s)):
            s.measured = IMPOSSIBLE
