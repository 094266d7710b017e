"""Checks of the measurements that were heard: names, values, units, rates, stamps."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np

from lpv.cli.doctor.finding import Finding, Level, error, ok, warn
from lpv.core.monitoring.idle_efforts import without_efforts
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.sampler import LATE
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.rate_independence import contradicts, rate_source
from lpv.core.serial_arm.turns import Turns
from lpv.core.support.errors import SampleError
from lpv.core.support.limits import SMALL
from lpv.core.support.timestamps import to_nanoseconds

_FAR_CLOCK = 0.5
"""Largest difference between stamp and clock [s]."""
_DEGREES = 180.0 / np.pi  # of a radian
_BETTER = 0.3
"""Share of the torque residual that must be left if positions are taken as degrees."""
_IN_RADIANS = (
    'let the driver publish rad, rad/s and N m (m, m/s and N of joints that slide) in '
    'sensor_msgs/JointState (REP-103)'
)


def check_measurements(shot: Any, arm: SerialArm | None) -> list[Finding]:
    """Run all checks of the measurements of a `Snapshot`."""
    findings = []
    for topic, heard in sorted(shot.measured.items()):
        if not heard:
            remedy = 'the driver or simulator is not active, or waits (lockstep: for the torque '
            remedy += 'that answers); see its log'
            findings.append(error('measurements', f'{topic} is silent', remedy))
            continue
        found = list(_problems(topic, heard, shot, arm))
        if all(p.level == Level.OK for p in found):
            text = f'{topic}: {len(heard)} messages in {shot.seconds:g} s'
            found.insert(0, ok('measurements', text))
        findings += found
    return findings


def _problems(
    topic: str, heard: list[tuple[int, Any]], shot: Any, arm: SerialArm | None
) -> Iterator[Finding]:
    heard = heard if arm is None else of_arm(heard, arm)
    messages = [message for _, message in heard]
    found = [
        check_efforts(topic, messages, shot),
        check_values(topic, messages, needs_rates(arm)),
        check_stamps(topic, heard, shot),
    ]
    if arm is not None:
        units = check_units(topic, messages, arm)
        checks = check_joints, check_rate, check_rate_source
        found += [units, *(check(topic, messages, arm) for check in checks)]
        if units is None:  # a wrong one explains whatever efforts contradict
            found.append(check_setup(topic, messages, arm))
    yield from (one for one in found if one is not None)


def of_arm(heard: list[tuple[int, Any]], arm: SerialArm) -> list[tuple[int, Any]]:
    """Messages with the arm's joints, without a gripper's; as they are if none has them."""
    order, found = JointOrder(arm.joint_names), []
    for time, message in heard:
        try:
            index = order.indices(message.name)
        except SampleError:
            continue  # of another publisher
        arrays = {name: getattr(message, name) for name in ('position', 'velocity', 'effort')}
        if all(len(values) in (0, len(message.name)) for values in arrays.values()):
            own = {name: [v[i] for i in index] if len(v) else [] for name, v in arrays.items()}
            message = SimpleNamespace(header=message.header, name=list(arm.joint_names), **own)
        found.append((time, message))
    return found or heard


def stated_rates(arm: SerialArm) -> list[str]:
    """What the arm file says of the rates of each joint."""
    return [joint.sensors.rates for joint in arm.joints]


def needs_rates(arm: SerialArm | None) -> bool:
    """Whether rates are measured on their own, or the observer needs them in any case."""
    return arm is None or 'independent' in stated_rates(arm)


def check_joints(topic: str, messages: list[Any], arm: SerialArm) -> Finding | None:
    """Names and sizes against the arm file."""
    try:
        JointOrder(arm.joint_names).indices(messages[-1].name)
    except SampleError as problem:
        remedy = 'put the names of the driver into the arm file (and design its gains again), or '
        return error('joints', f'{topic}: {problem}', remedy + 'correct the driver')
    return None


def check_efforts(topic: str, messages: list[Any], shot: Any) -> Finding | None:
    """Whether torques are measured where the observer takes them from."""
    sources = [values.get('torque_source') for values in shot.parameters.values()]
    without = sum(not len(m.effort) or not np.isfinite(m.effort).all() for m in messages)
    if not without and _fills_in(messages):
        without = len(messages)
    if not without or ('command' in sources and 'effort' not in sources):
        return None
    remedy = 'let the driver publish joint torques in effort [N m], or start the observer with '
    text = f'{topic}: {without} of {len(messages)} messages carry no effort'
    return error('efforts', text, f'{remedy}torque_source:=command')


def _fills_in(messages: list[Any]) -> bool:
    """Whether zeros are published in place of efforts."""
    count = len(messages[-1].position)
    rows = [(m.position, m.effort) for m in messages if len(m.position) == len(m.effort) == count]
    if not rows:
        return False
    position, effort = (np.array(values, float) for values in zip(*rows))
    moved, given = without_efforts(position, effort, position[0], SMALL)
    return bool(moved[-1] and not given[-1])


def check_values(topic: str, messages: list[Any], rates: bool = True) -> Finding | None:
    """Whether positions and, where they are needed, rates are there, and numbers."""
    for bad, text, remedy in (
        (
            [rates and not len(m.velocity) for m in messages],
            'carry no rates (velocity is empty)',
            'let the driver publish joint rates in velocity [rad/s]: samples without are not used',
        ),
        (
            [{len(m.position), len(m.velocity) or len(m.name)} != {len(m.name)} for m in messages],
            'have other numbers of positions or rates than of names',
            'let the driver publish one position and one rate per joint',
        ),
        (
            [not np.isfinite([*m.position, *m.velocity]).all() for m in messages],
            'have positions or rates that are not numbers',
            'see the sensors and their driver; the observer predicts positions for some time, and '
            'does not use samples without rates',
        ),
    ):
        if any(bad):
            return error('values', f'{topic}: {sum(bad)} of {len(bad)} messages {text}', remedy)
    return None


def check_stamps(topic: str, heard: list[tuple[int, Any]], shot: Any) -> Finding | None:
    """Whether stamps are set, increase, and are near the clock."""
    stamps = _stamps([message for _, message in heard])
    if not stamps.any():
        remedy = 'let the driver stamp its messages with the time of measurement'
        return error('stamps', f'{topic}: stamps are zero', remedy)
    if backwards := int((np.diff(stamps) < 0).sum()):
        text = f'{topic}: time goes backwards {backwards} times in {len(stamps)} messages'
        remedy = 'two sources publish on the topic, or a bag is played in a loop'
        return error('stamps', text, remedy)
    clock, name = np.array([t for t, _ in heard], dtype=np.int64), 'the clock of this machine'
    if any(v.get('lockstep') or v.get('use_sim_time') for v in shot.parameters.values()):
        if not shot.clock:
            return None  # its own finding
        arrived, told = np.array(shot.clock, dtype=np.int64).T
        clock, name = told[np.searchsorted(arrived, clock).clip(max=len(told) - 1)], '/clock'
    offset = float(np.median((stamps - clock) / 1e9))
    if abs(offset) <= _FAR_CLOCK:
        return None
    way = 'ahead of' if offset > 0 else 'behind'
    remedy = 'synchronise the clocks (chrony), stamp with the time of measurement since 1970, '
    remedy += 'or set use_sim_time where a bag or simulator drives /clock'
    return error('stamps', f'{topic}: stamps are {abs(offset):.3g} s {way} {name}', remedy)


def check_rate(topic: str, messages: list[Any], arm: SerialArm) -> Finding | None:
    """Whether samples come as often as the arm file says."""
    stamps = np.unique(_stamps(messages))
    if len(stamps) < 10:
        return None
    interval = float(np.median(np.diff(stamps))) / 1e9
    if 1.0 / LATE <= interval / arm.sample_time <= LATE:
        return None
    text = f'{topic}: one sample every {1e3 * interval:.3g} ms, the arm file says '
    remedy = 'set sample_time of the arm file to that of the driver and design the gains again'
    return warn('rate', f'{text}{1e3 * arm.sample_time:.3g} ms', remedy)


def _stamps(messages: list[Any]) -> np.ndarray:
    times = [to_nanoseconds(m.header.stamp) for m in messages]
    return np.array(times, np.int64)


def _samples(messages: list[Any], arm: SerialArm) -> tuple[np.ndarray, ...] | None:
    """Stamps [ns], positions, rates and efforts of the arm's joints; None without all of them."""
    order = JointOrder(arm.joint_names, needs_rates=False)
    try:
        rows = [order.pick(message) for message in messages]
    except SampleError:
        return None
    stamps, place = np.unique(_stamps(messages), return_index=True)
    position, velocity, effort = (np.array([r[i] for r in rows], float)[place] for i in range(3))
    return (stamps, *Turns(arm).continued(stamps, position, velocity), effort)


