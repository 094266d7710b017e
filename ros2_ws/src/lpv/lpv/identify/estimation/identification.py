"""From recordings to an identified arm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.identify.estimation.assembly import covariance_of_all, fit_of
from lpv.identify.estimation.mistakes import Mistake, find_mistakes
from lpv.identify.estimation.regression import Filters, Fit, Rows, model_torque
from lpv.identify.estimation.selection import WeightEvidence
from lpv.identify.estimation.torque_error import torque_error, torque_tolerance
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.model.base_parameters import BaseParameters
from lpv.identify.model.friction import TERMS
from lpv.identify.model.prior import structural_prior
from lpv.identify.recordings.filters import causal_low_pass, low_pass
from lpv.identify.recordings.motion import Motion
from lpv.identify.recordings.recording import Recording
from lpv.identify.sensors.sensing import Sensing

STEPS = 8
"""Steps of an identification that are reported."""
_LINK = ('mass', 'mx', 'my', 'mz', 'Ixx', 'Ixy', 'Iyy', 'Ixz', 'Iyz', 'Izz')
_REMEDIES = (
    (_LINK[:4], 'hold it, and those before it, in more different postures'),
    ((*_LINK[4:], 'rotor'), 'accelerate it more'),
    (TERMS, 'move it at more different speeds, both ways'),
)


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
    measured: np.ndarray  # not filtered [N m]
    predicted: np.ndarray  # [N m]
    residual_band: np.ndarray  # after the causal low-pass [N m]
    position: np.ndarray  # [rad]
    velocity: np.ndarray  # [rad/s]

    @property
    def residual(self) -> np.ndarray:
        """Measured less predicted torque [N m]."""
        return self.measured - self.predicted


def predict(rows: Rows, fit: Fit, filters: Filters, motion: Motion) -> Prediction:
    """Prediction over the counted samples of a segment's rows and motion."""
    predicted = low_pass(model_torque(rows, fit), filters.effort, rows.step)
    band = causal_low_pass(rows.effort - predicted, filters.test, rows.step)
    signals = motion.time, rows.effort, predicted, band, motion.position, rows.velocity
    return Prediction(*(signal[rows.part] for signal in signals))


def figures(predictions: Sequence[Prediction], filters: Filters, step: float) -> Figures:
    """Figures over several stretches of some sample time [s]."""
    measured = np.concatenate([p.measured for p in predictions])
    square = np.mean(np.concatenate([p.residual for p in predictions]) ** 2, axis=0)
    band = np.concatenate([p.residual_band for p in predictions])
    lag = max(1, int(round(0.5 / (min(filters.test, 0.5 / step) * step))))
    centred = band - band.mean(axis=0)
    products = centred[lag:] * centred[:-lag] if len(centred) > lag else 0.0 * centred
    return Figures(
        np.sqrt(square),
        np.sqrt(np.mean(band**2, axis=0)),
        np.sqrt(square) / np.maximum(np.ptp(measured, axis=0), 1e-12),
        1.0 - square / np.maximum(np.var(measured, axis=0), 1e-24),
        np.mean(products, axis=0) / np.maximum(np.mean(centred**2, axis=0), 1e-24),
    )


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
    names = parameter_names(base, arm.joint_names)
    used = np.diag(fit.normal) > 0.0
    sigma = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    _, width = structural_prior(arm)
    prior = np.sqrt(np.sum((base.combination * width) ** 2, axis=1))
    friction = np.abs(fit.friction)
    size = np.maximum(friction[:, [0, 1, 2, 1]], fit.scale[:, None] * 0.5)
    size[:, TERMS.index('load')] = np.maximum(size[:, TERMS.index('load')], 0.05)
    limit = 0.5 * np.concatenate([prior, 2.0 * size.ravel()])
    active = np.ones(len(names), bool)
    active[base.size + TERMS.index('load') :: len(TERMS)] = fit.used_load
    determined = (sigma > 0.0) & (sigma < limit) & used
    keep = np.flatnonzero(active)
    return Determination(
        [names[k] for k in keep], fit.parameters[keep], sigma[keep], determined[keep]
    )


