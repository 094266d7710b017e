"""What can be searched: numbers of the requirement, and of the diagnosis."""

import copy
import math
import re
from dataclasses import fields
from typing import Any

from lpv_campaign.plan.factors import Range
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.support.errors import ConfigError
from lpv_design.requirement import Requirement

DIAGNOSIS_LIMITS = {
    'threshold_factor': (1.0, math.inf),
    'sigmas': (3.0, math.inf),
    'dwell': (1e-3, math.inf),
    'hysteresis': (0.1, 1.0),
    'false_alarm_hours': (1.0, math.inf),
}
"""Widest ranges: below its bound a threshold means nothing, whatever a campaign says."""
_NAME = re.compile(r'(observer|controller)\.(\w+)(?:\[(\d)\])?')
_DIAGNOSIS = 'diagnosis.'


def base_value(name: str, requirement: Requirement) -> float:
    """Value of a field before the search."""
    if name.startswith(_DIAGNOSIS):
        return _diagnosis(name[len(_DIAGNOSIS) :], name)
    match = _NAME.fullmatch(name)
    part: Any = getattr(requirement, match[1]) if match else None
    known = {f.name for f in fields(part)} if match else set()
    if not match or match[2] not in known:
        raise _unknown(name, requirement)
    value, index = getattr(part, match[2]), match[3]
    if isinstance(value, tuple):
        if index is None:
            if len(set(value)) > 1:
                raise ConfigError(f'search.{name}', f'is {list(value)}: search {name}[0] ...')
            return float(value[0])
        if int(index) < len(value):
            return float(value[int(index)])
    elif isinstance(value, float) and index is None:
        return value
    raise _unknown(name, requirement)


def _unknown(name: str, requirement: Requirement) -> ConfigError:
    known = [
        f'{part}.{f.name}'
        for part in ('observer', 'controller')
        for f in fields(getattr(requirement, part))
        if isinstance(getattr(getattr(requirement, part), f.name), (float, tuple))
    ]
    known += [f'{_DIAGNOSIS}{f.name}' for f in fields(DiagnosisParameters) if f.name != 'latch']
    return ConfigError(f'search.{name}', 'cannot be searched; there are ' + ', '.join(known))


def _diagnosis(field: str, name: str) -> float:
    value = getattr(DiagnosisParameters(), field, None)
    if not isinstance(value, float):
        raise ConfigError(f'search.{name}', 'is not a number of the diagnosis')
    return value


def check_range(name: str, found: Range, base: float) -> None:
    """Refuse a range that is outside the meaningful one, or does not contain the base."""
    low, high = (
        DIAGNOSIS_LIMITS.get(name[len(_DIAGNOSIS) :], (0.0, math.inf))
        if name.startswith(_DIAGNOSIS)
        else (0.0, math.inf)
    )
    if not (low <= found.low and found.high <= high):
        raise ConfigError(f'search.{name}', f'must lie within {low:g} and {high:g}')
    if not found.low <= base <= found.high:
        raise ConfigError(
            f'search.{name}',
            f'must hold {base:g}, the value before the search, which is tried first',
        )


def changed(
    data: dict[str, Any], requirement: Requirement, values: dict[str, float]
) -> dict[str, Any]:
    """A requirement file with other values."""
    result = copy.deepcopy(data)
    for name, value in values.items():
        match = _NAME.fullmatch(name)
        if match is None:
            continue
        part, field, index = match.groups()
        old = getattr(getattr(requirement, part), field)
        if isinstance(old, tuple):
            new = (
                list(result[part].get(field, old))
                if isinstance(result[part].get(field, old), (list, tuple))
                else list(old)
            )
            for k in range(len(new)) if index is None else (int(index),):
                new[k] = value
            result[part][field] = new
        else:
            result[part][field] = value
    return result


def diagnosis_values(values: dict[str, float]) -> dict[str, float]:
    """Those of the diagnosis alone, named as factors of a campaign are."""
    return {name: value for name, value in values.items() if name.startswith(_DIAGNOSIS)}
