"""Figures of one bag that are summed up while it is replayed."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lpv_core.decision.diagnosis import Alarm, AlarmEvent, SensorState
from lpv_core.support.timestamps import NANOSECONDS

STATES = tuple(state.name.lower() for state in SensorState)
"""Names of the states of a sensor, in the order of their numbers."""
_DIAGNOSED = (int(SensorState.OK), int(SensorState.WARN), int(SensorState.ERROR))
_WAITING = 20_000
"""Samples that may wait for their reference, or references for their sample."""


class Tally:
    """Sums over the answers to one bag's measurements.

    A sample counts for the time until the next one, at most ``max_gap``: what was not recorded was
    not observed.

    Parameters
    ----------
    sample_time, max_gap : float
        Time that the last sample counts for, and the longest one [s].
    """

    def __init__(self, sample_time: float, max_gap: float) -> None:
        self._sample_time, self._max_gap = sample_time, max_gap
        self._state_time = np.zeros((len(STATES), 2))
        self._inconsistent = self._untrusted = 0.0
        self._score, self._largest = np.zeros(2), np.zeros(2)
        self._sums = np.zeros((4, 2))
        self._pending: np.ndarray | None = None
        self._first: int | None = None
        self._last: int | None = None
        self._tracking = _Tracking()

    def take(self, measured: Any, answers: Any, streams: dict[str, Any]) -> None:
        """Count the answers to a block, as `lpv_bag.replay.replay.Replay.watch` hands them on."""
        if len(measured.stamp):
            self._count_time(measured, answers)
        rows = np.flatnonzero(answers.answered & answers.has_fault)
        if len(rows):
            self._count_faults(answers.fault[rows])
        reference = streams.get('reference')
        self._tracking.take(
            measured.stamp,
            measured.position,
            *(reference[0], reference[1]['position']) if reference else (),
        )

    def _count_time(self, measured: Any, answers: Any) -> None:
        stamps = measured.stamp
        self._first = int(stamps[0]) if self._first is None else min(self._first, int(stamps.min()))
        self._last = int(stamps.max()) if self._last is None else max(self._last, int(stamps.max()))
        rows = np.flatnonzero(answers.answered)
        state = np.where(
            answers.has_fault[rows, None], answers.fault.state[rows], int(SensorState.STALE)
        ).astype(np.int64)
        table = np.column_stack(
            [stamps[rows], state, answers.inconsistent[rows], ~answers.state.trustworthy[rows]]
        ).astype(np.int64)
        if self._pending is not None:
            table = np.vstack([self._pending, table])
        if len(table):
            interval = np.clip(np.diff(table[:, 0]) / NANOSECONDS, 0.0, self._max_gap)
            self._add(table[:-1], interval)
            self._pending = table[-1:]

    def _add(self, table: np.ndarray, interval: np.ndarray) -> None:
        for i in range(2):
            self._state_time[:, i] += np.bincount(table[:, 1 + i], interval, len(STATES))
        self._inconsistent += float(interval @ table[:, 3])
        self._untrusted += float(interval @ table[:, 4])

    def _count_faults(self, fault: Any) -> None:
        estimate, threshold = np.asarray(fault.estimate), np.asarray(fault.threshold)
        state = np.asarray(fault.state)
        known = (state != int(SensorState.STALE)) & (threshold > 0.0)
        score = np.divide(np.abs(estimate), threshold, out=np.zeros_like(estimate), where=known)
        self._score = np.maximum(self._score, score.max(axis=0))
        diagnosed = np.isin(state, _DIAGNOSED)
        sure = np.where(diagnosed, estimate, 0.0)
        self._largest = np.maximum(self._largest, np.abs(sure).max(axis=0))
        self._sums += [
            diagnosed.sum(axis=0),
            sure.sum(axis=0),
            (sure**2).sum(axis=0),
            np.where(diagnosed, threshold, 0.0).sum(axis=0),
        ]

    def row(self) -> dict[str, Any]:
        """Figures of the bag, by column; None where there is nothing to be measured."""
        if self._pending is not None:
            self._add(self._pending, np.array([self._sample_time]))
            self._pending = None
        count = np.where(self._sums[0] > 0, self._sums[0], np.nan)
        mean, square, threshold = self._sums[1:] / count
        tracking = self._tracking.rms()
        row = {
            'start': self._first,
            'duration': ((self._last or 0) - (self._first or 0)) / NANOSECONDS,
            'observed': float(self._state_time[:, 0].sum()),
            'inconsistent_time': self._inconsistent,
            'untrusted_time': self._untrusted,
        }
        for i in range(2):
            number = i + 1
            row.update(
                {
                    f'time_{name}_{number}': float(self._state_time[k, i])
                    for k, name in enumerate(STATES)
                }
            )
            row.update(
                {
                    f'score_{number}': float(self._score[i]),
                    f'fault_largest_{number}': float(self._largest[i]),
                    f'fault_mean_{number}': _number(mean[i]),
                    f'fault_rms_{number}': _number(np.sqrt(square[i])),
                    f'threshold_mean_{number}': _number(threshold[i]),
                    f'reference_error_{number}': _number(tracking[i]),
                }
            )
        return row


class _Tracking:
    """Squared differences of measured positions and references with the same stamp."""

    def __init__(self) -> None:
        self._empty = np.empty(0, np.int64), np.empty((0, 2))
        self._measured = self._reference = self._empty
        self._sums, self._count = np.zeros(2), np.zeros(2)

    def take(
        self,
        stamps: np.ndarray,
        positions: np.ndarray,
        reference_stamps: np.ndarray | None = None,
        references: np.ndarray | None = None,
    ) -> None:
        self._measured = _joined(self._measured, stamps, positions)
        if reference_stamps is not None and references is not None:
            self._reference = _joined(self._reference, reference_stamps, references)
        common, i, j = np.intersect1d(self._measured[0], self._reference[0], return_indices=True)
        if len(common):
            error = self._measured[1][i] - self._reference[1][j]
            finite = np.isfinite(error)
            self._sums += (np.where(finite, error, 0.0) ** 2).sum(axis=0)
            self._count += finite.sum(axis=0)
            last = common[-1]
            self._measured = tuple(v[self._measured[0] > last] for v in self._measured)
            self._reference = tuple(v[self._reference[0] > last] for v in self._reference)

    def rms(self) -> np.ndarray:
        with np.errstate(invalid='ignore', divide='ignore'):
            return np.sqrt(self._sums / self._count)


def _joined(
    kept: tuple[np.ndarray, np.ndarray], stamps: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.concatenate([kept[0], stamps])[-_WAITING:],
        np.concatenate([kept[1], values])[-_WAITING:],
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def alarm_rows(events: Sequence[Alarm], start: int) -> list[dict[str, Any]]:
    """Alarms of a bag by sensor and kind.

    Returns ``sensor``, last said ``kind``, ``count``, and of the first such alarm ``onset`` and
    ``detected`` [s], ``size`` and ``bound`` [rad].
    """
    running: dict[str, dict[str, Any]] = {}
    done: list[dict[str, Any]] = []
    for event in events:
        if event.event == AlarmEvent.RAISED:
            done.append(
                {
                    'sensor': event.sensor,
                    'kind': event.kind,
                    'count': 1,
                    'onset': (event.onset - start) / NANOSECONDS,
                    'detected': (event.detected - start) / NANOSECONDS,
                    'size': float(event.size),
                    'bound': float(event.bound),
                }
            )
            running[event.sensor] = done[-1]
        elif event.sensor in running:
            running[event.sensor]['kind'] = event.kind
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for alarm in done:
        first = rows.setdefault((alarm['sensor'], alarm['kind']), alarm)
        if first is not alarm:
            first['count'] += 1
    return list(rows.values())
