"""Files of a study: all trials, and what was found if it is certified and better."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from lpv_campaign.tune.cost import pick
from lpv_campaign.tune.fields import diagnosis_values
from lpv_campaign.tune.search import Search
from lpv_campaign.tune.trial import Bench
from lpv_campaign.tune.validate import validate
from lpv_core.certificate.conditions import require
from lpv_core.certificate.gains import load_gains, save_gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import ArmParameters
from lpv_core.support.errors import LpvError
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

FILES = ('requirement.yaml', 'gains.yaml', 'diagnosis.yaml')


def conclude(bench: Bench, search: Search) -> dict[str, Any]:
    """Pick a trial and validate it.

    Returns content of ``study.json``.
    """
    study, trials = bench.study, search.trials
    picked = pick(trials, study.tolerance)
    result = {
        'name': study.name,
        'seed': study.seed,
        'study': study.data,
        'requirement': Path(bench.requirement.source).stem,
        'first': bench.base,
        'picked': None,
        'accepted': False,
        'verdict': '',
        'validation': None,
        'front': search.front,
        'importance': search.importance,
        'trials': trials,
    }
    if picked is None:
        return {**result, 'verdict': 'no trial is certified and keeps all limits'}
    result['picked'] = picked['number']
    if picked['number'] == 0:
        return {**result, 'verdict': 'the values before the search are the best ones'}
    try:
        first = bench.gains(bench.base)
    except (InfeasibleError, LpvError):
        return {
            **result,
            'accepted': True,
            'verdict': 'certified; the values before the search are not',
        }
    found = validate(bench, bench.gains(picked['values']), picked['values'], first)
    verdict = 'better, with the stated confidence' if found['accepted'] else found['reason']
    return {**result, 'accepted': found['accepted'], 'verdict': verdict, 'validation': found}


def write(bench: Bench, result: dict[str, Any], folder: Path) -> list[Path]:
    """Write ``study.json``, and the found values if they are accepted."""
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    written = [folder / 'study.json']
    written[0].write_text(json.dumps(result, indent=1, allow_nan=False) + '\n')
    if not result['accepted']:
        return written
    values = result['trials'][result['picked']]['values']
    comment = f'Found by lpv tune, study {result["name"]!r}, trial {result["picked"]}.'
    written.append(_dump(folder / 'requirement.yaml', comment, bench.content(values)))
    written.append(_write_gains(bench.arm, folder, comment))
    tuned: dict[str, Any] = {
        name.split('.')[1]: value for name, value in diagnosis_values(values).items()
    }
    if tuned:
        parameters = replace(DiagnosisParameters(), **tuned)
        written.append(
            _dump(
                folder / 'diagnosis.yaml',
                comment,
                {'/**': {'ros__parameters': {'diagnosis': vars(parameters)}}},
            )
        )
    return written


def _dump(path: Path, comment: str, data: dict[str, Any]) -> Path:
    path.write_text(f'# {comment}\n' + yaml.safe_dump(data, sort_keys=False))
    return path


def _write_gains(arm: ArmParameters, folder: Path, comment: str) -> Path:
    """From the file, as ``lpv design`` would; verified as the nodes will."""
    path, part = folder / 'gains.yaml', folder / 'gains.yaml.part'
    found = design(arm, load_requirement(folder / 'requirement.yaml'))
    lines = [f'Gains for arm {arm.name!r}. {comment}', 'Requirement: requirement.yaml']
    save_gains(found.gains, part, '\n'.join([*lines, *found.lines]))
    try:
        require(arm, load_gains(part), str(path))
    except LpvError:
        part.unlink()
        raise
    part.replace(path)
    return path
