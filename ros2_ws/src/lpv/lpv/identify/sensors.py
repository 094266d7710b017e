"""What a recording says of the sensors: noise, steps, source of rates, jitter, second encoders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lpv.bag.run.csv_import import ColumnMap
from lpv.core.serial_arm.description import JointSensors, PositionSensor, SerialArm
from lpv.core.serial_arm.rate_independence import rate_source
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import SMALL
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.assembly import with_joint_values
from lpv.identify.estimation.robust import robust_scale
from lpv.identify.recordings.recording import LARGEST, Recording, read_pairs

_ORDER = 3  # of the differences that show noise: motion up to a constant acceleration has none
_NEAR = 1.5  # times the median: samples that are further apart have a gap between them
_FEW = 20  # gaps between levels, fewer of which show no step
_SAME_SCALE = 0.1  # deviation of the scale from 1 beyond which it measures something else


@dataclass(frozen=True)
class Sensing:
    """What was found of the sensors; arrays of shape (n,)."""

    position_noise: np.ndarray  # without quantization [rad]
    quantization: np.ndarray  # step of the positions, 0 if there is none [rad]
    velocity_noise: np.ndarray  # [rad/s]
    rates: list[str]  # source of the rates: 'independent' where that is proved
    rate_evidence: np.ndarray  # share of the rates' noise that positions explain; NaN: not known
    jitter: float  # standard deviation of the stamps' distances [s]
    rate_delay: np.ndarray  # of rates behind positions [s]
    effort_delay: np.ndarray  # of efforts behind motion [s]

    def on(self, arm: SerialArm) -> SerialArm:
        """The arm with these sensors; their names stay."""
        sensors = [
            replace(
                joint.sensors,
                position_noise=max(float(self.position_noise[j]), 1e-9),
                quantization=float(self.quantization[j]),
                rates=self.rates[j],
                velocity_noise=max(float(self.velocity_noise[j]), 1e-9),
            )
            for j, joint in enumerate(arm.joints)
        ]
        return with_joint_values(arm, sensors=sensors)


def sense(
    recordings: Sequence[Recording],
    rate_delay: np.ndarray,  # shape (n,) [s]
    effort_delay: np.ndarray,  # shape (n,) [s]
) -> Sensing:
    """What recordings say of the sensors."""
    n = recordings[0].position.shape[1]
    step = quantization_step([one.position for one in recordings])
    times = [one.time for one in recordings]
    noise = noise_deviation([one.position for one in recordings], times)
    # What rounding does not explain; of a rounded signal at rest little is known.
    noise = np.sqrt(np.maximum(noise**2 - step**2 / 12.0, (0.05 * step) ** 2))
    rated = [one for one in recordings if one.velocity is not None]
    rates, rate_times = [one.rates for one in rated], [one.time for one in rated]
    sources, evidence = rate_sources(recordings)
    intervals = np.concatenate([np.diff(time) for time in times])
    near = intervals[intervals < 2.0 * np.median(intervals)]
    return Sensing(
        noise,
        step,
        noise_deviation(rates, rate_times) if rates else np.full(n, JointSensors.velocity_noise),
        sources,
        evidence,
        float(np.std(near)),
        rate_delay,
        effort_delay,
    )


def rate_sources(recordings: Sequence[Recording]) -> tuple[list[str], np.ndarray]:
    """Source of the rates of each joint and its evidence, shape (n,), of the longest recording."""
    # 'derived' unless independence is proved: a fault of the encoder is in derived rates, too.
    one = max(recordings, key=lambda r: len(r.time))
    n = one.position.shape[1]
    if one.velocity is None:
        return ['none'] * n, np.full(n, np.nan)
    found = [rate_source(one.stamps, one.position[:, j], one.velocity[:, j]) for j in range(n)]
    sources = ['derived' if f.source == 'undecided' else f.source for f in found]
    return sources, np.array([f.explained for f in found])


def noise_deviation(signals: Sequence[np.ndarray], times: Sequence[np.ndarray] = ()) -> np.ndarray:
    """Deviation of white noise by third differences of each column, shape (n,).

    Samples are evenly spaced unless their ``times`` are given: what was interpolated has less noise
    than what was measured.
    """
    times = times or [np.arange(len(signal)) for signal in signals]
    changes = np.concatenate([_differences(*pair) for pair in zip(signals, times)])
    # A quantized signal at rest does not change; the median would be 0 there.
    robust = robust_scale(changes, np.ones(changes.shape, bool))
    usual = np.quantile(changes, (0.02, 0.98), axis=0)
    spread = np.sqrt(np.mean(np.clip(changes, *usual) ** 2, axis=0))
    return np.where(robust > 0.0, robust, spread)


def _differences(signal: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Divided differences that are as large as the noise, of samples without a gap."""
    places = sliding_window_view(time, _ORDER + 1)
    length = places[:, -1] - places[:, 0]
    near = length <= _NEAR * np.median(length)
    for k in range(_ORDER):
        signal = np.diff(signal, axis=0) / (time[k + 1 :] - time[: -k - 1])[:, None]
    squares = 0.0
    for i in range(_ORDER + 1):
        squares += np.prod(places[:, [i]] - np.delete(places, i, axis=1), axis=1) ** -2.0
    return np.asarray(signal / np.sqrt(squares)[:, None])[near]


