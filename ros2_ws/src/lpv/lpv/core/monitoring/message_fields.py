"""Alarms and diagnostics as plain fields of messages: the same for the node and for a replay.

Neither ROS nor a bag library is needed here; headers are left out.
"""

from dataclasses import asdict, dataclass
from itertools import compress
from typing import Any

import numpy as np

from lpv.core.monitoring.sample_loop import UNWATCHED
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, Mode, SensorState
from lpv.core.serial_arm.diagnosis.estimator import HORIZON
from lpv.core.serial_arm.diagnosis.healthy_set import Guarantee
from lpv.core.support.timestamps import NANOSECONDS

# Levels of diagnostic_msgs/DiagnosticStatus.
OK, WARN, ERROR, STALE = range(4)

_LEVELS = {
    SensorState.OK: (OK, 'no fault'),
    SensorState.WARN: (WARN, 'above the threshold, not confirmed'),
    SensorState.ERROR: (ERROR, 'fault confirmed'),
    SensorState.STALE: (STALE, 'no data'),
    SensorState.NOT_DIAGNOSABLE: (WARN, 'not diagnosable in this configuration'),
}
_MODES = {
    Mode.OBSERVING: (OK, 'observing'),
    Mode.HOLDING: (WARN, 'holding: a link carries no gravity information'),
    Mode.INITIALISING: (WARN, 'initialising'),
    Mode.STALE: (STALE, 'no usable measurements'),
    Mode.NO_ESTIMATE: (STALE, 'no usable measurement yet'),
}
_UNSAFE = 'a confirmed fault cannot be compensated safely: stop'
_UNWATCHED = (
    f'no motion could be compared with torques for {UNWATCHED / NANOSECONDS:g} s: the estimate is '
    'not trustworthy'
)
_INCONSISTENT = 'inconsistent, cause unknown: rates, torques and model contradict each other'


def alarm_fields(alarm: Alarm) -> dict[str, Any]:
    """Fields of lpv_msgs/FaultAlarm; ``onset`` and ``detected`` in nanoseconds."""
    fields = {**asdict(alarm), 'event': int(alarm.event)}
    del fields['basis'], fields['unit'], fields['rate']
    return fields


@dataclass
class Report:
    """A diagnostics report, whose statuses are made where somebody wants them.

    What it holds stays as it was when the report was due.
    """

    name: str  # of the node, fully qualified
    arm: SerialArm
    state: np.void  # of an answer
    fault: np.void | None  # of the answer, if it has an estimate
    note: str
    counters: dict[str, int]
    rejected: int  # messages that did not fit the arm
    method: str
    sigmas: float  # standard deviations of bounds
    largest: float  # fault that a guarantee has to show, in the unit of `SerialJoint.scale`
    is_guaranteed: bool  # whether anything is
    guarantee: Guarantee | None

    def statuses(self) -> list[dict[str, Any]]:
        """The ``status`` list of diagnostic_msgs/DiagnosticArray: observer and sensors.

        Each entry has the fields of diagnostic_msgs/DiagnosticStatus; its ``values`` is a dict of
        strings.
        """
        values = {
            **self.counters,
            'rejected messages': self.rejected,
            'method': self.method,
            'bounds': f'statistical, {self.sigmas:g} standard deviations',
            'guarantee': self._guarantee_text(),
        }
        if self.guarantee is not None:
            values['guaranteed payload [kg]'] = '{:.3f} to {:.3f}'.format(*self.guarantee.payload)
        level, message = self._judgement()
        if self.fault is not None and level != STALE:
            corrected = self.state['compensated_position'] != self.state['measured_position']
            names = compress(self.arm.joint_names, corrected)
            values['corrected joints'] = ', '.join(names) or 'none'
        observer = self._status('observer', self.arm.name, level, message, values)
        return [observer, *map(self._sensor, range(len(self.arm.joints)))]

    def _judgement(self) -> tuple[int, str]:
        """Level and message of the observer.

        The message is the note, if there is one, where it would say that all is well, or that no
        measurement is usable.
        """
        level, message = _MODES[self.state['mode']]
        if level == STALE:
            return level, self.note or message
        if self.fault is not None and not self.state['trustworthy']:
            if (self.fault['state'] == SensorState.ERROR).any():
                return ERROR, _UNSAFE
            return ERROR, f'{_UNWATCHED}; {self.note}' if self.note else _UNWATCHED
        return (WARN, self.note) if self.fault is not None and self.note else (level, message)

    def _sensor(self, i: int) -> dict[str, Any]:
        """Status of a sensor."""
        state, values, above = SensorState.STALE, {}, False
        if self.fault is not None:
            unit, columns = self.arm.joints[i].units[0], ('estimate', 'bound', 'threshold', 'state')
            estimate, bound, threshold, state = (self.fault[one][i] for one in columns)
            above = abs(estimate) > threshold
            values = {
                f'fault estimate [{unit}]': f'{estimate:.6f}',
                f'bound [{unit}]': f'{bound:.6f}',
                f'threshold [{unit}]': f'{threshold:.6f}',
                **self._guaranteed(i, unit),
            }
        level, message = _LEVELS[state]
        if state == SensorState.WARN and not above:
            message = _INCONSISTENT
        name = self.arm.sensor_names[i]
        return self._status(name, name, level, message, values)

    def _status(
        self, part: str, hardware: str, level: int, message: str, values: dict[str, Any]
    ) -> dict[str, Any]:
        return {
            'level': level,
            'name': f'{self.name}: {part}',
            'message': message,
            'hardware_id': hardware,
            'values': {key: str(value) for key, value in values.items()},
        }

    def _guarantee_text(self) -> str:
        """For which healthy arms thresholds are guaranteed, if they still are."""
        stated = self.arm.uncertainty
        if stated.model_error is None:
            return 'none stated: the arm file has no uncertainty.model_error'
        if not self.is_guaranteed:
            causes = 'other loads, pushes or faults that change'
            return f'none of offsets for {HORIZON:g} s after {causes}'
        return (
            f'healthy arms with masses and inertias within {stated.model_error:.3g}, friction '
            f'within {stated.friction:.3g}, payload up to {stated.largest_payload:g} kg'
        )

    def _guaranteed(self, i: int, unit: str) -> dict[str, str]:
        """Guaranteed threshold of a sensor's offsets, where faults up to ``largest`` show."""
        if self.guarantee is None:
            return {}
        threshold, found = self.guarantee.threshold[i], self.guarantee.smallest_found[i]
        if not found < self.largest * self.arm.joints[i].scale:
            return {f'guaranteed threshold [{unit}]': 'none: this pose and motion show no offset'}
        return {
            f'guaranteed threshold [{unit}]': f'{threshold:.4f}',
            f'surely found beyond [{unit}]': f'{found:.4f}',
        }
