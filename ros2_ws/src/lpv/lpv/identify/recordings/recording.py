"""Recordings of an arm: positions, rates and efforts of its joints over time."""

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from lpv.bag.rosbag.reading import open_bag
from lpv.bag.run.csv_import import ColumnMap, opened, read_samples
from lpv.bag.run.measurements import MeasurementReader
from lpv.bag.run.record import find_topic
from lpv.core.monitoring.plausibility import Driver, find_unread
from lpv.core.serial_arm.chain import MAX_JOINTS
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.turns import Turns
from lpv.core.support.limits import MAX_GAP, MOST_SAMPLES, MOST_TEXT, SMALL
from lpv.core.support.timestamps import NANOSECONDS
from lpv.identify.errors import IdentificationError

LARGEST = 1e6
"""Positions [rad], rates [rad/s] and efforts beyond are no measurements."""
MIN_SHARE_VALID = 0.7
"""Smallest share of samples that must be complete."""
_STEADY = 0.98  # least share of stamps that move on
_CUT = 5.0 * MAX_GAP  # ends a segment at any rate that is used [s]
_SHORTEST = 1e-6  # floats of the seconds since 1970 resolve not much less [s]
_START = 2.0**30  # middle of the range of stamps: a clock may be set either way [s]
_PATTERNS = {
    'position': '{}_position {}_pos position_{} q_{} pos_meas{} motor_position{} position{} q{}',
    'velocity': '{}_velocity {}_vel velocity_{} v_{} vel_meas{} motor_velocity{} velocity{} dq{} '
    'v{}',
    'effort': '{}_effort {}_torque effort_{} tau_{} tau_meas{} motor_torque{} effort{} torque{} '
    'tau{} current{}',
}
"""Names of columns by the joint's name, or by its number."""
_GIVE_MAP = (
    'give a column map (--columns), a YAML file such as {time: {column: t, unit: ms}, '
    'joints: {shoulder: {position: q1, effort: i1, unit: deg}}}'
)


@dataclass(frozen=True)
class Recording:
    """Samples of the joints of an arm, in the order of the arm."""

    source: str  # where they come from
    time: np.ndarray  # stamps that increase, shape (n,) [s]
    position: np.ndarray  # shape (n, joints) [rad]
    velocity: np.ndarray | None  # [rad/s]; None if the recording has no rates, shape (n, joints)
    effort: np.ndarray  # in the unit of the driver, shape (n, joints)
    warnings: tuple[str, ...] = ()  # what was wrong and could be mended

    @property
    def stamps(self) -> np.ndarray:
        """Times since the first sample, shape (n,) [ns]."""
        return np.round(NANOSECONDS * (self.time - self.time[0])).astype(np.int64)

    @property
    def rates(self) -> np.ndarray:
        """Of the joints, shape (n, joints); NaN if the recording has none [rad/s]."""
        return np.full_like(self.position, np.nan) if self.velocity is None else self.velocity

    @property
    def duration(self) -> float:
        """From the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    def rows(self, chosen: Any) -> 'Recording':
        """Some of its samples, by a slice or a mask."""
        velocity = None if self.velocity is None else self.velocity[chosen]
        samples = self.time[chosen], self.position[chosen], velocity, self.effort[chosen]
        return Recording(self.source, *samples, self.warnings)


def read_recording(
    path: str | Path,
    joints: Sequence[str],
    topic: str | None = None,
    columns: ColumnMap | None = None,
) -> Recording:
    """Complete samples of a bag or CSV file; IdentificationError if signals are missing."""
    *signals, notes = _read(Path(path), joints, topic, columns)
    recording = clean(str(path), *signals)
    return replace(recording, warnings=(*notes, *recording.warnings))


def read_pairs(
    path: str | Path,
    first: Sequence[str],
    second: Sequence[str],
    topic: str | None,
    columns: ColumnMap | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions of joints and of their second encoders in the same samples, (n, joints) each."""
    _, position, *_ = _read(Path(path), first, topic, columns, second)
    return position[:, : len(first)], position[:, len(first) :]


