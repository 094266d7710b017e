"""Zero-phase low-pass filters and derivatives of signals on a uniform grid."""

import functools

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

_ORDER = 2  # forwards and backwards, hence 4 in all
_LARGE = 1_000_000  # numbers from which threads pay
NYQUIST_SHARE = 0.9
"""Cutoffs above this share of the Nyquist frequency filter nothing."""


def low_pass(
    signal: np.ndarray, cutoff: float, step: float, second: float = np.inf, order: int = _ORDER
) -> np.ndarray:
    """Butterworth's low-pass along the first axis, both ways, halved at each cutoff [Hz]."""
    cutoffs = tuple(c * step for c in (cutoff, second) if c < NYQUIST_SHARE * 0.5 / step)
    if not cutoffs:
        return signal
    count = len(signal)
    pad = min(count - 1, int(np.ceil(1.5 / min(cutoffs))))
    # Turned about its ends, the signal goes on without a step.
    before = 2.0 * signal[:1] - signal[pad:0:-1]
    after = 2.0 * signal[-1:] - signal[-2 : -pad - 2 : -1]
    padded = np.concatenate([before, signal, after]).reshape(count + 2 * pad, -1).T
    size = fft.next_fast_len(padded.shape[1], real=True)
    with fft.set_workers(-1 if padded.size > _LARGE else 1):  # all processors
        filtered = fft.irfft(fft.rfft(padded, size) * _gains(order, cutoffs, size), size)
    return filtered[:, pad : pad + count].T.reshape(signal.shape)


@functools.lru_cache(maxsize=64)
def _gains(order: int, cutoffs: tuple[float, ...], size: int) -> np.ndarray:
    """Squared gain of Butterworth filters at the frequencies of a Fourier transform."""
    frequency = np.tan(np.pi * np.minimum(fft.rfftfreq(size), 0.5 - 1e-9))
    return np.prod(
        [1.0 / (1.0 + (frequency / np.tan(np.pi * c)) ** (2 * order)) for c in cutoffs], axis=0
    )


def causal_low_pass(signal: np.ndarray, cutoff: float, step: float) -> np.ndarray:
    """Low-pass filter that uses the past only, along the first axis; as `low_pass`."""
    if not cutoff < NYQUIST_SHARE * 0.5 / step:
        return signal
    sections = butter(_ORDER, cutoff, fs=1.0 / step, output='sos')
    return sosfilt(sections, signal - signal[0], axis=0) + signal[0]


def derivative(signal: np.ndarray, step: float) -> np.ndarray:
    """Derivative in time along the first axis, by a cubic spline."""
    time = step * np.arange(len(signal))
    return CubicSpline(time, signal, axis=0).derivative()(time)


def shifted(signal: np.ndarray, delay: float | np.ndarray, step: float) -> np.ndarray:
    """Signal (samples, n) delayed by [s]: the value at t is that of t - delay, held at the ends."""
    time = step * np.arange(len(signal))
    delays = np.broadcast_to(delay, signal.shape[1:])
    if not delays.any():
        return signal
    late = [np.clip(time - d, 0.0, time[-1]) for d in delays]
    return np.stack([CubicSpline(time, x)(at) for x, at in zip(signal.T, late)], axis=1)
