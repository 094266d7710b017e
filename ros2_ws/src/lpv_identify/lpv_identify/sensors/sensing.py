"""What a recording says of the sensors."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sensing:
    """What was found of the sensors; arrays of shape (n,)."""

    position_noise: np.ndarray  # [rad]
    quantization: np.ndarray  # [rad]
    velocity_noise: np.ndarray  # [rad/s]
    rates: list[str]  # source of the rates of each joint
    rate_evidence: np.ndarray  # correlation of the fast parts of rates and positions
    rate_delay: np.ndarray  # of rates behind positions [s]
    effort_delay: np.ndarray  # of efforts behind motion [s]
