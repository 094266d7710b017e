"""The monitor of an arm of either kind, and what all monitors can do."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from lpv_core.certificate.gains import Gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.monitoring.answers import Answer, Answers
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.observer.sampled_observer import Mode
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import ConfigError


class Monitor(Protocol):
    """Diagnosis of one arm's position sensors."""

    name: str  # name in diagnostics: the node's fully qualified name
    rejected: int  # messages that did not fit the arm
    method: str  # how faults are found
    answer_type: np.dtype  # of a row of `take_many`'s answers
    needs_rates: bool  # whether measurements without rates are refused

    @property
    def arm(self) -> Any:
        """The arm, of either kind."""

    @property
    def counters(self) -> Any:
        """Dataclass of how many samples were not usable as they came."""

    def retune(self, parameters: DiagnosisParameters) -> None:
        """Change the tuning while running."""

    def reset(self) -> None:
        """Forget estimates and alarms; counters stay."""

    def warm_up(self) -> None:
        """Compile, so that the first measurement does not wait."""

    def take(
        self, stamp: int, message: Any, torque: Sequence[float] | None = None
    ) -> Answer | None:
        """Use one measurement."""

    def take_many(
        self, stamps: np.ndarray, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
    ) -> Answers:
        """Use many measurements; the same as `take` one by one."""

    def stale_fault(self) -> dict[str, Any] | None:
        """Fields of a FaultEstimate that says that its values are the last ones."""

    def status(self, mode: Mode) -> list[dict[str, Any]]:
        """Statuses for /diagnostics."""


def make_monitor(
    name: str,
    arm: Arm,
    gains: Gains | None = None,
    parameters: DiagnosisParameters | None = None,
    **sampling: Any,
) -> Monitor:
    """The monitor of an arm.

    Parameters
    ----------
    name : str
        Name in diagnostics.
    arm : ArmParameters or SerialArm
        The arm.
    gains : Gains, optional
        Of a two-link arm; a serial arm has none.
    parameters : DiagnosisParameters, optional
        Tuning.
    **sampling
        ``max_gap`` [s] and ``initial_samples`` of a two-link arm's observer; not used for others.

    Returns
    -------
    Monitor
        Fresh.

    Raises
    ------
    ConfigError
        If gains are missing, belong to another arm or were given for a serial arm.
    """
    if isinstance(arm, SerialArm):
        refuse_gains(arm, gains is not None)
        return SerialSensorMonitor(name, arm, parameters)
    if gains is None:
        raise ConfigError('gains', 'are needed for a two-link arm', arm.name)
    return SensorMonitor(name, arm, gains, parameters, **sampling)


def refuse_gains(arm: Arm, given: bool) -> None:
    """ConfigError if gains were given for an arm that is observed without any."""
    if given and isinstance(arm, SerialArm):
        raise ConfigError(
            'gains',
            f'are not used: {arm.name!r} is a serial arm, whose faults are found by momentum '
            'balances; leave the gains file out',
        )
