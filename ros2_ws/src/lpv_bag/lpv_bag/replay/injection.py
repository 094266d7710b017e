"""Faults added to recorded measurements."""

from typing import Any

import numpy as np

from lpv_bag.blocks.message_blocks import Block, rows
from lpv_bag.run.measurements import Measurements
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.sensor_map import map_rows
from lpv_core.simulation.faults import FaultInjector, derived_rate_error, rate_bias

CHANGED = ('position', 'velocity')
"""Fields of a measurement that faults act on."""
_RECENT = 10
"""A sample within so many sample times is the one before, if some were lost."""


class BlockInjector:
    """Adds faults to the measurements of block after block."""

    def __init__(self, injector: FaultInjector, monitor: SerialSensorMonitor) -> None:
        self._injector, self._arm = injector, monitor.arm
        self._to_sensors = self._arm.joints_to_sensors()
        self._to_joints = self._arm.sensors_to_joints()
        rates = [joint.sensors.rates for joint in self._arm.joints]
        self._derived = np.array([rate == 'derived' for rate in rates])
        self._start: int | None = None
        self._active = False
        self._last: tuple[float, np.ndarray] | None = None

    def apply(
        self,
        block: Block,
        positions: np.ndarray,
        measured: Measurements,
        places: dict[str, np.ndarray],
    ) -> dict[int, object]:
        """Change measurements, in their arrays and in the bytes that will be copied."""
        if not len(positions):
            return {}
        if self._start is None:
            self._start = int(measured.stamp[0])
        times = (measured.stamp - self._start) / 1e9
        active = np.zeros(len(times), bool)
        for fault in self._injector.faults:
            active |= (times >= fault.onset) & (
                (times < fault.onset + fault.duration) | (fault.duration <= 0.0)
            )
        # One sample after a fault, too: a stuck sensor is released.
        after = active | np.concatenate([[self._active], active[:-1]])
        self._active = bool(active[-1])
        # A rate that is a difference of positions shows the end of a fault, too.
        written = after if self._derived.any() else active
        changed = {}
        for row in np.flatnonzero(after).tolist():
            if row in measured.unusable:
                continue
            position, velocity = measured.position[row], measured.velocity[row]
            faulty = self._faulty(position, velocity, times[row])
            if written[row]:
                position[:], velocity[:] = faulty
                if row in measured.single:
                    changed[row] = self._rewritten(measured.single[row], faulty)
        self._write(block, measured, places, written)
        return changed

    @staticmethod
    def _write(
        block: Block, measured: Measurements, places: dict[str, np.ndarray], active: np.ndarray
    ) -> None:
        if active.any():
            block.data = block.data.copy()
            for name in CHANGED:
                regular = np.flatnonzero(active & (places[name][:, 0] >= 0))
                rows(block.data, '<f8')[places[name][regular]] = getattr(measured, name)[regular]

    def _faulty(
        self, position: np.ndarray, velocity: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position and rate with the faults added."""
        reading = np.array(map_rows(self._to_sensors, position), float)
        faulty = self._injector.apply(float(time), reading, self._arm.sample_time)
        count = len(reading)
        bias = np.array([rate_bias(self._injector.records, i, float(time)) for i in range(count)])
        if self._derived.any():
            bias += np.where(self._derived, self._derived_rate_error(faulty - reading, time), 0.0)
        if np.any(bias):
            velocity = map_rows(self._to_joints, map_rows(self._to_sensors, velocity) + bias)
        return map_rows(self._to_joints, faulty), velocity

    def _derived_rate_error(self, fault: np.ndarray, time: float) -> np.ndarray:
        """What faults add to rates that are differences of the positions."""
        before, last = self._last if self._last is not None else (time, np.zeros_like(fault))
        self._last = time, fault
        # Faults begin from none: rows before them are not looked at.
        interval = time - before
        if not 0.0 < interval < _RECENT * self._arm.sample_time:
            interval, last = self._arm.sample_time, np.zeros_like(fault)
        return np.array([derived_rate_error(*pair, interval) for pair in zip(fault, last)])

    def _rewritten(self, message: Any, faulty: tuple[np.ndarray, np.ndarray]) -> Any:
        """A message that was read alone, with other values."""
        columns = [list(message.name).index(name) for name in self._arm.joint_names]
        for name, values in zip(CHANGED, faulty):
            if len(getattr(message, name)):
                whole = getattr(message, name).copy()  # what is read from a bag is read-only
                whole[columns] = values
                setattr(message, name, whole)
        return message
