"""``lpv report``: the report of a recorded run."""

import argparse
from pathlib import Path

from rich.console import Console

from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import bringup_file
from lpv.report.certificate import find_arm_and_gains
from lpv.report.history import load
from lpv.report.run import write
from lpv.report.table import print_table


def run(arguments: argparse.Namespace) -> int:
    """Write the report and show its table."""
    arm, gains, source = find_arm_and_gains(arguments.bag, arguments.arm, arguments.gains)
    path = None
    if arguments.scenario:
        path = load_scenario(bringup_file('scenarios', arguments.scenario)).path(arm)
    title = f'{Path(arguments.bag).name}, arm “{arm.name}”'
    found = load(arguments.bag, arm, path, title, gains, source, arguments.topic)
    proof = found.certificate
    if arguments.gains and proof.problem:
        raise ConfigError('--gains', proof.problem)
    page = write(found, arguments.out)
    print_table(found.table)
    if proof.problem:
        said = f'certificate not known: {proof.problem}'
    else:
        said = 'holds' if proof.holds else f'does NOT hold: {"; ".join(proof.failed)}'
        said = f'{source}: the certificate {said}'
    Console(soft_wrap=True, highlight=False, markup=False).print(f'gains   {said}\nreport  {page}')
    return 0
