"""Checks of the measurements that were heard: names, values, units, rates, stamps."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from lpv.cli.doctor.finding import Finding, Level, error, ok, warn
from lpv.core.monitoring.alarm_text import ALMOST_ALL, other_unit
from lpv.core.monitoring.idle_efforts import without_efforts
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.sampler import LATE
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.rate_independence import contradicts, other_rates, rate_source
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


class Heard(NamedTuple):
    """Measurements of an arm on a topic, in the order of arrival; NaN where a message has none."""

    topic: str
    names: Sequence[str]  # of the joints
    arrived: np.ndarray  # times of arrival, shape (n,) [ns]
    stamps: np.ndarray  # header stamps, likewise
    position: np.ndarray  # shape (n, joints) [rad]
    velocity: np.ndarray  # likewise [rad/s]
    effort: np.ndarray  # likewise, in the unit of the driver
    rejected: Counter[str]  # messages of the joints without use, by reason
    others: str  # what messages of other joints were, a gripper's or those of another arm


def hear(topic: str, messages: list[tuple[int, Any]], arm: SerialArm | None) -> Heard:
    """What of some messages is the arm's, or of the joints of the first one."""
    names = messages[0][1].name if arm is None else arm.joint_names
    order, rows = JointOrder(names, needs_rates(arm)), list[tuple[Any, ...]]()
    rejected, others = Counter[str](), ''
    for time, message in messages:
        try:
            order.indices(message.name)
        except SampleError as problem:
            others = str(problem)
            continue
        try:
            rows.append((time, to_nanoseconds(message.header.stamp), *order.pick(message)))
        except SampleError as problem:
            rejected[str(problem)] += 1
    columns = list(zip(*rows)) or [()] * 5
    arrived, stamps = (np.array(column, np.int64) for column in columns[:2])
    position, velocity, effort = (
        np.reshape(np.array(column, float), (-1, len(names))) for column in columns[2:]
    )
    return Heard(topic, names, arrived, stamps, position, velocity, effort, rejected, others)


def check_measurements(shot: Any, arm: SerialArm | None) -> list[Finding]:
    """Run all checks of the measurements of a `Snapshot`."""
    findings, measured = [], sorted(shot.measured.items())
    heard = {topic: hear(topic, messages, arm) for topic, messages in measured if messages}
    arms = [topic for topic, seen in heard.items() if len(seen.stamps)]
    for topic, messages in measured:
        if not messages:
            remedy = 'the driver or simulator is not active, or waits (lockstep: for the torque '
            remedy += 'that answers); see its log'
            findings.append(error('measurements', f'{topic} is silent', remedy))
            continue
        if arms and heard[topic].others and not heard[topic].rejected and topic not in arms:
            text = f'{topic}: not checked, it is of other joints than {", ".join(arms)}'
            findings.append(ok('joints', f'{text}; --arm names another arm'))
            continue
        found = [one for one in _problems(heard[topic], shot, arm) if one is not None]
        if all(p.level == Level.OK for p in found):
            text = f'{topic}: {len(messages)} messages in {shot.seconds:g} s'
            found.insert(0, ok('measurements', text))
        findings += found
    return findings


def _problems(seen: Heard, shot: Any, arm: SerialArm | None) -> Iterator[Finding | None]:
    yield check_use(seen)
    if not len(seen.stamps):
        return
    yield check_efforts(seen, shot)
    yield check_values(seen, needs_rates(arm))
    yield check_stamps(seen, shot)
    if arm is None:
        return
    units = check_units(seen, arm)
    yield from (units, check_rate(seen, arm), check_rate_source(seen, arm))
    if units is None:  # a wrong one explains whatever efforts contradict
        yield check_setup(seen, arm)


def needs_rates(arm: SerialArm | None) -> bool:
    """Whether rates are measured on their own, or the observer needs them in any case."""
    return arm is None or any(joint.sensors.rates == 'independent' for joint in arm.joints)


def check_use(seen: Heard) -> Finding | None:
    """Names and sizes of the messages against the arm file."""
    if seen.rejected:
        (reason, count), *_ = seen.rejected.most_common(1)
        remedy = 'let the driver publish a position and a rate for each joint (rates only where '
        remedy += 'the arm file calls them independent): samples without are not used'
        return error('values', f'{seen.topic}: {count} messages not used: {reason}', remedy)
    if len(seen.stamps):
        return None
    remedy = 'let one message carry all joints of the arm, by the names of the arm file, or put '
    remedy += 'those of the driver into that (and design its gains again)'
    return error('joints', f'{seen.topic}: {seen.others}', remedy)


def check_efforts(seen: Heard, shot: Any) -> Finding | None:
    """Whether torques are measured where the observer takes them from."""
    sources = [values.get('torque_source') for values in shot.parameters.values()]
    missing, count = ~np.isfinite(seen.effort), len(seen.stamps)
    moved, given = without_efforts(seen.position, seen.effort, seen.position[0], SMALL)
    # Zeros in place of efforts: of joints in motion, or, where no others came, of all.
    missing |= ~given[-1] & (moved[-1] | (moved[-1].any() and not given[-1].any()))
    without = int(missing.any(axis=1).sum())
    if not without or ('command' in sources and 'effort' not in sources):
        return None
    remedy = 'let the driver publish joint torques in effort [N m], or start the observer with '
    text, joints = f'{seen.topic}: {without} of {count} messages carry no effort', missing.any(0)
    text += '' if joints.all() else ' of ' + ', '.join(compress(seen.names, joints))
    return error('efforts', text, f'{remedy}torque_source:=command')


