"""The designed observer one sample at a time, as an object: what tests of its recursion drive."""

from collections.abc import Sequence

import numpy as np

from lpv_core.support.records import new_record
from lpv_core.support.timestamps import NEVER
from lpv_core.uio.certificate.gains import Gains
from lpv_core.uio.model.arm import ArmParameters
from lpv_core.uio.model.joints import JointMap
from lpv_core.uio.observer.sampled_observer import (
    ESTIMATE,
    OBSERVER_STATE,
    observe,
    observer_constants,
    reset_observer,
)


class UnknownInputObserver:
    """Observer of an arm; the arguments are those of `observer_constants`."""

    def __init__(
        self, arm: ArmParameters, gains: Gains, initial_samples: int = 1, max_gap: float = 0.1
    ) -> None:
        self._constants = observer_constants(arm, gains, initial_samples, max_gap)
        self._state, self._estimate = new_record(OBSERVER_STATE), new_record(ESTIMATE)
        self.arm, self.joints = arm, JointMap(arm)
        self.reset()

    def reset(self) -> None:
        """Forget everything; the observer restarts with the next sample."""
        reset_observer(self._state)

    @property
    def stamp(self) -> int | None:
        """Stamp of the last sample [ns], or None."""
        return None if self._state.stamp == NEVER else int(self._state.stamp)

    def update(
        self,
        stamp: int,
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> np.record | None:
        """Estimate, of type `ESTIMATE`, at one measurement; None if it would not be finite."""
        vectors = (np.asarray(values, float) for values in (position, velocity, effort))
        used = observe(self._constants, self._state, self._estimate, stamp, *vectors)
        return self._estimate.copy() if used else None
