"""``lpv init``: commented files of an arm to start from, out of a URDF where there is one."""

import argparse
import math
import os
import re
from dataclasses import replace
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from lpv_cli import arm_choice
from lpv_core.support.errors import ConfigError

if TYPE_CHECKING:
    from lpv_core.serial_arm.description import SerialArm

FILES = ('arm.yaml', 'requirement.yaml', 'scenario.yaml')
_TEMPLATES = Path(__file__).resolve().parents[1] / 'templates'
_LARGEST_TURN = 0.4
"""Of a joint from the middle of its range to the waypoints [rad]."""
_SAME = 1e-3
"""Directions and angles that differ by less are the same."""
_EXAMPLE = {
    'joint': ('joint1', 'joint2'),
    'mass': (10.0, 5.0),
    'length': (1.0, 1.0),
    'center': (0.5, 0.5),
    'inertia': (0.83, 0.41),
    'viscous': (0.1, 0.1),
    'coulomb': (0.2, 0.2),
    'torque': (1500.0, 600.0),
    'zero_angle': -math.pi / 2,
    'velocity_limit': 20.0,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'folder', nargs='?', default='.', help='where the files are written (this folder)'
    )
    parser.add_argument('--name', help="name of the arm (the URDF's, or my_arm)")
    arm_choice.add_arguments(parser, required=False)


def run(arguments: argparse.Namespace) -> int:
    """Write the files, read them again, and say what to do next."""
    folder, name = Path(arguments.folder), arguments.name
    for path in (folder / file for file in FILES):
        if path.exists():
            raise ConfigError('folder', f'{path} exists already: nothing was written')
    if name and not re.fullmatch(r'[A-Za-z_]\w*', name):
        raise ConfigError('--name', f'must be letters, digits and underscores, got {name!r}')
    if not arguments.urdf:
        for option in ('joints', 'lock', 'tip'):
            if getattr(arguments, option):
                raise ConfigError(f'--{option}', 'is for joints of a URDF: give --urdf')
        return _write_planar(folder, name or 'my_arm', _EXAMPLE, 'those of an example')
    arm = arm_choice.with_stated_friction(arm_choice.chosen_arm(arguments), arguments.urdf)
    arm = replace(arm, name=name or re.sub(r'\W', '_', arm.name))
    values = _planar(arm)
    if values is not None:
        return _write_planar(folder, arm.name, values, 'those of the URDF')
    return _write_serial(folder, arm, Path(arguments.urdf))


def _write_serial(folder: Path, arm: 'SerialArm', urdf: Path) -> int:
    from lpv_core.serial_arm.arm_file import load_serial_arm, save_serial_arm
    from lpv_core.simulation.any_scenario import load_any_scenario, new_path

    folder.mkdir(parents=True, exist_ok=True)
    file, scenario = folder / FILES[0], folder / FILES[2]
    save_serial_arm(replace(arm, urdf=os.path.relpath(urdf.resolve(), folder.resolve())), file)
    values = {'name': arm.name, 'waypoints': _serial_waypoints(arm), 'sensor': arm.sensor_names[0]}
    scenario.write_text(_filled('serial_scenario.yaml', values), encoding='utf-8')
    again = load_serial_arm(file)
    new_path(again, load_any_scenario(scenario, again))
    print(f'written: {file}, {scenario}')
    print(f'joints: {", ".join(arm.joint_names)}')
    if arm.locked:
        print('held: ' + ', '.join(f'{joint} at {value:g}' for joint, value in arm.locked))
    print('next: a URDF knows no rotors and sensors; identify them from a recording')
    print(f'  lpv identify recording_bag --arm {file} --out {file}')
    print(f'  lpv demo --arm {file} --scenario {scenario}')
    return 0


def _serial_waypoints(arm: 'SerialArm') -> str:
    """There and back about the middle of the joints' ranges, as lines of YAML."""
    lines = []
    for time, side in ((0.5, 0.0), (4.0, 1.0), (8.0, -1.0), (11.5, 0.0)):
        places = []
        for low, high in (joint.range for joint in arm.joints):
            turn = min(0.2 * (high - low), _LARGEST_TURN)
            places.append(f'{0.5 * (low + high) + side * turn:.4f}')
        lines.append(f'    - {{t: {time}, joints: [{", ".join(places)}]}}')
    return '\n'.join(lines)


