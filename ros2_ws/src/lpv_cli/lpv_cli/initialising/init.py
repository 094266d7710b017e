"""``lpv init``: commented files of an arm to start from, out of a URDF where there is one."""

import argparse
import math
import re
from pathlib import Path
from string import Template

import numpy as np

from lpv_cli.initialising.serial_files import write_serial_files
from lpv_cli.initialising.urdf_arm import EXAMPLE, count_joints, read_urdf_arm
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.model.kinematics import forward
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.errors import ConfigError

FILES = ('arm.yaml', 'requirement.yaml', 'scenario.yaml')
_TEMPLATES = Path(__file__).resolve().parents[1] / 'templates'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'folder', nargs='?', default='.', help='where the files are written (this folder)'
    )
    parser.add_argument('--name', help="name of the arm (the URDF's, or my_arm)")
    parser.add_argument(
        '--urdf', help='URDF of the arm: two links in a plane, or a serial arm of n joints'
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the files, read them again, and say what to do next."""
    folder = Path(arguments.folder)
    paths = [folder / name for name in FILES]
    for path in paths:
        if path.exists():
            raise ConfigError('folder', f'{path} exists already: nothing was written')
    if arguments.name:
        _check_name(arguments.name)
    if arguments.urdf and count_joints(arguments.urdf) > 2:
        return _run_serial(folder, arguments)
    described = read_urdf_arm(arguments.urdf) if arguments.urdf else EXAMPLE
    name = arguments.name or described.name
    _check_name(name)
    values = described.values(
        name,
        'those of an example'
        if arguments.urdf is None
        else 'those of the URDF, or of an example where it has none',
    )
    folder.mkdir(parents=True, exist_ok=True)
    for path in paths[:2]:
        path.write_text(_filled(path.name, values), encoding='utf-8')
    values['waypoints'] = _waypoints(load_arm(paths[0]))
    paths[2].write_text(_filled(FILES[2], values), encoding='utf-8')
    load_scenario(paths[2]).path(load_arm(paths[0]))
    arm, requirement, scenario = paths
    print(f'written: {arm}, {requirement}, {scenario}')
    print('next: replace what is marked "check" in the arm file, then')
    gains = folder / 'gains.yaml'
    print(f'  lpv design --arm {arm} --requirement {requirement} --out {gains}')
    print(f'  lpv demo --arm {arm} --requirement {requirement} --scenario {scenario}')
    return 0


def _check_name(name: str) -> None:
    if not re.fullmatch(r'[A-Za-z_]\w*', name):
        raise ConfigError('--name', f'must be letters, digits and underscores, got {name!r}')


def _run_serial(folder: Path, arguments: argparse.Namespace) -> int:
    arm, scenario = write_serial_files(folder, Path(arguments.urdf), arguments.name)
    print(f'written: {arm}, {scenario}')
    print('next: a URDF knows no friction, rotors and sensors; identify them from a recording')
    print(f'  lpv identify recording_bag --arm {arm} --out {arm}')
    print(f'  lpv demo --arm {arm} --scenario {scenario}')
    return 0


def _filled(name: str, values: dict[str, str]) -> str:
    return Template((_TEMPLATES / name).read_text(encoding='utf-8')).substitute(values)


def _waypoints(arm: ArmParameters) -> str:
    """There and back within the region, as lines of YAML."""
    # Kinematics counts q1 from the x-axis, angles of the links count from the upper vertical.
    ends = [np.array([math.pi / 2 + side, 0.6]) for side in (-0.7, 0.1, -0.7)]
    points = forward(np.array(ends), arm.lengths)
    return '\n'.join(
        f'    - {{t: {time}, x: {x:.4f}, y: {y:.4f}}}'
        for time, (x, y) in zip((0.5, 6.0, 11.5), points.tolist())
    )
