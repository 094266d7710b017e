"""The monitor of an arm, and what it knows after samples that nobody has answered."""

from typing import NamedTuple

import numpy as np

from lpv.core.monitoring.answers import answer_type
from lpv.core.monitoring.compensation import answer_rows
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.stepped_monitor import SteppedMonitor
from lpv.core.serial_arm.diagnosis.alarms import SensorState
from lpv.core.serial_arm.sensor_map import map_rows, mixing


class Known(NamedTuple):
    """What is known after the last sample."""

    fault: np.ndarray  # (n,) [rad]
    sigma: np.ndarray  # (n,) [rad]
    state: tuple[SensorState, ...]


class Watched(SteppedMonitor):
    """The monitor of an arm, whose ``alarms`` are those of all samples."""

    def __init__(self, arm, **settings):
        super().__init__(arm, DiagnosisParameters(**settings))

    def take(self, stamps, samples):
        """Take samples (N, 3, n): joint positions by the readings, their rates, efforts."""
        readings, n = np.array(samples, order='C'), self.joints
        readings[:, :2] = map_rows(mixing(self.arm.joints_to_sensors()), readings[:, :2])
        rows = answer_rows(np.zeros(len(stamps) + 1, answer_type(n)))
        for *_, stamp in self.run(np.ascontiguousarray(stamps, np.int64), readings, rows, 0):
            if stamp is not None:
                self.know(stamp)

    def estimate(self) -> Known:
        """What is known now."""
        state = map(SensorState, self.answering.known.state.tolist())
        return Known(*self.published(), tuple(state))
