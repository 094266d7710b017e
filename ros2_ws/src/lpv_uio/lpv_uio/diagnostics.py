"""The /diagnostics view of the diagnosis: one status per sensor, one for the observer."""

from dataclasses import asdict

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from lpv_core.diagnosis import SensorState
from lpv_core.observer import Mode

_LEVELS = {
    SensorState.OK: (DiagnosticStatus.OK, 'no fault'),
    SensorState.WARN: (DiagnosticStatus.WARN, 'above the threshold, not confirmed'),
    SensorState.ERROR: (DiagnosticStatus.ERROR, 'fault confirmed'),
    SensorState.STALE: (DiagnosticStatus.STALE, 'no data'),
    SensorState.NOT_DIAGNOSABLE: (DiagnosticStatus.WARN, 'not diagnosable in this configuration'),
}
_MODES = {
    Mode.OBSERVING: (DiagnosticStatus.OK, 'observing'),
    Mode.HOLDING: (DiagnosticStatus.WARN, 'holding: a link carries no gravity information'),
    Mode.INITIALISING: (DiagnosticStatus.WARN, 'initialising'),
    Mode.STALE: (DiagnosticStatus.STALE, 'no usable measurements'),
    Mode.NO_ESTIMATE: (DiagnosticStatus.STALE, 'no usable measurement yet'),
}


def diagnostic_array(name, arm, estimate, diagnosis, counters, mode, extra):
    """Build the message.

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
    counters : Counters
        Unusable samples so far.
    mode : Mode
        State of the observer.
    extra : dict
        Further values for the observer's status.

    Returns
    -------
    diagnostic_msgs.msg.DiagnosticArray
        Without stamp.
    """
    array = DiagnosticArray()
    level, message = _MODES[mode]
    values = {**asdict(counters), **extra}
    array.status.append(_status(level, f'{name}: observer', message, arm.name, values))
    for i, sensor in enumerate(arm.sensor_names):
        state = SensorState.STALE
        values = {}
        if diagnosis is not None:
            state = SensorState.STALE if mode == Mode.STALE else diagnosis.state[i]
            values = {'fault estimate [rad]': f'{estimate.fault[i]:.6f}',
                      'bound [rad]': f'{diagnosis.bound[i]:.6f}',
                      'threshold [rad]': f'{diagnosis.threshold[i]:.6f}'}
        level, message = _LEVELS[state]
        array.status.append(_status(level, f'{name}: {sensor}', message, sensor, values))
    return array


def _status(level, name, message, hardware, values):
    return DiagnosticStatus(level=level, name=name, message=message, hardware_id=hardware,
                            values=[KeyValue(key=k, value=str(v)) for k, v in values.items()])
