"""How well an arm predicts torques: figures of data that were held back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv.identify.estimation.regression import Filters, Fit, Rows, model_torque
from lpv.identify.recordings.filters import causal_low_pass, low_pass


@dataclass(frozen=True)
class Figures:
    """Figures of each joint where it moves, all of shape (n,)."""

    rms: np.ndarray  # of effort minus prediction, the effort as it was recorded [N m]
    rms_band: np.ndarray  # after a causal low-pass at the analysis bandwidth [N m]
    share: np.ndarray  # rms by the range of the recorded effort
    r2: np.ndarray  # share of the effort's variance that is explained
    correlation: np.ndarray  # of residuals in the band, one time constant apart; 0 if white


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted torque along a recording, arrays of shape (samples, n)."""

    time: np.ndarray  # shape (samples,) [s]
    measured: np.ndarray  # not filtered [N m]
    predicted: np.ndarray  # [N m]
    residual_band: np.ndarray  # after the causal low-pass [N m]
    position: np.ndarray  # [rad]
    velocity: np.ndarray  # [rad/s]
    counts: np.ndarray  # where joints move: at rest friction may be anything

    @property
    def residual(self) -> np.ndarray:
        """Measured less predicted torque [N m]."""
        return self.measured - self.predicted


def predict(rows: Rows, fit: Fit, filters: Filters) -> Prediction:
    """Prediction over the counted samples of a segment."""
    predicted = low_pass(model_torque(rows, fit), filters.effort, rows.step)
    band = causal_low_pass(rows.effort - predicted, filters.test, rows.step)
    signals = rows.time, rows.effort, predicted, band, rows.position, rows.velocity, rows.counts
    return Prediction(*(signal[rows.part] for signal in signals))


def figures(predictions: Sequence[Prediction], filters: Filters, step: float) -> Figures:
    """Figures over several stretches of some sample time [s]."""
    names = 'measured', 'residual', 'residual_band', 'counts'
    measured, missed, band, counts = (
        np.concatenate([getattr(p, name) for p in predictions]) for name in names
    )

    def mean(values: np.ndarray, which: np.ndarray = counts) -> np.ndarray:
        return np.sum(values * which, axis=0) / np.maximum(np.sum(which, axis=0), 1)

    square = mean(missed**2)
    lag = max(1, int(round(0.5 / (min(filters.test, 0.5 / step) * step))))
    centred = band - mean(band)
    products = mean(centred[lag:] * centred[:-lag], counts[lag:] & counts[:-lag])
    return Figures(
        np.sqrt(square),
        np.sqrt(mean(band**2)),
        np.sqrt(square) / np.maximum(np.ptp(measured, axis=0), 1e-12),
        1.0 - square / np.maximum(mean((measured - mean(measured)) ** 2), 1e-24),
        products / np.maximum(mean(centred**2), 1e-24),
    )
