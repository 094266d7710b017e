"""What the data allow: faults that differ from none, from another one, or from a push, enough.

Known are the faulty sensor, the kind and the onset of the fault; noise is what the diagnosis learns
of the healthy run.  Rates are differences of the readings: of others, kinematic rows tell more.
"""

import math
from dataclasses import replace

import numpy as np
from fault_injection import Cell, Stream, derived, draw, first_limit
from watched import Watched

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.bank import Hypothesis
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.information import Posterior, Window, recent
from lpv.core.serial_arm.diagnosis.settings import DiagnosisParameters
from lpv.core.serial_arm.sensor_map import map_rows

LESS_NOISE = (1.0, 10.0, 100.0)
"""Factors by which the variance of the noise is smaller than the engine expects."""
NEVER_ALARM = 1e200
"""Hours between false alarms of a monitor that only watches."""


def needed(arm: SerialArm, kind: str = '') -> float:
    """Square of a fault over its variance that an alarm needs; of a scale error, its name."""
    settings = DiagnosisParameters()
    if kind == 'scale':
        return -2.0 * math.log(settings.probability_of_wrong_name)
    return 2.0 * settings.threshold(HorizonPlan.of(arm.sample_time).interval)


def shown(cell: Cell, k: int, seed: int) -> tuple[list[float], bool]:
    """What the data of a run show in time of an offset from the start, a drift, a scale error.

    The square of the fault over its variance, for each share of `LESS_NOISE`, chance left out, that
    of a scale error against an offset as large as it when it begins; and whether balances as
    measured name it, which is asked of drifts alone.
    """
    subject, window, _ = draw(cell, k, seed)
    fault = window.faults[0]
    limit = first_limit(cell.kind, subject.arm)
    end = window.stream.index(fault.onset + limit)
    faulty = _first(window.stream, end)
    if cell.kind.from_start:
        powers = offset_shows(subject.arm, faulty, fault.sensor, cell.kind.size)
        return powers, False
    if cell.kind.kind == 'scale':
        begin, readings = window.stream.index(fault.onset), faulty.samples.copy()
        change = window.truth[begin:end] - window.truth[begin]
        readings[begin:, 0] -= map_rows(subject.arm.sensors_to_joints(), change)
        steady = Stream(faulty.stamps, readings)
        steady = subject.driver(steady, cell.rates) if subject.driver else derived(steady)
        return Changed(subject.arm, steady, faulty).powers(), False
    none = replace(cell, kind=replace(cell.kind, size=0.0))  # all else is drawn as before
    changed = Changed(subject.arm, _first(draw(none, k, seed)[1].stream, end), faulty)
    return changed.powers(), changed.names(fault.sign * cell.kind.size, limit)


def offset_shows(arm: SerialArm, stream: Stream, joint: int, size: float) -> list[float]:
    """The same of an offset from the first sample on."""
    estimator = _watched(arm, stream).estimator
    window, level = estimator.window, estimator.level
    information = _information(window, level, recent(window, len(estimator)))
    least = np.diag(level.least)
    return [
        size**2 / np.linalg.inv(factor * information + least)[joint, joint] for factor in LESS_NOISE
    ]


class Changed:
    """Balances of a stream, and by how much those of another stream differ from them."""

    def __init__(self, arm: SerialArm, stream: Stream, other: Stream) -> None:
        self._monitor = _watched(arm, stream)
        estimator, changed = self._monitor.estimator, _watched(arm, other).readings.all_blocks()
        window, null = estimator.window, estimator.posterior
        self._at, m = recent(window, len(estimator))[::-1], len(null.mean)
        rows = estimator.rows_of(changed) - estimator.rows_of(self._monitor.readings.all_blocks())
        self._change = rows[:, :, 0]
        self._unknowns, self._weights = (window.rows[self._at][:, :, -m:], null.weights[self._at])
        self._information, self._least = _information(window, null, self._at), np.diag(null.least)

    def powers(self) -> list[float]:
        """Power of the difference less what is unknown of the arm, for `LESS_NOISE`."""
        return [self._product(self._change, self._change, factor) for factor in LESS_NOISE]

    def _estimate(self, balances: FloatArray, factor: float = 1.0) -> FloatArray:
        """Unknowns of the arm that explain most of balances, if noise were so much less."""
        pulled = np.einsum('kia,ki->a', self._unknowns, self._weights * balances)
        return -factor * np.linalg.solve(factor * self._information + self._least, pulled)

    def _product(self, one: FloatArray, other: FloatArray, factor: float = 1.0) -> float:
        """Of two courses of balances, less what is unknown of the arm."""
        left = other + self._unknowns @ self._estimate(other, factor)
        return factor * float((self._weights * one * left).sum())

    def names(self, drift: float, age: float) -> bool:
        """Whether balances as measured tell the other stream's drift from none and from a push.

        ``drift`` is its size [rad/s], which is unknown to them, and ``age`` the time since its
        onset [s].  Afterwards the monitor has these balances.
        """
        monitor, column = self._monitor, self._change / drift
        estimator = monitor.estimator
        measured = estimator.window.rows[self._at, :, 0] + self._change
        found, own = self._product(column, measured), self._product(column, column)
        wide = priors.SIZE['drift'] ** 2
        gain = 0.5 * (found**2 / (own + 1.0 / wide) - math.log1p(own * wide))
        estimator.window.rows[self._at, :, 0] = measured
        estimator.posterior.mean[:] = self._estimate(measured)
        begin = float(estimator.times(1)[0]) + estimator.plan.interval - age
        fault = Hypothesis('drift', 0, gain, drift, 0.0, begin)
        beyond = 2.0 * gain > needed(monitor.arm)
        return beyond and monitor.bank.excludes_contact(fault, monitor.margin('drift'))


def _first(stream: Stream, count: int) -> Stream:
    return Stream(stream.stamps[:count], stream.samples[:count])


def _watched(arm: SerialArm, stream: Stream) -> Watched:
    """A monitor that has seen a stream, and names nothing."""
    monitor = Watched(arm, hours_between_false_alarms=NEVER_ALARM)
    monitor.take(stream.stamps, stream.samples)
    return monitor


def _information(window: Window, null: Posterior, at: IntArray) -> FloatArray:
    """Information of balances on the unknowns."""
    rows = window.rows[at][:, :, -len(null.mean) :]
    information: FloatArray = np.einsum('kia,ki,kib->ab', rows, null.weights[at], rows)
    return information
