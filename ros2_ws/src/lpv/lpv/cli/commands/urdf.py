"""``lpv urdf``: the arm of an arm file as a URDF."""

import argparse
from pathlib import Path

from lpv.core.export.urdf import arm_urdf
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.support.resources import bringup_file


def run(arguments: argparse.Namespace) -> int:
    """Print or write the URDF."""
    text = arm_urdf(load_arm(bringup_file('arms', arguments.arm)))
    if arguments.out:
        Path(arguments.out).write_text(text, encoding='utf-8')
    else:
        print(text, end='')
    return 0
