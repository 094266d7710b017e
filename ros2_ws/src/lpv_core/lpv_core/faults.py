"""Faults of the physical position sensors, as the simulator injects them."""

import math
from dataclasses import dataclass

import numpy as np

from lpv_core.errors import ConfigError

KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout')


@dataclass(frozen=True)
class Fault:
    """One fault of one sensor.

    Attributes
    ----------
    sensor : str
        Name of the physical sensor.
    kind : str
        One of `KINDS`: ``bias`` adds ``size`` [rad]; ``drift`` grows with ``rate`` [rad/s] up to
        ``size`` (without end if 0); ``scale`` multiplies the reading by 1 + ``size``; ``stuck``
        freezes it; ``noise`` adds white noise of standard deviation ``size`` [rad]; ``spike``
        adds +-``size`` [rad] to single samples, ``rate`` of them a second; ``dropout`` gives NaN.
    onset : float
        Start [s].
    duration : float
        Length [s]; 0 until cleared.
    size, rate : float
        As above.
    """

    sensor: str
    kind: str
    onset: float
    duration: float = 0.0
    size: float = 0.0
    rate: float = 0.0

    def active(self, time):
        """Whether the fault acts at ``time`` [s]."""
        if time < self.onset:
            return False
        return self.duration <= 0.0 or time < self.onset + self.duration


def check_fault(fault, sensor_names):
    """Refuse a fault that the simulator cannot apply.

    Parameters
    ----------
    fault : Fault
        The fault.
    sensor_names : sequence of str
        Known sensors.

    Raises
    ------
    ConfigError
        Naming the field.
    """
    if fault.sensor not in sensor_names:
        raise ConfigError('fault.sensor', f'{fault.sensor!r} is unknown; the arm has '
                          + ', '.join(sensor_names))
    if fault.kind not in KINDS:
        raise ConfigError('fault.kind', f'{fault.kind!r} must be one of ' + ', '.join(KINDS))
    for name in ('onset', 'duration', 'size', 'rate'):
        value = getattr(fault, name)
        if not math.isfinite(value):
            raise ConfigError(f'fault.{name}', f'must be finite, got {value}')
    for name in ('duration',) + (('size',) if fault.kind == 'noise' else ()) + (
            ('rate',) if fault.kind == 'spike' else ()):
        if getattr(fault, name) < 0.0:
            raise ConfigError(f'fault.{name}', 'must not be negative')
    needed = {'bias': 'size', 'scale': 'size', 'noise': 'size', 'spike': 'size', 'drift': 'rate'}
    name = needed.get(fault.kind)
    if name and getattr(fault, name) == 0.0:
        raise ConfigError(f'fault.{name}', f'must not be 0 for a {fault.kind} fault')


class FaultInjector:
    """Applies all active faults to the readings of two sensors.

    Parameters
    ----------
    sensor_names : sequence of two str
        The physical sensors.
    faults : iterable of Fault
        Scheduled faults.
    generator : numpy.random.Generator
        Source of randomness for ``noise`` and ``spike``.
    """

    def __init__(self, sensor_names, faults, generator):
        self._names = tuple(sensor_names)
        self._generator = generator
        self.faults = []
        self._frozen = {}  # reading at which a stuck fault froze, by the fault's identity
        for fault in faults:
            self.add(fault)

    def add(self, fault):
        """Schedule a further fault.

        Parameters
        ----------
        fault : Fault
            The fault.

        Raises
        ------
        ConfigError
            If it is not valid.
        """
        check_fault(fault, self._names)
        self.faults.append(fault)

    def clear(self, sensor=''):
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
        if sensor and sensor not in self._names:
            raise ConfigError('fault.sensor', f'{sensor!r} is unknown; the arm has '
                              + ', '.join(self._names))
        kept = [f for f in self.faults if sensor and f.sensor != sensor]
        removed = len(self.faults) - len(kept)
        self.faults = kept
        self._frozen = {id(f): self._frozen[id(f)] for f in kept if id(f) in self._frozen}
        return removed

    def stuck(self, time):
        """Which sensors are frozen: they carry no noise either.

        Parameters
        ----------
        time : float
            [s].

        Returns
        -------
        ndarray of bool, shape (2,)
            One element a sensor.
        """
        frozen = {f.sensor for f in self.faults if f.kind == 'stuck' and f.active(time)}
        return np.array([name in frozen for name in self._names])

    def apply(self, time, reading, sample_time):
        """Faulty readings at one time.

        Parameters
        ----------
        time : float
            [s].
        reading : ndarray, shape (2,)
            Fault-free readings S theta [rad].
        sample_time : float
            For the rate of spikes [s].

        Returns
        -------
        ndarray, shape (2,)
            Readings with faults, NaN for a dropout.
        """
        faulty = np.array(reading, float)
        for fault in self.faults:
            if fault.active(time):
                i = self._names.index(fault.sensor)
                faulty[i] = self._one(fault, time, faulty[i], sample_time)
            else:
                self._frozen.pop(id(fault), None)
        return faulty

    def _one(self, fault, time, value, sample_time):
        if fault.kind == 'bias':
            return value + fault.size
        if fault.kind == 'drift':
            grown = fault.rate * (time - fault.onset)
            limit = abs(fault.size) if fault.size else math.inf
            return value + min(max(grown, -limit), limit)
        if fault.kind == 'scale':
            return value * (1.0 + fault.size)
        if fault.kind == 'stuck':
            return self._frozen.setdefault(id(fault), value)
        if fault.kind == 'noise':
            return value + fault.size * self._generator.standard_normal()
        if fault.kind == 'spike':
            hit, sign = self._generator.random(2)
            spike = fault.size if sign < 0.5 else -fault.size
            return value + spike if hit < fault.rate * sample_time else value
        return math.nan
