"""How large the noise of a sensor is, against what the arm file states.

Limits of changes are multiples of the stated noise.  Where the true noise is larger, healthy
sensors cross them all the time; so noise is measured, limits grow with it, and it is said.

Second differences of the residual are the noise of the reading, those of the rate innovation the
noise of the rate: what the arm does is smooth, or explained by the model.  Their median over short
windows ignores steps and spikes of faults; the mean of some windows is the estimate.
"""

import math

import numpy as np

from lpv_core.certificate.gains import ExactObserverGains, Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.residual.sample_buffer import INNOVATION, RESIDUAL, SampleBuffer
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type

_WINDOW = 50
"""Samples of a window."""
_WINDOWS = 20
"""Windows that the estimate is averaged over."""
_LARGEST = 3.0
"""More than so many times the stated noise is a fault, not noise that was stated too small."""
_TOLERATED, _UNCERTAIN = 1.2, 0.5
"""Ratio from which noise counts as larger than stated; and what is added to it for n windows, over
sqrt(n): the scatter of the estimate."""

NOISE_ESTIMATE = record_type(
    ('reading', 'f8'),  # standard deviation over the stated one [1]
    ('rate', 'f8'),  # standard deviation over the stated one [1]
    ('windows', 'i8'),  # that they are averaged over
    ('fresh', 'i8'),  # samples since the last window
)


def innovation_gain(arm: ArmParameters, gains: Gains) -> float:
    """Second differences of the innovation over those of the rate's white noise.

    The observer follows the rate with mu: the innovation is (1 - z^-1)/(1 - a z^-1) times the
    noise, a = 1 - mu Ts.
    """
    if not isinstance(gains.observer, ExactObserverGains):
        return 1.0
    a = 1.0 - min(1.0, float(np.mean(gains.observer.mu)) * arm.sample_time)
    response = np.convolve(np.diff(np.append(0.0, a ** np.arange(500))), [1.0, -2.0, 1.0])
    return math.sqrt(float(response @ response) / 6.0)


@njit
def reset_noise(state: np.record) -> None:
    """Nothing is known of the noise but what is stated."""
    state.reading = state.rate = 0.0
    state.windows = state.fresh = 0


@njit
def noise_level(values: np.ndarray, column: int) -> float:
    """Standard deviation of white noise in a column of a `SampleBuffer`, by second differences.

    Of at least 10 rows; the median ignores single spikes and steps.
    """
    count = len(values) - 2
    second = np.empty(count)
    for k in range(count):
        second[k] = abs(values[k + 2, column] - 2.0 * values[k + 1, column] + values[k, column])
    second.sort()
    median = 0.5 * (second[count // 2] + second[(count - 1) // 2])
    return median / (0.6745 * np.sqrt(6.0))


@njit
def update_noise(
    state: np.record, buffer: SampleBuffer, reading_noise: float, rate_noise: float
) -> None:
    """Follow the noise of a sensor without a fault of kind noise.

    Parameters
    ----------
    state : numpy.record
        Of type `NOISE_ESTIMATE`.
    buffer : SampleBuffer
        The sensor's past.
    reading_noise, rate_noise : float
        Stated standard deviations, of r from sample to sample [rad] and of the innovation [rad/s].
    """
    fresh = state.fresh + 1
    state.fresh = fresh
    if fresh < _WINDOW or buffer.used[0] < _WINDOW:
        return
    state.fresh = 0
    recent = buffer.values[buffer.used[0] - _WINDOW : buffer.used[0]]
    reading = noise_level(recent, RESIDUAL) / reading_noise
    rate = noise_level(recent, INNOVATION) / rate_noise
    if reading > _LARGEST or rate > _LARGEST:
        return
    windows = min(state.windows + 1, _WINDOWS)
    state.reading += (reading - state.reading) / windows
    state.rate += (rate - state.rate) / windows
    state.windows = windows


@njit
def excess(ratio: float, windows: int) -> float:
    """Factor by which noise is certainly larger than stated; 1 where it is not."""
    if windows == 0 or ratio <= _TOLERATED + _UNCERTAIN / math.sqrt(windows):
        return 1.0
    return ratio
