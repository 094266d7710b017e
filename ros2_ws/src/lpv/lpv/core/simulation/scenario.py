"""Contents of a simulated run: path, plant, noise, disturbance, faults; from one YAML file."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.control.path import CartesianPath, PlanarWaypoints, PoseWaypoints, SerialPath
from lpv.core.serial_arm.chain import MAX_JOINTS, Chain, body_parameters, compile_chain
from lpv.core.serial_arm.description import LinkInertia, SerialArm, SerialJoint
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.simulation.faults import Fault
from lpv.core.support.config import Section, read_yaml
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.errors import ConfigError, each, kept, raise_all
from lpv.core.support.limits import FAR, MOST_ENTRIES, TURN

PAPER_PLANTS = ('nonlinear_without_coriolis', 'lpv')
"""The arm of eq. (4) and the LPV plant (25), for planar arms."""
PLANTS = ('nonlinear', *PAPER_PLANTS, 'mujoco')
"""The true arm, those of the paper, or MuJoCo's."""

Waypoints = tuple[tuple[float, ...], ...] | PoseWaypoints | PlanarWaypoints
"""Joint positions [rad], poses of the tip, or points in the plane of a planar arm."""


def _plant(name: str, default: float, low: float, high: float) -> Any:
    """A field that is a number of the section of the plant."""
    return entry('number', default=default, low=low, high=high, at=f'plant.{name}')


def _factors(name: str) -> Any:
    return entry('numbers', MAX_JOINTS, default=(), above=0.0, high=100.0, at=f'plant.{name}')


@dataclass(frozen=True)
class Scenario:
    """A simulated run of an arm."""

    name: str
    duration: float  # [s]
    seed: int  # of all randomness
    times: tuple[float, ...]  # of the waypoints [s]
    waypoints: Waypoints
    faults: tuple[Fault, ...] = ()
    # one of `PLANTS`
    plant: str = entry('text', default=PLANTS[0], choices=PLANTS, at='plant.model')
    # lower end of the box of phi2, phi3 of the LPV plant
    sinc_min: float = _plant('sinc_min', -0.2, -0.3, 0.99)
    # largest relative error of each link's mass and inertia, drawn
    parameter_error: float = _plant('parameter_error', 0.0, 0.0, 0.5)
    # true over nominal, per link; none: 1
    mass_factors: tuple[float, ...] = _factors('mass_factors')
    # about the centre of mass, true over nominal
    inertia_factors: tuple[float, ...] = _factors('inertia_factors')
    # point mass at the tip beside the model's, may be negative [kg]
    payload: float = _plant('payload', 0.0, -1e4, 1e4)
    friction_factor: float = _plant('friction_factor', 1.0, 0.0, 100.0)  # true over nominal
    noise: bool = entry('flag', default=True)  # whether the sensors are noisy
    # true over stated standard deviation of the sensors' noise
    noise_factor: float = _plant('noise_factor', 1.0, 0.0, 1e3)
    # whether the disturbance d of the arm's ``lpv`` region acts
    disturbance: bool = entry('flag', default=True)
    disturbance_factor: float = _plant('disturbance_factor', 1.0, 0.0, 1e3)  # true over stated d

    def check(self, section: Section) -> None:
        """ConfigError for a factor of what is switched off."""
        for name in ('noise', 'disturbance'):
            if not getattr(self, name) and getattr(self, f'{name}_factor') not in (0.0, 1.0):
                raise section.error(f'plant.{name}_factor', f'counts only with {name}: true')

    def path(self, arm: SerialArm) -> SerialPath:
        """The path for an arm; ConfigError or UnreachableError where the arm cannot do it."""
        return _path(arm, self.name, self.times, self.waypoints)

    def true_arm(self, arm: SerialArm) -> SerialArm:
        """The plant's arm without its payload; parameter errors are drawn from the seed."""
        rng = np.random.default_rng((self.seed, 1))
        ones = (1.0,) * len(arm.joints)
        masses, inertias = self.mass_factors or ones, self.inertia_factors or ones
        for name, factors in (('mass_factors', masses), ('inertia_factors', inertias)):
            if len(factors) != len(arm.joints):
                raise ConfigError(f'plant.{name}', f'must have {len(arm.joints)} numbers')
        joints = tuple(
            self._true_joint(joint, mass, inertia, rng)
            for joint, mass, inertia in zip(arm.joints, masses, inertias)
        )
        return replace(arm, joints=joints)

    def true_chain(self, arm: SerialArm) -> Chain:
        """The plant's chain, with its payload."""
        chain = compile_chain(self.true_arm(arm))
        return with_payload(chain, self.payload) if self.payload else chain

    def _true_joint(
        self, joint: SerialJoint, mass: float, inertia: float, rng: np.random.Generator
    ) -> SerialJoint:
        # One factor for a whole link keeps it a rigid body.
        factor = 1.0 + self.parameter_error * rng.uniform(-1.0, 1.0)
        friction = joint.friction
        return replace(
            joint,
            link=_scaled(joint.link, factor * mass, factor * inertia),
            friction=replace(
                friction,
                viscous=self.friction_factor * friction.viscous,
                coulomb=self.friction_factor * friction.coulomb,
                load=self.friction_factor * friction.load,
            ),
        )


