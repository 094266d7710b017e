"""What is published about estimates, as plain fields: the same for the node and for a replay.

Each function returns a dict whose keys are the field names of one message type (without its
header), so that neither ROS nor a bag library is needed here.
"""

from dataclasses import asdict

from lpv_core.diagnosis import SensorState
from lpv_core.observer import Mode

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


def state_fields(estimate, diagnosis, mode, joints):
    """Fields of lpv_msgs/StateEstimate.

    Parameters
    ----------
    estimate : Estimate or None
        The estimate; all values are zero without one.
    diagnosis : Diagnosis or None
        Supplies the confirmed faults.
    mode : Mode
        State of the observer.
    joints : JointMap
        Conversions.

    Returns
    -------
    dict
        Field values.
    """
    names = ('position', 'velocity', 'compensated_position', 'measured_position',
             'measured_velocity')
    if estimate is None:
        return {**{name: [0.0, 0.0] for name in names}, 'mode': int(Mode.NO_ESTIMATE),
                'trustworthy': False}
    healthy = joints.joint_from_sensor(estimate.sensor_position - diagnosis.confirmed_fault)
    values = (estimate.position, estimate.velocity, healthy, estimate.measured_position,
              estimate.measured_velocity)
    return {**dict(zip(names, values)), 'mode': int(mode),
            'trustworthy': bool(diagnosis.trustworthy)}


def fault_fields(estimate, diagnosis, states, sensor_names):
    """Fields of lpv_msgs/FaultEstimate.

    Parameters
    ----------
    estimate : Estimate
        The estimate.
    diagnosis : Diagnosis
        Bounds and alarms.
    states : sequence of SensorState
        State per sensor.
    sensor_names : sequence of str
        Names of the sensors.

    Returns
    -------
    dict
        Field values.
    """
    return {'sensor_names': list(sensor_names), 'estimate': estimate.fault,
            'bound': diagnosis.bound, 'threshold': diagnosis.threshold,
            'state': [int(s) for s in states], 'alarm': [bool(a) for a in diagnosis.alarm]}


def alarm_fields(alarm):
    """Fields of lpv_msgs/FaultAlarm; ``onset`` and ``detected`` in nanoseconds.

    Parameters
    ----------
    alarm : Alarm
        The event.

    Returns
    -------
    dict
        Field values.
    """
    return {**asdict(alarm), 'event': int(alarm.event)}


def diagnostic_fields(name, arm, estimate, diagnosis, mode, values):
    """The ``status`` list of diagnostic_msgs/DiagnosticArray: observer and sensors.

    Parameters
    ----------
    name : str
        Fully qualified node name.
    arm : ArmParameters
        Names of arm and sensors.
    estimate : Estimate or None
        Latest estimate.
    diagnosis : Diagnosis or None
        Latest decision.
    mode : Mode
        State of the observer.
    values : dict
        Key-value pairs of the observer's status.

    Returns
    -------
    list of dict
        Fields of diagnostic_msgs/DiagnosticStatus; ``values`` is a dict of strings.
    """
    level, message = _MODES[mode]
    if diagnosis is not None and level < STALE:
        if not diagnosis.trustworthy:
            level, message = ERROR, 'a confirmed fault cannot be compensated safely: stop'
        elif diagnosis.inconsistent:
            level, message = WARN, ('inconsistent, cause unknown: rates, torques and model '
                                    'contradict each other')
    result = [_status(level, f'{name}: observer', message, arm.name, values)]
    for i, sensor in enumerate(arm.sensor_names):
        state, values = SensorState.STALE, {}
        if diagnosis is not None:
            state = SensorState.STALE if mode == Mode.STALE else diagnosis.state[i]
            values = {'fault estimate [rad]': f'{estimate.fault[i]:.6f}',
                      'bound [rad]': f'{diagnosis.bound[i]:.6f}',
                      'threshold [rad]': f'{diagnosis.threshold[i]:.6f}'}
        level, message = _LEVELS[state]
        result.append(_status(level, f'{name}: {sensor}', message, sensor, values))
    return result


def _status(level, name, message, hardware, values):
    return {'level': level, 'name': name, 'message': message, 'hardware_id': hardware,
            'values': {key: str(value) for key, value in values.items()}}
