"""``lpv report``: the report of a recorded run."""

from pathlib import Path

from rich.console import Console

from lpv_core.arm import load_arm
from lpv_core.resources import bringup_file
from lpv_core.scenario import load_scenario


def add_arguments(parser):
    """Declare the command's arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument('bag', help='rosbag2 directory or MCAP file')
    parser.add_argument('--arm', required=True, help='arm file, or name of a shipped arm')
    parser.add_argument('--scenario', help='scenario whose path and obstacle are drawn')
    parser.add_argument('--out', default='out/report', help='folder for the report')


def run(arguments):
    """Write the report and show its table.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add_arguments`.

    Returns
    -------
    int
        0.
    """
    from lpv_cli.report import print_table, write_report

    arm = load_arm(bringup_file('arms', arguments.arm))
    path = None
    if arguments.scenario:
        path = load_scenario(bringup_file('scenarios', arguments.scenario)).path(arm)
    result = write_report(arguments.bag, Path(arguments.out), arm, path,
                          title=f'{Path(arguments.bag).name} on arm {arm.name}')
    if result.table:
        print_table(result.table)
    Console(soft_wrap=True).print(f'report  {result.html}', highlight=False)
    return 0
