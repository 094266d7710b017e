"""``lpv design``: that of lpv_design, with the map in the look of the reports."""

import argparse

from lpv_design import main as design


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    design.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Design, report, write."""
    if not arguments.map:
        return design.run(arguments)
    # Only here: a design without a picture need not wait for plotting.
    from lpv_report.guarantees.region_figure import draw_region

    return design.run(arguments, draw_region)
