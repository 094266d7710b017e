"""``lpv report``: the report of a recorded run."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console

from lpv_cli.completion import completed, shipped
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('bag', help='rosbag2 directory or MCAP file')
    completed(
        parser.add_argument(
            '--arm',
            help='arm file, or name of a shipped arm; the one that the gains describe if not given',
        ),
        shipped('arms'),
    )
    parser.add_argument(
        '--gains', help='gains file that the run was answered with; the one in the bag if not given'
    )
    completed(
        parser.add_argument('--scenario', help='scenario whose path and obstacle are drawn'),
        shipped('scenarios'),
    )
    parser.add_argument('--out', default='out/report', help='folder for the report')


def run(arguments: argparse.Namespace) -> int:
    """Write the report and show its table."""
    from lpv_report.run import find_used_gains, print_table, write_report

    used = find_used_gains(arguments.bag, arguments.gains)
    arm = _arm(arguments, used)
    path = None
    if arguments.scenario:
        path = load_scenario(bringup_file('scenarios', arguments.scenario)).path(arm)
    result = write_report(
        arguments.bag,
        Path(arguments.out),
        arm,
        path,
        title=f'{Path(arguments.bag).name} on arm {arm.name}',
        used=used,
    )
    console = Console(soft_wrap=True, highlight=False)
    if result.table:
        print_table(result.table)
    console.print(_said(result.certificate, used))
    console.print(f'report  {result.html}')
    return 0


def _arm(arguments: argparse.Namespace, used: Any) -> ArmParameters:
    from lpv_report.run import arm_of

    if arguments.arm:
        arm = load_arm(bringup_file('arms', arguments.arm))
        if arguments.gains:
            used.gains.check_arm(arm, arguments.gains)
        return arm
    if used.gains is None:
        raise ConfigError('--arm', f'is needed: {used.problem}')
    return arm_of(used.gains)


def _said(certificate: Any, used: Any) -> str:
    if certificate is None:
        return f'gains   not known: {used.problem}'
    if certificate.holds:
        return f'gains   {used.source}: the certificate holds'
    why = certificate.problem or '; '.join(certificate.failed) or 'its margins were changed'
    return f'gains   {used.source}: the certificate does NOT hold: {why}'
