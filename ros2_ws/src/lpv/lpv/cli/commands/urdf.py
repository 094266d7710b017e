"""``lpv urdf``: the arm of an arm file as a URDF."""

import argparse
from pathlib import Path

from lpv.core.export.urdf import arm_urdf


def run(arguments: argparse.Namespace) -> int:
    """Print or write the URDF."""
    text = arm_urdf(arguments.arm)
    if arguments.out:
        Path(arguments.out).write_text(text, encoding='utf-8')
    else:
        print(text, end='')
    return 0
