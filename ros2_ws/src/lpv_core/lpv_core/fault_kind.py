"""Which kind of fault a confirmed one is, from its course since the onset."""

import numpy as np

from lpv_core.history import History

KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout', 'inconsistent',
         'unclassified')
"""What an alarm may be called; ``inconsistent``: rates, torques and model contradict each other."""

_SETTLED = 0.1
"""Shortest time since the onset for a judgement of the course [s]."""
_STUCK_SAMPLES = 20


def is_stuck(values, position_noise):
    """Whether a reading stands still while the arm moves.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        Samples of a `History`.
    position_noise : float
        Standard deviation of a healthy reading [rad].

    Returns
    -------
    bool
        False without enough motion to tell.
    """
    recent = values[-_STUCK_SAMPLES:]
    if len(recent) < _STUCK_SAMPLES:
        return False
    reading = recent[:, History.READING]
    # Noise alone moves a healthy reading from sample to sample.
    return bool(np.ptp(reading) < 0.2 * position_noise
                and np.ptp(recent[:, History.EXPECTED]) > 3.0 * position_noise)


def noise_level(values):
    """Standard deviation of white noise in a fault estimate, by second differences.

    Parameters
    ----------
    values : ndarray, shape (n, 3)
        At least 10 samples.

    Returns
    -------
    float
        [rad]; the median ignores single spikes and steps.
    """
    second = np.diff(values[:, History.FAULT], 2)
    return float(np.median(np.abs(second)) / (0.6745 * np.sqrt(6.0)))


def classify(stamps, values, onset, baseline, position_noise):
    """Name the kind of a fault that still acts.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        Samples since the onset [ns].
    values : ndarray, shape (n, 3)
        f^, y_p, S theta^ [rad].
    onset : int
        [ns].
    baseline : float
        f^ before the onset [rad].
    position_noise : float
        Standard deviation of a healthy reading [rad].

    Returns
    -------
    str
        One of `KINDS`; ``unclassified`` while there is too little to tell.
    """
    if is_stuck(values, position_noise):
        return 'stuck'
    if len(values) >= 25 and noise_level(values[-50:]) > 3.0 * position_noise:
        return 'noise'
    time = (stamps - onset) / 1e9
    if len(time) < 10 or time[-1] < _SETTLED:
        return 'unclassified'
    fault = values[:, History.FAULT] - baseline
    return _course(time, fault, values[:, History.EXPECTED], position_noise)


def _course(time, fault, expected, position_noise):
    """Bias, drift or scale: the model that leaves the smallest residual, simplest first."""
    floor = len(time) * position_noise**2
    residual = {
        'bias': _residual(np.ones_like(time)[:, None], fault),
        'drift': _residual(time[:, None], fault),
        'scale': _residual(expected[:, None], fault),
    }
    best = min(residual, key=residual.get)
    if best == 'scale' and np.ptp(expected) < 20.0 * position_noise:
        best = 'bias'  # without motion, a scale error is a bias
    if best != 'bias' and residual['bias'] < residual[best] + 2.0 * floor:
        best = 'bias'
    steps = _residual(np.column_stack([np.ones_like(time), time]), fault)
    if residual[best] > 4.0 * (steps + floor):
        # Neither fits alone, a ramp from an offset does: it grows, whatever it started from.
        return 'drift'
    return best


def _residual(basis, values):
    weights, *_ = np.linalg.lstsq(basis, values, rcond=None)
    return float(np.sum((values - basis @ weights) ** 2))
