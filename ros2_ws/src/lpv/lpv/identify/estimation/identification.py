"""From recordings to an identified arm."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.identify.estimation.assembly import covariance_of_all, fit_of, with_joint_values
from lpv.identify.estimation.evaluation import (
    Determination,
    Figures,
    Prediction,
    determine,
    figures,
    hardly_explained,
    predict,
)
from lpv.identify.estimation.health import unhealthy
from lpv.identify.estimation.mistakes import Mistake, find_mistakes
from lpv.identify.estimation.regression import Fit
from lpv.identify.estimation.torque_error import torque_error, torque_tolerance, usual_error
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.recordings.motion import Bandwidths
from lpv.identify.recordings.recording import Recording
from lpv.identify.sensors import Sensing, sense

STEPS = 9
"""Steps of an identification that are reported."""


@dataclass(frozen=True)
class Identification:
    """Identified arm, and how well it does on data that were held back."""

    arm: SerialArm
    figures: Figures  # of the arm, on data held back
    prior_figures: Figures  # of the arm as it was given, on the same data
    predictions: list[Prediction]  # on data held back
    sensing: Sensing
    determination: Determination
    fit: Fit  # to the training data
    bands: Bandwidths
    used_rates: bool  # measured rates were used
    mistakes: tuple[Mistake, ...]  # what is likely wrong in the set-up; part of the warnings, too
    warnings: tuple[str, ...]


def identify(
    arm: SerialArm,
    recordings: Sequence[Recording],
    tests: Sequence[Recording] = (),  # held back; otherwise the rest of every recording is
    report: Callable[[str], None] = lambda step: None,
    train_share: float = 0.6,  # of every recording
    refit: bool = False,  # write the parameters of a fit to all samples
    weight_is_known: bool = False,  # keep what the arm says on gravity in the efforts
) -> Identification:
    """Identify an arm, with rough inertias, from recordings; IdentificationError."""
    report('preparing the motion')
    workshop = Workshop(arm, recordings, 1.0 if tests else train_share)
    workshop.estimate_gains()
    report('looking for mistakes of the set-up')
    # A load it finds by itself.
    mistakes = [m for m in find_mistakes(workshop.arm, recordings) if m.kind != 'load']
    workshop.warnings += [m.text for m in mistakes]
    # With gravity from elsewhere, or other joints' efforts, the weight cannot be judged.
    if [m.kind for m in mistakes] == ['weight'] and not weight_is_known:
        workshop.change_weight()
        mistakes.clear()
        workshop.warnings[-1] += '; taken so'
    arm = workshop.arm
    workshop.choose(report)
    report('fitting the parameters')
    fit = workshop.fit()
    found = workshop.arm_of(fit)
    held_back = workshop.test_rows(tests)
    predictions, before = (
        [predict(rows, fit_of(one, workshop.base, fit), workshop.bands) for rows in held_back]
        for one in (found, arm)
    )
    if refit:
        workshop.share = 1.0
        fit = workshop.fit(fit.prior)
        found = workshop.arm_of(fit)
    workshop.check_scale(fit)
    report('measuring what is uncertain')
    determination = determine(workshop.base, fit, arm)
    sensing = sense(recordings, workshop.rate_delay, workshop.joint_delays)
    found = _finish(found, workshop, sensing, predictions, determination, fit)
    report('looking for faults in the recordings')
    workshop.warnings += unhealthy(found, [*recordings, *tests])
    step = workshop.step
    shown = figures(predictions, workshop.bands, step)
    workshop.warnings += hardly_explained(found.joint_names, shown.r2)
    return Identification(
        found,
        shown,
        figures(before, workshop.bands, step),
        predictions,
        sensing,
        determination,
        fit,
        workshop.bands,
        workshop.use_rates,
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
    rates, residuals = [p.velocity for p in predictions], [p.residual for p in predictions]
    counts = [p.counts for p in predictions]
    speed, missed, used = map(np.concatenate, (rates, residuals, counts))
    tolerances = [torque_tolerance(speed[one, j], missed[one, j]) for j, one in enumerate(used.T)]
    delays = workshop.effort_delay.tolist()
    arm = with_joint_values(arm, effort_delay=delays, torque_tolerance=tolerances)
    determined = int(determination.determined.sum())
    error = torque_error(rates, residuals, counts, workshop.step, usual_error(workshop.arm))
    return replace(
        error.on(sensing.on(arm)),
        covariance=covariance_of_all(workshop.arm, workshop.base, fit, determined),
        sample_time=workshop.step,
        effort_bandwidth=workshop.bands.effort,
    )
