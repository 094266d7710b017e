"""Whether it may be a rate sensor that moves a residual.

A residual that starts to move at some speed means that either the position sensor drifts, or that
its rate sensor is wrong by as much.  A rate that goes wrong suddenly shows in the observer's rate
innovation: by its whole size at first, then less as exp(-mu t), until the observer has followed.
A matched filter looks for that around the onset.  Errors of torques and model change the innovation
slowly, or within what the arm file tolerates.
"""

import math

from lpv_core.consistency import tolerated_rates
from lpv_core.history import INNOVATION
from lpv_core.jit import njit
from lpv_core.records import new_record, record_type

_SIGMAS = 4.0
_LENGTH = 3.0
"""Length of the filter, over 1/mu."""
_SHORTEST = 5

INNOCENT, UNKNOWN, GUILTY = range(3)
"""Verdicts on a rate sensor."""

RATE_TEST = record_type(('used', '?'), ('fall', 'f8'), ('length', 'i8'), ('noise', 'f8'),
                        ('smallest', 'f8'))
"""Whether the test can be made; decay of the innovation in one sample; samples of the filter;
standard deviation of a rate; slower changes stay doubtful [rad/s]."""


def rate_test(arm, gains):
    """Constants of the test for one arm.

    Parameters
    ----------
    arm : ArmParameters
        Its noise, inertia and torque tolerance.
    gains : Gains
        The test can only be made for method ``exact``.

    Returns
    -------
    numpy.record
        Of type `RATE_TEST`.
    """
    if gains.observer.method != 'exact':
        return new_record(RATE_TEST)
    share = max(gains.observer.mu) * arm.sample_time
    return new_record(RATE_TEST, used=True, fall=math.exp(-share),
                      length=math.ceil(_LENGTH / share), noise=arm.velocity_noise,
                      smallest=2.0 * tolerated_rates(arm, gains).max())


@njit
def rate_verdict(c, values, end, first, last, speed):
    """Whether a rate went wrong suddenly when a residual began to move.

    Parameters
    ----------
    c : numpy.record
        `rate_test`.
    values : ndarray
        The sensor's past, see `lpv_core.history`.
    end : int
        Rows in use.
    first, last : int
        Rows between which the residual began to move.
    speed : float
        Of the residual [rad/s].

    Returns
    -------
    int
        `INNOCENT` if the error of the rate would have shown and did not, `GUILTY` if it is there,
        `UNKNOWN` where noise or tolerated torques could hide it.
    """
    if not c.used or abs(speed) <= c.smallest or first < c.length or end - last < _SHORTEST:
        return UNKNOWN
    verdict = INNOCENT
    for row in range(first, last + 1):
        error, deviation = _match(c, values, row, min(c.length, end - row))
        share = error / speed
        if share > 0.5 and abs(error) > _SIGMAS * deviation:
            return GUILTY
        if abs(share) > 0.5 or abs(speed) < 2.0 * _SIGMAS * deviation:
            verdict = UNKNOWN
    return verdict


@njit
def _match(c, values, row, count):
    """Sudden error of the rate at a row that fits the innovation best, and its deviation."""
    before = 0.0
    for k in range(row - c.length, row):
        before += values[k, INNOVATION]
    before /= c.length
    weight, power, cross = 1.0, 0.0, 0.0
    for k in range(row, row + count):
        power += weight * weight
        cross += weight * (values[k, INNOVATION] - before)
        weight *= c.fall
    return cross / power, c.noise * math.sqrt(1.0 / power + 1.0 / c.length)
