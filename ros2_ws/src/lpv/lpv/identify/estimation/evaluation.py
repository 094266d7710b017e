"""What a fit is worth: figures of data held back, and which parameters the data determine."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.identify.estimation.regression import Fit, Rows, model_torque
from lpv.identify.model.friction import TERMS
from lpv.identify.model.prior import parameter_map
from lpv.identify.model.rigid_body import BaseParameters
from lpv.identify.recordings.filters import causal_low_pass, low_pass
from lpv.identify.recordings.motion import Bandwidths

_LINK = ('mass', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
_REMEDIES = (
    (_LINK[:4], 'hold it, and those before it, in more different postures'),
    ((*_LINK[4:], 'rotor'), 'accelerate it more'),
    (TERMS, 'move it at more different speeds, both ways'),
)
_EXPLAINED = 0.5  # share of an effort's variance below which it is said


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


def predict(rows: Rows, fit: Fit, bands: Bandwidths) -> Prediction:
    """Prediction over the counted samples of a segment."""
    predicted = low_pass(model_torque(rows, fit), bands.effort, rows.step)
    band = causal_low_pass(rows.effort - predicted, bands.test, rows.step)
    signals = rows.time, rows.effort, predicted, band, rows.position, rows.velocity, rows.counts
    return Prediction(*(signal[rows.part] for signal in signals))


def figures(predictions: Sequence[Prediction], bands: Bandwidths, step: float) -> Figures:
    """Figures over several stretches of some sample time [s]."""
    names = 'measured', 'residual', 'residual_band', 'counts'
    measured, missed, band, counts = (
        np.concatenate([getattr(p, name) for p in predictions]) for name in names
    )
    mean = partial(_mean, which=counts)
    square = mean(missed**2)
    lag = max(1, int(round(0.5 / (min(bands.test, 0.5 / step) * step))))
    centred = band - mean(band)
    products = _mean(centred[lag:] * centred[:-lag], counts[lag:] & counts[:-lag])
    return Figures(
        np.sqrt(square),
        np.sqrt(mean(band**2)),
        np.sqrt(square) / np.maximum(np.ptp(measured, axis=0), 1e-12),
        explained(measured, missed, counts),
        products / np.maximum(mean(centred**2), 1e-24),
    )


def _mean(values: np.ndarray, which: np.ndarray) -> np.ndarray:
    return np.sum(values * which, axis=0) / np.maximum(np.sum(which, axis=0), 1)


def explained(measured: np.ndarray, missed: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """R2 of each joint, shape (n,), from efforts and what a model misses, shape (samples, n)."""
    spread = measured - _mean(measured, counts)
    return 1.0 - _mean(missed**2, counts) / np.maximum(_mean(spread**2, counts), 1e-24)


def hardly_explained(joints: Sequence[str], r2: np.ndarray) -> list[str]:
    """Remarks on joints whose efforts the model hardly explains."""
    return [
        f'{name}: less than half of its efforts is explained (R2 {share:.2g}): its motion says too '
        'little, or there is a mistake that was not found'
        for name, share in zip(joints, r2)
        if share < _EXPLAINED
    ]


@dataclass(frozen=True)
class Determination:
    """Parameters of a fit by name, with their standard deviations."""

    names: list[str]
    values: np.ndarray  # shape (parameters,)
    sigma: np.ndarray  # standard deviation, shape (parameters,)
    determined: np.ndarray  # the data say more than the prior, shape (parameters,)

    def advice(self, joints: tuple[str, ...]) -> list[str]:
        """What motion is missing, one sentence for each joint of which much is unknown."""
        texts = []
        for name in joints:
            whose = [one.partition(': ') for one, d in zip(self.names, self.determined) if not d]
            for terms, remedy in _REMEDIES:
                missing = [term for joint, _, term in whose if joint == name and term in terms]
                if missing:
                    texts.append(f'{name}: {", ".join(missing)} not determined; {remedy}')
        return texts


def determine(base: BaseParameters, fit: Fit, arm: SerialArm) -> Determination:
    """Deviations of a fit's parameters, and which are determined by half of the prior's."""
    # A base parameter has the name of the column that stands for it.
    links = [f'{joint}: {part}' for joint in arm.joint_names for part in _LINK]
    links += [f'{joint}: rotor' for joint in arm.joint_names]
    names = [links[column] for column in base.columns]
    names += [f'{joint}: {term}' for joint in arm.joint_names for term in TERMS]
    used = np.diag(fit.normal) > 0.0
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    turn = parameter_map(base, len(arm.joints))[: base.size]
    prior = np.sqrt(np.sum((turn * fit.prior.whole[1]) ** 2, axis=1))
    friction = np.abs(fit.friction)
    size = np.maximum(friction[:, [0, 1, 2, 1]], fit.scale[:, None] * 0.5)
    size[:, TERMS.index('load')] = np.maximum(size[:, TERMS.index('load')], 0.05)
    limit = np.concatenate([prior / np.sqrt(5.0), size.ravel()])
    determined = (sigma > 0.0) & (sigma < limit) & used
    return Determination(names, fit.parameters, sigma, determined)
