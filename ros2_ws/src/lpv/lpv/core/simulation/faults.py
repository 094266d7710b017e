"""Faults of the physical sensors, as the simulator injects them."""

import math
import reprlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.chain import MAX_JOINTS
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import njit
from lpv.core.support.records import record_type

KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout', 'rate_bias')
_BIAS, _DRIFT, _SCALE, _STUCK, _NOISE, _SPIKE, _DROPOUT, _RATE_BIAS = range(len(KINDS))

GRACE = 1.0
"""Within this time after the end of a fault an alarm that began before is confirmed [s]."""
_LATE = 0.1
"""An alarm that begins so long after a spike, or after the end of a fault, is still of it [s]."""

_NEEDED = {'drift': ('rate',), 'spike': ('size', 'rate'), 'stuck': (), 'dropout': ()}
"""Fields of `Fault` that must not be zero, by kind; of others ``size``."""

_POSITIVE = {'noise': 'size', 'spike': 'rate'}
"""That which must not be negative."""


def _needed(kind: str) -> tuple[str, ...]:
    return _NEEDED.get(kind, ('size',))


def uses(kind: str, name: str) -> bool:
    """Whether a fault of a kind has a ``size``, or a ``rate``."""
    return name in _needed(kind) or (kind, name) == ('drift', 'size')


MAX_FAULTS = len(KINDS) * MAX_JOINTS
"""Most faults at a time: every kind on every sensor."""

_FAULT = record_type(
    ('kind', 'i8'),  # index in KINDS
    ('sensor', 'i8'),
    ('onset', 'f8'),  # [s]
    ('duration', 'f8'),  # [s]
    ('amount', 'f8'),  # size of `Fault`
    ('rate', 'f8'),
    ('frozen', 'f8'),  # reading at which a stuck sensor froze [rad]
    ('is_frozen', '?'),
    ('draw', 'f8', (2,)),  # random numbers of the present sample, see `draw_chances`
)
"""A `Fault` for compiled functions."""


@dataclass(frozen=True)
class Fault:
    """One fault of one sensor."""

    sensor: str = entry('text')  # name of the physical sensor
    # ``bias`` adds ``size`` [rad]; ``drift`` grows with ``rate`` [rad/s] up to ``size`` (without
    # end if 0); ``scale`` multiplies the reading by 1 + ``size``; ``stuck`` freezes it; ``noise``
    # adds white noise of standard deviation ``size`` [rad]; ``spike`` adds +-``size`` [rad] to
    # single samples, ``rate`` of them a second; ``dropout`` gives NaN; ``rate_bias`` is no position
    # fault: it adds ``size`` [rad/s] to the rate that belongs to the sensor
    kind: str = entry('text', choices=KINDS)
    onset: float = entry('number', low=0.0, high=1e6)  # start [s]
    # length [s]; 0 until cleared
    duration: float = entry('number', default=0.0, low=0.0, high=1e6)
    size: float = entry('number', default=0.0, low=-1e3, high=1e3)  # see kind
    rate: float = entry('number', default=0.0, low=-1e3, high=1e3)  # see kind

    def check(self, section: Section) -> None:
        """ConfigError for a fault that does nothing, or less than that."""
        positive = _POSITIVE.get(self.kind, '')
        if positive and getattr(self, positive) < 0.0:
            raise section.error(positive, 'must not be negative')
        for needed in _needed(self.kind):
            if getattr(self, needed) == 0.0:
                raise section.error(needed, f'must not be 0 for a {self.kind} fault')

    @property
    def end(self) -> float:
        """When it stops to act [s]; infinite if only when it is cleared."""
        return self.onset + self.duration if self.duration > 0.0 else math.inf


def tells_of(start: float, end: float, onset: float, detected: float, kind: str) -> bool | None:
    """Whether an alarm tells of a fault of its sensor between two times; None: of its end alone.

    A reading that jumps back when its fault ends is alarmed, too: that finds no fault, and is not
    false. All times in [s]; ``kind`` is that of the alarm.
    """
    late = _LATE if kind == 'spike' else 0.0  # it is over by then
    if start <= detected < end + (GRACE if onset < end else late):
        return True
    return None if start <= detected < end + GRACE and onset <= end + _LATE else False


@njit
def _acts(f: np.record, time: float) -> bool:
    return time >= f.onset and (f.duration <= 0.0 or time < f.onset + f.duration)


@njit
def draw_chances(faults: np.ndarray, time: float, generator: np.random.Generator) -> None:
    """Draw what the random ones among the faults need at a time."""
    for k in range(len(faults)):
        f = faults[k]
        if f.kind == _NOISE and _acts(f, time):
            f.draw[0] = generator.standard_normal()
        elif f.kind == _SPIKE and _acts(f, time):
            f.draw[0], f.draw[1] = generator.random(), generator.random()


