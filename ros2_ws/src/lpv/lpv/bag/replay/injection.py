"""Faults added to recorded measurements."""

import math
from typing import Any

import numpy as np

from lpv.bag.blocks.message_blocks import Block
from lpv.bag.rosbag.reading import BagReader
from lpv.bag.run.measurements import MEASUREMENT_TYPE, Measurements
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.sensor_map import map_rows
from lpv.core.simulation.faults import FaultInjector, rate_bias
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.timestamps import NANOSECONDS


class BlockInjector:
    """Adds faults to the measurements of block after block."""

    def __init__(self, injector: FaultInjector, arm: SerialArm, reader: BagReader) -> None:
        self._injector, self._arm, self._reader = injector, arm, reader
        self._to_sensors, self._to_joints = arm.joints_to_sensors(), arm.sensors_to_joints()
        self._derived = np.array([joint.sensors.rates == 'derived' for joint in arm.joints])
        self._start: int | None = None
        # Of the last measurement: time, whether a fault acted, errors of the readings.
        self._last = -math.inf, False, np.zeros(len(arm.joints))

    def apply(self, block: Block, measured: Measurements) -> dict[int, Any]:
        """Change measurements in their arrays; messages with the new values by place."""
        if not len(measured.stamp):
            return {}
        self._start = int(measured.stamp[0]) if self._start is None else self._start
        times = (measured.stamp - self._start) / NANOSECONDS
        active = np.zeros(len(times), bool)
        for fault in self._injector.faults:
            active |= (times >= fault.onset) & (times < fault.end)
        # One sample after a fault, too: a stuck sensor is released, and a rate that is a
        # difference of positions shows the end of a fault.
        after = active | np.append(self._last[1], active[:-1])
        reading = map_rows(self._to_sensors, measured.position)
        faulty, bias, changed = reading.copy(), np.zeros(reading.shape), {}
        for row in np.flatnonzero(after).tolist():
            time = float(times[row])
            faulty[row] = self._injector.apply(time, reading[row], self._arm.sample_time)
            bias[row] = [rate_bias(self._injector.records, i, time) for i in range(len(bias[row]))]
        with np.errstate(invalid='ignore'):  # of readings that are infinite
            error = np.where(faulty == reading, 0.0, faulty - reading)
            bias += np.where(self._derived, self._derived_rate_error(error, times), 0.0)
        self._last = float(times[-1]), bool(active[-1]), error[-1]
        for row in np.flatnonzero(after if self._derived.any() else active).tolist():
            measured.position[row] = map_rows(self._to_joints, faulty[row])
            if np.any(bias[row]):
                rate = map_rows(self._to_sensors, measured.velocity[row]) + bias[row]
                measured.velocity[row] = map_rows(self._to_joints, rate)
            place = int(measured.places[row])
            message = self._reader.deserialize(block.message(place), MEASUREMENT_TYPE)
            columns = [list(message.name).index(name) for name in self._arm.joint_names]
            for name in ('position', 'velocity'):
                if len(getattr(message, name)):
                    whole = getattr(message, name).copy()  # what is read is read-only
                    whole[columns] = getattr(measured, name)[row]
                    setattr(message, name, whole)
            changed[place] = message
        return changed

    def _derived_rate_error(self, error: np.ndarray, times: np.ndarray) -> np.ndarray:
        """What errors of readings, shape (n, sensors), add to rates that are their differences.

        NaN without a reading; the first one after a dropout has no difference.
        """
        before = np.vstack([self._last[2], error[:-1]])
        interval = np.diff(times, prepend=self._last[0])
        # After a gap it is as if nothing had been measured before.
        follows = (interval > 0.0) & (interval < MAX_GAP + self._arm.sample_time)
        before[~follows], interval[~follows] = 0.0, self._arm.sample_time
        rates = (error - before) / interval[:, None]
        return np.where(np.isnan(before) & ~np.isnan(error), 0.0, rates)
