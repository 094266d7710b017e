"""State of one sensor, from healthy to faulty and back."""

import math
from dataclasses import dataclass

from lpv.core.serial_arm.diagnosis.alarms import SensorState

_OK, _WARN, _ERROR = SensorState.OK, SensorState.WARN, SensorState.ERROR
"""As attributes of their class they take microseconds."""


@dataclass
class SensorRecord:
    """What is known of a fault of one sensor."""

    state: SensorState = _OK  # a fault that seems over is still ERROR
    kind: str = ''  # of the fault
    onset: float = 0.0  # [s]
    peak: float = 0.0  # largest size since [rad]
    level: bool = False  # whether the estimate of gravity and motion is part of the fault
    unproved: bool = False  # whether its guarantee is still to come
    over_since: float | None = None  # since when the fault seems over [s]
    unseen: bool = False  # whether it was confirmed before a break, and not seen since
    wrong_until: float = -math.inf  # when its rates were last wrong, or noisy [s]

    @property
    def active(self) -> bool:
        """Whether an alarm of this sensor is up."""
        return self.state is _ERROR

    def confirm(self, kind: str, onset: float, size: float) -> None:
        """A fault was named; its onset is that of the first name."""
        if not self.active:
            self.onset, self.peak = onset, 0.0
        self.state, self.kind, self.over_since = _ERROR, kind, None
        self.unseen = False
        self.peak = max(self.peak, size)

    def suspect(self, is_suspect: bool) -> None:
        """What is seen may be this sensor's fault, or not."""
        if not self.active:
            self.state = _WARN if is_suspect else _OK

    def doubt(self) -> None:
        """Nothing was seen of the sensor for a while, in which its fault may have ended."""
        self.unseen, self.over_since = self.active, None

    def recover(self, now: float) -> None:
        """The fault seems over."""
        self.over_since, self.level = now, False

    def watch_end(self, over: bool, now: float, dwell: float, size: float) -> bool:
        """Whether the fault has been over for long enough; ``size`` is what is left of it [rad]."""
        if not over:
            self.over_since, self.peak = None, max(self.peak, size)
            return False
        if self.over_since is None:
            self.over_since = now
        return now - self.over_since >= dwell

    def clear(self) -> None:
        """The fault is over."""
        self.state, self.kind, self.peak = _OK, '', 0.0
        self.level, self.unproved, self.unseen, self.over_since = False, False, False, None
