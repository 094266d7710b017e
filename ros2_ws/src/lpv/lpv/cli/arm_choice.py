"""The arm that ``lpv init``, ``identify`` and ``excite`` start from: a URDF, or an arm file."""

import argparse
import contextlib
import math
from collections.abc import Sequence
from typing import Any

from lpv.cli.options import refuse
from lpv.core.serial_arm.arm_file import check_inertia
from lpv.core.serial_arm.urdf_chain import read_urdf_ends
from lpv.core.support.errors import ConfigError


def chosen_arm(arguments: argparse.Namespace) -> Any:
    """`SerialArm` of the arguments; None where they name none, as they need not for init."""
    if not arguments.urdf:
        refuse(arguments, ('joints', 'lock', 'tip'), 'is for joints of a URDF: give --urdf')
        return getattr(arguments, 'arm', None)
    locked = {}
    for text in _separated(arguments.lock):
        name, _, value = text.partition('=')
        locked[name] = math.nan
        with contextlib.suppress(ValueError):
            locked[name] = float(value or 0.0)
        if not math.isfinite(locked[name]):
            raise ConfigError('--lock', f'{value!r} is not a number')
    joints = [name for name in _separated(arguments.joints) if name]
    if arguments.tip is not None and joints:
        raise ConfigError('--tip', 'and --joints say the same: give one of them')
    arm, (end, *others) = read_urdf_ends(arguments.urdf, locked, joints or None, arguments.tip)
    check_inertia(arm, arguments.urdf)
    if others and not arguments.tip:
        print(f'tip: {end}, where loads sit; --tip names another: {", ".join(others)}')
    return arm


def _separated(texts: Sequence[str] | None) -> list[str]:
    """What was given with spaces or commas between."""
    return [one for text in texts or () for one in text.split(',')]