def _read(
    path: Path,
    joints: Sequence[str],
    topic: str | None,
    columns: ColumnMap | None,
    others: Sequence[str] = (),
) -> tuple[Any, ...]:
    """Stamps, positions, rates (or None), efforts, remarks; of ``others`` positions at least."""
    if path.suffix.lower() == '.csv':
        return _read_csv(path, joints, columns, others)
    return *_read_bag(path, (*joints, *others), topic), []


def clean(
    source: str,
    stamps: Sequence[np.ndarray],
    position: np.ndarray,
    velocity: np.ndarray | None,
    effort: np.ndarray,
) -> Recording:
    """Recording of the complete samples; the steadiest of the given ``stamps`` is taken."""
    warnings = []
    if len(position) < 2:
        raise IdentificationError(f'{source}: has {len(position)} samples of the joints')
    if velocity is not None and np.mean(_usable(velocity)) < MIN_SHARE_VALID:
        warnings.append('rates are missing, they are computed from positions')
        velocity = None
    measured = effort[_usable(effort)]
    if not (len(measured) and np.ptp(measured, axis=0).any()):
        never = 'efforts that never change, as of mock hardware'
        what = never if len(measured) else 'no efforts of all joints'
        raise IdentificationError(
            f'{source}: has {what}; torques or currents of the motors must be recorded, too'
        )
    recorded = (position, effort) if velocity is None else (position, effort, velocity)
    zeros = _zeros_alone(stamps[0], position, velocity, effort)
    if zeros.any():
        text = 'samples of zeros alone, as of a driver that reads no hardware, are left out'
        warnings.append(f'{np.sum(zeros)} {text}')
    valid = ~zeros & np.all([_usable(values) for values in recorded], axis=0)
    if valid.mean() < MIN_SHARE_VALID:
        raise IdentificationError(
            f'{source}: only {100 * valid.mean():.0f} % of the samples are '
            f'complete, the others hold values that are not finite or beyond {LARGEST:g}'
        )
    if not (zeros | valid).all():
        text = f'samples with values that are not finite or beyond {LARGEST:g} are left out'
        warnings.append(f'{np.sum(~(zeros | valid))} {text}')
    kept = _once(stamps[0], *recorded)
    if not kept.all():
        warnings.append(f'{np.sum(~kept)} samples that are there again are left out')
    time = np.full(len(position), np.nan)
    time[kept], notes = _choose_stamps(source, [s[kept] for s in stamps], position[kept])
    warnings += notes
    valid &= np.isfinite(time)
    # Times go on after a gap where a clock was set back; one stamp that is off sets none.
    steps = np.diff(median_filter(time[valid], 3, mode='nearest'))
    back = np.where(steps < -MAX_GAP, _CUT - steps, 0.0)
    time[valid] = time[valid] + np.concatenate([[0.0], np.cumsum(back)])
    if count := np.count_nonzero(back):
        warnings.append(f'the clock was set back ({count} times): the recording is cut there')
    index = np.flatnonzero(valid)
    index = index[np.argsort(time[index], kind='stable')]
    index = index[np.concatenate([[True], np.diff(time[index]) > _SHORTEST])]
    time, position, effort = time[index], position[index], effort[index]
    if velocity is not None:
        velocity, way = velocity[index], np.ptp(position, axis=0)
        reach = np.mean(np.abs(velocity), axis=0) * (time[-1] - time[0])
        if np.any((way > SMALL) & (reach < 0.1 * way)):
            warnings.append('rates stand still while positions move, they are not used')
            velocity = None
    return Recording(source, time, position, velocity, effort, tuple(warnings))


def continued(arm: SerialArm, one: Recording) -> Recording:
    """The recording without wraps of joints that turn without end."""
    position, rates = Turns(arm).continued(one.stamps, one.position, one.rates)
    return replace(one, position=position, velocity=None if one.velocity is None else rates)


def _usable(values: np.ndarray) -> np.ndarray:
    """Which samples are numbers that a sensor may give, for all joints; shape (n,)."""
    return (np.abs(values) <= LARGEST).all(1)


