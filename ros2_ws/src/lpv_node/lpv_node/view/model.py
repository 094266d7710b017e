"""What the live view knows of the running graph, as plain values that JSON can carry."""

import contextlib
import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from lpv.core.control.path import SerialPath
from lpv.core.monitoring.joint_order import JointOrder
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Mode, SensorState
from lpv.core.simulation.faults import KINDS
from lpv.core.support.errors import SampleError
from lpv.core.support.limits import MOST_TEXT, PATIENCE, QUIET
from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS, to_nanoseconds
from lpv_node.view.alarm_list import AlarmList, seconds
from lpv_node.view.skeleton import Skeleton

Numbers = list[float | None]
MODES, STATES = tuple(Mode.__members__), tuple(SensorState.__members__)
LEVELS = ('OK', 'WARN', 'ERROR', 'STALE')
WINDOW = 30.0
"""Length of the history that a new client gets [s]."""
_MOST_SAMPLES, _MOST_STATUSES = round(60.0 * WINDOW), 14
"""Samples of the history at the highest rate; statuses beside those of the joints."""
_ARRAYS = {
    'joint_states': (),
    'state_estimate': ('position',),
    'fault_estimate': ('sensor_names', 'estimate', 'bound', 'threshold', 'state', 'alarm'),
    'torque_command': ('torque',),
    'ground_truth': ('position', 'fault'),
    'reference': (),
}
"""Fields that are shown and have one element for each joint, by source."""
_CHARTS = {
    'estimate': ('fault_estimate', 'estimate'),
    'bound': ('fault_estimate', 'bound'),
    'threshold': ('fault_estimate', 'threshold'),
    'fault': ('ground_truth', 'fault'),
    'torque': ('torque_command', 'torque'),
    'tip': ('reference', 'tip_position'),
}
"""Source and field of what a sample of the charts has."""


