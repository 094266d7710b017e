"""The arm that ``lpv init``, ``identify`` and ``excite`` start from: a URDF, or an arm file."""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.serial_arm.urdf_text import read_urdf_text
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file

_MOVING = ('revolute', 'continuous', 'prismatic', 'planar', 'floating')


def chosen_arm(arguments: argparse.Namespace) -> SerialArm:
    """Arm of the arguments, with the friction that a URDF states."""
    if not arguments.urdf:
        return load_arm(bringup_file('arms', arguments.arm))
    root = ElementTree.fromstring(read_urdf_text(Path(arguments.urdf)).text)
    moving = {str(j.get('name')): j for j in root.findall('joint') if j.get('type') in _MOVING}
    locked = dict(_locked(text) for text in arguments.lock)
    joints = [name for text in arguments.joints or () for name in text.split(',') if name]
    tip = arguments.tip
    if tip is not None:
        if joints:
            raise ConfigError('--tip', 'and --joints say the same: give one of them')
        links = [str(link.get('name')) for link in root.iter('link')]
        if tip not in links:
            raise ConfigError('--tip', f'{tip!r} is no link of the URDF: {", ".join(links)}')
        joints = [name for name in _way_to(root, tip) if name in moving and name not in locked]
    kept = [name for name in moving if name not in locked and (not joints or name in joints)]
    _refuse_others(root, kept, moving, arguments.urdf)
    arm = read_urdf_chain(arguments.urdf, locked, None if tip else joints or None, tip)
    return _with_friction(arm, {name: joint.find('dynamics') for name, joint in moving.items()})


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


def _way_to(root: ElementTree.Element, tip: str) -> list[str]:
    """Names of the joints from the base to a link."""
    above = {_end(j, 'child'): j for j in root.findall('joint')}
    way: list[str] = []
    while tip in above and len(way) < len(above):
        way.insert(0, str(above[tip].get('name')))
        tip = _end(above[tip], 'parent')
    return way


def _end(joint: ElementTree.Element, side: str) -> str:
    element = joint.find(side)
    return '' if element is None else str(element.get('link'))


def _refuse_others(
    root: ElementTree.Element, kept: Sequence[str], moving: dict[str, Any], source: str
) -> None:
    """ConfigError that says how to leave out joints that no arm has, and fingers that slide."""
    ways = [_way_to(root, _end(moving[name], 'child')) for name in kept]
    is_chain = any(set(kept) <= set(way) for way in ways)
    usual = ('revolute', 'continuous', *(('prismatic',) if is_chain else ()))
    others = [name for name in kept if moving[name].get('type') not in usual]
    if others:
        turning = ','.join(name for name in kept if name not in others)
        kinds = ', '.join(f'{name!r} is {moving[name].get("type")}' for name in others)
        raise ConfigError(
            'joint',
            f'{kinds}: hold it with {" ".join(f"--lock {name}=0" for name in others)}, name the '
            f'joints of the arm with --joints {turning}, or its last link with --tip LINK',
            source,
        )


def _number(element: ElementTree.Element, key: str) -> float:
    text = element.get(key, '0')
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise ConfigError(f'dynamics.{key}', f'must be a number within [0, 1e6], got {text!r}')
    return value
