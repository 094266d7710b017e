"""``lpv tune``: search the weights of a design by campaigns of runs."""

import argparse
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from lpv_campaign.execution.execute import software, worker_pool
from lpv_campaign.tune.picture import draw
from lpv_campaign.tune.result import conclude, write
from lpv_campaign.tune.search import Search
from lpv_campaign.tune.study_file import MOST_TRIALS, Study, load_study
from lpv_campaign.tune.trial import Bench
from lpv_cli.progress import counted
from lpv_core.support.config import sha256_of
from lpv_core.support.errors import ConfigError

EXIT_NOTHING = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('study', help='study file (YAML), see docs/tune.md')
    parser.add_argument(
        '--out',
        default=None,
        help='folder of the results (out/tune/NAME); where it holds a part of '
        'this study, the search is resumed',
    )
    parser.add_argument(
        '--trials',
        type=int,
        default=None,
        help='designs to try, in place of the number in the study file',
    )
    parser.add_argument(
        '--workers',
        type=int,
        default=None,
        help='processes on this machine; 0: this process only (default: one per core)',
    )
    parser.add_argument(
        '--scheduler',
        default=None,
        metavar='ADDRESS',
        help='Dask scheduler to use instead, e.g. tcp://127.0.0.1:8786',
    )


def run(arguments: argparse.Namespace) -> int:
    """Search, validate, write.

    Exit code: 0; 1 if no trial is certified and keeps all limits.
    """
    study = load_study(arguments.study)
    trials = study.trials if arguments.trials is None else arguments.trials
    if not 1 <= trials <= MOST_TRIALS:
        raise ConfigError('--trials', f'must lie within 1 and {MOST_TRIALS}, got {trials}')
    if arguments.workers is not None and not 0 <= arguments.workers <= 1024:
        raise ConfigError('--workers', f'must lie within 0 and 1024, got {arguments.workers}')
    folder = Path(arguments.out or Path('out') / 'tune' / Path(arguments.study).stem)
    console = Console(soft_wrap=True, highlight=False)
    with worker_pool(arguments.workers, arguments.scheduler) as execute:
        bench = Bench(study, execute)
        folder.mkdir(parents=True, exist_ok=True)
        search = Search(study, _key(study, bench), folder / 'study.db')
        _search(search, bench, trials, console)
        console.print('validating the picked trial on other runs ...')
        result = conclude(bench, search)
    files = write(bench, result, folder)
    draw(result, folder / 'study.png')
    _show(result, console)
    for path in (*files, folder / 'study.png'):
        console.print(f'written: {path}')
    return EXIT_NOTHING if result['picked'] is None else 0


def _key(study: Study, bench: Bench) -> str:
    """Trials may be more; everything else makes another study."""
    data = {
        name: value
        for name, value in study.data.items()
        if name not in ('trials', 'validation', 'tolerance')
    }
    return sha256_of([data, bench.key, bench.content({}), software()])


def _search(search: Search, bench: Bench, trials: int, console: Console) -> None:
    done = len(search.trials)
    if done:
        console.print(f'{done} trials are here already')
    with counted(console, bench.study.name, trials, done, _best(search.trials)) as advance:
        for _ in range(done, trials):
            search.step(bench)
            advance(note=_best(search.trials))


def _best(trials: list[dict[str, Any]]) -> str:
    costs = [trial['cost'] for trial in trials if trial['state'] == 'good']
    return f'lowest cost {min(costs):.3f}' if costs else 'nothing yet'


def _show(result: dict[str, Any], console: Console) -> None:
    states = [trial['state'] for trial in result['trials']]
    console.print(
        f'{len(states)} trials: {states.count("good")} good, '
        f'{states.count("beyond limits")} beyond the limits, '
        f'{states.count("infeasible")} without certified gains'
    )
    if result['picked'] is not None:
        values = result['trials'][result['picked']]['values']
        table = Table(title=f'searched values, trial {result["picked"]} picked')
        for name in ('field', 'before', 'picked'):
            table.add_column(name, justify='right')
        for name, value in values.items():
            table.add_row(name, f'{result["first"][name]:g}', f'{value:g}')
        console.print(table)
    if result['validation']:
        _show_validation(result['validation'], console)
    console.print(
        ('accepted: ' if result['accepted'] else 'nothing is changed: ') + result['verdict']
    )


def _show_validation(found: dict[str, Any], console: Console) -> None:
    table = Table(
        title=f'on {found["runs"]} other runs; intervals hold '
        f'{found["confidence"]:.0%} of {found["resamples"]} resamples'
    )
    for name in ('figure', 'before', 'picked', 'difference, from to'):
        table.add_column(name, justify='right', no_wrap=True)
    for name, entry in (('cost', found['cost']), *found['figures'].items()):
        table.add_row(
            name,
            f'{entry["first"]:.4g}',
            f'{entry["picked"]:.4g}',
            '{:+.3g} {:+.3g}'.format(*entry['interval']),
        )
    for name in ('healthy_score', 'false_alarms'):
        table.add_row(
            name.replace('_', ' '),
            *(f'{found[name][which]:.4g}' for which in ('first', 'picked')),
            '',
        )
    console.print(table)
