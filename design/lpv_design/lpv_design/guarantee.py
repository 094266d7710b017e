"""What a design guarantees, configuration by configuration: thresholds and detectable faults."""

from dataclasses import dataclass

import numpy as np

from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.uio.bound.error_bound import error_bound, static_bound
from lpv.core.uio.certificate.gains import Gains

POINTS = 13
"""Angles of each link in the map."""


@dataclass(frozen=True)
class Guarantee:
    """Bounds at rest over the certified region."""

    deviation: np.ndarray  # angle of a link from the vertical, shape (n,) [rad]
    # bound on the fault-estimate error of each sensor [rad], rows link 1, columns link 2; a healthy
    # arm at rest stays below, whatever its stated model error, payload, friction and disturbance
    # do, but for noise beyond its standard deviations; infinite where gravity cannot bound it;
    # shape (n, n, 2)
    bound: np.ndarray
    threshold: np.ndarray  # what the diagnosis compares with, shape (n, n, 2) [rad]

    @property
    def detectable(self) -> np.ndarray:
        """Smallest lasting fault whose estimate exceeds the threshold whatever its error [rad]."""
        return self.threshold + self.bound


def guarantee(arm: ArmParameters, gains: Gains, points: int = POINTS) -> Guarantee:
    """The bound of the diagnosis' usual tuning over the region, at so many angles of each link."""
    limit = float(np.arccos(min(arm.cos_min)))
    deviation = np.linspace(-limit, limit, points)
    theta = deviation + (0.0 if arm.sign > 0 else np.pi)  # upright, hanging: absolute angles
    tuning = DiagnosisParameters()
    constants = error_bound(arm, gains.observer, tuning.sigmas)
    bound = np.array([[static_bound(constants, np.array([a, b])) for b in theta] for a in theta])
    return Guarantee(deviation, bound, np.maximum(bound, tuning.minimum_threshold))
