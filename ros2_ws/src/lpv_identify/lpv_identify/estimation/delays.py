"""Delays between signals: of rates behind positions, of efforts behind motion."""

from collections.abc import Sequence

import numpy as np

from lpv_identify.estimation.regression import Filters, Fit, Rows, model_torque
from lpv_identify.recordings.filters import derivative, low_pass
from lpv_identify.recordings.motion import Bandwidths, Segment

MAX_DELAY = 0.1
"""Largest delay that is looked for [s]."""


def rate_delays(segments: Sequence[Segment], bands: Bandwidths) -> np.ndarray:
    """Delay of measured rates behind the derivative of positions, shape (n,) [s]."""
    pairs = []
    cutoff = min(bands.position, bands.velocity)
    for segment in segments:
        assert segment.velocity is not None
        rate = derivative(low_pass(segment.position, cutoff, segment.step), segment.step)
        pairs.append((rate, low_pass(segment.velocity, cutoff, segment.step), segment.step))
    return _delays(pairs)


def effort_delays(rows: Sequence[Rows], fit: Fit, filters: Filters) -> np.ndarray:
    """Delay of recorded efforts behind predicted ones, shape (n,) [s]."""
    pairs = []
    for one in rows:
        cutoff = min(filters.effort, filters.analysis)
        predicted = low_pass(model_torque(one, fit), cutoff, one.step)
        pairs.append(
            (predicted[one.part], low_pass(one.effort, cutoff, one.step)[one.part], one.step)
        )
    return _delays(pairs)


def _delays(pairs: Sequence[tuple[np.ndarray, np.ndarray, float]]) -> np.ndarray:
    """Delay d of each column: late(t) = scale*early(t - d) + offset, by Gauss-Newton."""
    n = pairs[0][0].shape[1]
    result = np.zeros(n)
    for j in range(n):
        early, slope, late = [], [], []
        for first, second, step in pairs:
            early.append(first[:, j])
            slope.append(derivative(first[:, j], step))
            late.append(second[:, j])
        x, dx, y = np.concatenate(early), np.concatenate(slope), np.concatenate(late)
        columns = np.column_stack([x, -dx, np.ones_like(x)])
        if np.ptp(x) < 1e-9:
            continue
        solution = _robust(columns, y)
        if 0.6 < solution[0] < 1.6:  # otherwise the one does not follow from the other
            result[j] = np.clip(solution[1] / solution[0], -MAX_DELAY, MAX_DELAY)
    return result


def _robust(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    weight = np.ones(len(target))
    for _ in range(5):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)[0]
        residual = np.abs(target - columns @ solution)
        scale = np.median(residual) / 0.6745 + 1e-12
        weight = 3.0 / np.maximum(residual / scale, 3.0)
    return solution
