"""Checks of the measurements that were heard."""

import math
from typing import Any

import numpy as np

from lpv_cli.doctor.findings import Finding, Level, error, ok, warn
from lpv_cli.doctor.signals import check_rate_source, check_units
from lpv_cli.doctor.watch import Snapshot
from lpv_core.model.joint_order import JointOrder
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import SampleError

_FAR = 0.5
"""Largest difference between stamp and clock [s]."""
_UNEVEN = 1.5
"""Largest ratio of measured to expected interval."""


def check_measurements(shot: Snapshot, arm: Arm | None) -> list[Finding]:
    """Run all checks of the measurements."""
    findings = []
    for topic, heard in sorted(shot.measured.items()):
        if not heard:
            findings.append(
                error(
                    'measurements',
                    f'{topic} is silent',
                    'the driver or simulator is not active, '
                    'or waits (lockstep: for the torque that answers); see its log',
                )
            )
            continue
        messages = [message for _, message in heard]
        problems = [
            check_joints(topic, messages[-1], arm),
            check_efforts(topic, messages, shot),
            check_values(topic, messages, needs_rates(arm)),
            check_stamps(topic, heard, shot),
            check_rate(topic, messages, arm, shot),
        ]
        if arm is not None:
            problems += [check_units(topic, messages, arm), check_rate_source(topic, messages, arm)]
        found = [p for p in problems if p is not None]
        if all(p.level == Level.OK for p in found):
            text = f'{topic}: {len(messages)} messages in {shot.seconds:g} s'
            found.insert(0, ok('measurements', text))
        findings += found
    return findings


def check_joints(topic: str, message: Any, arm: Arm | None) -> Finding | None:
    """Names and sizes against the arm file."""
    if arm is None:
        return None
    try:
        JointOrder(arm.joint_names).indices(message.name)
    except SampleError as problem:
        return error(
            'joints',
            f'{topic}: {problem}',
            'put the names of the driver into '
            'the arm file (and design the gains of a two-link arm again), or correct the driver',
        )
    return None


def check_efforts(topic: str, messages: list[Any], shot: Snapshot) -> Finding | None:
    """Whether torques are measured where the observer takes them from."""
    sources = [values.get('torque_source') for values in shot.parameters.values()]
    if 'command' in sources and 'effort' not in sources:
        return None
    without = sum(not len(m.effort) or not np.isfinite(m.effort).all() for m in messages)
    if not without:
        return None
    return error(
        'efforts',
        f'{topic}: {without} of {len(messages)} messages carry no effort',
        'let the driver publish joint torques in effort [N m], or start the observer '
        'with torque_source:=command',
    )


def needs_rates(arm: Arm | None) -> bool:
    """Whether an arm's sensors measure rates of their own, or its observer needs them."""
    if isinstance(arm, SerialArm):
        return any(joint.sensors.rates == 'independent' for joint in arm.joints)
    return True


def check_values(topic: str, messages: list[Any], rates: bool = True) -> Finding | None:
    """Whether positions and, where they are needed, rates are there, and numbers."""
    count = len(messages)
    without = sum(not len(m.velocity) for m in messages)
    if without and rates:
        return error(
            'values',
            f'{topic}: {without} of {count} messages carry no rates (velocity is empty)',
            'let the driver publish joint rates in velocity [rad/s]: samples without are not used',
        )
    odd = sum({len(m.position), len(m.velocity) or len(m.name)} != {len(m.name)} for m in messages)
    if odd:
        return error(
            'values',
            f'{topic}: {odd} of {count} messages have other numbers of positions or rates than '
            'of names',
            'let the driver publish one position and one rate per joint',
        )
    bad = sum(not np.isfinite([*m.position, *m.velocity]).all() for m in messages)
    if not bad:
        return None
    return error(
        'values',
        f'{topic}: {bad} of {count} messages have positions or rates that are not numbers',
        'see the sensors and their driver; the observer predicts positions for some time, and does '
        'not use samples without rates',
    )


def check_stamps(topic: str, heard: list[tuple[int, Any]], shot: Snapshot) -> Finding | None:
    """Whether stamps are set, increase, and are near the clock."""
    stamps = np.array([_nanoseconds(m) for _, m in heard], dtype=np.int64)
    if not stamps.any():
        return error(
            'stamps',
            f'{topic}: stamps are zero',
            'let the driver stamp its messages with the time of measurement',
        )
    backwards = int((np.diff(stamps) < 0).sum())
    if backwards:
        return error(
            'stamps',
            f'{topic}: time goes backwards {backwards} times in {len(stamps)} messages',
            'two sources publish on the topic, or a bag is played in a loop',
        )
    clock, name = np.array([t for t, _ in heard], dtype=np.int64), 'the clock of this machine'
    if any(v.get('lockstep') or v.get('use_sim_time') for v in shot.parameters.values()):
        if not shot.clock:
            return None  # its own finding
        arrived, told = np.array(shot.clock, dtype=np.int64).T
        clock, name = told[np.searchsorted(arrived, clock).clip(max=len(told) - 1)], '/clock'
    offset = float(np.median((stamps - clock) / 1e9))
    if abs(offset) <= _FAR:
        return None
    return error(
        'stamps',
        f'{topic}: stamps are {abs(offset):.3g} s {"ahead of" if offset > 0 else "behind"} {name}',
        'synchronise the clocks (chrony), stamp with the time of measurement since 1970, '
        'or set use_sim_time where a bag or simulator drives /clock',
    )


def check_rate(topic: str, messages: list[Any], arm: Arm | None, shot: Snapshot) -> Finding | None:
    """Whether samples come as often as the gains were designed for."""
    stamps = np.unique([_nanoseconds(m) for m in messages])
    if arm is None or len(stamps) < 10:
        return None
    interval = float(np.median(np.diff(stamps))) / 1e9
    ratio = interval / arm.sample_time
    if 1.0 / _UNEVEN <= ratio <= _UNEVEN or math.isnan(ratio):
        return None
    return warn(
        'rate',
        f'{topic}: one sample every {1e3 * interval:.3g} ms, the arm file says '
        f'{1e3 * arm.sample_time:.3g} ms',
        'set sample_time of the arm file to that of the driver and design the gains again',
    )


def _nanoseconds(message: Any) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