def check_units(topic: str, messages: list[Any], arm: SerialArm) -> Finding | None:
    """Whether positions look like degrees or mm: by size, by their rates, or by gravity."""
    from lpv.identify.estimation.mistakes import other_unit

    found = _samples(messages, arm)
    if found is None or len(found[0]) < 2:
        return None
    stamps, position, velocity, effort = found
    if said := other_unit(arm, np.nan_to_num(position)):
        return error('units', f'{topic}: {said}', _IN_RADIANS)
    turns = np.array([not joint.is_prismatic for joint in arm.joints])
    # Between samples the mean rate counts, so that sampling does not matter.
    steps = np.diff(stamps)[:, None] / 1e9
    moved, driven = np.diff(position, axis=0), 0.5 * (velocity[1:] + velocity[:-1]) * steps
    known = np.isfinite(moved) & np.isfinite(driven)
    moved, driven = np.where(known, moved, 0.0), np.where(known, driven, 0.0)
    power = (driven**2).sum(axis=0)
    far = turns & (np.abs(moved).sum(axis=0) >= SMALL) & (power > 0.0)
    ratios = np.where(far, (moved * driven).sum(axis=0) / np.where(far, power, 1.0), 1.0)
    for name, ratio in zip(arm.joint_names, ratios):
        for factor, what in ((_DEGREES, 'positions'), (1 / _DEGREES, 'rates')):
            if 0.7 < ratio / factor < 1.4:
                text = f'{topic}: {name} moves {ratio:.3g} times as far as its rate says: '
                return error('units', f'{text}{what} in degrees?', _IN_RADIANS)
    return _against_gravity(topic, position, effort, arm)