def _write_planar(folder: Path, name: str, found: dict, origin: str) -> int:
    import yaml

    from lpv_core.model.arm import parse_arm
    from lpv_core.simulation.scenario import parse_scenario

    values = {'name': name, 'origin': origin}
    for key, value in found.items():
        for i, part in enumerate(value, start=1) if isinstance(value, tuple) else ((0, value),):
            text = part if isinstance(part, str) else f'{part:.9g}'
            values[f'{key}_{i}' if i else key] = text
    texts = {name: _filled(name, values) for name in FILES[:2]}
    described = parse_arm(yaml.safe_load(texts[FILES[0]]))
    values['waypoints'] = _planar_waypoints(described.lengths)
    texts[FILES[2]] = _filled(FILES[2], values)
    parse_scenario(yaml.safe_load(texts[FILES[2]])).path(described)
    folder.mkdir(parents=True, exist_ok=True)
    arm, requirement, scenario = (folder / file for file in FILES)
    for path in (arm, requirement, scenario):
        path.write_text(texts[path.name], encoding='utf-8')
    print(f'written: {arm}, {requirement}, {scenario}')
    print('next: replace what is marked "check" in the arm file, then')
    gains = folder / 'gains.yaml'
    print(f'  lpv design --arm {arm} --requirement {requirement} --out {gains}')
    print(f'  lpv demo --arm {arm} --requirement {requirement} --scenario {scenario}')
    return 0


def _filled(name: str, values: dict[str, str]) -> str:
    return Template((_TEMPLATES / name).read_text(encoding='utf-8')).substitute(values)


def _planar_waypoints(lengths: tuple[float, float]) -> str:
    """There and back within the region, as lines of YAML."""
    import numpy as np

    from lpv_core.model.kinematics import forward

    # Kinematics counts q1 from the x-axis, angles of the links count from the upper vertical.
    ends = np.array([[math.pi / 2 + side, 0.6] for side in (-0.7, 0.1, -0.7)])
    return '\n'.join(
        f'    - {{t: {time}, x: {x:.4f}, y: {y:.4f}}}'
        for time, (x, y) in zip((0.5, 6.0, 11.5), forward(ends, lengths).tolist())
    )


def _planar(arm: 'SerialArm') -> dict | None:
    """Values of the template if the arm has two links in a vertical plane; else None.

    Both axes are the same and horizontal, and the arm is stretched where joint 2 is zero.
    """
    import numpy as np

    from lpv_core.serial_arm.description import rotation_from_rpy

    if len(arm.joints) != 2:
        return None
    one, two = arm.joints
    turned = [rotation_from_rpy(one.orientation)]
    turned.append(turned[0] @ rotation_from_rpy(two.orientation))
    axes = [turn @ joint.axis for turn, joint in zip(turned, arm.joints)]
    if np.abs(axes[0] - axes[1]).max() > _SAME or abs(axes[0][2]) > _SAME:
        return None
    axis, up = axes[0], np.array([0.0, 0.0, 1.0])
    masses = [max(joint.link.mass, 1e-9) for joint in arm.joints]
    centers = [
        turn @ joint.link.first_moment / mass
        for turn, joint, mass in zip(turned, arm.joints, masses)
    ]
    # A URDF without a frame at its tip has none: its link then ends twice as far as its centre.
    tip = np.array(arm.tip) if np.any(arm.tip) else 2.0 * turned[1].T @ centers[1]
    steps = [turned[0] @ two.position, turned[1] @ tip]
    steps = [step - axis * (axis @ step) for step in steps]
    lengths = [float(np.linalg.norm(step)) for step in steps]
    angles = [math.atan2(axis @ np.cross(up, step), up @ step) for step in steps]
    if min(lengths) <= 0.0 or abs(math.remainder(angles[1] - angles[0], 2 * math.pi)) > 0.01:
        return None
    across = [center - axis * (axis @ center) for center in centers]
    inertias = [
        float(np.array(j.axis) @ j.link.rotational_inertia() @ j.axis - m * (c @ c))
        for j, m, c in zip(arm.joints, masses, across)
    ]
    return {
        'joint': arm.joint_names,
        'mass': tuple(masses),
        'length': tuple(lengths),
        'center': tuple(float(c @ s) / n for c, s, n in zip(across, steps, lengths)),
        'inertia': tuple(inertias),
        'viscous': (one.friction.viscous, two.friction.viscous),
        'coulomb': (one.friction.coulomb, two.friction.coulomb),
        'torque': tuple(min(limit, 1e6) for limit in arm.torque_limit),
        'zero_angle': angles[0],
        'velocity_limit': min(arm.velocity_limit),
    }
