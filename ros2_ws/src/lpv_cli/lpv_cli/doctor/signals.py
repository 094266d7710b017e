"""Checks of what measured signals mean: their units, and whether rates are independent."""

from typing import Any

import numpy as np

from lpv_cli.doctor.findings import Finding, error, ok, warn
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joint_order import JointOrder
from lpv_core.model.joints import JointMap
from lpv_core.residual.rate_independence import contradicts, rate_source
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import SampleError

_DEGREES = 180.0 / np.pi
_FAR = 4.0 * np.pi
"""Positions beyond two turns are no angles of an arm in rad."""
_MOTION = 0.05
"""Least change of a position from which rates are compared with it [rad]."""
_BETTER = 0.3
"""Share of the torque residual that must be left if positions are taken as degrees."""
_IN_RADIANS = 'let the driver publish rad, rad/s and N m in sensor_msgs/JointState (REP-103)'


def samples(messages: list[Any], arm: Arm) -> tuple[np.ndarray, ...] | None:
    """Stamps [ns], positions, rates and efforts of the arm's joints; None without all of them."""
    order = JointOrder(arm.joint_names, needs_rates=not isinstance(arm, SerialArm))
    try:
        rows = [order.pick(message) for message in messages]
    except SampleError:
        return None
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
    place = np.unique(stamps, return_index=True)[1]
    arrays = (np.array([row[i] for row in rows], float)[place] for i in range(3))
    return (np.array(stamps, np.int64)[place], *arrays)


def check_units(topic: str, messages: list[Any], arm: Arm) -> Finding | None:
    """Whether positions look like degrees: by size, by their rates, or by gravity."""
    found = samples(messages, arm)
    if found is None or len(found[0]) < 2:
        return None
    stamps, position, velocity, effort = found
    if np.nanmax(np.abs(position), initial=0.0) > _FAR:
        largest = np.nanmax(np.abs(position))
        return error('units', f'{topic}: a position is {largest:.3g} rad: degrees?', _IN_RADIANS)
    # Between samples the mean rate counts, so that sampling does not matter.
    steps = np.diff(stamps)[:, None] / 1e9
    moved, driven = np.diff(position, axis=0), 0.5 * (velocity[1:] + velocity[:-1]) * steps
    for i, name in enumerate(arm.joint_names):
        kept = np.isfinite(moved[:, i]) & np.isfinite(driven[:, i])
        power = float(driven[kept, i] @ driven[kept, i])
        if np.abs(moved[kept, i]).sum() < _MOTION or not power > 0.0:
            continue
        ratio = float(moved[kept, i] @ driven[kept, i]) / power
        for factor, text in (
            (_DEGREES, 'positions in degrees'),
            (1 / _DEGREES, 'rates in degrees'),
        ):
            if 0.7 < ratio / factor < 1.4:
                return error(
                    'units',
                    f'{topic}: {name} moves {ratio:.3g} times as far as its rate says: {text}?',
                    _IN_RADIANS,
                )
    if isinstance(arm, SerialArm):
        return None
    return _against_gravity(topic, position, effort, arm)


def _against_gravity(
    topic: str, position: np.ndarray, effort: np.ndarray, arm: ArmParameters
) -> Finding | None:
    """Torques that hold the arm fit gravity at its angles, in rad."""
    known = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    if not known.any() or not np.abs(effort[known]).max() > 0.0:
        return None
    joints, gravity = JointMap(arm), np.asarray(arm.constants().gravity)
    torque = joints.absolute_torque(effort[known])

    def residual(q: np.ndarray) -> float:
        held = -gravity * np.sin(joints.absolute_position(q))
        return float(np.sqrt(np.mean((torque - held) ** 2)))

    as_said, in_degrees = residual(position[known]), residual(position[known] / _DEGREES)
    if as_said < 0.2 * float(gravity.max()) or in_degrees > _BETTER * as_said:
        return None
    return error(
        'units',
        f'{topic}: torques fit gravity within {in_degrees:.3g} N m if positions are degrees, and '
        f'within {as_said:.3g} N m if they are rad',
        _IN_RADIANS,
    )


def check_rate_source(topic: str, messages: list[Any], arm: Arm) -> Finding | None:
    """Whether rates are what the arm file says: independent, or derived from the positions."""
    found = samples(messages, arm)
    if found is None or not np.isfinite(found[2]).all():
        return None  # its own finding
    stamps, position, velocity, _ = found
    sources = [
        rate_source(stamps, position[:, i], velocity[:, i]) for i in range(position.shape[1])
    ]
    texts = [
        f'{name} {found.source}'
        + (
            ''
            if np.isnan(found.explained)
            else f' ({100 * max(found.explained, 0.0):.0f}% derived)'
        )
        for name, found in zip(arm.joint_names, sources)
    ]
    if all(source.source == 'undecided' for source in sources):
        return None  # at rest, or too few samples
    text = f'{topic}: ' + ', '.join(texts)
    if isinstance(arm, SerialArm):
        stated = [joint.sensors.rates for joint in arm.joints]
    else:
        stated = [arm.rates] * len(sources)
    wrong = {
        s.source
        for said, s in zip(stated, sources)
        if said != 'none' and contradicts(said, s.source)
    }
    if not wrong:
        return ok('rates', text)
    return warn(
        'rates',
        f'{text}; the arm file says {", ".join(dict.fromkeys(stated))}',
        f'set sensors.rates of the arm file to {" or ".join(sorted(wrong))} and design the gains '
        'again: with derived rates an encoder and its rate go wrong together',
    )
