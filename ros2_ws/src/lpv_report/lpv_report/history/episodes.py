"""Alarms of a run as episodes, from the fault's onset to the alarm's end."""

import math
from dataclasses import dataclass, replace

import numpy as np

from lpv_bag.run.streams import RecordedAlarm, RunRecord
from lpv_core.decision.diagnosis import AlarmEvent


@dataclass(frozen=True)
class Episode:
    """One alarm of one sensor; times since the first measurement [s]."""

    sensor: str  # name of the sensor
    sensor_index: int  # its column
    onset: float  # first sample above the threshold, as diagnosed
    raised: float  # when the fault was confirmed
    cleared: float | None  # when the alarm ended; None if it lasted to the end of the run
    size: float  # latest fault estimate before the alarm was cleared [rad]
    bound: float  # bound of its error [rad]
    # fault estimate of largest magnitude during the alarm [rad]; NaN without fault estimates
    largest: float
    kind: str  # latest classification
    confidence: float  # latest confidence
    # start of the true fault at the time of the alarm; NaN if there was none (false alarm), None
    # without ground truth
    true_onset: float | None = None

    @property
    def delay(self) -> float | None:
        """Time from the true fault's onset to the alarm [s]; None where that is unknown."""
        if self.true_onset is None or math.isnan(self.true_onset):
            return None
        return self.raised - self.true_onset

    @property
    def false_alarm(self) -> bool:
        """Whether ground truth says that there was no fault."""
        return self.true_onset is not None and math.isnan(self.true_onset)


@dataclass(frozen=True)
class Interval:
    """An interval of time of one sensor."""

    sensor_index: int  # column of the sensor
    start: float  # [s] since the first measurement
    end: float  # [s]; that of the record if it lasted so long


def intervals(mask: np.ndarray, time: np.ndarray, sensor_index: int = 0) -> list[Interval]:
    """Intervals in which a mask is true; each ends at the first sample outside."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    ends = np.minimum(ends, len(time) - 1)
    return [Interval(sensor_index, float(time[a]), float(time[b])) for a, b in zip(starts, ends)]


def true_faults(record: RunRecord) -> list[Interval] | None:
    """Intervals in which faults acted; None without ground truth."""
    truth = record.get('ground_truth', 'fault')
    if truth is None:
        return None
    time = record.seconds(record.stamps['ground_truth'])
    # A dropout is recorded as NaN, which is not zero either.
    return [
        interval
        for i in range(truth.shape[1])
        for interval in intervals(truth[:, i] != 0.0, time, i)
    ]


def episodes(record: RunRecord) -> list[Episode]:
    """Alarms of a run, in the order in which they were raised.

    An alarm whose start is not in the bag (an event that clears or updates it is) is taken from
    that event.
    """
    faults = true_faults(record)
    closed: list[Episode] = []
    running: dict[int, Episode] = {}
    for event in record.alarms:
        episode = running.pop(event.sensor_index, None)
        if episode is None or event.event == AlarmEvent.RAISED:
            closed += [episode] if episode is not None else []
            episode = _start(record, event, faults)
        if event.event == AlarmEvent.CLEARED:
            closed.append(replace(episode, cleared=record.seconds(event.stamp)))
        else:
            running[event.sensor_index] = replace(
                episode,
                kind=event.kind,
                confidence=event.confidence,
                size=event.size,
                bound=event.bound,
            )
    found = [_with_largest(record, e) for e in (*closed, *running.values())]
    return sorted(found, key=lambda e: (e.raised, e.sensor_index))


def missed_faults(record: RunRecord, found: list[Episode]) -> list[Interval]:
    """True faults during which no alarm was raised or active; none without ground truth."""
    return [
        fault
        for fault in true_faults(record) or []
        if not any(
            e.sensor_index == fault.sensor_index
            and e.raised <= fault.end
            and (e.cleared is None or e.cleared > fault.start)
            for e in found
        )
    ]


def _start(record: RunRecord, event: RecordedAlarm, faults: list[Interval] | None) -> Episode:
    raised = record.seconds(event.detected)
    return Episode(
        event.sensor,
        event.sensor_index,
        record.seconds(event.onset),
        raised,
        None,
        event.size,
        event.bound,
        math.nan,
        event.kind,
        event.confidence,
        _true_onset(faults, event.sensor_index, raised),
    )


def _true_onset(faults: list[Interval] | None, sensor_index: int, raised: float) -> float | None:
    if faults is None:
        return None
    begun = [
        f.start for f in faults if f.sensor_index == sensor_index and f.start <= raised <= f.end
    ]
    return begun[-1] if begun else math.nan


def _with_largest(record: RunRecord, episode: Episode) -> Episode:
    estimate = record.get('fault_estimate', 'estimate')
    if estimate is None or not 0 <= episode.sensor_index < estimate.shape[1]:
        return episode
    time = record.seconds(record.stamps['fault_estimate'])
    end = math.inf if episode.cleared is None else episode.cleared
    values = estimate[(time >= episode.raised) & (time <= end), episode.sensor_index]
    values = values[np.isfinite(values)]
    if values.size == 0:
        return episode
    return replace(episode, largest=float(values[np.argmax(np.abs(values))]))
