"""Requirement files: what a design must fulfil."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpv.core.support.config import Section, names_all_errors, read_yaml
from lpv.core.support.errors import ConfigError
from lpv_design.controller import ControllerRequirement
from lpv_design.exact_observer import ExactRequirement

SHIPPED = Path(__file__).parent / 'requirements'


@dataclass(frozen=True)
class PaperRequirement:
    """Requirements of the literal observer design."""

    lmi: str = '55'  # '55', literally, or '54+disc': (54) and the disc as separate inequalities
    sinc_min: float = 0.96  # lower end of the box of phi2 and phi3
    gamma: float = 1.0  # attenuation level
    q: float = 20.0  # disc [1/s]
    r: float = 15.0  # disc [1/s]


@dataclass(frozen=True)
class Requirement:
    """A whole requirement file."""

    observer: ExactRequirement | PaperRequirement  # observer part; its type tells the method
    controller: ControllerRequirement  # controller part
    controller_method: str  # 'paper' or 'exact'
    controller_sinc_min: float  # box of the controller's method ``paper``
    source: str  # file name


def shipped_requirements() -> list[str]:
    """Names of the shipped requirements."""
    return sorted(path.stem for path in SHIPPED.glob('*.yaml'))


def requirement_file(name: str | Path) -> Path:
    """File of a path, or of the bare name of a shipped requirement, else ConfigError."""
    path = Path(name)
    if path.suffix not in ('.yaml', '.yml'):
        path = SHIPPED / f'{name}.yaml'
        if not path.exists():
            known = ', '.join(shipped_requirements())
            raise ConfigError('requirement', f'{name!r} is not shipped; there are {known}')
    return path


def load_requirement(name: str | Path) -> Requirement:
    """Requirement of a path, or of the bare name of a shipped one; ConfigError names a wrong
    field."""
    path = requirement_file(name)
    return parse_requirement(read_yaml(path), str(path))


@names_all_errors
def parse_requirement(data: dict[str, Any], source: str) -> Requirement:
    """Build a requirement from the mapping of a requirement file."""
    top = Section(data, source)
    observer, controller = top.section('observer'), top.section('controller')
    requirement = Requirement(
        observer=_observer(observer),
        controller=_controller(controller),
        controller_method=controller.text('method', choices=('paper', 'exact')),
        controller_sinc_min=controller.number('sinc_min', -0.2, -0.3, 0.99),
        source=source,
    )
    for section in (observer, controller, top):
        section.finish()
    return requirement


def _observer(section: Section) -> ExactRequirement | PaperRequirement:
    if section.text('method', choices=('paper', 'exact')) == 'paper':
        requirement = PaperRequirement(
            lmi=section.text('lmi', '55', ('55', '54+disc')),
            sinc_min=section.number('sinc_min', 0.96, -0.3, 0.999),
            gamma=section.number('gamma', 1.0, above=0.0, high=1e9),
            q=section.number('q', 20.0, above=0.0, high=1e9),
            r=section.number('r', 15.0, above=0.0, high=1e9),
        )
        if not requirement.r < requirement.q:
            raise section.error('r', 'must be below q, or the disc reaches unstable poles')
        return requirement
    return ExactRequirement(
        decay=section.number('decay', above=0.0, high=1e9),
        fastest=_fastest(section, 'decay'),
        acceleration_noise=section.pair('acceleration_noise', above=0.0, high=1e9),
        rate_noise=section.number('rate_noise', above=0.0, high=1e9),
        velocity_weight=section.number('velocity_weight', 0.02, above=0.0, high=1e9),
        torque_gain=section.number('torque_gain', 1e9, above=0.0, high=1e9),
    )


def _controller(section: Section) -> ControllerRequirement:
    return ControllerRequirement(
        alpha=section.number('alpha', above=0.0, high=1e9),
        fastest=_fastest(section, 'alpha'),
        state_weight=tuple(section.vector('state_weight', 3, above=0.0, high=1e9)),
        torque_weight=section.number('torque_weight', above=0.0, high=1e9),
    )


def _fastest(section: Section, slowest: str) -> float:
    fastest = section.number('fastest', above=0.0, high=1e9)
    if not fastest > section.number(slowest):
        raise section.error('fastest', f'must be greater than {slowest}')
    return fastest
