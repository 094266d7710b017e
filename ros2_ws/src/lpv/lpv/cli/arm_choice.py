"""The arm that ``lpv init``, ``identify`` and ``excite`` start from: a URDF, or an arm file."""

import argparse
import math
from typing import Any

from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.errors import ConfigError


def chosen_arm(arguments: argparse.Namespace) -> Any:
    """`SerialArm` of the arguments; None where they name none, as they need not for init."""
    if not arguments.urdf:
        for option in ('joints', 'lock', 'tip'):
            if getattr(arguments, option):
                raise ConfigError(f'--{option}', 'is for joints of a URDF: give --urdf')
        return getattr(arguments, 'arm', None)
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
