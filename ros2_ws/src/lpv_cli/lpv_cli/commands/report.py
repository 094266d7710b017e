"""``lpv report``: the report of a recorded run."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from lpv_core.monitoring.factory import refuse_gains
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file, shipped_files

if TYPE_CHECKING:  # drawing takes a second to import
    from lpv_report.guarantees.gains_source import UsedGains
    from lpv_report.run import ReportResult


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('bag', help='rosbag2 directory or MCAP file')
    parser.add_argument(
        '--arm',
        help='arm file, or name of a shipped arm; if not given, the one that the gains '
        'describe, or the shipped one that the recorded messages name',
    )
    parser.add_argument(
        '--gains', help='gains file that the run was answered with; the one in the bag if not given'
    )
    parser.add_argument(
        '--scenario',
        help='scenario whose path and obstacle are drawn; the one in the bag if not given',
    )
    parser.add_argument('--out', default='out/report', help='folder for the report')


def run(arguments: argparse.Namespace) -> int:
    """Write the report and show its table."""
    from lpv_report.run import (
        find_scenario,
        find_shipped_gains,
        find_used_gains,
        print_table,
        write_report,
    )

    used = find_used_gains(arguments.bag, arguments.gains)
    if used.gains is None and not arguments.arm:
        used = find_shipped_gains(arguments.bag)
    arm = _arm(arguments, used)
    scenario = find_scenario(arguments.bag)
    if arguments.scenario:
        scenario = load_scenario(bringup_file('scenarios', arguments.scenario))
    path = None
    if scenario is not None and not isinstance(arm, SerialArm):
        path = scenario.path(arm)
    result = write_report(
        arguments.bag,
        Path(arguments.out),
        arm,
        path,
        title=f'{Path(arguments.bag).name}, arm “{arm.name}”',
        used=used,
    )
    console = Console(soft_wrap=True, highlight=False)
    if result.table:
        print_table(result.table)
    if not isinstance(arm, SerialArm):
        console.print(_said(result, used))
    console.print(f'report  {result.html}')
    return 0


def _arm(arguments: argparse.Namespace, used: 'UsedGains') -> Arm:
    from lpv_report.run import arm_of, named_arm

    if arguments.arm:
        arm = load_any_arm(bringup_file('arms', arguments.arm))
        refuse_gains(arm, bool(arguments.gains))
        if arguments.gains and used.gains and not isinstance(arm, SerialArm):
            used.gains.check_arm(arm, arguments.gains)
        return arm
    shipped = shipped_files('arms').get(named_arm(arguments.bag))
    if used.gains is None and shipped is not None:
        arm = load_any_arm(shipped)
        if isinstance(arm, SerialArm):
            return arm
    if used.gains is None:
        raise ConfigError('--arm', f'is needed: {used.problem}')
    return arm_of(used.gains)


def _said(result: 'ReportResult', used: 'UsedGains') -> str:
    certificate, again = result.certificate, result.reproduction
    if certificate is None:
        return f'gains   not known: {used.problem}'
    if certificate.holds:
        but = ''
        if again is not None and not again.same:
            but = (
                f'; whether the run had them is not known: run again, the fault estimates differ '
                f'by up to {again.largest:.2g} rad (see the report)'
            )
        return f'gains   {used.source}: the certificate holds{but}'
    why = certificate.problem or '; '.join(certificate.failed) or 'its margins were changed'
    return f'gains   {used.source}: the certificate does NOT hold: {why}'
