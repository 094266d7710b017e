"""Rows of a run's streams as they are read, and the arrays that are made of them."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_bag.errors import BagError
from lpv_bag.run.streams import ALARMS, STREAMS, RecordedAlarm, RunRecord, lengths, stamp_of
from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.observer.sampled_observer import Mode
from lpv_core.support.errors import SampleError


class RunRows:
    """Gathers messages one by one or many at a time, then fills the arrays of a record."""

    def __init__(self, record: RunRecord, joint_names: Sequence[str] | None = None) -> None:
        self._record = record
        self._parts: dict[str, list[tuple[Any, Any, list[np.ndarray]]]] = {}
        self._alarms: dict[tuple[int, int, int], RecordedAlarm] = {}
        record.joint_names = tuple(joint_names or ())
        self._names: list[str] | None = None
        self._index: list[int] | None = None
        self._missing: tuple[str, str] | None = None
        self._joints = len(record.joint_names)
        self._lengths: dict[str, dict[str, int]] = {}  # of the arrays of each stream
        self._misfits: Counter[str] = Counter()  # messages of other lengths by stream
        self.warnings: list[str] = []

    def add(self, name: str, number: int, message: Any) -> None:
        """Take one message."""
        if name == ALARMS:
            alarm = _alarm(message)
            # Latched events are delivered again to late subscribers.
            self._alarms[alarm.stamp, alarm.sensor_index, alarm.event] = alarm
            return
        try:
            values = self.values(name, message)
        except SampleError:
            self._misfits[name] += 1
            return
        if values is not None:
            self.add_many(
                name,
                [number],
                [stamp_of(message.header.stamp)],
                [np.asarray(value, float)[None] for value in values],
            )

    def values(self, name: str, message: Any) -> list[Any] | None:
        """Fields of a message in the order of its stream; None if it is not to be taken.

        Raises SampleError if its arrays have other lengths than those of the arm.
        """
        if name == 'state_estimate' and message.mode == Mode.NO_ESTIMATE:
            return None  # its values mean nothing
        if name == 'joint_states':
            index = self.pick(message.name)
            return None if index is None else _columns(message, index)
        self._check_lengths(name, lengths(name, message))
        if name == 'fault_estimate' and not self._record.sensor_names:
            self._record.sensor_names = tuple(message.sensor_names)
        return [getattr(message, field) for field in STREAMS[name][1]]

    def _check_lengths(self, name: str, found: dict[str, int]) -> None:
        """All arrays are for the same joints, and as long as in the messages before."""
        joints = {length for field, length in found.items() if field != 'tip_position'}
        if len(joints) > 1 or (self._joints and joints != {self._joints}):
            raise SampleError(f'{name} has arrays of {sorted(joints)} values')
        if self._lengths.setdefault(name, found) != found:
            raise SampleError(f'{name} has arrays of other lengths than before')

    def add_many(
        self,
        name: str,
        numbers: Sequence[int] | np.ndarray,
        stamps: Sequence[int] | np.ndarray,
        columns: list[np.ndarray],
    ) -> None:
        """Take the values of many messages of one stream."""
        if name == 'state_estimate':
            known = columns[STREAMS[name][1].index('mode')] != Mode.NO_ESTIMATE
            if not known.all():
                numbers, stamps = np.asarray(numbers)[known], np.asarray(stamps)[known]
                columns = [column[known] for column in columns]
        if len(stamps):
            self._parts.setdefault(name, []).append((numbers, stamps, columns))

    def pick(self, names: Sequence[str]) -> list[int] | None:
        """Columns of the wanted joints in a message with these joints, or None.

        Drivers sort joints as they like, and have more.  A message of other joints only (a
        gripper's, on the same topic) is not about this arm.
        """
        if names != self._names:
            wanted = self._record.joint_names = self._record.joint_names or tuple(names)
            self._names = list(names)
            missing = [n for n in wanted if n not in names]
            self._index = None
            if missing:
                self._missing = (missing[0], ', '.join(names) or 'no joint')
            else:
                self._index = [list(names).index(n) for n in wanted]
        return self._index

    def finish(self, answers_only: bool) -> None:
        """Fill the record."""
        for name in STREAMS:
            parts = self._parts.get(name)
            if not parts:
                continue
            order = np.argsort(np.concatenate([part[0] for part in parts]), kind='stable')
            stamps = np.concatenate([np.asarray(part[1], np.int64) for part in parts])[order]
            self._judge(name, stamps)
            # np.unique gives the first of equal ones: reversed, that is the last message.
            stamps, last = np.unique(stamps[::-1], return_index=True)
            rows = order[len(order) - 1 - last]
            columns = [np.concatenate(column)[rows] for column in zip(*(part[2] for part in parts))]
            self._record.stamps[name] = stamps
            self._record.streams[name] = dict(zip(STREAMS[name][1], columns))
        for name, count in self._misfits.items():
            self.warnings.append(
                f'{self._record.topics[name]}: {count} messages whose number of joints does not '
                'fit are left out'
            )
        self._record.alarms = [self._alarms[key] for key in sorted(self._alarms)]
        self._check_measurements(answers_only)

    def _check_measurements(self, answers_only: bool) -> None:
        count = len(self._record.stamps.get('joint_states', ()))
        if count == 0 and answers_only:
            return
        if count == 0 and self._missing:
            raise BagError(
                f'joint {self._missing[0]!r} is not in joint_states, which has {self._missing[1]}'
            )
        if count == 0:
            raise BagError(f'{self._record.topics["joint_states"]} holds no message')
        if count == 1:
            raise BagError(
                f'all messages of {self._record.topics["joint_states"]} have the same '
                'stamp, or there is one only'
            )

    def _judge(self, name: str, stamps: np.ndarray) -> None:
        """Warn where stamps run backwards or stand still."""
        backwards = int(np.sum(stamps[1:] < np.maximum.accumulate(stamps)[:-1]))
        same = len(stamps) - len(np.unique(stamps))
        topic = self._record.topics[name]
        if backwards:
            self.warnings.append(
                f'{topic}: time goes backwards {backwards} times, messages are '
                'sorted by their stamps'
            )
        if same:
            self.warnings.append(
                f'{topic}: {same} messages have the stamp of another one, the '
                'last one of each stamp counts'
            )


def _columns(message: Any, index: list[int]) -> list[np.ndarray]:
    """Values of chosen joints; NaN where a message has none of a kind."""
    nothing = np.full(len(index), np.nan)
    return [
        values[index] if len(values) == len(message.name) else nothing
        for values in (message.position, message.velocity, message.effort)
    ]


def _alarm(message: Any) -> RecordedAlarm:
    try:
        event = AlarmEvent(message.event)
    except ValueError as error:
        raise BagError(f'fault_alarm: unknown event {message.event}') from error
    return RecordedAlarm(
        event,
        int(message.sensor_index),
        message.sensor,
        stamp_of(message.onset),
        stamp_of(message.detected),
        float(message.size),
        float(message.bound),
        message.kind,
        float(message.confidence),
        stamp_of(message.header.stamp),
    )
