"""Contents of a simulated run of a serial arm: path, plant, faults; from one YAML file."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from lpv_core.control.serial_path import PoseWaypoints, SerialPath
from lpv_core.serial_arm.arm_file import KIND
from lpv_core.serial_arm.chain import MAX_JOINTS, Chain, compile_chain
from lpv_core.serial_arm.description import LinkInertia, SerialArm, SerialJoint
from lpv_core.serial_arm.dynamics.payload import with_payload
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import expanded_plant, parse_faults
from lpv_core.support.config import Section, names_all_errors

PLANTS = ('nonlinear', 'mujoco')
_MOST_WAYPOINTS = 10_000


@dataclass(frozen=True)
class SerialScenario:
    """A simulated run of a serial arm."""

    name: str
    duration: float  # [s]
    seed: int  # of all randomness
    plant: str  # one of `PLANTS`
    parameter_error: float  # largest relative error of each link's mass and inertia, drawn
    payload: float  # point mass at the tip beside the model's, may be negative [kg]
    friction_factor: float  # true over nominal
    noise: bool  # whether the sensors are noisy
    noise_factor: float  # true over stated standard deviation of the sensors' noise
    times: tuple[float, ...]  # of the waypoints [s]
    waypoints: tuple[tuple[float, ...], ...] | PoseWaypoints  # joint positions [rad], or poses
    faults: tuple[Fault, ...]

    def path(self, arm: SerialArm) -> SerialPath:
        """The path for an arm; ConfigError or UnreachableError where the arm cannot do it."""
        if not isinstance(self.waypoints, PoseWaypoints):
            n = len(arm.joints)
            for i, row in enumerate(self.waypoints):
                if len(row) != n:
                    field, reason = f'path.waypoints[{i}].joints', f'must have {n} numbers for'
                    raise Section({}, self.name).error(field, f'{reason} {arm.name}')
        return _path(arm, self.times, self.waypoints)

    def true_arm(self, arm: SerialArm) -> Chain:
        """The plant's chain: parameters with errors drawn from the seed, and the payload."""
        rng = np.random.default_rng((self.seed, 1))
        joints = tuple(self._true_joint(joint, rng) for joint in arm.joints)
        chain = compile_chain(replace(arm, joints=joints))
        return with_payload(chain, self.payload) if self.payload else chain

    def _true_joint(self, joint: SerialJoint, rng: np.random.Generator) -> SerialJoint:
        # One factor for a whole link keeps it a rigid body.
        factor = 1.0 + self.parameter_error * rng.uniform(-1.0, 1.0)
        return replace(
            joint,
            link=LinkInertia.from_vector(factor * joint.link.to_vector()),
            friction=replace(
                joint.friction,
                viscous=self.friction_factor * joint.friction.viscous,
                coulomb=self.friction_factor * joint.friction.coulomb,
                load=self.friction_factor * joint.friction.load,
            ),
        )


@lru_cache(maxsize=4)
def _path(
    arm: SerialArm,
    times: tuple[float, ...],
    waypoints: tuple[tuple[float, ...], ...] | PoseWaypoints,
) -> SerialPath:
    """Kept: the simulator asks for the path of a run, and so does its tracker."""
    if isinstance(waypoints, PoseWaypoints):
        return SerialPath.through_poses(arm, times, waypoints)
    return SerialPath(arm, times, waypoints)


def is_serial_scenario(data: dict[str, Any]) -> bool:
    """Whether the mapping of a scenario file is for a serial arm."""
    return data.get('kind') == KIND


@names_all_errors
def parse_serial_scenario(data: dict[str, Any], source: str = 'scenario') -> SerialScenario:
    """Build a scenario from the mapping of a scenario file.

    Parameters
    ----------
    data : dict
        Content; see ``docs/scenario-file.md``.
    source : str, optional
        Name for error messages.

    Returns
    -------
    SerialScenario
        Validated as far as that is possible without the arm.

    Raises
    ------
    ConfigError
        Naming the offending field.
    """
    top = Section(expanded_plant(data), source)
    top.text('kind', choices=(KIND,))
    times, waypoints = _waypoints(top.section('path'))
    plant = top.section('plant', required=False)
    scenario = SerialScenario(
        name=top.text('name'),
        duration=top.number('duration', above=0.0, high=1e6),
        seed=top.integer('seed', 1, low=0),
        plant=plant.text('model', 'nonlinear', PLANTS),
        parameter_error=plant.number('parameter_error', 0.0, 0.0, 0.5),
        payload=plant.number('payload', 0.0, -1e4, 1e4),
        friction_factor=plant.number('friction_factor', 1.0, 0.0, 100.0),
        noise=top.flag('noise', True),
        noise_factor=plant.number('noise_factor', 1.0, 0.0, 1e3),
        times=times,
        waypoints=waypoints,
        faults=parse_faults(top),
    )
    plant.finish()
    top.finish()
    return scenario


def _waypoints(
    path: Section,
) -> tuple[tuple[float, ...], tuple[tuple[float, ...], ...] | PoseWaypoints]:
    """Times and waypoints: joint positions, or poses with the posture to begin with."""
    sections = path.sections('waypoints')
    if not 2 <= len(sections) <= _MOST_WAYPOINTS:
        raise path.error('waypoints', f'must be 2 to {_MOST_WAYPOINTS}')
    times = tuple(point.number('t', low=0.0, high=1e6) for point in sections)
    if any(b <= a for a, b in zip(times, times[1:])):
        raise path.error('waypoints', 'times must increase')
    joints, poses = ('joints' in sections[0], 'position' in sections[0])
    if joints == poses:
        raise sections[0].error('joints', 'or position must be given, one of them')
    waypoints: tuple[tuple[float, ...], ...] | PoseWaypoints
    if joints:
        waypoints = tuple(
            tuple(point.numbers('joints', MAX_JOINTS, -1e3, 1e3)) for point in sections
        )
    else:
        waypoints = PoseWaypoints(
            tuple(_triple(point, 'position') for point in sections),
            tuple(path.numbers('start', MAX_JOINTS, -1e3, 1e3)),
            tuple(_triple(point, 'rpy') for point in sections if 'rpy' in point),
        )
        if 0 < len(waypoints.orientations) < len(sections):
            raise path.error('waypoints', 'must have rpy all, or none of them')
    for section in (*sections, path):
        section.finish()
    return times, waypoints


def _triple(section: Section, key: str) -> tuple[float, float, float]:
    x, y, z = section.vector(key, 3, low=-1e3, high=1e3)
    return x, y, z
