"""What the data allow: faults that differ from none, or from another one, by what a name needs.

Known are the faulty sensor, the kind and the onset of the fault; noise is what the diagnosis learns
of the healthy run.  Rates are differences of the readings: of others, kinematic rows tell more.
"""

from dataclasses import replace

import numpy as np
from fault_injection import Cell, Stream, draw, first_limit

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.information import Window, recent
from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv.core.serial_arm.diagnosis.settings import MonitorSettings

LESS_NOISE = (1.0, 10.0, 100.0)
"""Factors by which the variance of the noise is smaller than the engine expects."""
NEVER_ALARM = 1e200
"""Hours between false alarms of a monitor that only watches."""


def needed(arm: SerialArm) -> float:
    """Square of a fault over its variance that an alarm needs."""
    interval = HorizonPlan.of(arm.sample_time).interval
    return 2.0 * MonitorSettings().threshold(interval)


def shown(cell: Cell, k: int, seed: int) -> list[float]:
    """Square of the fault of a run over its variance, in time, for each share of `LESS_NOISE`.

    An offset from the start, or a drift.
    """
    subject, window, _ = draw(cell, k, seed)
    fault = window.faults[0]
    end = window.stream.index(fault.onset + first_limit(cell.kind, subject.arm))
    faulty = _first(window.stream, end)
    if cell.kind.from_start:
        return offset_shows(subject.arm, faulty, fault.sensor, cell.kind.size)
    none = replace(cell, kind=replace(cell.kind, size=0.0))  # all else is drawn as before
    return difference(subject.arm, _first(draw(none, k, seed)[1].stream, end), faulty)


def offset_shows(arm: SerialArm, stream: Stream, joint: int, size: float) -> list[float]:
    """The same of an offset from the first sample on."""
    estimator = _watched(arm, stream).estimator
    (window, level), last = estimator.of_levels, len(estimator)
    information = _information(window, len(level.mean), recent(window, last))
    least = np.diag(level.least)
    return [
        size**2 / np.linalg.inv(factor * information + least)[joint, joint] for factor in LESS_NOISE
    ]


def difference(arm: SerialArm, stream: Stream, other: Stream) -> list[float]:
    """Power of the difference of two streams' balances, less what is unknown of the arm."""
    one, changed = _watched(arm, stream), _watched(arm, other).readings.all_blocks()
    estimator, blocks = one.estimator, one.readings.all_blocks()
    window, null, last = estimator.window, estimator.posterior, len(estimator)
    at, m = recent(window, last)[::-1], len(null.mean)
    change = (estimator.rows_of(changed) - estimator.rows_of(blocks))[:, :, 0]
    weighed, unknowns = window.weights[at] * change, window.rows[at][:, :, -m:]
    information, least = _information(window, m, at), np.diag(null.least)
    across, own = np.einsum('kia,ki->a', unknowns, weighed), float((weighed * change).sum())
    return [
        factor * own - factor**2 * across @ np.linalg.solve(factor * information + least, across)
        for factor in LESS_NOISE
    ]


def _first(stream: Stream, count: int) -> Stream:
    return Stream(stream.stamps[:count], stream.samples[:count])


def _watched(arm: SerialArm, stream: Stream) -> SerialMonitor:
    """A monitor that has seen a stream, and names nothing."""
    monitor = SerialMonitor(arm, MonitorSettings(NEVER_ALARM))
    monitor.update_many(stream.stamps, stream.samples)
    return monitor


def _information(window: Window, m: int, at: IntArray) -> FloatArray:
    """Information of balances on the m unknowns."""
    rows = window.rows[at][:, :, -m:]
    information: FloatArray = np.einsum('kia,ki,kib->ab', rows, window.weights[at], rows)
    return information
