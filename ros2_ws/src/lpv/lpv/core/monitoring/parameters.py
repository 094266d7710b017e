"""Tuning of the diagnosis."""

from collections.abc import Iterable
from dataclasses import dataclass, fields

from lpv.core.control.estimate_check import FADING
from lpv.core.serial_arm.diagnosis.settings import MonitorSettings
from lpv.core.support.errors import ConfigError


@dataclass(frozen=True)
class DiagnosisParameters(MonitorSettings):
    """What a user asks of the decisions; every field is a parameter of the observer node."""

    # how fast a compensation without a known step is faded in and out [rad/s]
    compensation_rate: float = FADING
    # a confirmed fault that is removed with a wider bound stops the arm [rad]
    safe_stop_bound: float = 1.5


def check_names(names: Iterable[str], where: str) -> None:
    """ConfigError for the first name, below ``diagnosis``, that is no parameter."""
    known = [field.name for field in fields(DiagnosisParameters)]
    for name in names:
        if name not in known:
            reason = f'is not a known parameter; known here: {", ".join(known)}'
            raise ConfigError(f'diagnosis.{name}', reason, where)
