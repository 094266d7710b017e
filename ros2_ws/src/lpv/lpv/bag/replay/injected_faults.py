"""What a replay found of the faults that were injected into its measurements."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lpv.bag.replay.replay import ReplayResult
from lpv.bag.run.record import RecordedAlarm
from lpv.core.serial_arm.diagnosis.alarms import RATE_BIAS, AlarmEvent
from lpv.core.simulation.faults import GRACE, Fault, tells_of
from lpv.core.support.timestamps import NANOSECONDS


@dataclass(frozen=True)
class InjectedFault:
    """One injected fault and the alarm that found it."""

    fault: Fault
    acted: bool  # the recording was not over before
    wrong_sensors: tuple[str, ...] = ()  # healthy sensors that were alarmed meanwhile
    delay: float | None = None  # from its onset to the confirmed alarm of its sensor, if any [s]
    last: RecordedAlarm | None = None  # what that alarm said last while the fault acted
    error: float | None = None  # its size minus the injected one, where that is defined [rad]

    @property
    def verdict(self) -> str:
        """One phrase for the user."""
        if not self.acted:
            return 'not injected, the recording ends before'
        if self.last is not None:
            return 'found'
        wrong = ', '.join(self.wrong_sensors)
        return f'wrong sensor: {wrong}' if wrong else 'not found'


def judge(faults: Sequence[Fault], result: ReplayResult) -> list[InjectedFault]:
    """What alarms say of faults whose onsets count from the first measurement, in their order."""
    start, found = result.first_stamp or 0, []
    events = [((event.stamp - start) / NANOSECONDS, event) for event in result.events]

    def tells(fault: Fault, at: float, event: RecordedAlarm) -> bool | None:
        onset = (event.onset - start) / NANOSECONDS
        is_own = event.sensor == fault.sensor
        return is_own and tells_of(fault.onset, fault.end, onset, at, event.kind)

    end = math.inf if result.last_stamp is None else (result.last_stamp - start) / NANOSECONDS
    for fault in faults:
        wrong = {
            event.sensor
            for at, event in events
            if event.event == AlarmEvent.RAISED and event.sensor != fault.sensor
            if fault.onset <= at <= fault.end + GRACE
            if all(tells(f, at, event) is False for f in faults)
        }
        own = [
            (at, event)
            for at, event in events
            if event.event != AlarmEvent.CLEARED and tells(fault, at, event)
        ]
        delays = [at - fault.onset for at, event in own if event.event == AlarmEvent.RAISED]
        one = InjectedFault(fault, fault.onset <= end, tuple(sorted(wrong)))
        if delays:
            at, last = ([pair for pair in own if pair[0] <= fault.end] or own)[-1]
            true, error = true_size(fault, at), None
            if true is not None and (last.kind == RATE_BIAS) == (fault.kind == RATE_BIAS):
                error = last.size - true
            one = replace(one, delay=delays[0], last=last, error=error)
        found.append(one)
    return found


def true_size(fault: Fault, time: float) -> float | None:
    """Error of a reading [rad], or of a rate, at a time; None where it depends on the reading."""
    if fault.kind == 'drift':
        grown = fault.rate * (min(time, fault.end) - fault.onset)
        # The sign of the limit does not count, as in `lpv.core.simulation.faults.apply_faults`.
        return grown if fault.size == 0.0 else min(max(grown, -abs(fault.size)), abs(fault.size))
    return fault.size if fault.kind in ('bias', RATE_BIAS) else None
