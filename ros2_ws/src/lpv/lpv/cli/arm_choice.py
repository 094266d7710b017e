"""The arm that ``lpv init``, ``identify`` and ``excite`` start from: a URDF, or an arm file."""

import argparse
import math

from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.errors import ConfigError


def chosen_arm(arguments: argparse.Namespace) -> SerialArm:
    """Arm of the arguments."""
    if not arguments.urdf:
        return arguments.arm
    locked = dict(_locked(text) for text in arguments.lock)
    joints = [name for text in arguments.joints or () for name in text.split(',') if name]
    if arguments.tip is not None and joints:
        raise ConfigError('--tip', 'and --joints say the same: give one of them')
    return read_urdf_chain(arguments.urdf, locked, joints or None, arguments.tip)


def _locked(text: str) -> tuple[str, float]:
    name, _, value = text.partition('=')
    try:
        position = float(value or 0.0)
    except ValueError:
        position = math.nan
    if not math.isfinite(position):
        raise ConfigError('--lock', f'{value!r} is not a number')
    return name, position
