"""``lpv design``: that of lpv_design, and a map of what is detected."""

import argparse
from typing import TYPE_CHECKING

from lpv_cli.progress import wrapped
from lpv_design import main as design

if TYPE_CHECKING:
    from lpv_core.uio.model.arm import ArmParameters
    from lpv_design.guarantee import Guarantee


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    design.add_arguments(parser)
    parser.add_argument(
        '--map',
        metavar='MAP.png',
        help='picture to write: smallest fault that is always detected, over the region',
    )


def run(arguments: argparse.Namespace) -> int:
    """Design, report, write."""

    def draw(found: 'Guarantee', arm: 'ArmParameters') -> None:
        # Only here: a design without a picture need not wait for plotting.
        from lpv_report.figures import draw_region

        draw_region(found, arm, arguments.map)
        print(f'map written to {arguments.map}')

    with wrapped():
        return design.run(arguments, draw if arguments.map else None)
