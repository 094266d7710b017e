"""Requirement files: what a design must fulfil."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv.core.support.config import Section, read_yaml
from lpv.core.support.entries import part, part_by, read_entries
from lpv.core.support.resources import bringup_file
from lpv_design.controller import ControllerRequirement
from lpv_design.exact_observer import ExactRequirement
from lpv_design.paper_observer import PaperRequirement


@dataclass(frozen=True)
class Requirement:
    """A whole requirement file."""

    # its type tells the method
    observer: ExactRequirement | PaperRequirement = part_by(
        'method', paper=PaperRequirement, exact=ExactRequirement
    )
    controller: ControllerRequirement = part(ControllerRequirement)
    source: str = ''  # file name


def load_requirement(name: str | Path) -> Requirement:
    """Requirement of a path, or of the bare name of a shipped one; ConfigError names a wrong
    field."""
    path = Path(name)
    if path.suffix not in ('.yaml', '.yml'):
        path = bringup_file('requirements', str(name))
    return parse_requirement(read_yaml(path), str(path))


def parse_requirement(data: dict[str, Any], source: str) -> Requirement:
    """Build a requirement from the mapping of a requirement file."""
    return read_entries(Requirement, Section(data, source), source=source)
