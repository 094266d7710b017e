"""What was run, with which designs and which software."""

import json
import platform
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
import yaml

from lpv_campaign.execution.execute import software
from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.report.statistics.results import Results
from lpv_core.certificate.conditions import verify

_PACKAGES = ('numpy', 'scipy', 'numba', 'pyarrow', 'distributed', 'lpv_core', 'lpv_campaign')
_ORDER = (
    'name',
    'seed',
    'method',
    'plan',
    'arm',
    'scenario',
    'designs',
    'duration',
    'twin',
    'substeps',
    'limit',
    'factors',
    'path',
    'low',
    'high',
    'spacing',
    'levels',
)
"""Of the fields of a campaign file."""


def head(results: Results) -> dict[str, Any]:
    """The head of the report.

    Returns ``name``, ``spec`` (YAML), ``arm``, ``arm_sha256``, ``planned`` and finished
    ``runs``, ``missing``, ``duration`` of a run [s], ``hours`` simulated, ``designs``,
    ``software``.
    """
    campaign = results.campaign
    runs = results.count * (2 if campaign.spec.twin else 1)
    content = json.loads(campaign.text)
    return {
        'name': campaign.spec.name,
        'arm': campaign.arm.name,
        'arm_sha256': campaign.arm.sha256(),
        'method': campaign.spec.method,
        'seed': campaign.spec.seed,
        'planned': campaign.spec.runs,
        'runs': results.count,
        'missing': max(campaign.spec.runs - results.count, 0),
        'duration': results.duration,
        'hours': results.count * results.duration / 3600.0,
        'twin': runs > results.count,
        'spec': yaml.safe_dump(
            _in_order(content['spec']),
            sort_keys=False,
            default_flow_style=None,
            allow_unicode=True,
            width=90,
        ),
        'designs': [_design(campaign, name, data) for name, data in content['gains'].items()],
        'software': _software(),
    }


def _in_order(data: Any) -> Any:
    """A campaign file as users write it: what was kept is sorted by name."""
    if not isinstance(data, dict):
        return data
    return {key: _in_order(data[key]) for key in sorted(data, key=_rank)}


def _rank(key: str) -> int:
    return _ORDER.index(key) if key in _ORDER else len(_ORDER)


def _design(campaign: Campaign, key: str, data: dict[str, Any]) -> dict[str, Any]:
    name, _, time = key.rpartition('@')
    gains = campaign.gains(name, float(time))
    observer: Any = gains.observer
    controller: Any = gains.controller
    arm: Any = campaign.arm
    checks = verify(replace(arm, sample_time=float(time)), gains)
    return {
        'name': name,
        'sample_time': float(time),
        'observer': observer.method,
        'decay': float(observer.decay),
        'controller': controller.method,
        'controller_decay': float(controller.decay),
        'fault_sigma': np.asarray(observer.fault_sigma, float).tolist(),
        'checks': len(checks),
        'hold': sum(check.holds for check in checks),
        'solver': str(data['certificate'].get('solver', '')),
    }


def _software() -> dict[str, str]:
    found = {'Python': platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {**found, 'lpv sources': software()}
