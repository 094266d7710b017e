"""Contents of a simulated run: path, faults, noise, disturbance, plant; from one YAML file."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv_core.control.path import CartesianPath, Obstacle
from lpv_core.export.mjcf import COULOMB
from lpv_core.model.arm import ArmParameters
from lpv_core.model.kinematics import ELBOWS
from lpv_core.simulation.faults import KINDS, Fault
from lpv_core.support.config import Section, names_all_errors, read_yaml

PLANTS = ('nonlinear', 'nonlinear_without_coriolis', 'lpv', 'mujoco')

_FAR = 100.0
"""Largest coordinate of a waypoint [m]."""


@dataclass(frozen=True)
class Scenario:
    """A simulated run.

    Attributes are commented where they are declared.
    """

    name: str
    duration: float  # [s]
    seed: int  # of all randomness
    plant: str  # one of `PLANTS`: the true arm, the arm of eq. (4), the LPV plant (25), or MuJoCo's
    sinc_min: float  # lower end of the box of phi2, phi3 of the LPV plant
    mass_factors: tuple[float, float]  # true over nominal, per link
    inertia_factors: tuple[float, float]  # true over nominal, per link
    payload: float  # point mass at the tip beside the model's, may be negative [kg]
    friction_factor: float  # true over nominal
    noise: bool  # whether the sensors are noisy
    disturbance: bool  # whether d acts
    times: tuple[float, ...]  # of the waypoints [s]
    points: tuple[tuple[float, float], ...]  # waypoints x, y [m]
    elbow: str  # branch of the inverse kinematics
    obstacle: Obstacle | None
    faults: tuple[Fault, ...]
    coulomb: str = 'smooth'  # law of Coulomb friction in MuJoCo: smooth or dry
    noise_factor: float = 1.0  # true over stated standard deviation of the sensors' noise
    disturbance_factor: float = 1.0  # true over stated d

    def path(self, arm: ArmParameters) -> CartesianPath:
        """The Cartesian path for an arm."""
        return CartesianPath(arm, self.times, np.array(self.points), self.elbow, self.obstacle)

    def true_arm(self, arm: ArmParameters) -> ArmParameters:
        """The plant's arm: nominal parameters with model error and payload."""
        scaled = arm.scaled(self.mass_factors, self.inertia_factors)
        scaled = replace(
            scaled,
            viscous=tuple(self.friction_factor * v for v in arm.viscous),
            coulomb=tuple(self.friction_factor * v for v in arm.coulomb),
        )
        return scaled.with_payload(self.payload) if self.payload else scaled


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/scenario-file.md``.

    Returns
    -------
    Scenario
        Validated.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    return parse_scenario(read_yaml(path), str(Path(path)))


@names_all_errors
def parse_scenario(data: dict[str, Any], source: str = 'scenario') -> Scenario:
    """Build a scenario from the mapping of a scenario file.

    Parameters
    ----------
    data : dict
        Content.
    source : str, optional
        Name for error messages.

    Returns
    -------
    Scenario
        Validated.

    Raises
    ------
    ConfigError
        As `load_scenario`.
    """
    top = Section(expanded_plant(data), source)
    path = top.section('path')
    waypoints = path.sections('waypoints')
    times = tuple(w.number('t', low=0.0, high=1e6) for w in waypoints)
    points = tuple(
        (w.number('x', None, -_FAR, _FAR), w.number('y', None, -_FAR, _FAR)) for w in waypoints
    )
    obstacle = None
    if 'obstacle' in path:
        section = path.section('obstacle')
        obstacle = Obstacle(
            section.pair('center', None, -_FAR, _FAR),
            section.number('radius', above=0.0, high=_FAR),
        )
        section.finish()
    elbow = path.text('elbow', 'positive', tuple(ELBOWS))
    for section in (*waypoints, path):
        section.finish()
    plant = top.section('plant', required=False)
    model = plant.text('model', 'nonlinear', PLANTS)
    coulomb = plant.text('coulomb', 'smooth', COULOMB)
    if coulomb != 'smooth' and model != 'mujoco':
        raise plant.error('coulomb', f'can be {coulomb} with model mujoco only')
    scenario = Scenario(
        name=top.text('name'),
        duration=top.number('duration', above=0.0, high=1e6),
        seed=top.integer('seed', 1, low=0),
        plant=model,
        sinc_min=plant.number('sinc_min', -0.2, -0.3, 0.99),
        mass_factors=plant.pair('mass_factors', 1.0, above=0.0, high=100.0),
        inertia_factors=plant.pair('inertia_factors', 1.0, above=0.0, high=100.0),
        payload=plant.number('payload', 0.0, -1e4, 1e4),
        friction_factor=plant.number('friction_factor', 1.0, 0.0, 100.0),
        noise=top.flag('noise', True),
        disturbance=top.flag('disturbance', True),
        times=times,
        points=points,
        elbow=elbow,
        obstacle=obstacle,
        faults=parse_faults(top),
        coulomb=coulomb,
        noise_factor=plant.number('noise_factor', 1.0, 0.0, 1e3),
        disturbance_factor=plant.number('disturbance_factor', 1.0, 0.0, 1e3),
    )
    plant.finish()
    top.finish()
    return scenario


def expanded_plant(data: Any) -> Any:
    """``plant: mujoco`` stands for ``plant: {model: mujoco}``."""
    if isinstance(data, dict) and isinstance(data.get('plant'), str):
        return {**data, 'plant': {'model': data['plant']}}
    return data


def parse_faults(top: Section) -> tuple[Fault, ...]:
    """Read the list ``faults``, which may be missing; ConfigError naming the offending field."""
    return tuple(_fault(section) for section in top.sections('faults', []))


def _fault(section: Section) -> Fault:
    fault = Fault(
        sensor=section.text('sensor'),
        kind=section.text('kind', choices=KINDS),
        onset=section.number('onset', low=0.0, high=1e6),
        duration=section.number('duration', 0.0, 0.0, 1e6),
        size=section.number('size', 0.0, -1e3, 1e3),
        rate=section.number('rate', 0.0, -1e3, 1e3),
    )
    section.finish()
    return fault
