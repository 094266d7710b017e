"""``lpv init``: commented files of an arm to start from, out of a URDF where there is one."""

import argparse
import json
import math
import os
import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from string import Template

import numpy as np
import yaml

from lpv.cli.arm_choice import chosen_arm
from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import LpvRegion, SerialArm
from lpv.core.serial_arm.dynamics.aligned_axes import aligned_axes
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.simulation import integration_step
from lpv.core.simulation.scenario import parse_scenario
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.core.uio.model.kinematics import forward
from lpv.core.uio.planar import is_planar, planar_model

FILES = ('arm.yaml', 'requirement.yaml', 'scenario.yaml')
_TEMPLATES = Path(__file__).resolve().parents[1] / 'templates'
_TURNS = (0.4, 0.2, 0.1)
"""Turns of a joint to the waypoints that are tried, the largest that drives can hold [rad]."""
_SIDES = (-0.7, 0.1), (0.7, -0.1), (-0.3, 0.1), (0.3, -0.1)
"""Turns of the first link from the vertical in a region, tried until limits admit them [rad]."""
_SLOW = 0.8
"""Way to the waypoints of a joint that is slow, in what its limit lets it go in a second [s]."""
_HEAVY = 0.5
"""Share of a torque limit that the weight may need in the middle of the ranges; else there are
lighter poses to move about."""
_FARTHEST = 20.0 * math.pi
"""Limits that are warned of: no cable turns ten times, and 63 m are no arm's [rad], [m]."""


def run(arguments: argparse.Namespace) -> int:
    """Write the files, and say what to do next."""
    folder, name = Path(arguments.folder or '.'), arguments.name
    for path in (folder / file for file in FILES):
        if path.exists():
            raise ConfigError('folder', f'{path} exists already: nothing was written')
    if name and not re.fullmatch(r'[A-Za-z_]\w*', name):
        raise ConfigError('--name', f'must be letters, digits and underscores, got {name!r}')
    arm = chosen_arm(arguments)
    if arm is None:
        arm = load_arm(bringup_file('arms', 'paper'))  # with encoders at the joints
        joints = [
            replace(joint, sensors=replace(joint.sensors, name=f'{joint.name}_encoder'))
            for joint in arm.joints
        ]
        example = replace(arm, name=name or 'my_arm', joints=tuple(joints), sensor_matrix=None)
        return _write(folder, example, 'arm')
    arm = _with_region(replace(arm, name=name or re.sub(r'\W', '_', arm.name)))
    urdf = os.path.relpath(Path(arguments.urdf).resolve(), folder.resolve())
    return _write(folder, replace(arm, urdf=urdf), arguments.urdf)


def _with_region(arm: SerialArm) -> SerialArm:
    """A planar arm with the region that gains are designed for; others as they are."""
    if len(arm.joints) == 2 and not any(arm.tip):
        # A URDF without a frame at its tip: the link ends twice as far as its centre of mass.
        x, y, z = (2.0 * arm.joints[1].link.center()).tolist()
        arm = replace(arm, tip=(x, y, z))
    if not is_planar(arm):
        return arm
    region = LpvRegion('upright', (0.3, 0.3), (0.7, 0.7), 0.0, 0.1)
    return replace(arm, lpv=region)


