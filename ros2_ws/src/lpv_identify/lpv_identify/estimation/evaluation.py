"""How well an arm predicts torques: figures of data that were held back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv_identify.estimation.regression import Filters, Fit, Rows, model_torque
from lpv_identify.recordings.filters import causal_low_pass, low_pass


@dataclass(frozen=True)
class Figures:
    """Figures of each joint, all of shape (n,)."""

    rms: np.ndarray  # of effort minus prediction, the effort as it was recorded [N m]
    rms_band: np.ndarray  # after a causal low-pass at the analysis bandwidth [N m]
    share: np.ndarray  # rms by the range of the recorded effort
    r2: np.ndarray  # share of the effort's variance that is explained
    correlation: np.ndarray  # of residuals in the band, one time constant apart; 0 if white


@dataclass(frozen=True)
class Prediction:
    """Measured and predicted torque along a recording, arrays of shape (samples, n)."""

    time: np.ndarray  # shape (samples,) [s]
    measured: np.ndarray  # [N m]
    predicted: np.ndarray  # [N m]
    residual_band: np.ndarray  # after the causal low-pass [N m]
    position: np.ndarray  # [rad]
    velocity: np.ndarray  # [rad/s]


def predict(
    rows: Rows, fit: Fit, filters: Filters, time: np.ndarray, position: np.ndarray
) -> Prediction:
    """Prediction over the counted samples of a segment.

    Parameters
    ----------
    rows : Rows
        Of the segment.
    fit : Fit
        Parameters.
    filters : Filters
        The effort sensor's bandwidth and that of the analysis.
    time, position : ndarray
        Of all samples of the segment.

    Returns
    -------
    Prediction
        The measured torque is not filtered.
    """
    predicted = low_pass(model_torque(rows, fit), filters.effort, rows.step)
    band = causal_low_pass(rows.effort - predicted, filters.test, rows.step)
    part = rows.part
    return Prediction(
        time[part],
        rows.effort[part],
        predicted[part],
        band[part],
        position[part],
        rows.velocity[part],
    )


def figures(predictions: Sequence[Prediction], filters: Filters, step: float) -> Figures:
    """Figures over several stretches.

    Parameters
    ----------
    predictions : sequence of Prediction
        Stretches.
    filters : Filters
        Those of the predictions.
    step : float
        Sample time [s].

    Returns
    -------
    Figures
        Of every joint.
    """
    measured = np.concatenate([p.measured for p in predictions])
    residual = measured - np.concatenate([p.predicted for p in predictions])
    band = np.concatenate([p.residual_band for p in predictions])
    rms = np.sqrt(np.mean(residual**2, axis=0))
    spread = np.maximum(np.ptp(measured, axis=0), 1e-12)
    variance = np.maximum(np.var(measured, axis=0), 1e-24)
    lag = max(1, int(round(0.5 / (min(filters.test, 0.5 / step) * step))))
    centred = band - band.mean(axis=0)
    power = np.maximum(np.mean(centred**2, axis=0), 1e-24)
    correlation = (
        np.mean(centred[lag:] * centred[:-lag], axis=0) / power
        if len(centred) > lag
        else np.zeros(len(rms))
    )
    return Figures(
        rms,
        np.sqrt(np.mean(band**2, axis=0)),
        rms / spread,
        1.0 - np.mean(residual**2, axis=0) / variance,
        correlation,
    )
