"""What the diagnosis finds in recordings that an arm file is made from."""

from collections.abc import Sequence

from lpv.core.monitoring.alarm_text import describe
from lpv.core.monitoring.serial_monitor import CONTACT, MISFIT, SerialSensorMonitor
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv.core.support.timestamps import NANOSECONDS
from lpv.identify.recordings.recording import Recording


def unhealthy(arm: SerialArm, recordings: Sequence[Recording], fits: bool = True) -> list[str]:
    """First alarm of each sensor, and torques from outside; misfits if the file ``fits`` else."""
    warned = (CONTACT, MISFIT) if fits else (CONTACT,)
    texts = []
    for one in recordings:
        monitor = SerialSensorMonitor('identify', arm)
        answers = monitor.take_many(one.stamps, one.position, one.rates, one.effort)
        said = [
            (event.onset / NANOSECONDS, event.sensor, describe(event))
            for _, event in answers.events
            if event.event == AlarmEvent.RAISED
        ]
        said += [
            (one.stamps[row] / NANOSECONDS, text, text)
            for row, text in answers.warnings
            if text in warned
        ]
        first = {key: (time, text) for time, key, text in sorted(said, reverse=True)}
        texts += [
            f'{one.source}, {max(0.0, time):.1f} s: {text}; is the recording healthy?'
            for time, text in sorted(first.values())
        ]
    return texts