def check_values(seen: Heard, rates: bool = True) -> Finding | None:
    """Whether positions and, where they are needed, rates are numbers."""
    values = np.hstack([seen.position, seen.velocity]) if rates else seen.position
    bad = ~np.isfinite(values).all(axis=1)
    if not bad.any():
        return None
    text = f'{sum(bad)} of {len(bad)} messages have positions or rates that are not numbers'
    remedy = 'see the sensors and their driver; the observer predicts positions for some time, and '
    return error('values', f'{seen.topic}: {text}', f'{remedy}does not use samples without rates')


def check_stamps(seen: Heard, shot: Any) -> Finding | None:
    """Whether stamps are set, increase, and are near the clock."""
    topic, stamps, clock, name = seen.topic, seen.stamps, seen.arrived, 'the clock of this machine'
    if not stamps.any():
        remedy = 'let the driver stamp its messages with the time of measurement'
        return error('stamps', f'{topic}: stamps are zero', remedy)
    if backwards := int((np.diff(stamps) < 0).sum()):
        text = f'{topic}: time goes backwards {backwards} times in {len(stamps)} messages'
        remedy = 'two sources publish on the topic, or a bag is played in a loop'
        return error('stamps', text, remedy)
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


def check_rate(seen: Heard, arm: SerialArm) -> Finding | None:
    """Whether samples come as often as the arm file says."""
    stamps = np.unique(seen.stamps)
    if len(stamps) < 10:
        return None
    interval = float(np.median(np.diff(stamps))) / 1e9
    if 1.0 / LATE <= interval / arm.sample_time <= LATE:
        return None
    text = f'{seen.topic}: one sample every {1e3 * interval:.3g} ms, the arm file says '
    remedy = 'set sample_time of the arm file to that of the driver and design the gains again'
    return warn('rate', f'{text}{1e3 * arm.sample_time:.3g} ms', remedy)


def _samples(seen: Heard, arm: SerialArm) -> tuple[np.ndarray, ...]:
    """Stamps [ns], each once, positions without wraps, rates and efforts of the arm's joints."""
    stamps, place = np.unique(seen.stamps, return_index=True)
    position, velocity = Turns(arm).continued(stamps, seen.position[place], seen.velocity[place])
    return stamps, position, velocity, seen.effort[place]


def check_units(seen: Heard, arm: SerialArm) -> Finding | None:
    """Whether positions look like degrees or mm: by size, by their rates, or by gravity."""
    topic, (stamps, position, velocity, effort) = seen.topic, _samples(seen, arm)
    if len(stamps) < 2:
        return None
    if said := other_unit(arm, *np.quantile(np.nan_to_num(position), ALMOST_ALL, axis=0)):
        return error('units', f'{topic}: {said}', _IN_RADIANS)
    if said := other_rates(arm, stamps, position, velocity):
        return error('units', f'{topic}: {said}', _IN_RADIANS)
    # Torques that hold the arm fit gravity at its angles, in rad.
    known = np.isfinite(position).all(axis=1) & np.isfinite(effort).all(axis=1)
    turns = not any(joint.is_prismatic for joint in arm.joints)
    if not (turns and arm.effort_includes_gravity and known.any()) or not effort[known].any():
        return None
    model = SerialModel(compile_chain(arm))
    torque = effort[known] * arm.torque_gain
    gravity = np.abs(model.gravity(position[known])).max()

    def residual(q: np.ndarray) -> float:
        return float(np.sqrt(np.mean((torque - model.gravity(q)) ** 2)))

    as_said, in_degrees = residual(position[known]), residual(position[known] / _DEGREES)
    if as_said < 0.2 * float(gravity) or in_degrees > _BETTER * as_said:
        return None
    text = f'{topic}: torques fit gravity within {in_degrees:.3g} N m if positions are degrees, '
    return error('units', f'{text}and within {as_said:.3g} N m if they are rad', _IN_RADIANS)


def check_rate_source(seen: Heard, arm: SerialArm) -> Finding | None:
    """Whether rates are what the arm file says: independent, or derived from the positions."""
    stamps, position, velocity, _ = _samples(seen, arm)
    if not np.isfinite(velocity).all():
        return None  # its own finding
    sources = [rate_source(stamps, q, v) for q, v in zip(position.T, velocity.T)]
    if all(source.source == 'undecided' for source in sources):
        return None  # at rest, or too few samples
    texts = []
    for name, one in zip(arm.joint_names, sources):
        known = not np.isnan(one.explained)
        share = f' ({100 * max(one.explained, 0.0):.0f}% derived)' if known else ''
        texts.append(f'{name} {one.source}{share}')
    text, stated = f'{seen.topic}: ' + ', '.join(texts), [j.sensors.rates for j in arm.joints]
    pairs = zip(stated, (one.source for one in sources))
    wrong = sorted({s for said, s in pairs if said != 'none' and contradicts(said, s)})
    if not wrong:
        return ok('rates', text)
    remedy = f'set sensors.rates of the arm file to {" or ".join(wrong)} and design the gains '
    remedy += 'again: with derived rates an encoder and its rate go wrong together'
    said = ', '.join(dict.fromkeys(stated))
    return warn('rates', f'{text}; the arm file says {said}', remedy)


def check_setup(seen: Heard, arm: SerialArm) -> Finding | None:
    """Whether motion and efforts fit arm file and mounting; else what is wrong, or alarms."""
    from lpv.identify.errors import IdentificationError
    from lpv.identify.estimation.health import unhealthy
    from lpv.identify.estimation.mistakes import find_mistakes
    from lpv.identify.recordings.recording import clean

    topic, (stamps, position, velocity, effort) = seen.topic, _samples(seen, arm)
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
