"""Torque that the model misses: its size, its growth with speed, how long it lasts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm, TorqueTolerance
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.parameter_error import model_error, typical_torque
from lpv.core.support.limits import SMALL
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.autocorrelation import autocovariance
from lpv.identify.estimation.evaluation import explained, hardly_explained
from lpv.identify.estimation.health import unhealthy
from lpv.identify.model.rigid_body import joint_torques
from lpv.identify.recordings.filters import derivative, low_pass
from lpv.identify.recordings.motion import (
    Motion,
    Segment,
    check_efforts,
    find_bandwidths,
    moving,
    smooth,
    split,
)
from lpv.identify.recordings.recording import Recording
from lpv.identify.sensors import Sensing, noise_deviation, sense

_QUANTILE = 0.99  # of residuals that an envelope holds
_BINS = 8  # of speed
_LEAST = 30  # samples of a bin


@dataclass(frozen=True)
class TorqueError:
    """What a model misses, sigma(v)^2 = slow^2 + (growth v)^2, without the efforts' white noise."""

    slow: np.ndarray  # in slow motion, shape (n,) [N m]
    growth: np.ndarray  # with the joint's rate, shape (n,) [N m s/rad]
    time: float  # in which its correlation falls to 1/e, median of the joints [s]

    def on(self, arm: SerialArm) -> SerialArm:
        """The arm with this uncertainty."""
        slow, growth = (tuple(float(f'{v:.4g}') for v in x) for x in (self.slow, self.growth))
        stated = replace(
            arm.uncertainty,
            torque_error=slow,
            torque_error_speed=growth,
            torque_error_time=float(f'{self.time:.4g}'),
        )
        return replace(arm, uncertainty=stated)


@dataclass(frozen=True)
class Calibration:
    """A given arm with what a recording says of its sensors and of its model's errors."""

    arm: SerialArm  # parameters are those given
    sensing: Sensing
    error: TorqueError
    rms: np.ndarray  # of efforts minus the model's torques, shape (n,) [N m]
    warnings: tuple[str, ...]


def torque_error(
    rates: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    counts: Sequence[np.ndarray],  # where joints move: friction at rest is no error of the model
    step: float,
    usual: np.ndarray,  # what models miss, before any data, shape (n,) [N m]
) -> TorqueError:
    """Fit the size of what a model misses by least squares of the squares of data held back.

    What is usual, at rest and at usual rates, counts as one independent sample.
    """
    noise = noise_deviation(residuals)
    n, every = len(usual), np.concatenate(counts)
    speed, size = np.concatenate(rates) ** 2, np.concatenate(residuals) ** 2
    slow, growth, lengths = np.zeros((3, n))
    for j in np.arange(n):
        used = [one[:, j].astype(float) for one in counts]
        parts = [r[:, j] * one for one, r in zip(used, residuals)]
        lengths[j] = _correlation_length(parts, used, float(noise[j]))
        fast = np.append(speed[every[:, j], j], [0.0, priors.USUAL_RATE**2])
        squares = np.maximum(size[every[:, j], j] - noise[j] ** 2, 0.0)
        target, often = np.append(squares, 2 * [usual[j] ** 2]), np.ones(len(fast))
        often[-2:] = lengths[j]
        least = max(1e-4 * float(np.mean(target)), 1e-18)
        rows = np.sqrt(often)[:, None] * np.column_stack([np.ones(len(target)), fast, target])
        variance = np.full(len(target), 1.0)
        for _ in range(3):  # twice weighted by what the squares say
            upper = np.asarray(np.linalg.qr(rows / variance[:, None], mode='r'))
            (constant, slope), _ = nnls(upper[:, :2], upper[:, -1])
            variance = np.maximum(constant + slope * fast, least)
            variance = variance / variance.mean()
        slow[j], growth[j] = np.sqrt(max(constant, least)), np.sqrt(slope)
    seen = every.any(axis=0)
    return TorqueError(slow, growth, step * float(np.median(lengths[seen if seen.any() else ...])))


def usual_error(arm: SerialArm) -> np.ndarray:
    """Torque that models miss for as long as a pose lasts, shape (n,) [N m]."""
    return priors.LASTING * model_error(arm) * typical_torque(compile_chain(arm), arm.scales())


