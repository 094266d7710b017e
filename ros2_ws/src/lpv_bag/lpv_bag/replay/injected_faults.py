"""What a replay found of the faults that were injected into its measurements."""

from collections.abc import Sequence
from dataclasses import dataclass

from lpv_bag.replay.session import ReplayResult
from lpv_bag.run.streams import RecordedAlarm
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv_core.simulation.faults import Fault
from lpv_core.support.timestamps import NANOSECONDS

_GRACE = 1.0
"""An alarm that is confirmed within this time after the end of a fault belongs to it [s]."""


@dataclass(frozen=True)
class InjectedFault:
    """One injected fault and the alarm that found it; times since the first measurement [s]."""

    fault: Fault
    found: bool  # an alarm of its sensor was confirmed while it acted
    wrong_sensors: tuple[str, ...] = ()  # healthy sensors that were alarmed meanwhile
    delay: float | None = None  # from its onset to the confirmed alarm [s]
    kind: str = ''  # latest classification while it acted
    size: float | None = None  # latest estimate while it acted [rad]
    bound: float | None = None  # stated bound of the estimate's error [rad]
    error: float | None = None  # estimate minus injected size; None where no size is defined [rad]

    @property
    def verdict(self) -> str:
        """One phrase for the user."""
        if self.found:
            also = f', and wrongly {", ".join(self.wrong_sensors)}' if self.wrong_sensors else ''
            return f'found{also}'
        if self.wrong_sensors:
            return f'wrong sensor: {", ".join(self.wrong_sensors)}'
        return 'not found'


def judge(faults: Sequence[Fault], result: ReplayResult) -> list[InjectedFault]:
    """Compare the alarms of a replay with the injected faults, whose onsets count from the first
    measurement; in the order of the faults."""
    start = result.first_stamp or 0
    events = [((event.stamp - start) / NANOSECONDS, event) for event in result.events]
    return [_judge(fault, faults, events) for fault in faults]


def _judge(
    fault: Fault, faults: Sequence[Fault], events: list[tuple[float, RecordedAlarm]]
) -> InjectedFault:
    during = [(at, event) for at, event in events if _acts(fault, at)]
    raised = [(at, event) for at, event in during if event.event == AlarmEvent.RAISED]
    faulty = {(at, other.sensor) for at, _ in raised for other in faults if _acts(other, at)}
    wrong = {event.sensor for at, event in raised if (at, event.sensor) not in faulty}
    mine = [at for at, event in raised if event.sensor == fault.sensor]
    if not mine:
        return InjectedFault(fault, False, tuple(sorted(wrong)))
    at, last = [
        (at, event)
        for at, event in during
        if event.sensor == fault.sensor and event.event != AlarmEvent.CLEARED
    ][-1]
    true = true_size(fault, at)
    return InjectedFault(
        fault,
        True,
        tuple(sorted(wrong)),
        mine[0] - fault.onset,
        last.kind,
        last.size,
        last.bound,
        None if true is None else last.size - true,
    )


def _acts(fault: Fault, time: float) -> bool:
    return fault.onset <= time and (
        fault.duration <= 0.0 or time <= fault.onset + fault.duration + _GRACE
    )


def true_size(fault: Fault, time: float) -> float | None:
    """Error of the reading at a time; None for kinds whose error depends on the reading [rad]."""
    if fault.duration > 0.0:
        time = min(time, fault.onset + fault.duration)
    if fault.kind == 'bias':
        return fault.size
    if fault.kind == 'drift':
        grown = fault.rate * (time - fault.onset)
        return grown if fault.size == 0.0 else min(grown, fault.size, key=abs)
    return None
