"""The arm that ``lpv init``, ``identify`` and ``excite`` start from: a URDF, or an arm file."""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.serial_arm.urdf_text import read_urdf_text
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file


def chosen_arm(arguments: argparse.Namespace) -> SerialArm:
    """Arm of the arguments, with the friction that a URDF states."""
    if not arguments.urdf:
        return load_arm(bringup_file('arms', arguments.arm))
    locked = dict(_locked(text) for text in arguments.lock)
    joints = [name for text in arguments.joints or () for name in text.split(',') if name]
    if arguments.tip is not None and joints:
        raise ConfigError('--tip', 'and --joints say the same: give one of them')
    arm = read_urdf_chain(arguments.urdf, locked, joints or None, arguments.tip)
    root = ElementTree.fromstring(read_urdf_text(Path(arguments.urdf)).text)
    return _with_friction(
        arm, {str(joint.get('name')): joint.find('dynamics') for joint in root.findall('joint')}
    )


def _with_friction(arm: SerialArm, found: dict[str, ElementTree.Element | None]) -> SerialArm:
    """The arm with the friction of ``<dynamics>`` of its joints."""
    joints = []
    for joint in arm.joints:
        dynamics = found.get(joint.name)
        if dynamics is not None:
            viscous, coulomb = (_number(dynamics, key) for key in ('damping', 'friction'))
            friction = replace(joint.friction, viscous=viscous, coulomb=coulomb)
            joint = replace(joint, friction=friction)
        joints.append(joint)
    return replace(arm, joints=tuple(joints))


def _locked(text: str) -> tuple[str, float]:
    name, _, value = text.partition('=')
    try:
        position = float(value or 0.0)
    except ValueError:
        position = math.nan
    if not math.isfinite(position):
        raise ConfigError('--lock', f'{value!r} is not a number')
    return name, position


def _number(element: ElementTree.Element, key: str) -> float:
    text = element.get(key, '0')
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise ConfigError(f'dynamics.{key}', f'must be a number within [0, 1e6], got {text!r}')
    return value
