"""``lpv campaign DIR --run N --bag FOLDER``: one run again, as a bag."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.execution.run_to_bag import differences, write_run_bag
from lpv_campaign.execution.runs import RunPlan, plan_run
from lpv_campaign.execution.store import CampaignFolder
from lpv_cli.campaigns.campaign_files import open_file, open_folder
from lpv_core.support.errors import ConfigError, LpvError


def run_to_bag(arguments: argparse.Namespace) -> int:
    """Simulate a run again, compare its figures with the results, write its bag."""
    if arguments.spec is None:
        raise ConfigError('spec', 'is missing: name the results folder of a campaign, or its file')
    if arguments.number is None or arguments.bag is None:
        raise ConfigError(
            '--run', 'and --bag must be given together: which run, and the bag to write'
        )
    console = Console(soft_wrap=True, highlight=False)
    if Path(arguments.spec).is_dir():
        campaign, folder = open_folder(arguments.spec)
    else:
        campaign, folder = open_file(arguments.spec, arguments.out)
    if not 0 <= arguments.number < campaign.spec.runs:
        raise ConfigError(
            '--run', f'must lie within 0 and {campaign.spec.runs - 1}, got {arguments.number}'
        )
    plan = plan_run(campaign, arguments.number)
    if not isinstance(plan, RunPlan):
        raise ConfigError('--bag', 'is written of runs of two-link arms, not of serial ones')
    run = plan.simulate()
    twin = plan.simulate(faults=False) if campaign.spec.twin and plan.scenario.faults else None
    found = figures(plan, run, twin)
    stored = None if folder.holds_another(campaign) else stored_row(folder, arguments.number)
    console.print(_table(arguments.number, stored, found))
    if stored is not None:
        wrong = differences(stored, {**plan.values, **found})
        if wrong:
            raise LpvError(
                f'{folder.path}: run {arguments.number} gives another '
                + ', '.join(wrong)
                + ' now; the results are of another version of '
                'this software'
            )
    write_run_bag(plan, run, arguments.bag)
    _hints(Path(arguments.bag), plan, console)
    return 0


def stored_row(folder: CampaignFolder, number: int) -> dict[str, Any] | None:
    """Row of a run in the results."""
    if number not in folder.finished():
        return None
    table = folder.table()
    return table.slice(table['number'].index(number).as_py(), 1).to_pylist()[0]


def _table(number: int, stored: dict[str, Any] | None, found: dict[str, Any]) -> Table:
    table = Table(title=f'run {number}', title_justify='left')
    table.add_column('figure')
    table.add_column('results', justify='right')
    table.add_column('now', justify='right')
    for name, value in found.items():
        if not isinstance(value, list):
            there = '-' if stored is None else _text(stored.get(name))
            table.add_row(name, there, _text(value))
    return table


def _text(value: Any) -> str:
    if value is None or value != value:
        return '-'
    return f'{value:.6g}' if isinstance(value, float) else str(value)


def _hints(bag: Path, plan: RunPlan, console: Console) -> None:
    files = f'--arm {bag}/arm.yaml'
    console.print(f'bag     {bag}')
    console.print(f'report  lpv report {bag} {files} --scenario {bag}/scenario.yaml')
    console.print(
        f'replay  lpv replay {bag} {files} --gains {bag}/gains.yaml --parameters '
        f'{bag}/parameters.yaml'
    )
    if plan.delay or plan.loss:
        console.print(
            'The graph does not repeat this run: it has neither delayed commands nor lost samples.'
        )
    else:
        console.print(
            f'The nodes repeat this run with the files in {bag}; parameters.yaml is for '
            'all of them.'
        )