def _against_gravity(
    topic: str, position: np.ndarray, effort: np.ndarray, arm: SerialArm
) -> Finding | None:
    """Torques that hold the arm fit gravity at its angles, in rad."""
    known = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    turns = not any(joint.is_prismatic for joint in arm.joints)
    if not (turns and arm.effort_includes_gravity and known.any()) or not effort[known].any():
        return None
    model = SerialModel(compile_chain(arm))
    torque = effort[known] * [joint.torque_gain for joint in arm.joints]
    gravity = np.abs([model.gravity(q) for q in position[known]]).max()

    def residual(q: np.ndarray) -> float:
        held = np.array([model.gravity(one) for one in q])
        return float(np.sqrt(np.mean((torque - held) ** 2)))

    as_said, in_degrees = residual(position[known]), residual(position[known] / _DEGREES)
    if as_said < 0.2 * float(gravity) or in_degrees > _BETTER * as_said:
        return None
    text = f'{topic}: torques fit gravity within {in_degrees:.3g} N m if positions are degrees, '
    return error('units', f'{text}and within {as_said:.3g} N m if they are rad', _IN_RADIANS)


def check_rate_source(topic: str, messages: list[Any], arm: SerialArm) -> Finding | None:
    """Whether rates are what the arm file says: independent, or derived from the positions."""
    found = _samples(messages, arm)
    if found is None or not np.isfinite(found[2]).all():
        return None  # its own finding
    stamps, position, velocity, _ = found
    sources = [rate_source(stamps, q, v) for q, v in zip(position.T, velocity.T)]
    if all(source.source == 'undecided' for source in sources):
        return None  # at rest, or too few samples
    texts = []
    for name, one in zip(arm.joint_names, sources):
        known = not np.isnan(one.explained)
        share = f' ({100 * max(one.explained, 0.0):.0f}% derived)' if known else ''
        texts.append(f'{name} {one.source}{share}')
    text, stated = f'{topic}: ' + ', '.join(texts), stated_rates(arm)
    pairs = zip(stated, (one.source for one in sources))
    wrong = sorted({s for said, s in pairs if said != 'none' and contradicts(said, s)})
    if not wrong:
        return ok('rates', text)
    remedy = f'set sensors.rates of the arm file to {" or ".join(wrong)} and design the gains '
    remedy += 'again: with derived rates an encoder and its rate go wrong together'
    said = ', '.join(dict.fromkeys(stated))
    return warn('rates', f'{text}; the arm file says {said}', remedy)


def check_setup(topic: str, messages: list[Any], arm: SerialArm) -> Finding | None:
    """Whether motion and efforts fit arm file and mounting; else what is wrong, or alarms."""
    from lpv.identify.errors import IdentificationError
    from lpv.identify.estimation.health import unhealthy
    from lpv.identify.estimation.mistakes import find_mistakes
    from lpv.identify.recordings.recording import clean

    found = _samples(messages, arm)
    if found is None:
        return None  # its own finding
    stamps, position, velocity, effort = found
    rates = velocity if np.isfinite(velocity).all() else None
    try:
        recording = clean(topic, [(stamps - stamps[0]) / 1e9], position, rates, effort)
        mistakes = find_mistakes(arm, [recording])
    except IdentificationError:
        return None  # too short, or at rest: that is no mistake
    if not mistakes and (alarms := unhealthy(arm, [recording])):
        return warn('health', '; '.join(alarms), 'see docs/alarms.md, or look at the observer')
    if not mistakes:
        return ok('setup', f'{topic}: efforts of {recording.duration:.0f} s of motion fit the arm')
    remedy = 'correct arm file, mounting or driver; lpv identify says what fits, from a recording'
    return error('setup', f'{topic}: ' + '; '.join(one.text for one in mistakes), remedy)
