"""Tuning of the diagnosis."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from lpv.core.control.estimate_check import FADING
from lpv.core.serial_arm.diagnosis.settings import MonitorSettings
from lpv.core.support.config import Section
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.options import Entry, entries


@dataclass(frozen=True)
class DiagnosisParameters(MonitorSettings):
    """What a user asks of the decisions; every field is a parameter of the observer node."""

    # how fast a compensation without a known step is faded in and out [rad/s]
    compensation_rate: float = FADING
    # a confirmed fault that is removed with a wider bound stops the arm [rad]
    safe_stop_bound: float = 1.5


DIAGNOSIS = tuple(
    one._replace(default=getattr(DiagnosisParameters, one.name))
    for one in entries("""
hours_between_false_alarms[0.01:1e6]  mean time between false alarms of a healthy arm [h]
probability_of_wrong_name[1e-6:0.5]  probability that a named cause is another one [1]
minimum_threshold[0:10]  smaller lasting offsets are no faults [rad]
smallest_step[0:10]      smaller jumps of a reading are no faults [rad]
clear_dwell[0:100]       for which a fault must be over before its alarm ends [s]
latch                    alarms stay until ~/reset, even if the fault is over
sigmas[1:10]             standard deviations in a bound [1]
compensation_rate[0.01:100]  how fast a compensation without a known step is faded in and out
                         [rad/s]
safe_stop_bound[0.01:100]  a confirmed fault that is removed with a wider bound stops the arm [rad]
""")
)
"""Fields of `DiagnosisParameters`, which has their defaults, as parameters of the observer node."""
SAMPLING = tuple(
    entries(f"""
initial_samples=1[1:100000]  samples over which the start value is averaged
max_gap={MAX_GAP}[0.001:10]  longest interval that is integrated [s]; after a longer one the
                         estimate is re-anchored on the encoders
""")
)
"""Parameters of the node that `SerialSensorMonitor` takes beside."""


def given_values(section: Section, table: Iterable[Entry]) -> dict[str, Any]:
    """Values of parameters that are in a section of a file; ConfigError outside their limits."""
    found: dict[str, Any] = {}
    for one in table:
        if one.name not in section:
            continue
        if one.limits is None:
            found[one.name] = section.flag(one.name)
        elif one.kind is int:
            found[one.name] = section.integer(one.name, low=1)
        else:
            found[one.name] = section.number(one.name, None, *one.limits)
    return found


def check_parameters(parameters: DiagnosisParameters | None) -> None:
    """ConfigError for the first value outside its limits, which files and nodes refuse, too."""
    given_values(Section(vars(parameters or DiagnosisParameters()), '', 'diagnosis'), DIAGNOSIS)


def check_names(names: Iterable[str], where: str) -> None:
    """ConfigError for the first name, below ``diagnosis``, that is no parameter."""
    known = [field.name for field in fields(DiagnosisParameters)]
    for name in names:
        if name not in known:
            reason = f'is not a known parameter; known here: {", ".join(known)}'
            raise ConfigError(f'diagnosis.{name}', reason, where)
