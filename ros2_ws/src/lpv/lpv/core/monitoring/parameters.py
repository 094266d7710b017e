"""Tuning of the diagnosis."""

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

from lpv.core.serial_arm.diagnosis.settings import DIAGNOSIS, DiagnosisParameters
from lpv.core.support.config import Section
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import MAX_GAP
from lpv.core.support.options import Entry, entries

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
            found[one.name] = section.integer(one.name)
            section.number(one.name, None, *one.limits)
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
