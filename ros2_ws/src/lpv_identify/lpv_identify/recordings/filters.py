"""Zero-phase low-pass filters and derivatives of signals on a uniform grid."""

import functools

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt, sosfiltfilt

_ORDER = 2  # forwards and backwards, hence 4 in all
NYQUIST_SHARE = 0.9
"""Cutoffs above this share of the Nyquist frequency filter nothing."""


def low_pass(
    signal: np.ndarray, cutoff: float, step: float, second: float = np.inf, order: int = _ORDER
) -> np.ndarray:
    """Low-pass filter without delay along the first axis of a uniformly sampled signal.

    ``cutoff``, and ``second`` of another filter after it, are where amplitudes are halved [Hz], inf
    for none; ``step`` is the sample time [s].  A high ``order``, that of each filter in each
    direction, leaves what is below the cutoff as it is.
    """
    cutoffs = [c for c in (cutoff, second) if c < NYQUIST_SHARE * 0.5 / step]
    if not cutoffs:
        return signal
    sections = np.concatenate([_sections(order, c * step) for c in cutoffs])
    pad = min(len(signal) - 1, int(np.ceil(1.5 / (min(cutoffs) * step))))
    return sosfiltfilt(sections, signal, axis=0, padlen=pad)


def causal_low_pass(signal: np.ndarray, cutoff: float, step: float) -> np.ndarray:
    """Low-pass filter that uses the past only, along the first axis; as `low_pass`."""
    if not cutoff < NYQUIST_SHARE * 0.5 / step:
        return signal
    sections = _sections(_ORDER, cutoff * step)
    return sosfilt(sections, signal - signal[0], axis=0) + signal[0]


@functools.lru_cache(maxsize=64)
def _sections(order: int, cutoff: float) -> np.ndarray:
    """Butterworth's filter; cutoff in cycles per sample."""
    return butter(order, cutoff, fs=1.0, output='sos')


def derivative(signal: np.ndarray, step: float) -> np.ndarray:
    """Derivative in time along the first axis, by a cubic spline."""
    time = step * np.arange(len(signal))
    return CubicSpline(time, signal, axis=0).derivative()(time)


def shifted(signal: np.ndarray, delay: float | np.ndarray, step: float) -> np.ndarray:
    """Signal delayed: the value at t is that of t - delay, held at the ends.

    Parameters
    ----------
    signal : ndarray, shape (samples, n)
        Uniformly sampled.
    delay : float or ndarray, shape (n,)
        [s]; negative to advance.
    step : float
        Sample time [s].

    Returns
    -------
    ndarray, shape (samples, n)
        The delayed signal.
    """
    time = step * np.arange(len(signal))
    delays = np.broadcast_to(delay, signal.shape[1:])
    if not delays.any():
        return signal
    spline = CubicSpline(time, signal, axis=0)
    columns = [spline(np.clip(time - d, 0.0, time[-1]))[:, j] for j, d in enumerate(delays)]
    return np.stack(columns, axis=1)
