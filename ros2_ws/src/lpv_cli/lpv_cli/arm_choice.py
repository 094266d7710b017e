"""The arm that ``lpv identify`` and ``lpv excite`` start from: a URDF, or an arm file."""

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lpv_core.serial_arm.description import SerialArm


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the choice."""
    arm = parser.add_mutually_exclusive_group(required=True)
    arm.add_argument('--urdf', help='URDF of the arm (xacro expanded)')
    arm.add_argument('--arm', help='arm file, of n joints or of two links')
    parser.add_argument(
        '--joints',
        nargs='+',
        metavar='JOINT',
        help='joints of the arm; all others of the URDF are locked',
    )
    parser.add_argument(
        '--tip',
        metavar='LINK',
        help='link at the end of the arm, if the URDF has several branches; joints that do not '
        'lead to it are locked',
    )


def chosen_arm(
    arguments: argparse.Namespace, locked: Mapping[str, float] | None = None
) -> 'SerialArm':
    """Arm of the arguments; joints of the URDF can be locked at an angle [rad]."""
    from lpv_core.serial_arm.urdf_chain import read_urdf_chain
    from lpv_identify.results.starting_arm import load_any_arm

    if arguments.urdf:
        return read_urdf_chain(arguments.urdf, locked, arguments.joints, arguments.tip)
    return load_any_arm(arguments.arm)
