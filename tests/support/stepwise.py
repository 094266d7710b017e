"""Observer and diagnosis one sample at a time, as objects: what tests of the recursions drive."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import (
    DIAGNOSIS_STATE,
    Alarm,
    DiagnosisParameters,
    SensorState,
    diagnose,
    diagnosis_buffers,
    diagnosis_constants,
    make_alarm,
    reset_diagnosis,
)
from lpv_core.decision.sensor_decision import NOTHING
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap
from lpv_core.observer.sampled_observer import (
    ESTIMATE,
    OBSERVER_STATE,
    Counters,
    counters,
    observe,
    observer_constants,
    pair,
    reset_observer,
)
from lpv_core.support.records import new_record
from lpv_core.support.timestamps import NEVER


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
        """Forget everything but the counters; the observer restarts with the next sample."""
        reset_observer(self._state)

    @property
    def counters(self) -> Counters:
        """What was not usable so far, as `Counters`."""
        return counters(self._state.counters)

    @property
    def stamp(self) -> int | None:
        """Stamp of the last accepted sample [ns], or None."""
        return None if self._state.stamp == NEVER else int(self._state.stamp)

    def update(
        self,
        stamp: int,
        position: Sequence[float],
        velocity: Sequence[float],
        effort: Sequence[float],
    ) -> np.record | None:
        """Estimate, of type `ESTIMATE`, at one measurement; None if that was dropped."""
        used = observe(
            self._constants,
            self._state,
            self._estimate,
            stamp,
            pair(position, 'position'),
            pair(velocity, 'velocity'),
            pair(effort, 'effort'),
        )
        return self._estimate.copy() if used else None


@dataclass
class Diagnosis:
    """Decision at one sample as `DECISION` has it, in Python's types."""

    bound: np.ndarray
    threshold: np.ndarray
    state: list[SensorState]
    alarm: np.ndarray
    confirmed_fault: np.ndarray
    events: list[Alarm]
    inconsistent: bool
    trustworthy: bool


class Diagnoser:
    """Bounds, decisions of both sensors, consistency, and what to compensate."""

    def __init__(
        self, arm: ArmParameters, gains: Gains, parameters: DiagnosisParameters | None = None
    ) -> None:
        self._arm, self._gains = arm, gains
        self.state, self.buffers = new_record(DIAGNOSIS_STATE), diagnosis_buffers(arm)
        self.retune(parameters or DiagnosisParameters())
        self.reset()

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running; alarms stay as they are."""
        self.parameters = parameters
        self.constants = diagnosis_constants(self._arm, self._gains, parameters)

    def reset(self) -> None:
        """Clear alarms and past."""
        reset_diagnosis(self.state, self.buffers)

    def update(self, estimate: np.record) -> Diagnosis:
        """Decide on one estimate."""
        diagnose(self.constants, self.state, self.buffers, estimate)
        d = self.state.decision
        return Diagnosis(
            d.bound.copy(),
            d.threshold.copy(),
            [SensorState(s) for s in d.state],
            d.alarm.astype(bool),
            d.confirmed_fault.copy(),
            self.alarms(d.events),
            bool(d.inconsistent),
            bool(d.trustworthy),
        )

    def alarms(self, events: Iterable[np.record]) -> list[Alarm]:
        """Alarms of those entries of type `ALARM_EVENT` in which something happened."""
        return [
            make_alarm(event, self._arm, self.parameters)
            for event in events
            if event.happened != NOTHING
        ]
