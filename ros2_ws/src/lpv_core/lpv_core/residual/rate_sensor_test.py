"""Whether it may be a rate sensor that moves a residual.

A residual that starts to move at some speed means that either the position sensor drifts, or that
its rate sensor is wrong by as much.  A rate that goes wrong shows in the observer's rate
innovation: its changes at once, and then less as exp(-mu t), until the observer has followed.  What
went wrong gradually shows the less the longer it took, down to nothing.

So how long may the rate have taken, by the residual?  Ramps r_0 + b q(t - t_0; T) are fitted to it,
with q' rising from 0 to 1 within T.  For every one that fits, a matched filter looks for what the
rate sensor would have left in the innovation.  The rate is ruled out if that would have shown, for
all of them, and is not there.  Errors of torques and model change the innovation slowly, or within
what the arm file tolerates.
"""

import math
from typing import NamedTuple

import numpy as np

from lpv_core.certificate.gains import ExactObserverGains, Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.residual.model_consistency import tolerated_rates
from lpv_core.residual.sample_buffer import INNOVATION, RESIDUAL, SampleBuffer, first_since
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.timestamps import NANOSECONDS

_SIGMAS = 3.5
_WORSE = 9.0
"""A ramp fits if it leaves at most so many variances of a reading more than the best one."""
_NOISE = 3.0
"""Mean square that the best ramp may leave, over the variance of a reading."""
_RISES = (0.0, 0.01, 0.02, 0.04, 0.06, 0.08, 0.12, 0.2, 0.4, 1.0)
"""Times T that a rate may have taken to go wrong [s]."""
_STARTS = 13
"""Onsets that are tried for each."""
_LENGTH = 3.0
"""Length of the filter after the rise, over 1/mu."""
_BEFORE = 4
"""Length of the mean before the onset, over that."""
_SHORTEST = 5

RULED_OUT, UNDECIDED, IMPLICATED = range(3)
"""Verdicts on a rate sensor."""

RATE_TEST = record_type(
    ('used', '?'),  # whether the test can be made
    ('fall', 'f8'),  # decay of the innovation in one sample [1]
    ('length', 'i8'),  # samples of the filter
    ('noise', 'f8'),  # standard deviation of a rate [rad/s]
    ('smallest', 'f8'),  # what torques may leave in the innovation [rad/s]
    ('reading', 'f8'),  # standard deviation of a reading [rad]
)


class Movement(NamedTuple):
    """A residual that began to move."""

    baseline: float
    """r_0 [rad]."""
    onset: int
    """When it began, if that was sudden [ns]."""
    speed: float
    """Its speed since then [rad/s]."""


def rate_test(arm: ArmParameters, gains: Gains) -> np.record:
    """`RATE_TEST` for one arm; the test can only be made for method ``exact``."""
    if not isinstance(gains.observer, ExactObserverGains):
        return new_record(RATE_TEST)
    share = max(gains.observer.mu) * arm.sample_time
    return new_record(
        RATE_TEST,
        used=True,
        fall=math.exp(-share),
        length=math.ceil(_LENGTH / share),
        noise=arm.velocity_noise,
        smallest=2.0 * tolerated_rates(arm, gains.observer).max(),
        reading=arm.position_noise,
    )


@njit
def scale_rate_test(stated: np.record, reading: float, rate: float, scaled: np.record) -> None:
    """The test for noise of readings and rates that is so many times what is stated."""
    scaled.used, scaled.fall, scaled.length = stated.used, stated.fall, stated.length
    scaled.smallest = stated.smallest
    scaled.noise, scaled.reading = rate * stated.noise, reading * stated.reading