class LiveModel:
    """Latest messages, a short history and the list of alarms, for one thread and without ROS."""

    def __init__(self, arm: SerialArm, path: SerialPath | None = None) -> None:
        self._arm, self._path = arm, path
        self._order, self._joints = JointOrder(arm.joint_names), len(arm.joint_names)
        self._skeleton = Skeleton(arm)
        self.alarms = AlarmList()
        self.services = {'inject': False, 'clear': False, 'reset': False}
        self._latest: dict[str, tuple[float, Any]] = {}  # messages, with steady times [s]
        self._history: deque[dict[str, Any]] = deque(maxlen=_MOST_SAMPLES)
        self._statuses: dict[str, tuple[float, dict[str, Any]]] = {}  # with steady times [s]
        self._stops: dict[str, Any] = {'count': 0, 'last': ''}  # safe stops of the tracker
        self._stopped = -math.inf  # steady time of the last one [s]
        self._stamp: int | None = None

    def take(self, source: str, message: Any, now: float) -> bool:
        """Take one message of a topic, as ``state_estimate``, received at a steady time [s].

        False: it is of another arm, and not taken.
        """
        if source == 'fault_alarm':
            self.alarms.add(message)
        elif source == 'diagnostics':
            for status in message.status:
                self._take_status(status, now)
        elif (
            (source == 'reference' and len(message.tip_position) != 3)
            or (source == 'fault_estimate' and (*message.sensor_names,) != self._arm.sensor_names)
            or any(len(getattr(message, field)) != self._joints for field in _ARRAYS[source])
        ):
            return False
        else:
            self._latest[source] = now, message
            if source == 'fault_estimate':
                self.alarms.follow(message)
            elif source == 'state_estimate' and message.mode == Mode.INITIALISING:
                self.alarms.restart(_stamp(message))
        return True

    def _take_status(self, status: Any, now: float) -> None:
        name, known = status.name[:MOST_TEXT], self._statuses
        own = status.hardware_id in (self._arm.name, *self._arm.sensor_names)
        if name not in known and len(known) >= _MOST_STATUSES + self._joints:
            # Those of other nodes, of which a robot has many, keep none of this arm's out.
            other = next((n for n, (_, one) in known.items() if own and not one['own']), None)
            if other is None:
                return
            del known[other]
        # A byte, which Python sees as bytes.
        level = status.level[0] if isinstance(status.level, bytes) and status.level else 0
        text = status.message[:MOST_TEXT]
        fields = {'name': name, 'level': _name(LEVELS, level), 'message': text, 'own': own}
        known[name] = now, fields
        values = {pair.key: pair.value for pair in status.values[:_MOST_STATUSES]}
        count = values.get('safe stops', '')
        if not (count.isascii() and count.isdigit() and len(count) < 10):
            return
        if int(count) > self._stops['count']:
            self._stopped = now
        self._stops = {'count': int(count), 'last': values.get('last safe stop', '')[:MOST_TEXT]}

    def hello(self) -> dict[str, Any]:
        """First message to a client: constants of the arm, history and alarms."""
        arm = self._arm
        return {
            'type': 'hello',
            'arm': arm.name,
            'reach': round(self._skeleton.reach, 4),
            'joints': list(arm.joint_names),
            'sensors': list(arm.sensor_names),
            'units': [joint.units for joint in arm.joints],  # of position and torque
            'kinds': list(KINDS),
            'window': WINDOW,
            'scene': self._scene(),
            'history': list(self._history),
            'alarms': self.alarms.rows(),
        }

    def _scene(self) -> dict[str, Any]:
        if self._path is None:
            return {'path': [], 'obstacle': None}
        times = np.linspace(self._path.start, self._path.end, 151)
        points, found = self._skeleton.drawn(self._path.sample(times).tip), self._path.obstacle
        obstacle = found and {'center': _numbers(found.center), 'radius': found.radius}
        return {'path': [_numbers(point, 4) for point in points], 'obstacle': obstacle}

    def frame(self, now: float) -> dict[str, Any]:
        """The present at a steady time [s], for clients and history; None: not known."""
        sources = 'state_estimate', 'fault_estimate', 'torque_command'
        state, fault, command = (self._live(source, now) for source in sources)
        newest = max((at for at, _ in self._latest.values()), default=None)
        drawn = self._skeleton.drawn
        corners = {
            name: None if q is None else [_numbers(c, 4) for c in drawn(self._skeleton.corners(q))]
            for name, q in self.arms(now).items()
        }
        states = [None] * self._joints if fault is None else [_name(STATES, s) for s in fault.state]
        return {
            'type': 'frame',
            'live': {source: self._live(source, now) is not None for source in _ARRAYS},
            'services': dict(self.services),
            'age': None if newest is None else round(max(0.0, now - newest), 1),
            'sample': self._sample(now),
            'arms': corners,
            'diagnostics': [
                status if now - at < 2.0 * PATIENCE else {**status, 'level': 'STALE'}
                for at, status in self._statuses.values()
            ],
            'mode': None if state is None else _name(MODES, state.mode),
            'trustworthy': None if state is None else bool(state.trustworthy),
            'safe_stop': None if command is None else bool(command.safe_stop),
            'stops': {**self._stops, 'recent': now - self._stopped < WINDOW},
            'states': states,
        }

    def arms(self, now: float) -> dict[str, Any]:
        """Joint positions [rad], or None, of the arms to draw at a steady time [s]."""
        found = {
            'true': self._field('ground_truth', 'position', now),
            'estimated': self._field('state_estimate', 'position', now),
            'measured': None,
        }
        state, measured = (self._live(source, now) for source in ('state_estimate', 'joint_states'))
        if state is not None and _name(MODES, state.mode) == 'NO_ESTIMATE':
            found['estimated'] = None
        if measured is not None:
            with contextlib.suppress(SampleError):
                found['measured'] = _numbers(self._order.pick(measured)[0])
        return {name: q if q is not None and None not in q else None for name, q in found.items()}

    def stamp(self) -> int | None:
        """Stamp of the newest measurement, estimate or command [ns], None before the first."""
        if not self._latest:
            return None
        # What fell silent is left out: its clock may have restarted since.
        newest = max(at for at, _ in self._latest.values())
        return max(_stamp(one) for at, one in self._latest.values() if at > newest - QUIET)

    def _live(self, source: str, now: float) -> Any:
        """Latest message of a source; None if it has fallen silent."""
        at, message = self._latest.get(source, (-math.inf, None))
        return message if now - at < QUIET else None

    def _field(self, source: str, field: str, now: float) -> Numbers | None:
        message = self._live(source, now)
        return None if message is None else _numbers(getattr(message, field))

    def _sample(self, now: float) -> dict[str, Any]:
        """One point of the charts; enters the history when time has gone on."""
        stamp = self.stamp()
        sample: dict[str, Any] = {'t': None if stamp is None else seconds(stamp)}
        for name, (source, field) in _CHARTS.items():
            sample[name] = self._field(source, field, now) or [None] * self._joints
        if None not in sample['tip']:
            sample['tip'] = _numbers(self._skeleton.drawn(np.array(sample['tip'])))
        if stamp is not None and stamp != self._stamp:
            if self._stamp is not None and stamp < self._stamp - NANOSECONDS:
                self._history.clear()  # time restarted
                self.alarms.forget_clock()
            self._stamp = stamp
            self._history.append(sample)
            while self._history[0]['t'] < sample['t'] - WINDOW:
                self._history.popleft()
        return sample


def _stamp(message: Any) -> int:
    # Within what a stamp can hold, whatever a sender wrote.
    return min(LAST_STAMP, max(0, to_nanoseconds(message.header.stamp)))


def _name(names: Sequence[str], index: int) -> str:
    return names[index] if 0 <= index < len(names) else 'UNKNOWN'


def _numbers(values: Iterable[float], digits: int = 6) -> Numbers:
    return [round(float(v), digits) if math.isfinite(v) else None for v in values]
