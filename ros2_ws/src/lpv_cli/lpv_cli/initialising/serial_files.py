"""Files of a serial arm of n joints to start from, out of its URDF."""

import os
from dataclasses import replace
from pathlib import Path
from string import Template

import numpy as np

from lpv_core.serial_arm.arm_file import load_serial_arm, save_serial_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.urdf_chain import read_urdf_chain
from lpv_core.simulation.any_scenario import load_any_scenario, new_path

FILES = ('arm.yaml', 'scenario.yaml')
_TEMPLATE = Path(__file__).resolve().parents[1] / 'templates' / 'serial_scenario.yaml'
_LARGEST_TURN = 0.4
"""Of a joint from the middle of its range to the waypoints [rad]."""


def write_serial_files(folder: Path, urdf: Path, name: str | None) -> list[Path]:
    """Write arm and scenario, read them again, and return their paths; ConfigError if invalid."""
    described = read_urdf_chain(urdf)
    near = os.path.relpath(urdf.resolve(), folder.resolve())
    arm = replace(described, name=name or described.name, urdf=near)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / file for file in FILES]
    save_serial_arm(arm, paths[0])
    values = {'name': arm.name, 'waypoints': _waypoints(arm), 'sensor': arm.sensor_names[0]}
    text = Template(_TEMPLATE.read_text(encoding='utf-8')).substitute(values)
    paths[1].write_text(text, encoding='utf-8')
    again = load_serial_arm(paths[0])
    new_path(again, load_any_scenario(paths[1], again))
    return paths


def _waypoints(arm: SerialArm) -> str:
    """There and back about the middle of the joints' ranges, as lines of YAML."""
    low = np.array([max(joint.limits.lower, -np.pi) for joint in arm.joints])
    high = np.array([min(joint.limits.upper, np.pi) for joint in arm.joints])
    middle, turn = 0.5 * (low + high), np.minimum(0.2 * (high - low), _LARGEST_TURN)
    lines = []
    for time, side in ((0.5, 0.0), (4.0, 1.0), (8.0, -1.0), (11.5, 0.0)):
        joints = ', '.join(f'{value:.4f}' for value in middle + side * turn)
        lines.append(f'    - {{t: {time}, joints: [{joints}]}}')
    return '\n'.join(lines)