def _scaled(link: LinkInertia, mass: float, inertia: float) -> LinkInertia:
    """A link with its mass, and its inertia about the centre of mass, multiplied."""
    if mass == inertia:
        return LinkInertia.from_vector(mass * link.to_vector())
    own = inertia * link.about_center()
    return LinkInertia.from_vector(body_parameters(mass * link.mass, link.center(), own))


@lru_cache(maxsize=4)
def _path(arm: SerialArm, name: str, times: tuple[float, ...], waypoints: Waypoints) -> SerialPath:
    """Kept: the simulator asks for the path of a run, and so does its tracker."""
    if isinstance(waypoints, PlanarWaypoints):
        if len(arm.joints) != 2:
            what = f'x and y are for planar arms of two links, {arm.name} has {len(arm.joints)}'
            raise ConfigError('path.waypoints', f'{what}: give joints or position', name)
        return CartesianPath(arm, times, waypoints)
    if isinstance(waypoints, PoseWaypoints):
        return SerialPath.through_poses(arm, times, waypoints)
    for i, row in enumerate(waypoints):
        if len(row) != len(arm.joints):
            field, reason = f'path.waypoints[{i}].joints', f'must have {len(arm.joints)} numbers'
            raise ConfigError(field, f'{reason} for {arm.name}', name)
    return SerialPath(arm, times, waypoints)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/scenario-file.md``.

    Returns
    -------
    Scenario
        Validated as far as that is possible without the arm.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    return parse_scenario(read_yaml(path), str(Path(path)))


def parse_scenario(data: dict[str, Any], source: str = 'scenario') -> Scenario:
    """Build a scenario from the mapping of a scenario file, as `load_scenario`."""
    top = Section(_expanded(data), source)
    errors: list[ConfigError] = []
    path: tuple[Any, Any] = (), ()
    with kept(errors):
        path = _waypoints(top.section('path'))
    with kept(errors):
        scenario = read_entries(
            Scenario,
            top,
            name=lambda: top.text('name'),
            duration=lambda: top.number('duration', above=0.0, high=1e6),
            seed=lambda: top.integer('seed', 1, low=0),
            times=path[0],
            waypoints=path[1],
            faults=lambda: parse_faults(top),
        )
    raise_all(errors)
    return scenario


def _expanded(data: Any) -> Any:
    """``plant: mujoco`` stands for ``plant: {model: mujoco}``."""
    if isinstance(data, dict) and isinstance(data.get('plant'), str):
        return {**data, 'plant': {'model': data['plant']}}
    return data


def _waypoints(path: Section) -> tuple[tuple[float, ...], Waypoints]:
    """Times and waypoints: joint positions, poses of the tip, or points in the plane."""
    sections = path.sections('waypoints')
    if not 2 <= len(sections) <= MOST_ENTRIES:
        raise path.error('waypoints', f'must be 2 to {MOST_ENTRIES}')
    times = each(lambda point: point.number('t', low=0.0, high=1e6), sections)
    if any(b <= a for a, b in zip(times, times[1:])):
        raise path.error('waypoints', 'times must increase')
    kinds = [key for key in ('joints', 'position', 'x') if key in sections[0]]
    if len(kinds) != 1:
        raise sections[0].error('joints', 'or position, or x and y, must be given, one of them')
    waypoints: Waypoints
    limits = None, -FAR, FAR
    if kinds == ['x']:
        points = each(lambda p: (p.number('x', *limits), p.number('y', *limits)), sections)
        waypoints = read_entries(PlanarWaypoints, path, points=points)
    elif kinds == ['joints']:
        waypoints = each(lambda p: tuple(p.numbers('joints', MAX_JOINTS, *limits[1:])), sections)
    else:
        waypoints = PoseWaypoints(
            each(lambda p: tuple(p.vector('position', 3, *limits)), sections),
            tuple(path.numbers('start', MAX_JOINTS, *limits[1:])),
            tuple(tuple(p.vector('rpy', 3, None, -TURN, TURN)) for p in sections if 'rpy' in p),
        )
        if 0 < len(waypoints.orientations) < len(sections):
            raise path.error('waypoints', 'must have rpy all, or none of them')
    each(Section.finish, (*sections, path))
    return times, waypoints


def parse_faults(top: Section) -> tuple[Fault, ...]:
    """Read the list ``faults``, which may be missing; ConfigError naming the offending field."""
    return each(lambda section: read_entries(Fault, section), top.sections('faults', []))


def disturbance_of(arm: SerialArm, scenario: Scenario) -> tuple[np.ndarray, float, float]:
    """The white disturbance d of eq. (31).

    Parameters
    ----------
    arm : SerialArm
        With or without an ``lpv`` region.
    scenario : Scenario
        Whether d acts, and how much of it.

    Returns
    -------
    tuple
        Accelerations of the joints per unit of d, shape (n,), mean and standard deviation of d.
    """
    region = arm.lpv
    if region is None or not scenario.disturbance:
        return np.zeros(len(arm.joints)), 0.0, 0.0
    first, second = region.disturbance_direction  # of the absolute angles: q' = J theta'
    factor = scenario.disturbance_factor
    return (
        np.array([first, second - first]),
        factor * region.disturbance_mean,
        factor * math.sqrt(region.disturbance_variance),
    )