def _write(folder: Path, arm: SerialArm, source: str) -> int:
    """Check what the files say, write them, and say what comes next."""
    file, requirement, scenario = (folder / name for name in FILES)
    # Before the first file is there: half of them would block the next try.
    texts = {scenario: _scenario(arm, source)}
    if arm.lpv is not None:
        texts[requirement] = _filled(requirement.name, name=arm.name)
    folder.mkdir(parents=True, exist_ok=True)
    save_arm(arm, file)
    for path, text in texts.items():
        path.write_text(text, encoding='utf-8')
    print(f'written: {", ".join(map(str, (file, *texts)))}')
    print(f'joints: {", ".join(arm.joint_names)}')
    ends = [*(joint.position for joint in arm.joints[1:]), arm.tip]
    for joint, end in zip(arm.joints, ends):
        if joint.link.mass == 0.0 and any(end):  # those of ball joints have no length
            print(f'warning: the link of {joint.name} has no mass', file=sys.stderr)
        farthest = max(abs(joint.limits.lower), abs(joint.limits.upper))
        if _FARTHEST < farthest < math.inf:
            text = f'{joint.name} may go to {farthest:g} {joint.units[0]}: degrees, or mm?'
            print(f'warning: {text}', file=sys.stderr)
        if not joint.link.is_physical:
            print(f'warning: no body has the inertia of the link of {joint.name}', file=sys.stderr)
    try:
        integration_step(compile_chain(arm), arm.sample_time)
    except ConfigError as error:
        print(f'warning: before it is simulated: {error}', file=sys.stderr)
    if aligned := aligned_axes(arm):
        print(f'warning: {aligned}', file=sys.stderr)
    if arm.locked:
        print('held: ' + ', '.join(f'{joint} at {value:g}' for joint, value in arm.locked))
    print('next: a URDF knows no rotors and sensors; identify them from a recording of a motion')
    known: list[str | Path] = ['--arm', file]
    _show('excite', *known, '--out', folder / 'motion')
    _show('identify', 'recording_bag', *known, '--out', folder / 'identified.yaml')
    print('or simulate it as it is')
    if arm.lpv is not None:
        known += ['--requirement', requirement]
        _show('design', *known, '--out', folder / 'gains.yaml')
    _show('demo', *known, '--scenario', scenario)
    return 0


def _show(*words: str | Path) -> None:
    print('  lpv', shlex.join(map(str, words)))


def _scenario(arm: SerialArm, source: str) -> str:
    """A scenario as it is written, whose path the arm of the file can follow; ConfigError."""
    # JSON's quotes are YAML's: names may hold any character.
    sensor, written = json.dumps(arm.sensor_names[0], ensure_ascii=False), to_mapping(arm)
    own, tried = parse_arm(written, source), [*_waypoints(arm)]
    for lines in tried:
        text = _filled('scenario.yaml', name=arm.name, sensor=sensor, waypoints=lines)
        try:
            parse_scenario(yaml.safe_load(text)).path(own)
            break
        except ConfigError:
            if lines is tried[-1]:
                raise
    return text


def _waypoints(arm: SerialArm) -> Iterator[str]:
    """There and back as lines of YAML: in the region, or about a pose, ever less far."""
    if arm.lpv is not None:
        planar = planar_model(arm)
        # Kinematics counts q1 from the x-axis, angles of the links count from the upper vertical.
        up = math.pi / 2 if planar.sign > 0 else -math.pi / 2
        for far, near in _SIDES:
            ends = np.array([[up + side, 0.6] for side in (far, near, far)])
            yield '\n'.join(
                f'    - {{t: {time}, x: {x:.4f}, y: {y:.4f}}}'
                for time, (x, y) in zip((0.5, 6.0, 11.5), forward(ends, planar.lengths).tolist())
            )
    low, high = np.array([joint.range for joint in arm.joints]).T
    middle, sides = 0.5 * (low + high), np.array([0.0, 1.0, -1.0, 0.0])[:, None]
    # The middle of the ranges, or a pose nearby that asks for less of the drives.
    nearby = np.random.default_rng(0).uniform(-0.2, 0.2, (200, len(middle))) * (high - low)
    poses, times = middle + np.vstack([0.0 * middle, nearby]), (0.5, 4.0, 8.0, 11.5)
    weight = np.abs(SerialModel(compile_chain(arm)).gravity(poses)) / arm.torque_limit
    shares = weight.max(axis=1)
    pose = poses[0 if shares[0] < _HEAVY else int(shares.argmin())]
    # Slow joints, as lifts are, move no farther than the tracker's `max_speed` lets them.
    ways = np.minimum(0.2 * (high - low), _SLOW * np.array(arm.velocity_limit))
    for largest in _TURNS:
        places = pose + sides * np.minimum(ways, largest)
        yield '\n'.join(
            f'    - {{t: {time}, joints: [{", ".join(f"{place:.4f}" for place in row)}]}}'
            for time, row in zip(times, places)
        )


def _filled(template: str, **values: str) -> str:
    return Template((_TEMPLATES / template).read_text(encoding='utf-8')).substitute(values)
