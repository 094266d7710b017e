"""``lpv urdf``: the arm of an arm file as a URDF."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('--arm', default='paper', help='shipped arm or arm file (paper)')
    parser.add_argument('--out', help='file to write instead of the terminal')


def run(arguments: argparse.Namespace) -> int:
    """Print or write the URDF."""
    from lpv_core.export.urdf import arm_urdf
    from lpv_core.serial_arm.arm_file import load_arm
    from lpv_core.support.resources import bringup_file

    text = arm_urdf(load_arm(bringup_file('arms', arguments.arm)))
    if arguments.out:
        Path(arguments.out).write_text(text, encoding='utf-8')
    else:
        print(text, end='')
    return 0