def _zeros_alone(
    time: np.ndarray, position: np.ndarray, velocity: np.ndarray | None, effort: np.ndarray
) -> np.ndarray:
    """Which samples are none of the arm, as the observer judges them, but of its driver."""
    count, joints = position.shape
    rates = np.full_like(position, np.nan) if velocity is None else velocity
    samples, unread = np.stack([position, rates, effort], axis=1), np.empty(count, bool)
    driver = Driver(np.full(joints, np.nan), np.zeros(1, np.int64))
    stamps = np.round(NANOSECONDS * time).astype(np.int64)
    find_unread(stamps, samples, np.full(joints, SMALL), driver, unread)
    return unread & (position == 0.0).all(axis=1)


def _once(stamps: np.ndarray, *signals: np.ndarray) -> np.ndarray:
    """Which samples to keep so that each is there once, as of a topic that was recorded twice."""
    order = np.argsort(stamps, kind='stable')
    values = np.nan_to_num(np.column_stack([stamps, *signals])[order])
    kept = np.ones(len(stamps), bool)
    kept[order[1:]] = (values[1:] != values[:-1]).any(axis=1)
    # Where stamps stand still, an arm at rest may give the same sample again.
    return kept if len(np.unique(stamps)) > _STEADY * kept.sum() else np.ones_like(kept)


def _choose_stamps(
    source: str, stamps: Sequence[np.ndarray], position: np.ndarray
) -> tuple[np.ndarray, list[str]]:
    """The first of the stamps, unless another one fits the motion better."""
    named = dict(zip(('header stamps', 'log times'), (np.asarray(s, float) - s[0] for s in stamps)))
    first, counted = next(iter(named)), _counted(list(named.values())[-1])
    if counted is not None:
        named['the count of the samples'] = counted
    usable = {
        name: _roughness(time, position)
        for name, time in named.items()
        if np.mean(np.diff(time) > 0.0) > _STEADY
    }
    if not usable:
        raise IdentificationError(
            f'{source}: stamps stand still or run backwards, no others are recorded'
        )
    name, score = next(iter(usable.items()))
    if score > 1.25 * min(usable.values()):
        name = min(usable, key=lambda one: usable[one])
    notes = [f'{first} jitter or stand still, times are taken from {name}']
    return named[name], notes if name != first else []


def _counted(time: np.ndarray) -> np.ndarray | None:
    """Times of a steady clock that counts the samples; None if many in a row were lost."""
    steps = np.diff(time)
    step = np.median(steps)
    if not step > 0.0 or np.max(steps) > 5.0 * step:
        return None
    # Where no step is short, long ones are no jitter: samples were lost.
    ticks = np.rint(steps / step)
    index = np.append(0.0, np.cumsum(ticks if ticks.min() > 0.0 else np.ones_like(ticks)))
    slope, start = np.polyfit(index, time, 1)
    if np.max(np.abs(time - start - slope * index)) > 20.0 * step:
        return None
    return slope * index


def _roughness(time: np.ndarray, position: np.ndarray) -> float:
    """How much the motion jerks in these times: jitter of stamps looks like acceleration."""
    step = np.diff(time)
    keep = step > 1e-6
    if np.count_nonzero(keep) < 2:
        return np.inf
    rate = np.diff(position, axis=0)[keep] / step[keep, None]
    return float(np.median(np.abs(np.diff(rate, axis=0)), axis=0).sum())


def _read_bag(path: Path, joints: Sequence[str], topic: str | None) -> tuple[Any, ...]:
    """Stamps, positions, rates (or None) and efforts."""
    parts, count = list[tuple[np.ndarray, ...]](), 0
    with open_bag(path) as bag:
        measured = find_topic(bag, 'joint_states', topic, joints)
        reader = MeasurementReader(bag, joints)
        for block in bag.blocks([c for c in bag.connections if c.topic == measured]):
            found = reader.read(block, np.arange(len(block)))
            parts.append((found.stamp, block.time[found.places], *found[2:]))
            count += len(found.places)
            if count > MOST_SAMPLES:
                raise IdentificationError(f'{path}: has more than {MOST_SAMPLES} samples')
    if not count:
        reason = next(iter(reader.rejected), f'holds no message on {measured}')
        raise IdentificationError(f'{path}: {reason}')
    header, log, position, rates, effort = (np.concatenate(part) for part in zip(*parts))
    velocity = rates if np.isfinite(rates).any() else None
    return [1e-9 * (stamps - stamps[0]) for stamps in (header, log)], position, velocity, effort


