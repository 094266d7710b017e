"""Rows of a campaign as columns of NumPy, with the questions that all sections ask of them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from lpv_campaign.execution.run_metrics import BINS
from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.plan.factors import ByKind, Choice, Range
from lpv_campaign.plan.spec import BOTH, NO_FAULT, NUMBERS
from lpv_core.simulation.faults import KINDS


@dataclass(frozen=True)
class Dose:
    """What is called the size of a kind of fault."""

    column: str  # Factor that holds it; empty for kinds that have no size
    name: str  # As axes and tables call it
    unit: str  # Its unit there


_DOSES = {
    'bias': Dose('fault.size', 'size', 'rad'),
    'drift': Dose('fault.rate', 'rate', 'rad/s'),
    'scale': Dose('fault.size', 'relative size', '1'),
    'noise': Dose('fault.size', 'standard deviation', 'rad'),
    'spike': Dose('fault.size', 'height', 'rad'),
    'rate_bias': Dose('fault.size', 'size', 'rad/s'),
}
_NO_DOSE = Dose('', '', '')


def dose_of(kind: str) -> Dose:
    """What is called the size of a kind of fault."""
    return _DOSES.get(kind, _NO_DOSE)


class Results:
    """Results of a campaign, or of a part of it.

    Parameters
    ----------
    campaign : Campaign
        What was run.
    table : pyarrow.Table
        Rows; columns may be missing or empty.

    Attributes
    ----------
    campaign : Campaign
        The same.
    count : int
        Number of rows.
    sensors : tuple of str
        Names of the sensors.
    kind, sensor : ndarray of str, shape (count,)
        Injected fault.
    faulty : ndarray of bool, shape (count,)
        Whether there was any.
    """

    def __init__(self, campaign: Campaign, table: pa.Table) -> None:
        self.campaign, self._table = campaign, table
        self.count, self.sensors = table.num_rows, campaign.arm.sensor_names
        self.kind, self.sensor = self.text('kind', NO_FAULT), self.text('sensor', NO_FAULT)
        self.faulty = self.kind != NO_FAULT

    @property
    def columns(self) -> list[str]:
        """Names of the columns that are there."""
        return self._table.column_names

    def number(self, name: str) -> np.ndarray:
        """A column of numbers, NaN where there is none; shape (count,)."""
        if name not in self.columns:
            return np.full(self.count, math.nan)
        column = self._table[name]
        return (
            np.asarray(column.to_numpy(), float)
            if column.null_count == 0
            else np.array([math.nan if v is None else v for v in column.to_pylist()], float)
        )

    def text(self, name: str, empty: str = '') -> np.ndarray:
        """A column of texts, ``empty`` where there is none; shape (count,)."""
        if name not in self.columns:
            return np.full(self.count, empty, object)
        values = [empty if v is None else str(v) for v in self._table[name].to_pylist()]
        return np.array(values, object)

    def flag(self, name: str) -> np.ndarray:
        """A column of truths, False where there is none; shape (count,)."""
        return np.nan_to_num(self.number(name)) > 0.0

    def lists(self, name: str) -> np.ndarray:
        """A column of one number a class of `BINS`; shape (count, classes), 0 where missing."""
        result = np.zeros((self.count, len(BINS) - 1))
        if name in self.columns:
            for row, values in enumerate(self._table[name].to_pylist()):
                if values is not None and len(values) == result.shape[1]:
                    result[row] = values
        return np.where(np.isfinite(result), result, 0.0)

    @property
    def kinds(self) -> list[str]:
        """Kinds of faults that occur, in the order in which they are documented."""
        present = set(self.kind)
        return [kind for kind in KINDS if kind in present]

    def of_sensor(self, index: int) -> np.ndarray:
        """Runs in which a sensor is faulty, alone or with others; shape (count,)."""
        name = self.sensors[index]
        mine = [sensor == BOTH or name in sensor.split('+') for sensor in self.sensor]
        return np.array(mine, bool) & self.faulty

    @property
    def several(self) -> np.ndarray:
        """Runs in which several sensors are faulty; shape (count,)."""
        return np.array([sensor == BOTH or '+' in sensor for sensor in self.sensor], bool)

    def dose(self, kind: str) -> np.ndarray:
        """Size of the faults of a kind, without sign; NaN elsewhere and where it is not known."""
        column = dose_of(kind).column
        # Faults of the scenario leave the factors at what they are without one.
        mine = (self.kind == kind) & (self.text('fault.kind', NO_FAULT) == kind)
        if not column:
            return np.full(self.count, math.nan)
        values = np.abs(self.number(column))
        return np.where(mine & (values > 0.0), values, math.nan)

    @property
    def duration(self) -> float:
        """Length of each run [s]."""
        spec = self.campaign.spec
        return spec.duration or self.campaign.scenario(spec.scenario).duration

    @property
    def faulty_time(self) -> np.ndarray:
        """Time from first onset to last end of the faults of each run [s]; shape (count,)."""
        begin, end = self._interval()
        return np.clip(end, 0.0, self.duration) - np.clip(begin, 0.0, self.duration)

    @property
    def healthy_hours(self) -> np.ndarray:
        """Time without a fault, of each run [h]; shape (count,)."""
        return (self.duration - self.faulty_time) / 3600.0

    @property
    def early_hours(self) -> np.ndarray:
        """Time before the first fault, of each run [h]; shape (count,)."""
        return np.clip(self._interval()[0], 0.0, self.duration) / 3600.0

    def _interval(self) -> tuple[np.ndarray, np.ndarray]:
        spec = self.campaign.spec
        if 'fault.kind' in spec.factors:
            begin, length = self.number('fault.onset'), self.number('fault.duration')
            begin = np.where(self.faulty, np.nan_to_num(begin), math.inf)
            return begin, np.where(length > 0.0, begin + length, math.inf)
        faults = self.campaign.scenario(spec.scenario).faults
        first = min((f.onset for f in faults), default=math.inf)
        last = max(
            (f.onset + f.duration if f.duration > 0.0 else math.inf for f in faults),
            default=math.inf,
        )
        return np.full(self.count, first), np.full(self.count, last)

    def varied(self, numeric: bool) -> list[str]:
        """Factors that differ between rows."""
        found = []
        for name, factor in self.campaign.spec.factors.items():
            is_number = name in NUMBERS or name.startswith('diagnosis.')
            if isinstance(factor, ByKind) or is_number != numeric or not _varies(factor):
                continue
            found.append(name)
        return found


def _varies(factor: Any) -> bool:
    return isinstance(factor, Range) or isinstance(factor, Choice) and len(factor.values) > 1
