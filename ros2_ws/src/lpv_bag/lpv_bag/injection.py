"""Faults added to recorded measurements."""

import numpy as np

from lpv_bag.layout import rows
from lpv_core.joints import JointMap


class BlockInjector:
    """Adds faults to the measurements of block after block.

    Parameters
    ----------
    injector : FaultInjector
        The faults; their times count from the first measurement.
    monitor : SensorMonitor
        Knows the arm.
    """

    def __init__(self, injector, monitor):
        self._injector = injector
        self._arm, self._joints = monitor.arm, JointMap(monitor.arm)
        self._start, self._active = None, False

    def apply(self, block, positions, measured, places):
        """Change measurements, in their arrays and in the bytes that will be copied.

        Parameters
        ----------
        block : Block
            Its data are replaced by changed ones.
        positions : ndarray of int, shape (n,)
            Measurements in the block.
        measured : Measurements
            They, decoded.
        places : ndarray of int, shape (n, 2)
            Where their positions are in the block's data.

        Returns
        -------
        dict of int to object
            Odd messages by row that were changed.
        """
        if not len(positions):
            return {}
        if self._start is None:
            self._start = int(measured.stamp[0])
        times = (measured.stamp - self._start) / 1e9
        active = np.zeros(len(times), bool)
        for fault in self._injector.faults:
            active |= (times >= fault.onset) & ((times < fault.onset + fault.duration)
                                                | (fault.duration <= 0.0))
        # One sample after a fault: what has frozen must thaw.
        after = active | np.concatenate([[self._active], active[:-1]])
        self._active = bool(active[-1])
        changed = {}
        for row in np.flatnonzero(after):
            if row in measured.odd:
                if self._odd(measured.odd[row], times[row]):
                    changed[int(row)] = measured.odd[row]
            else:
                faulty = self._faulty(measured.position[row], times[row])
                if active[row]:
                    measured.position[row] = faulty
        regular = np.flatnonzero(active & (places[:, 0] >= 0))
        if len(regular):
            block.data = block.data.copy()
            rows(block.data, '<f8')[places[regular]] = measured.position[regular]
        return changed

    def _faulty(self, position, time):
        reading = self._joints.sensor_position(position)
        faulty = self._injector.apply(float(time), reading, self._arm.sample_time)
        return self._joints.joint_from_sensor(faulty)

    def _odd(self, message, time):
        try:
            columns = [list(message.name).index(name) for name in self._arm.joint_names]
            faulty = self._faulty(message.position[columns], time)
        except (ValueError, IndexError):
            return False  # the monitor will say what is wrong with this message
        message.position = message.position.copy()  # what is read from a bag is read-only
        message.position[columns] = faulty
        return True