def _read_csv(
    path: Path, joints: Sequence[str], columns: ColumnMap | None, others: Sequence[str]
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray | None, np.ndarray, list[str]]:
    """Stamps, positions, rates (or None), efforts, remarks of a CSV file with a header line.

    Columns of ``others`` are positions of the same joints, too.
    """
    notes, count = list[str](), len(joints) + len(others)
    stamps, *parts = array('q'), array('d'), array('d'), array('d')
    columns = columns or _guess_columns(path, joints)
    for joint in joints:
        if joint not in columns.joints:
            known = ', '.join(columns.joints)
            text = f'the column map has no joint {joint!r}; it has {known}'
            raise IdentificationError(f'{path}: {text}')
    found = {name: columns.joints[name] for name in joints}
    found |= {f'column {name}': (name, '', '') for name in others}
    units = {f'column {name}': columns.units[joint] for name, joint in zip(others, joints)}
    chosen = replace(columns, start=_START, joints=found, units=columns.units | units)
    for stamp, *vectors in read_samples(path, chosen, None, notes):
        stamps.append(stamp)
        for part, vector in zip(parts, vectors):
            part.extend(vector)
        if len(stamps) > MOST_SAMPLES:
            raise IdentificationError(f'{path}: has more than {MOST_SAMPLES} samples')
    time = np.array(stamps)
    position, velocity, effort = (
        np.array(part).reshape(-1, count) if part else np.full((len(time), count), np.nan)
        for part in parts
    )
    rates = velocity if np.isfinite(velocity).any() else None
    return [1e-9 * (time - time[:1])], position, rates, effort, notes


def _guess_columns(path: Path, joints: Sequence[str]) -> ColumnMap:
    """Column map from a header that names columns after joints or their numbers."""
    with opened(path) as reader:
        header = [name.strip() for name in next(reader, [])]
    time = next((name for name in header if re.fullmatch(r'(time|t|stamp)(_s)?', name, re.I)), None)
    if time is None:
        there = ', '.join(header) or 'no columns at all'
        text = f'has no column "time", "t" or "stamp", it has {there[:MOST_TEXT]}'
        raise IdentificationError(f'{path}: {text}; {_GIVE_MAP}')
    found, labels = {}, _labels(path, header, joints)
    for label, joint in zip(labels, joints):
        names = []
        for kind, patterns in _PATTERNS.items():
            wanted = [pattern.format(label) for pattern in patterns.split()]
            match = next((name for name in wanted if name in header), None)
            if match is None and kind != 'velocity':
                raise IdentificationError(
                    f'{path}: no column looks like the {kind} of {joint!r}; {_GIVE_MAP}'
                )
            names.append(match or '')
        found[joint] = tuple(names)
    return ColumnMap(time, 's', 0.0, found, dict.fromkeys(joints, 'rad'))


def _labels(path: Path, header: list[str], joints: Sequence[str]) -> Sequence[str]:
    """What the columns of the joints' positions are named after: joints, or numbers."""

    def among(labels: Sequence[str]) -> list[str]:
        return [x for x in labels if any(p.format(x) in header for p in patterns)]

    patterns = _PATTERNS['position'].split()
    numbers = among([str(k) for k in range(MAX_JOINTS + 1)])
    if among(joints) or not numbers:
        return joints
    if len(numbers) != len(joints):
        raise IdentificationError(
            f'{path}: positions are numbered {", ".join(numbers)}, but the arm has '
            f'{len(joints)} joints; {_GIVE_MAP}'
        )
    return numbers
