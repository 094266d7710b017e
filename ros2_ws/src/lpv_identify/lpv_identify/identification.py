"""From recordings to an identified arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpv_core.serial_arm.description import JointSensors, SerialArm
from lpv_identify.assembly import (
    consistent_parameters,
    covariance_of_all,
    fit_of,
    with_parameters,
)
from lpv_identify.base_parameters import BaseParameters, find_base_parameters
from lpv_identify.delays import effort_delays, rate_delays
from lpv_identify.determination import Determination, determine
from lpv_identify.evaluation import Figures, Prediction, figures, predict
from lpv_identify.friction import TERMS
from lpv_identify.motion import (
    Bandwidths,
    Motion,
    Segment,
    check_motion,
    find_bandwidths,
    smooth,
    split,
)
from lpv_identify.noise import noise_deviation, quantization_step
from lpv_identify.prior import structural_prior
from lpv_identify.rates import rate_sources
from lpv_identify.recording import Recording
from lpv_identify.regression import Filters, Fit, Prior, Rows, fit_parameters, make_rows
from lpv_identify.rigid_body import build_model
from lpv_identify.selection import (
    choose_effort_band,
    choose_load,
    choose_prior,
    divide,
    validation_error,
)
from lpv_identify.tolerance import torque_tolerance

WEAK = 1e-3
"""Strength of the prior while the model is chosen."""
_BETTER = 0.95  # ratio of mean squares below which a correction is made


@dataclass(frozen=True)
class Options:
    """What the user says of recordings and fit."""

    train_share: float = 0.6  # of every recording; the rest is held back
    refit: bool = False  # write the parameters of a fit to all samples


@dataclass(frozen=True)
class Sensing:
    """What was found of the sensors; arrays of shape (n,)."""

    position_noise: np.ndarray  # [rad]
    quantization: np.ndarray  # [rad]
    velocity_noise: np.ndarray  # [rad/s]
    rates: list[str]  # source of the rates of each joint
    rate_evidence: np.ndarray  # correlation of the fast parts of rates and positions
    rate_delay: np.ndarray  # of rates behind positions [s]
    effort_delay: np.ndarray  # of efforts behind motion [s]


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
    base: BaseParameters
    bandwidths: Bandwidths
    filters: Filters
    strength: float  # of the prior
    used_rates: bool  # measured rates were used
    warnings: tuple[str, ...]


def identify(
    arm: SerialArm,
    recordings: Sequence[Recording],
    options: Options | None = None,
    tests: Sequence[Recording] = (),
) -> Identification:
    """Identify an arm from recordings.

    Parameters
    ----------
    arm : SerialArm
        Kinematics, first guess of the inertias, limits, gains of the efforts.
    recordings : sequence of Recording
        To fit; the last part of each is held back, unless there are ``tests``.
    options : Options, optional
        Choices of the user.
    tests : sequence of Recording, optional
        Other recordings, to test on.

    Returns
    -------
    Identification
        Arm and figures.

    Raises
    ------
    IdentificationError
        If the recordings cannot identify the arm.
    """
    options = options or Options()
    workshop = _Workshop(arm, recordings)
    share = 1.0 if tests else options.train_share
    workshop.choose(share)
    fit, strength = workshop.fit(share)
    found = workshop.arm_of(fit, strength)
    held_back = workshop.test_rows(share, tests)
    predictions = [
        predict(
            rows, fit_of(found, workshop.base, fit), workshop.filters, motion.time, motion.position
        )
        for rows, motion in held_back
    ]
    before = [
        predict(
            rows, fit_of(arm, workshop.base, fit), workshop.filters, motion.time, motion.position
        )
        for rows, motion in held_back
    ]
    if options.refit:
        fit, _ = workshop.fit(1.0)
        found = workshop.arm_of(fit, strength)
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
        workshop.base,
        workshop.bands,
        workshop.filters,
        strength,
        workshop.use_rates,
        tuple(workshop.warnings),
    )


class _Workshop:
    """Recordings, and the choices that are made on the way."""

    def __init__(self, arm: SerialArm, recordings: Sequence[Recording]):
        self.arm = arm
        self.n = len(arm.joints)
        self.gain = np.array([joint.torque_gain for joint in arm.joints])
        self.segments = [segment for one in recordings for segment in split(one)]
        self.warnings = [text for one in recordings for text in one.warnings]
        self.warnings += check_motion(self.segments, arm.joint_names)
        self.step = max(segment.step for segment in self.segments)
        self.bands = find_bandwidths(self.segments)
        self.model = build_model(arm)
        self.base = find_base_parameters(self.model)
        self.prior = _base_prior(arm, self.base)
        self.use_rates = self.segments[0].velocity is not None
        self.rate_delay = (
            rate_delays(self.segments, self.bands) if self.use_rates else np.zeros(self.n)
        )
        self.effort_delay = np.zeros(self.n)
        self.joint_delays = np.zeros(self.n)
        self.use_load = np.zeros(self.n, bool)
        thinning = max(1, int(1.0 / (8.0 * self.bands.analysis * self.step)))
        self.filters = Filters(np.inf, self.bands.analysis, thinning)
        self.strength = 1.0
        self._prepare()

    def _prepare(self) -> None:
        self.motions = [self._motion(segment) for segment in self.segments]
        self.rows = [self._rows(motion) for motion in self.motions]

    def _motion(self, segment: Segment) -> Motion:
        scaled = replace(segment, effort=segment.effort * self.gain)
        return smooth(scaled, self.bands, self.use_rates, self.rate_delay, self.effort_delay)

    def _rows(self, motion: Motion) -> Rows:
        limit = 1.1 * np.array([joint.limits.velocity for joint in self.arm.joints])
        rows = make_rows(self.model, self.base, motion, limit, self.arm.effort_includes_gravity)
        margin = min(int(np.ceil(0.5 / (self.bands.analysis * self.step))), len(motion.time) // 10)
        return replace(rows, part=slice(margin, len(motion.time) - margin))

    def train_rows(self, share: float) -> list[Rows]:
        return [divide(rows, share)[0] for rows in self.rows]

    def test_rows(self, share: float, tests: Sequence[Recording]) -> list[tuple[Rows, Motion]]:
        if not tests:
            return [
                (divide(rows, share)[1], motion) for rows, motion in zip(self.rows, self.motions)
            ]
        motions = [self._motion(segment) for one in tests for segment in split(one)]
        return [(self._rows(motion), motion) for motion in motions]

    def choose(self, share: float) -> None:
        """Rates, bandwidth of the efforts, delay, load: by prediction within the training data."""
        weak = Prior(self.prior.mean, WEAK * self.prior.information)
        if self.use_rates:
            self._choose_rates(share)
        rows = self.train_rows(share)
        band = choose_effort_band(rows, self.filters, self.use_load, weak)
        self.filters = replace(self.filters, effort=band)
        rows = self.train_rows(share)
        slope = fit_parameters(rows, self.filters, self.use_load, weak).slope
        self.use_load = choose_load(rows, self.filters, weak, slope)
        self._choose_delay(share)

    def consistent_fit(
        self, rows: Sequence[Rows], strength: float, slope: np.ndarray | None = None
    ) -> Fit:
        """Fit whose parameters belong to bodies of positive mass."""
        prior = Prior(self.prior.mean, strength * self.prior.information)
        fit = fit_parameters(rows, self.filters, self.use_load, prior, slope)
        return fit_of(self.arm_of(fit, strength), self.base, fit)

    def _error(self, share: float) -> float:
        """Mean logarithm of the mean square errors on blocks held back of the training data."""
        rows = self.train_rows(share)
        slope = self.consistent_fit(rows, 1.0).slope
        errors = validation_error(
            rows, self.filters, lambda part: self.consistent_fit(part, 1.0, slope)
        )
        return float(np.mean(np.log(errors)))

    def _choose_rates(self, share: float) -> None:
        """Measured rates, unless derivatives of the positions predict better."""
        measured = self._error(share)
        kept = self.motions, self.rows
        self.use_rates = False
        self._prepare()
        if self._error(share) > measured + np.log(_BETTER):
            self.use_rates = True
            self.motions, self.rows = kept

    def _choose_delay(self, share: float) -> None:
        """Delays of the efforts, if predictions gain from them.

        A drive that follows late looks like a negative inertia, which no body has.
        """
        before = self._error(share)
        kept = self.motions, self.rows
        for _ in range(2):
            rows = self.train_rows(share)
            found = self.consistent_fit(rows, 1.0)
            self.effort_delay = self.effort_delay + effort_delays(rows, found, self.filters)
            self._prepare()
        self.joint_delays = self.effort_delay
        if self._error(share) > before + np.log(_BETTER):
            self.effort_delay = np.zeros(self.n)
            self.motions, self.rows = kept

    def fit(self, share: float) -> tuple[Fit, float]:
        """Fit with the prior of the strength that predicts best, and this strength."""
        rows = self.train_rows(share)
        slope = self.consistent_fit(rows, 1.0).slope
        strength = choose_prior(
            rows, self.filters, lambda tried: lambda part: self.consistent_fit(part, tried, slope)
        )
        strong = Prior(self.prior.mean, strength * self.prior.information)
        return fit_parameters(rows, self.filters, self.use_load, strong), strength

    def free_fit(self, share: float, slope: np.ndarray) -> Fit:
        """Fit without a prior: its covariance is that of the data."""
        return fit_parameters(
            self.train_rows(share), self.filters, self.use_load, None, slope, signed=False
        )

    def arm_of(self, fit: Fit, strength: float) -> SerialArm:
        values = consistent_parameters(self.arm, self.base, fit, strength)
        return with_parameters(self.arm, values, fit.slope)

    def sensing(self) -> Sensing:
        """Noise, quantization, source of rates, delays."""
        positions = [segment.position for segment in self.segments]
        rates = [s.velocity for s in self.segments if s.velocity is not None]
        sources, evidence = rate_sources(self.segments)
        noise = noise_deviation(rates) if rates else np.full(self.n, 1e-2)
        return Sensing(
            noise_deviation(positions),
            quantization_step(positions),
            noise,
            sources,
            evidence,
            self.rate_delay,
            self.joint_delays,
        )


def _base_prior(arm: SerialArm, base: BaseParameters) -> Prior:
    mean, sigma = structural_prior(arm)
    covariance = (base.combination * sigma**2) @ base.combination.T
    size = base.size + len(TERMS) * len(arm.joints)
    information = np.zeros((size, size))
    information[: base.size, : base.size] = np.linalg.inv(covariance)
    return Prior(np.concatenate([base.combination @ mean, np.zeros(size - base.size)]), information)


def _finish(
    arm: SerialArm,
    workshop: _Workshop,
    sensing: Sensing,
    predictions: Sequence[Prediction],
    determination: Determination,
    fit: Fit,
) -> SerialArm:
    """The arm with sensors, tolerances, delays and covariance."""
    speed = np.concatenate([p.velocity for p in predictions])
    residual = np.concatenate([p.measured - p.predicted for p in predictions])
    joints = []
    for j, joint in enumerate(arm.joints):
        sensors = JointSensors(
            joint.sensors.name,
            max(float(sensing.position_noise[j]), 1e-9),
            float(sensing.quantization[j]),
            sensing.rates[j],
            max(float(sensing.velocity_noise[j]), 1e-9),
            joint.sensors.second_encoder,
        )
        joints.append(
            replace(
                joint,
                sensors=sensors,
                effort_delay=float(workshop.effort_delay[j]),
                torque_tolerance=torque_tolerance(speed[:, j], residual[:, j]),
            )
        )
    covariance = covariance_of_all(
        workshop.arm, workshop.base, fit, int(determination.determined.sum())
    )
    return replace(
        arm,
        joints=tuple(joints),
        covariance=covariance,
        sample_time=workshop.step,
        effort_bandwidth=workshop.filters.effort,
    )