@njit
def rate_verdict(params: np.record, buffer: SampleBuffer, movement: Movement) -> int:
    """Whether a rate went wrong when a residual began to move.

    Parameters
    ----------
    params : numpy.record
        Of type `RATE_TEST`.
    buffer : SampleBuffer
        The sensor's past.
    movement : Movement
        How the residual moves.

    Returns
    -------
    int
        `RULED_OUT` if the error of the rate would have shown and did not, `IMPLICATED` if it is
        there, `UNDECIDED` where noise or tolerated torques could hide it.
    """
    if not params.used or movement.speed == 0.0:
        return UNDECIDED
    fits = [_fit(params, buffer, movement, rise, k) for rise in _RISES for k in range(_STARTS)]
    best = math.inf
    for left, _, _ in fits:
        best = min(best, left)
    if not _is_explained(params, buffer, movement, best):
        return UNDECIDED
    verdict = RULED_OUT
    for i in range(len(_RISES)):
        for left, fitted, row in fits[i * _STARTS : (i + 1) * _STARTS]:
            if left > best + _WORSE * params.reading * params.reading:
                continue
            one = _matched_filter(params, buffer, row, _RISES[i], fitted)
            if one == IMPLICATED:
                return IMPLICATED
            if one == UNDECIDED:
                verdict = UNDECIDED
    return verdict


@njit
def _is_explained(params: np.record, buffer: SampleBuffer, movement: Movement, best: float) -> bool:
    """Whether the best ramp leaves no more than noise: other motion says nothing of the rate."""
    row, count = first_since(buffer, movement.onset), buffer.used[0]
    energy = 0.0
    for k in range(row, count):
        away = buffer.values[k, RESIDUAL] - movement.baseline
        energy += away * away
    return energy + best <= _NOISE * max(count - row, _SHORTEST) * params.reading * params.reading


@njit
def _fit(
    params: np.record, buffer: SampleBuffer, movement: Movement, rise: float, number: int
) -> tuple[float, float, int]:
    """Sum of squares that one ramp leaves, less that of the residual; its b; first row after its
    t_0."""
    reach = 2.0 * params.reading / abs(movement.speed) + 0.5 * rise
    share = 2.0 * number / (_STARTS - 1) - 1.0
    begin = movement.onset + round((share * reach - 0.5 * rise) * NANOSECONDS)
    row = first_since(buffer, begin)
    power = cross = 0.0
    for k in range(row, buffer.used[0]):
        ramp = _ramp((buffer.stamps[k] - begin) / NANOSECONDS, rise)
        power += ramp * ramp
        cross += ramp * (buffer.values[k, RESIDUAL] - movement.baseline)
    if power == 0.0:
        return 0.0, 0.0, row
    return -cross * cross / power, cross / power, row


@njit
def _ramp(time: float, rise: float) -> float:
    """q: the integral of a rate that rises to 1."""
    return 0.5 * time * time / rise if time < rise else time - 0.5 * rise


@njit
def _matched_filter(
    params: np.record, buffer: SampleBuffer, row: int, rise: float, speed: float
) -> int:
    """Verdict if the rate took so long to go wrong, from a row on."""
    stamps, values, count = buffer.stamps, buffer.values, buffer.used[0]
    first = row - _BEFORE * params.length
    if first < 0 or count - row < _SHORTEST:
        return UNDECIDED
    before = 0.0
    for k in range(first, row):
        before += values[k, INNOVATION]
    before /= row - first
    last = first_since(buffer, stamps[row] + round(rise * NANOSECONDS)) + params.length
    shown = wrong = power = total = cross = most = 0.0
    for k in range(row, min(last, count)):
        now = 1.0
        if rise > 0.0:
            now = min(1.0, (stamps[k] - stamps[row]) / NANOSECONDS / rise)
        shown, wrong = params.fall * shown + now - wrong, now
        power += shown * shown
        total += shown
        cross += shown * (values[k, INNOVATION] - before)
        most = max(most, shown)
    if power == 0.0:
        return UNDECIDED
    error = cross / power
    deviation = params.noise * math.sqrt(
        1.0 / power + total * total / (power * power) / (row - first)
    )
    share = error / speed if speed != 0.0 else 0.0
    if share > 0.5 and abs(error) > _SIGMAS * deviation:
        return IMPLICATED
    if abs(share) > 0.5 or abs(speed) < 2.0 * _SIGMAS * deviation:
        return UNDECIDED
    return RULED_OUT if abs(speed) * most > params.smallest else UNDECIDED
