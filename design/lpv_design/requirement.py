"""Requirement files: what a design must fulfil."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv.core.support.config import Section, names_all_errors, read_yaml
from lpv.core.support.entries import part, read_entries
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.conditions import METHODS
from lpv_design.controller import ControllerRequirement
from lpv_design.exact_observer import ExactRequirement
from lpv_design.paper_observer import PaperRequirement


@dataclass(frozen=True)
class Requirement:
    """A whole requirement file."""

    observer: ExactRequirement | PaperRequirement  # its type tells the method
    controller: ControllerRequirement = part(ControllerRequirement)
    source: str = ''  # file name


def load_requirement(name: str | Path) -> Requirement:
    """Requirement of a path, or of the bare name of a shipped one; ConfigError names a wrong
    field."""
    path = Path(name)
    if path.suffix not in ('.yaml', '.yml'):
        path = bringup_file('requirements', str(name))
    return parse_requirement(read_yaml(path), str(path))


@names_all_errors
def parse_requirement(data: dict[str, Any], source: str) -> Requirement:
    """Build a requirement from the mapping of a requirement file."""
    top = Section(data, source)
    requirement = read_entries(
        Requirement, top, observer=_observer(top.section('observer')), source=source
    )
    _check_fastest(top.section('controller'), requirement.controller.alpha, 'alpha')
    return requirement


def _observer(section: Section) -> ExactRequirement | PaperRequirement:
    if section.text('method', choices=METHODS) == 'paper':
        literal = read_entries(PaperRequirement, section)
        if not literal.r < literal.q:
            raise section.error('r', 'must be below q, or the disc reaches unstable poles')
        return literal
    requirement = read_entries(ExactRequirement, section)
    _check_fastest(section, requirement.decay, 'decay')
    return requirement


def _check_fastest(section: Section, slowest: float, name: str) -> None:
    if not section.number('fastest') > slowest:
        raise section.error('fastest', f'must be greater than {name}')