def _correlation_length(
    residuals: Sequence[np.ndarray], counts: Sequence[np.ndarray], noise: float
) -> float:
    """Samples in which the correlation of what is not white falls to 1/e.

    Residuals that do not count are 0.
    """
    longest = max(2, max(len(r) for r in residuals) // 4)
    gamma = autocovariance(residuals, longest)
    pairs = np.maximum(autocovariance(counts, longest), 1e-9)
    # Where all is noise, next to nothing is left to compare with.
    value = np.clip(gamma / pairs / max(gamma[0] / pairs[0] - noise**2, 1e-18), -1.0, 1.0)
    value[0] = 1.0
    below = np.flatnonzero(value < np.exp(-1.0))
    if not len(below):
        return longest
    lag = int(below[0])
    return lag - 1 + (value[lag - 1] - np.exp(-1.0)) / max(value[lag - 1] - value[lag], 1e-9)


def model_residual(arm: SerialArm, segment: Segment) -> tuple[Motion, np.ndarray]:
    """Motion of a segment, and its efforts minus the torques of an arm's model [N m]."""
    gain = np.array(arm.torque_gain)
    delay = np.array([joint.effort_delay for joint in arm.joints])
    scaled = replace(segment, effort=segment.effort * gain)
    motion = smooth(scaled, find_bandwidths([segment]), False, 0.0 * delay, delay)
    if not arm.effort_includes_gravity:
        arm = replace(arm, gravity=0.0)
    acceleration = derivative(motion.velocity, motion.step)
    torque = joint_torques(arm, motion.position, motion.velocity, acceleration)
    return motion, motion.effort - low_pass(torque, arm.effort_bandwidth, motion.step)


def calibrate(arm: SerialArm, recordings: Sequence[Recording]) -> Calibration:
    """Sensors and errors of a given model from some 10 s of healthy motion."""
    segments = [segment for one in recordings for segment in split(one)]
    check_efforts(segments, arm.joint_names)
    spans = np.ptp(np.concatenate([one.position for one in recordings]), axis=0)
    if frozen := [name for name, span in zip(arm.joint_names, spans) if not span]:
        raise IdentificationError(
            f'readings of {", ".join(frozen)} never change: their noise cannot be measured; record '
            'a motion of all joints'
        )
    parts = [model_residual(arm, segment) for segment in segments]
    # The ends, where filters have no motion to both sides, do not count.
    cuts = [slice(len(r) // 20, len(r) - len(r) // 20) for _, r in parts]
    rates = [motion.velocity[cut] for (motion, _), cut in zip(parts, cuts)]
    residuals = [r[cut] for (_, r), cut in zip(parts, cuts)]
    if not all(np.isfinite(r).all() for r in residuals):
        raise IdentificationError('torques of the model are not finite')
    step = max(segment.step for segment in segments)
    delay = np.array([joint.effort_delay for joint in arm.joints])
    sensing = sense(recordings, 0.0 * delay, delay)
    counts = [moving(rate, one.step, arm.scales()) for rate, one in zip(rates, segments)]
    error = torque_error(rates, residuals, counts, step, usual_error(arm))
    warnings = [text for one in recordings for text in one.warnings]
    fastest = np.max(np.abs(np.concatenate(rates)), axis=0)
    warnings += [
        f'{name} hardly moves: how errors of the model grow with its speed is not seen'
        for name, speed in zip(arm.joint_names, fastest)
        if speed < SMALL
    ]
    efforts = [motion.effort[cut] for (motion, _), cut in zip(parts, cuts)]
    r2 = explained(*map(np.concatenate, (efforts, residuals, counts)))
    warnings += hardly_explained(arm.joint_names, r2)
    rms = np.sqrt(np.mean(np.concatenate(residuals) ** 2, axis=0))
    given = replace(sensing.on(arm), sample_time=step)
    # Without the errors that were measured: they hold what is wrong in the recording.
    warnings += unhealthy(given, recordings, fits=False)
    return Calibration(error.on(given), sensing, error, rms, tuple(warnings))


def torque_tolerance(speed: np.ndarray, residual: np.ndarray) -> TorqueTolerance:
    """Envelope of 99 % of a joint's residuals [N m], in bins of its speed [rad/s]."""
    speed, size = np.abs(speed), np.abs(residual)
    edges = np.quantile(speed, np.linspace(0.0, 1.0, _BINS + 1) ** 1.5) if len(speed) else speed
    points: list[tuple[float, float]] = []
    for low, high in zip(edges[:-1], edges[1:]):
        inside = (speed >= low) & (speed <= high)
        middle = float(np.median(speed[inside])) if inside.sum() >= _LEAST else -1.0
        if middle > (points[-1][0] if points else -1e-9) + 1e-9:
            points.append((round(middle, 6), float(np.quantile(size[inside], _QUANTILE))))
    knots, torques = zip(*(points or [(0.0, float(np.max(size, initial=0.0)))]))
    return TorqueTolerance(knots, torques)
