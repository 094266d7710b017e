"""Alarms and diagnostics as plain fields of messages: the same for the node and for a replay.

Neither ROS nor a bag library is needed here; headers are left out.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lpv.core.monitoring.sample_loop import UNWATCHED
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Alarm, Mode, SensorState
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
        """The ``status`` list of diagnostic_msgs/DiagnosticArray."""
        values = {
            **self.counters,
            'rejected messages': self.rejected,
            'method': self.method,
            'bounds': f'statistical, {self.sigmas:g} standard deviations',
            'guarantee': guarantee_text(self.arm, self.is_guaranteed),
        }
        details: tuple[dict[str, str], ...] = ()
        if self.guarantee is not None:
            values['guaranteed payload [kg]'] = '{:.3f} to {:.3f}'.format(*self.guarantee.payload)
            details = guaranteed_fields(self.arm, self.guarantee, self.largest)
        return diagnostic_fields(
            self.name, self.arm, self.state, self.fault, values, self.note, details
        )


def diagnostic_fields(
    name: str,
    arm: SerialArm,
    state: np.void,
    fault: np.void | None,
    values: dict[str, Any],
    note: str,
    details: tuple[dict[str, str], ...],
) -> list[dict[str, Any]]:
    """The ``status`` list of diagnostic_msgs/DiagnosticArray: observer and sensors.

    ``name`` is the fully qualified node name, ``fault`` is None without an estimate, and ``values``
    are the key-value pairs of the observer's status; its message is the ``note``, if there is one,
    where it would say that all is well, or that no measurement is usable.  ``details`` are further
    key-value pairs of each sensor, or empty.  Each entry has the fields of
    diagnostic_msgs/DiagnosticStatus; its ``values`` is a dict of strings.
    """
    level, message = _MODES[state['mode']]
    if level == STALE:
        message = note or message
    elif fault is not None:
        if not state['trustworthy']:
            is_confirmed = (fault['state'] == SensorState.ERROR).any()
            level, message = ERROR, _UNSAFE if is_confirmed else _UNWATCHED
            message += '' if is_confirmed or not note else f'; {note}'
        elif note:
            level, message = WARN, note
        pairs = zip(state['compensated_position'].tolist(), state['measured_position'].tolist())
        corrected = (name for name, (now, read) in zip(arm.joint_names, pairs) if now != read)
        values['corrected joints'] = ', '.join(corrected) or 'none'
    result = [_status(level, f'{name}: observer', message, arm.name, values)]
    columns: list[list[Any]] = []
    if fault is not None:
        columns = [fault[one].tolist() for one in ('estimate', 'bound', 'threshold', 'state')]
    for i, sensor in enumerate(arm.sensor_names):
        sensor_state, values, above = SensorState.STALE, {}, False
        if fault is not None:
            unit = arm.joints[i].units[0]
            estimate, bound, threshold, sensor_state = (column[i] for column in columns)
            above = abs(estimate) > threshold
            values = {
                f'fault estimate [{unit}]': f'{estimate:.6f}',
                f'bound [{unit}]': f'{bound:.6f}',
                f'threshold [{unit}]': f'{threshold:.6f}',
                **(details[i] if details else {}),
            }
        level, message = _LEVELS[sensor_state]
        if sensor_state == SensorState.WARN and not above:
            message = _INCONSISTENT
        result.append(_status(level, f'{name}: {sensor}', message, sensor, values))
    return result


def guarantee_text(arm: SerialArm, is_guaranteed: bool) -> str:
    """For which healthy arms thresholds are guaranteed, if they still are."""
    stated = arm.uncertainty
    if stated.model_error is None:
        return 'none stated: the arm file has no uncertainty.model_error'
    if not is_guaranteed:
        return 'none of offsets after other loads, pushes or a fault that changes, until reset'
    return (
        f'healthy arms with masses and inertias within {stated.model_error:.3g}, friction '
        f'within {stated.friction:.3g}, payload up to {stated.largest_payload:g} kg'
    )


def guaranteed_fields(
    arm: SerialArm, known: Guarantee, largest: float
) -> tuple[dict[str, str], ...]:
    """Guaranteed thresholds of the offsets, for each sensor, where faults up to ``largest`` show.

    ``largest`` is in the unit of `SerialJoint.scale`.
    """
    result = []
    for joint, threshold, found in zip(arm.joints, known.threshold, known.smallest_found):
        unit = joint.units[0]
        one = {f'guaranteed threshold [{unit}]': 'none: this pose and motion show no offset'}
        if found < largest * joint.scale:
            one[f'guaranteed threshold [{unit}]'] = f'{threshold:.4f}'
            one[f'surely found beyond [{unit}]'] = f'{found:.4f}'
        result.append(one)
    return tuple(result)


def _status(
    level: int, name: str, message: str, hardware: str, values: dict[str, Any]
) -> dict[str, Any]:
    return {
        'level': level,
        'name': name,
        'message': message,
        'hardware_id': hardware,
        'values': {key: str(value) for key, value in values.items()},
    }
