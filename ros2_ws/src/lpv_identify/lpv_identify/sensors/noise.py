"""Noise and quantization of signals that move slowly against their sample time."""

from collections.abc import Sequence

import numpy as np

_ORDER = 3
_GAIN = np.sqrt(20.0)  # of white noise through third differences


def noise_deviation(signals: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation of white noise in each column, from third differences, shape (n,).

    In the unit of the signals, stretches of shape (samples, n) that are sampled uniformly; includes
    quantization.
    """
    changes = np.concatenate([np.diff(s, _ORDER, axis=0) for s in signals])
    # A quantized signal at rest does not change; the median would be 0 there.
    robust = np.median(np.abs(changes), axis=0) / 0.6745
    spread = np.sqrt(
        np.mean(np.clip(changes, *np.quantile(changes, (0.02, 0.98), axis=0)) ** 2, axis=0)
    )
    return np.where(robust > 0.0, robust, spread) / _GAIN


def quantization_step(signals: Sequence[np.ndarray]) -> np.ndarray:
    """Step of the readings in each column, shape (n,); 0 where they are as fine as floats.

    The step is the largest number that nearly all differences are multiples of.
    """
    columns = [np.concatenate([s[:, j] for s in signals]) for j in range(signals[0].shape[1])]
    return np.array([_step(column) for column in columns])


def _step(values: np.ndarray) -> float:
    levels = np.unique(values)
    if len(levels) < 3 or len(levels) > 0.8 * len(values):
        return 0.0
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-6 * np.median(gaps)]
    step = float(np.quantile(gaps, 0.05))
    if step <= 0.0:
        return 0.0
    # Rounding errors of the driver blur the levels by far less than a step.
    multiples = gaps / step
    near = multiples < 30.0
    off = np.abs(multiples[near] - np.round(multiples[near]))
    if np.mean(off < 0.1) < 0.9:
        return 0.0
    step = float(np.sum(gaps[near]) / np.sum(np.round(multiples[near])))
    return step
