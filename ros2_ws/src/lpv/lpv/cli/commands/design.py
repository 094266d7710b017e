"""``lpv design``: that of lpv_design, and a map of what is detected."""

import argparse
from typing import TYPE_CHECKING

from lpv.cli.progress import wrapped
from lpv_design import main as design

if TYPE_CHECKING:
    from lpv.core.uio.model.arm import ArmParameters
    from lpv_design.guarantee import Guarantee


def run(arguments: argparse.Namespace) -> int:
    """Design, report, write."""

    def draw(found: 'Guarantee', arm: 'ArmParameters') -> None:
        from lpv.report.figures import draw_region  # a design without a picture does not wait

        draw_region(found, arm, arguments.map)
        print(f'map written to {arguments.map}')

    with wrapped():
        return design.run(arguments, draw if arguments.map else None)