def parameter_names(base: BaseParameters, joints: tuple[str, ...]) -> list[str]:
    """Names of a fit's parameters; a base parameter has that of the column that stands for it."""
    structural = [f'{joint}: {part}' for joint in joints for part in _LINK]
    structural += [f'{joint}: rotor' for joint in joints]
    friction = [f'{joint}: {term}' for joint in joints for term in TERMS]
    return [structural[column] for column in base.columns] + friction


@dataclass(frozen=True)
class Options:
    """What the user says of recordings and fit."""

    train_share: float = 0.6  # of every recording; the rest is held back
    refit: bool = False  # write the parameters of a fit to all samples
    weight_is_known: bool = False  # keep what the arm says on gravity in the efforts


@dataclass(frozen=True)
class Identification:
    """Identified arm, and how well it does on data that were held back."""

    arm: SerialArm
    figures: Figures  # of the arm, on data held back
    prior_figures: Figures  # of the arm as it was given, on the same data
    predictions: list[Prediction]  # on data held back
    sensing: Sensing
    determination: Determination
    fit: Fit  # to the training data, without a prior
    filters: Filters
    used_rates: bool  # measured rates were used
    weight: WeightEvidence  # whether the efforts contain the arm's weight
    mistakes: tuple[Mistake, ...]  # what is likely wrong in the set-up; part of the warnings, too
    warnings: tuple[str, ...]


def identify(
    arm: SerialArm,
    recordings: Sequence[Recording],
    options: Options | None = None,
    tests: Sequence[Recording] = (),
    report: Callable[[str], None] = lambda step: None,
) -> Identification:
    """Identify an arm, with rough inertias, from recordings; IdentificationError."""
    options = options or Options()
    report('preparing the motion')
    workshop = Workshop(arm, recordings)
    share = 1.0 if tests else options.train_share
    workshop.estimate_gains(share)
    report('looking for mistakes of the set-up')
    mistakes = [m for m in find_mistakes(workshop.arm, recordings) if m.kind != 'weight']
    workshop.warnings += [m.text for m in mistakes]
    # With gravity from elsewhere, or other joints' efforts, the weight cannot be judged.
    weight = workshop.check_weight(share, not (options.weight_is_known or mistakes))
    arm = workshop.arm
    workshop.choose(share, report)
    report('fitting the parameters')
    fit, strength = workshop.fit(share)
    found = workshop.arm_of(fit, strength)
    held_back = workshop.test_rows(share, tests)
    predictions, before = (
        [
            predict(rows, fit_of(one, workshop.base, fit), workshop.filters, motion)
            for rows, motion in held_back
        ]
        for one in (found, arm)
    )
    if options.refit:
        fit, _ = workshop.fit(1.0)
        found = workshop.arm_of(fit, strength)
    report('measuring what is uncertain')
    free = workshop.free_fit(1.0 if options.refit else share, fit.slope)
    determination = determine(workshop.base, free, arm)
    sensing = workshop.sensing()
    found = _finish(found, workshop, sensing, predictions, determination, free)
    step = workshop.step
    return Identification(
        found,
        figures(predictions, workshop.filters, step),
        figures(before, workshop.filters, step),
        predictions,
        sensing,
        determination,
        free,
        workshop.filters,
        workshop.use_rates,
        weight,
        tuple(mistakes),
        tuple(workshop.warnings),
    )


def _finish(
    arm: SerialArm,
    workshop: Workshop,
    sensing: Sensing,
    predictions: Sequence[Prediction],
    determination: Determination,
    fit: Fit,
) -> SerialArm:
    """The arm with sensors, tolerances, delays and covariance."""
    speed = np.concatenate([p.velocity for p in predictions])
    residual = np.concatenate([p.residual for p in predictions])
    joints = []
    for joint, delay, rate, rest in zip(arm.joints, workshop.effort_delay, speed.T, residual.T):
        tolerance = torque_tolerance(rate, rest)
        joints.append(replace(joint, effort_delay=float(delay), torque_tolerance=tolerance))
    determined = int(determination.determined.sum())
    stretches = [p.residual for p in predictions]
    error = torque_error([p.velocity for p in predictions], stretches, workshop.step)
    return replace(
        error.on(sensing.on(replace(arm, joints=tuple(joints)))),
        covariance=covariance_of_all(workshop.arm, workshop.base, fit, determined),
        sample_time=workshop.step,
        effort_bandwidth=workshop.filters.effort,
    )
