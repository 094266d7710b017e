"""Delays between signals: of rates behind positions, of efforts behind motion."""

from collections.abc import Sequence

import numpy as np

from lpv.core.support.limits import MAX_GAP
from lpv.identify.estimation.regression import Fit, Rows, model_torque
from lpv.identify.estimation.robust import robust_fit
from lpv.identify.recordings.filters import derivative, low_pass
from lpv.identify.recordings.motion import Bandwidths, Segment

_Pair = tuple[np.ndarray, np.ndarray, float]
"""Early and late signal, each of shape (samples, n), and their sample time [s]."""


def rate_delays(segments: Sequence[Segment], bands: Bandwidths) -> np.ndarray:
    """Delay of measured rates behind the derivative of positions, shape (n,) [s]."""
    pairs: list[_Pair] = []
    cutoff = min(bands.position, bands.velocity)
    for segment in segments:
        if segment.velocity is None:
            continue
        rate = derivative(low_pass(segment.position, cutoff, segment.step), segment.step)
        pairs.append((rate, low_pass(segment.velocity, cutoff, segment.step), segment.step))
    return _delays(pairs)


def effort_delays(rows: Sequence[Rows], fit: Fit, bands: Bandwidths) -> np.ndarray:
    """Delay of recorded efforts behind predicted ones, shape (n,) [s]."""
    pairs: list[_Pair] = []
    cutoff = min(bands.effort, bands.analysis)
    for one in rows:
        early, late = (low_pass(x, cutoff, one.step) for x in (model_torque(one, fit), one.effort))
        pairs.append((early[one.part], late[one.part], one.step))
    return _delays(pairs)


def _delays(pairs: Sequence[_Pair]) -> np.ndarray:
    """Delay d of each column: late(t) = scale*early(t - d) + offset, by Gauss-Newton."""
    early = np.concatenate([first for first, _, _ in pairs])
    slope = np.concatenate([derivative(first, step) for first, _, step in pairs])
    late = np.concatenate([second for _, second, _ in pairs])
    result = np.zeros(early.shape[1])
    for j in np.flatnonzero(np.ptp(early, axis=0) >= 1e-9):
        columns = np.column_stack([early[:, j], -slope[:, j], np.ones(len(early))])
        target, ones = late[:, j, None], np.ones((len(late), 1))
        solution, *_ = robust_fit(columns[:, None], target, ones, ones[0], rounds=5, least=1e-12)
        if 0.6 < solution[0] < 1.6:  # otherwise the one does not follow from the other
            result[j] = np.clip(solution[1] / solution[0], -MAX_GAP, MAX_GAP)
    return result
