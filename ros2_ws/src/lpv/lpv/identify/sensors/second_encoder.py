"""Second position sensors of joints: their noise, and how far they agree with the first."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lpv.bag.run.csv_import import ColumnMap
from lpv.core.serial_arm.description import SecondEncoder, SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import SMALL
from lpv.identify.errors import IdentificationError
from lpv.identify.recordings.recording import LARGEST, read_pairs
from lpv.identify.sensors.sensing import noise_deviation, quantization_step

_SAME_SCALE = 0.1  # deviation of the scale from 1 beyond which it measures something else


@dataclass(frozen=True)
class SecondReading:
    """What a recording says of the second encoder of a joint."""

    joint: str  # name of the joint
    encoder: SecondEncoder  # its noise and quantization
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
                'second encoder of this joint in rad at the joint'
            )
        rest = second[:, j] - scale * first[:, j] - offset
        encoder = SecondEncoder(name, max(float(noise[j]), 1e-9), float(step[j]))
        found.append(SecondReading(joint, encoder, scale, offset, float(np.sqrt(np.mean(rest**2)))))
    return found


def with_second_encoders(arm: SerialArm, found: Sequence[SecondReading]) -> SerialArm:
    """The arm with second encoders; ConfigError for joints that it does not have."""
    encoders = {one.joint: one.encoder for one in found}
    unknown = [name for name in encoders if name not in arm.joint_names]
    if unknown:
        raise ConfigError('--second-encoder', f'{arm.name} has no joint {unknown[0]!r}')
    joints = []
    for joint in arm.joints:
        second = encoders.get(joint.name, joint.sensors.second_encoder)
        joints.append(replace(joint, sensors=replace(joint.sensors, second_encoder=second)))
    return replace(arm, joints=tuple(joints))


def describe(reading: SecondReading) -> str:
    """One line on a second encoder."""
    encoder = reading.encoder
    return (
        f'second encoder of {reading.joint}, {encoder.name}: noise '
        f'{encoder.position_noise:.2g} rad, step {encoder.quantization:.2g} rad, scale '
        f'{reading.scale:.4f}, offset {reading.offset:.4f} rad, differs by '
        f'{1e3 * reading.difference:.3f} mrad RMS'
    )
