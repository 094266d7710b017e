"""Whether measured rates come from a sensor of their own or from the positions."""

from collections.abc import Sequence

import numpy as np

from lpv_identify.recordings.motion import Segment

_TAPS = 4  # differences of positions before and after that a driver's filter may use
_EXPLAINED = 0.5


def rate_sources(segments: Sequence[Segment]) -> tuple[list[str], np.ndarray]:
    """Source of the rates of each joint, and the evidence: the multiple correlation, shape (n,).

    What the sensors add is fast; motion is slow.  If the fast part of the rates is a filtered
    version of the fast part of the positions' differences, rates are 'derived' from positions, and
    a fault of the encoder is in both; otherwise they are 'independent', or there are 'none'.
    """
    n = segments[0].position.shape[1]
    if segments[0].velocity is None:
        return ['none'] * n, np.zeros(n)
    evidence = np.array([_explained(segments, j) for j in range(n)])
    return ['derived' if e > _EXPLAINED else 'independent' for e in evidence], np.sqrt(evidence)


def _explained(segments: Sequence[Segment], joint: int) -> float:
    """Share of the rates' fast variance that positions explain."""
    columns, targets = [], []
    for segment in segments:
        assert segment.velocity is not None
        steps = np.diff(segment.position[:, joint], prepend=segment.position[0, joint])
        fast = _fast(steps / segment.step)
        windows = np.stack([np.roll(fast, k) for k in range(-_TAPS, _TAPS + 1)], axis=1)
        part = slice(_TAPS + 3, -_TAPS - 3)
        columns.append(windows[part])
        targets.append(_fast(segment.velocity[:, joint])[part])
    design, target = np.concatenate(columns), np.concatenate(targets)
    total = float(target @ target)
    if total <= 0.0:
        return 0.0
    residual = target - design @ np.linalg.lstsq(design, target, rcond=1e-8)[0]
    count = max(1, len(target) - design.shape[1])
    return max(0.0, 1.0 - float(residual @ residual) / count * len(target) / total)


def _fast(signal: np.ndarray) -> np.ndarray:
    """Fourth differences: motion that is smooth over five samples is gone."""
    return np.convolve(signal, [1.0, -4.0, 6.0, -4.0, 1.0], 'same')
