"""Faults added to recorded measurements."""

from typing import Any

import numpy as np

from lpv.bag.blocks.message_blocks import Block
from lpv.bag.rosbag.reading import BagReader
from lpv.bag.run.measurements import MEASUREMENT_TYPE, Measurements
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.sensor_map import map_rows
from lpv.core.simulation.faults import FaultInjector, derived_rate_error, rate_bias
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.timestamps import NANOSECONDS


class BlockInjector:
    """Adds faults to the measurements of block after block."""

    def __init__(self, injector: FaultInjector, arm: SerialArm, reader: BagReader) -> None:
        self._injector, self._arm, self._reader = injector, arm, reader
        self._to_sensors, self._to_joints = arm.joints_to_sensors(), arm.sensors_to_joints()
        self._derived = np.array([joint.sensors.rates == 'derived' for joint in arm.joints])
        self._start: int | None = None
        self._active = False
        self._last: tuple[float, np.ndarray] | None = None

    def apply(self, block: Block, measured: Measurements) -> dict[int, Any]:
        """Change measurements in their arrays; messages with the new values by place."""
        if not len(measured.stamp):
            return {}
        if self._start is None:
            self._start = int(measured.stamp[0])
        times = (measured.stamp - self._start) / NANOSECONDS
        active = np.zeros(len(times), bool)
        for fault in self._injector.faults:
            active |= (times >= fault.onset) & (times < fault.end)
        # One sample after a fault, too: a stuck sensor is released, and a rate that is a
        # difference of positions shows the end of a fault.
        after = active | np.concatenate([[self._active], active[:-1]])
        self._active, changed = bool(active[-1]), {}
        for row in np.flatnonzero(after).tolist():
            faulty = self._faulty(measured.position[row], measured.velocity[row], times[row])
            if active[row] or self._derived.any():
                measured.position[row], measured.velocity[row] = faulty
                place = int(measured.places[row])
                message = self._reader.deserialize(block.message(place), MEASUREMENT_TYPE)
                columns = [list(message.name).index(name) for name in self._arm.joint_names]
                for name, values in zip(('position', 'velocity'), faulty):
                    if len(getattr(message, name)):
                        whole = getattr(message, name).copy()  # what is read is read-only
                        whole[columns] = values
                        setattr(message, name, whole)
                changed[place] = message
        return changed

    def _faulty(
        self, position: np.ndarray, velocity: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Position and rate with the faults added."""
        reading = np.array(map_rows(self._to_sensors, position), float)
        faulty = self._injector.apply(float(time), reading, self._arm.sample_time)
        records, count = self._injector.records, len(reading)
        bias = np.array([rate_bias(records, i, float(time)) for i in range(count)])
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
        if not 0.0 < interval < MAX_GAP + self._arm.sample_time:
            interval, last = self._arm.sample_time, np.zeros_like(fault)
        return np.array([derived_rate_error(*pair, interval) for pair in zip(fault, last)])