@njit
def apply_faults(faults: np.ndarray, time: float, reading: np.ndarray, sample_time: float) -> None:
    """Add all faults that act at a time to the readings S theta [rad]; NaN for a dropout.

    ``sample_time`` [s] is for the rate of spikes.
    """
    for k in range(len(faults)):
        f = faults[k]
        if not _acts(f, time):
            f.is_frozen = False
            continue
        i, value = f.sensor, reading[f.sensor]
        if f.kind == _BIAS:
            reading[i] = value + f.amount
        elif f.kind == _DRIFT:
            grown, limit = f.rate * (time - f.onset), abs(f.amount)
            reading[i] = value + (min(max(grown, -limit), limit) if limit > 0.0 else grown)
        elif f.kind == _SCALE:
            reading[i] = value * (1.0 + f.amount)
        elif f.kind == _STUCK:
            if not f.is_frozen:
                f.is_frozen, f.frozen = True, value
            reading[i] = f.frozen
        elif f.kind == _NOISE:
            reading[i] = value + f.amount * f.draw[0]
        elif f.kind == _SPIKE:
            if f.draw[0] < f.rate * sample_time:
                reading[i] = value + (f.amount if f.draw[1] < 0.5 else -f.amount)
        elif f.kind == _DROPOUT:
            reading[i] = math.nan


@njit
def rate_bias(faults: np.ndarray, sensor: int, time: float) -> float:
    """What faults add to the rate that belongs to a sensor [rad/s]."""
    total = 0.0
    for k in range(len(faults)):
        f = faults[k]
        if f.kind == _RATE_BIAS and f.sensor == sensor and _acts(f, time):
            total += f.amount
    return total


@njit
def is_frozen(faults: np.ndarray, sensor: int, time: float) -> bool:
    """Whether a sensor is stuck: it carries no noise either."""
    for k in range(len(faults)):
        if faults[k].kind == _STUCK and faults[k].sensor == sensor and _acts(faults[k], time):
            return True
    return False


def _check_sensor(name: str, known: Sequence[str]) -> None:
    if name not in known:
        reason = f'{reprlib.repr(name)} is unknown; the arm has {", ".join(known)}'
        raise ConfigError('fault.sensor', reason)


def check_fault(fault: Fault, sensor_names: Sequence[str]) -> None:
    """Refuse a fault that the simulator cannot apply: ConfigError naming the field."""
    _check_sensor(fault.sensor, sensor_names)
    read_entries(Fault, Section(vars(fault), '', 'fault'))


def _records(rows: np.ndarray) -> np.ndarray:
    """Rows whose fields are attributes, as an array that Numba takes quickly."""
    return np.asarray(rows.view(np.recarray))


class FaultInjector:
    """Applies all active faults to the readings of an arm's sensors.

    Parameters
    ----------
    sensor_names : sequence of str, n
        The physical sensors.
    faults : iterable of Fault
        Scheduled faults.
    generator : numpy.random.Generator
        Source of randomness for ``noise`` and ``spike``.

    Attributes
    ----------
    faults : list of Fault
        What is scheduled.
    records : ndarray
        The same for compiled functions.
    generator : numpy.random.Generator
        As given.
    """

    def __init__(
        self, sensor_names: Sequence[str], faults: Iterable[Fault], generator: np.random.Generator
    ) -> None:
        self._names = tuple(sensor_names)
        self.generator = generator
        self.faults: list[Fault] = []
        self.records = _records(np.zeros(0, _FAULT))
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Schedule a further fault; ConfigError if it is not valid."""
        check_fault(fault, self._names)
        if len(self.faults) >= MAX_FAULTS:
            raise ConfigError('fault', f'there are {MAX_FAULTS} already: clear some first')
        row = np.zeros(1, _FAULT)
        row['kind'], row['sensor'] = KINDS.index(fault.kind), self._names.index(fault.sensor)
        row['onset'], row['duration'] = fault.onset, fault.duration
        row['amount'], row['rate'] = fault.size, fault.rate
        self.faults.append(fault)
        self.records = _records(np.concatenate([self.records, row]))

    def clear(self, sensor: str = '') -> int:
        """Remove faults.

        Parameters
        ----------
        sensor : str, optional
            Name of one sensor; all if empty.

        Returns
        -------
        int
            How many were removed.

        Raises
        ------
        ConfigError
            If the sensor is unknown.
        """
        if sensor:
            _check_sensor(sensor, self._names)
        kept = [bool(sensor) and f.sensor != sensor for f in self.faults]
        removed = kept.count(False)
        self.faults = [f for f, keep in zip(self.faults, kept) if keep]
        self.records = self.records[np.array(kept, dtype=bool)]
        return removed

    def apply(self, time: float, reading: np.ndarray, sample_time: float) -> np.ndarray:
        """Faulty readings at one time.

        Parameters
        ----------
        time : float
            [s].
        reading : ndarray, shape (n,)
            Fault-free readings S theta [rad].
        sample_time : float
            For the rate of spikes [s].

        Returns
        -------
        ndarray, shape (n,)
            Readings with faults, NaN for a dropout.
        """
        faulty = np.array(reading, float)
        if any(fault.kind in ('noise', 'spike') for fault in self.faults):
            draw_chances(self.records, float(time), self.generator)
        apply_faults(self.records, float(time), faulty, sample_time)
        return faulty
