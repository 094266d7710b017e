"""``lpv report``: the report of a recorded run."""

import argparse

from rich.console import Console

from lpv.core.support.errors import ConfigError
from lpv.report.history import load
from lpv.report.run import write
from lpv.report.table import print_table


def run(arguments: argparse.Namespace) -> int:
    """Write the report and show its table."""
    given = vars(arguments)
    options = {name: given[name] for name in ('arm', 'scenario', 'gains', 'topic')}
    found = load(arguments.bag, **options)
    proof = found.certificate
    if arguments.gains and proof.problem:
        raise ConfigError('--gains', proof.problem)
    page = write(found, arguments.out)
    print_table(found.table)
    if proof.problem:
        said = f'certificate not known: {proof.problem}'
    else:
        said = 'holds' if proof.holds else f'does NOT hold: {"; ".join(proof.failed)}'
        said = f'{dict(proof.facts)["gains file"]}: the certificate {said}'
    Console(soft_wrap=True, highlight=False, markup=False).print(f'gains   {said}\nreport  {page}')
    return 0
