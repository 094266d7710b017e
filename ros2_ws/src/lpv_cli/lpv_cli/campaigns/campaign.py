"""``lpv campaign``: the statistics of thousands of closed-loop runs."""

import argparse
from pathlib import Path

import pyarrow as pa
from rich.console import Console

from lpv_campaign.execution.execute import execute
from lpv_campaign.execution.store import CampaignFolder
from lpv_campaign.plan.campaign import Campaign
from lpv_cli.campaigns import fleet
from lpv_cli.campaigns.campaign_files import open_file, open_folder
from lpv_cli.campaigns.campaign_run import run_to_bag
from lpv_cli.progress import counted
from lpv_core.support.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'spec',
        nargs='?',
        help='campaign file (YAML) or name of a shipped one; '
        'or a folder of results: its report is written again, or with --run one '
        'of its runs as a bag',
    )
    parser.add_argument(
        '--out',
        default=None,
        help='folder of the results (out/campaign/NAME); where it holds a part '
        'of this campaign, the rest is run',
    )
    parser.add_argument(
        '--workers',
        type=int,
        default=None,
        help='processes on this machine; 0: this process only (default: one per core)',
    )
    parser.add_argument(
        '--no-report', action='store_true', help='put the results together, and write no report'
    )
    parser.add_argument(
        '--scheduler',
        default=None,
        metavar='ADDRESS',
        help='Dask scheduler to use instead, e.g. tcp://127.0.0.1:8786',
    )
    parser.add_argument(
        '--run',
        type=int,
        dest='number',
        metavar='N',
        help='do this run again, and write it as the bag that --bag names',
    )
    parser.add_argument('--bag', metavar='FOLDER', help='bag of the run to write')
    fleet.add_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run what is missing, and put the results together.

    Exit code: 0; 3 if a bag of an archive could not be read.
    """
    _check_workers(arguments)
    if arguments.bags is not None:
        return _replay_archive(arguments)
    if arguments.number is not None or arguments.bag is not None:
        return run_to_bag(arguments)
    if arguments.spec is None:
        raise ConfigError('spec', 'is missing: name a campaign file')
    console = Console(soft_wrap=True)
    if Path(arguments.spec).is_dir():
        return _report_again(arguments, console)
    campaign, folder = open_file(arguments.spec, arguments.out)
    if folder.holds_another(campaign):
        raise ConfigError(
            '--out',
            'holds results of another campaign (file, arm or scenario '
            'changed): take another folder, or remove it',
            str(folder.path),
        )
    finished = folder.finished()
    numbers = [n for n in range(campaign.spec.runs) if n not in finished]
    if finished:
        console.print(f'{len(finished)} of {campaign.spec.runs} runs are here already')
    if numbers:
        folder.begin(campaign)
        _run(arguments, campaign, folder, numbers, console)
    table = folder.finish()
    console.print(f'results: {folder.runs_file}')
    if not arguments.no_report:
        _report(campaign, folder, table, console)
    return 0


def _report(campaign: Campaign, folder: CampaignFolder, table: pa.Table, console: Console) -> None:
    # Only here: runs must not wait for plotting.
    from lpv_campaign.report import print_summary, write_report

    report = write_report(campaign, table, folder.path)
    print_summary(report.numbers, console)
    console.print(f'report: {report.html}')


def _report_again(arguments: argparse.Namespace, console: Console) -> int:
    """Report of what is in a folder, whether it is all or not."""
    if arguments.out is not None:
        raise ConfigError('--out', 'goes with a campaign file, not with a folder of results')
    campaign, folder = open_folder(arguments.spec)
    table = folder.table()
    missing = campaign.spec.runs - table.num_rows
    if missing > 0:
        console.print(
            f'{missing} of {campaign.spec.runs} runs are missing: the same campaign file '
            f'with --out {folder.path} runs them'
        )
    _report(campaign, folder, table, console)
    return 0


def _check_workers(arguments: argparse.Namespace) -> None:
    if arguments.workers is not None and not 0 <= arguments.workers <= 1024:
        raise ConfigError('--workers', f'must lie within 0 and 1024, got {arguments.workers}')


def _replay_archive(arguments: argparse.Namespace) -> int:
    if arguments.spec is not None or arguments.number is not None or arguments.bag is not None:
        raise ConfigError('--bags', 'goes without a campaign file, --run and --bag')
    return fleet.replay_archive(arguments)


def _run(
    arguments: argparse.Namespace,
    campaign: Campaign,
    folder: CampaignFolder,
    numbers: list[int],
    console: Console,
) -> None:
    total = campaign.spec.runs
    with counted(console, campaign.spec.name, total, total - len(numbers)) as advance:
        for rows in execute(campaign, numbers, arguments.workers, arguments.scheduler):
            folder.add(campaign, rows)
            advance(len(rows))