def quantization_step(signals: Sequence[np.ndarray]) -> np.ndarray:
    """Step of each column, shape (n,), of which differences are multiples; 0 if there is none."""
    columns = [np.concatenate([s[:, j] for s in signals]) for j in range(signals[0].shape[1])]
    return np.array([_step(column) for column in columns])


def _step(values: np.ndarray) -> float:
    gaps = np.diff(np.unique(values))
    # Rounding errors of the driver blur the levels by far less than a step.
    gaps = gaps[gaps > 1e-6 * np.median(gaps)] if len(gaps) else gaps
    if len(gaps) < _FEW:
        return 0.0
    for step in (np.quantile(gaps, 0.05), gaps.min()):
        near = gaps[gaps < 30.0 * step]
        multiples = np.round(near / step)
        if len(near) >= _FEW and np.mean(np.abs(near / step - multiples) < 0.1) > 0.9:
            return float(np.sum(near) / np.sum(multiples))
    return 0.0


@dataclass(frozen=True)
class SecondReading:
    """What a recording says of the second encoder of a joint."""

    joint: str  # name of the joint
    encoder: PositionSensor  # its noise and quantization
    scale: float  # second reading by first; negative where it counts the other way
    offset: float  # of the second reading [rad]
    difference: float  # RMS of what scale and offset leave: elasticity, backlash, noise [rad]


def find_second_encoders(
    path: str | Path,
    pairs: Mapping[str, str],
    topic: str | None = None,
    columns: ColumnMap | None = None,
) -> list[SecondReading]:
    """Compare second encoders, by joint, with the first ones; IdentificationError."""
    first, second = read_pairs(path, list(pairs), list(pairs.values()), topic, columns)
    valid = (np.abs(np.hstack([first, second])) <= LARGEST).all(axis=1)
    if valid.sum() < 100:
        raise IdentificationError(
            f'{path}: only {valid.sum()} samples have readings of both encoders'
        )
    first, second = first[valid], second[valid]
    noise, step = noise_deviation([second]), quantization_step([second])
    found = []
    for j, (joint, name) in enumerate(pairs.items()):
        scale, offset = 1.0, float(np.median(second[:, j] - first[:, j]))
        if np.ptp(first[:, j]) > SMALL:
            scale, offset = (float(v) for v in np.polyfit(first[:, j], second[:, j], 1))
        if not abs(abs(scale) - 1.0) < _SAME_SCALE:
            raise IdentificationError(
                f'{path}: {name} turns {scale:.3g} times as far as {joint}, so that it is no '
                'second encoder of this joint in rad, or m, at the joint'
            )
        rest = second[:, j] - scale * first[:, j] - offset
        encoder = PositionSensor(name, max(float(noise[j]), 1e-9), float(step[j]))
        found.append(SecondReading(joint, encoder, scale, offset, float(np.sqrt(np.mean(rest**2)))))
    return found


def with_second_encoders(arm: SerialArm, found: Sequence[SecondReading]) -> SerialArm:
    """The arm with second encoders; ConfigError for joints that it does not have."""
    encoders = {one.joint: one.encoder for one in found}
    unknown = [name for name in encoders if name not in arm.joint_names]
    if unknown:
        raise ConfigError('--second-encoder', f'{arm.name} has no joint {unknown[0]!r}')
    known = {joint.name: joint.sensors.second_encoder for joint in arm.joints} | encoders
    sensors = [replace(j.sensors, second_encoder=known[j.name]) for j in arm.joints]
    return with_joint_values(arm, sensors=sensors)


def describe(reading: SecondReading, unit: str) -> str:
    """One line on a second encoder; unit of the joint's position."""
    encoder = reading.encoder
    return (
        f'second encoder of {reading.joint}, {encoder.name}: noise '
        f'{encoder.position_noise:.2g} {unit}, step {encoder.quantization:.2g} {unit}, scale '
        f'{reading.scale:.4f}, offset {reading.offset:.4f} {unit}, differs by '
        f'{1e3 * reading.difference:.3f} m{unit} RMS'
    )
