"""``lpv campaign``: the statistics of thousands of closed-loop runs."""

import argparse
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console

from lpv.campaign.execution.execute import ResultsFolder, chunks_of, worker_pool
from lpv.campaign.execution.runs import repeat
from lpv.campaign.plan.campaign import Campaign, load_campaign
from lpv.cli.progress import bar
from lpv.core.simulation.transport import Transport
from lpv.core.support.errors import ConfigError, LpvError
from lpv.report.table import print_grid


def run(arguments: argparse.Namespace) -> int:
    """Run what is missing, and put the results together."""
    console = Console(soft_wrap=True, highlight=False, markup=False)
    is_folder = Path(arguments.campaign).is_dir()
    campaign, folder = _open(arguments)
    if arguments.run is not None or arguments.bag is not None:
        return _run_to_bag(arguments, campaign, folder, console)
    if is_folder and arguments.out is not None:
        raise ConfigError('--out', 'goes with a campaign file, not with a folder of results')
    chunks = chunks_of(campaign)
    if not is_folder:
        execute(arguments, campaign, folder, chunks, campaign.spec.name, console)
    table = folder.rows(chunks)
    missing = campaign.spec.runs - table.num_rows
    if missing:
        remedy = f'the same campaign file with --out {folder.path} runs them'
        console.print(f'{missing} of {campaign.spec.runs} runs are missing: {remedy}')
    else:
        folder.finish(table)
        console.print(f'results: {folder.file}')
    if not arguments.no_report:
        # Only here: runs must not wait for plotting.
        from lpv.campaign.report.write import print_summary, write_report

        numbers = write_report(campaign, table, folder.path, campaign.spec.runs)
        print_summary(numbers, console)
        console.print(f'report: {folder.path / "report.html"}')
    return 0


def _open(arguments: argparse.Namespace) -> tuple[Campaign, ResultsFolder]:
    """Campaign and its results, with the gains that were used if it has begun already."""
    path = Path(arguments.campaign)
    if path.is_dir():
        folder = ResultsFolder(path)
        begun = folder.load()
        if not isinstance(begun, Campaign):
            raise ConfigError('spec', 'holds no results of a campaign', str(path))
        return begun, folder
    path, campaign = load_campaign(arguments.campaign)
    folder = ResultsFolder(arguments.out or Path('out') / 'campaign' / path.stem)
    begun = folder.load()
    same = isinstance(begun, Campaign) and begun.key == campaign.key
    return (begun if same else campaign), folder  # type: ignore[return-value]


def execute(
    arguments: argparse.Namespace,
    work: Any,
    folder: ResultsFolder,
    chunks: dict[str, list[Any]],
    name: str,
    console: Console,
) -> list[dict[str, Any]]:
    """Do what is missing of a campaign of runs or bags; rows of bags that could not be read."""
    folder.begin(work)
    missing = folder.missing(chunks)
    total, left = (sum(map(len, part.values())) for part in (chunks, missing))
    if left < total:
        console.print(f'{total - left} of {total} are here already')
    failed: list[dict[str, Any]] = []
    if not left:
        return failed
    with (
        worker_pool(arguments.workers, arguments.scheduler) as do,
        bar(console, name, total, total - left) as show,
    ):
        for chunk, rows in do(work, missing):
            if any(row.get('error') for row in rows):
                failed += rows
            else:
                folder.add(chunk, rows)
            left -= len(rows)
            show(total - left)
    return failed


def _run_to_bag(
    arguments: argparse.Namespace, campaign: Campaign, folder: ResultsFolder, console: Console
) -> int:
    """Simulate a run again, compare its figures with the results, write its bag."""
    from lpv.campaign.execution.run_to_bag import differences, write_run_bag

    number, runs = arguments.run, campaign.spec.runs
    if number is None or arguments.bag is None:
        reason = 'and --bag must be given together: which run, and the bag to write'
        raise ConfigError('--run', reason)
    if not 0 <= number < runs:
        raise ConfigError('--run', f'must lie within 0 and {runs - 1}, got {number}')
    plan, run, found = repeat(campaign, number)
    stored = _stored_row(campaign, folder, number)
    rows = [(name, _text((stored or {}).get(name)), _text(value)) for name, value in found.items()]
    print_grid(console, ('figure', 'results', 'now'), rows, f'run {number}')
    wrong = [] if stored is None else differences(stored, found)
    if wrong:
        why = 'the results are of another version of this software'
        raise LpvError(f'{folder.path}: run {number} gives another {", ".join(wrong)} now; {why}')
    write_run_bag(plan, run, arguments.bag)
    bag = shlex.quote(str(arguments.bag))
    files = f'{bag} --arm {bag}/arm.yaml'
    gains = f' --gains {bag}/gains.yaml' if plan.gains is not None else ''
    console.print(
        f'bag     {arguments.bag}\nreport  lpv report {files} --scenario {bag}/scenario.yaml'
    )
    console.print(f'replay  lpv replay {files}{gains} --parameters {bag}/parameters.yaml')
    if plan.transport != Transport():
        why = 'it has neither delayed commands nor lost samples'
        console.print(f'The graph does not repeat this run: {why}.')
    return 0


def _stored_row(campaign: Campaign, folder: ResultsFolder, number: int) -> dict[str, Any] | None:
    begun = folder.load()
    chunk = {name: runs for name, runs in chunks_of(campaign).items() if number in runs}
    if begun is None or begun.key != campaign.key or folder.missing(chunk):
        return None
    return next(row for row in folder.rows(chunk).to_pylist() if row['number'] == number)


def _text(value: Any) -> str:
    if value is None or value != value:
        return '-'
    return f'{value:.6g}' if isinstance(value, float) else str(value)
