"""``lpv campaign --bags DIR``: an archive of bags replayed, and the statistics of the fleet."""

import argparse
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

from lpv_campaign.fleet.archive import FleetSettings, watch_fleet
from lpv_campaign.fleet.find import FoundBag, find_bags
from lpv_campaign.fleet.statistics import FleetStatistics, fleet_statistics
from lpv_campaign.fleet.store import FleetFolder
from lpv_cli.progress import counted
from lpv_cli.replaying.observing import (
    add_diagnosis,
    add_reading,
    arm_and_gains,
    diagnosis_parameters,
    reading_options,
)
from lpv_core.certificate.conditions import require
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import ConfigError

FAILED = 3
"""Exit code where a bag could not be read."""
_TOGETHER, _EVERY = 50, 2.0
"""Rows that are written at once, and how long one waits for others [s]."""
_SHOWN = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``--bags``."""
    group = parser.add_argument_group('archives of bags')
    group.add_argument(
        '--bags',
        metavar='DIR',
        help='replay every rosbag2 bag below this folder '
        'in place of simulations, see docs/fleet.md; results that --out holds '
        'already are kept, and code 3 says that a bag could not be read',
    )
    group.add_argument(
        '--healthy',
        action='store_true',
        help='with --bags: the arms were healthy, all alarms are false',
    )
    add_diagnosis(group)
    add_reading(group)


def replay_archive(arguments: argparse.Namespace) -> int:
    """Replay what has not been replayed, show and write the statistics."""
    console = Console(soft_wrap=True, highlight=False)
    root = Path(arguments.bags)
    folder = FleetFolder(arguments.out or Path('out') / 'fleet' / (root.resolve().name or 'root'))
    bags = find_bags(root, [folder.path])
    if not bags:
        raise ConfigError('--bags', 'holds no rosbag2 bag', str(root))
    settings = _settings(arguments, console)
    folder.begin(settings)
    there = folder.rows(bags)
    done = {
        name
        for name, error in zip(there['bag'].to_pylist(), there['error'].to_pylist())
        if not error
    }
    if done:
        console.print(f'{len(done)} of {len(bags)} bags are replayed already')
    left = [bag for bag in bags if bag.name not in done]
    if left:
        _replay(arguments, settings, root, left, folder, console, len(bags))
    table = folder.finish(folder.rows(bags))
    statistics = fleet_statistics(table, settings.arm.sensor_names, arguments.healthy)
    _show(statistics, settings.arm, arguments.healthy, console)
    report = folder.path / 'report.html'
    _write_report(report, statistics, settings.arm, root, folder, arguments.healthy)
    console.print(f'rows    {folder.whole_file}\nreport  {report}')
    return FAILED if statistics.failed else 0


def _settings(arguments: argparse.Namespace, console: Console) -> FleetSettings:
    arm, gains = arm_and_gains(arguments, console)
    if gains is None or isinstance(arm, SerialArm):
        raise ConfigError('--arm', f'{arm.name!r} is a serial arm: lpv replay takes its bags')
    require(arm, gains, arguments.gains or 'gains')
    diagnosis, others = diagnosis_parameters(arguments.parameters)
    return FleetSettings(arm, gains, diagnosis, options=reading_options(arguments), **others)


def _replay(
    arguments: argparse.Namespace,
    settings: FleetSettings,
    root: Path,
    bags: list[FoundBag],
    folder: FleetFolder,
    console: Console,
    total: int,
) -> None:
    waiting, since = [], time.monotonic()
    with counted(console, 'bags', total, total - len(bags)) as advance:
        try:
            for rows in watch_fleet(settings, root, bags, arguments.workers, arguments.scheduler):
                waiting += rows
                advance(len(rows))
                if len(waiting) >= _TOGETHER or time.monotonic() - since > _EVERY:
                    folder.add(waiting)
                    waiting, since = [], time.monotonic()
        finally:
            # Also of what was stopped: nothing is done twice.
            if waiting:
                folder.add(waiting)


def _show(statistics: FleetStatistics, arm: ArmParameters, healthy: bool, console: Console) -> None:
    # Plotting is imported only when everything is done.
    from lpv_campaign.fleet.report import number, rates, truth_text

    table = Table(
        title=f'{statistics.bags} bags, {statistics.failed} could not be read, '
        f'{statistics.hours:.3g} h under observation',
        title_justify='left',
    )
    table.add_column('alarms')
    for name in ('number', 'hours', 'per hour', '95 % interval'):
        table.add_column(name, justify='right')
    for name, rate in rates(statistics):
        table.add_row(
            name,
            str(rate.count),
            number(rate.hours),
            number(rate.value),
            f'{number(rate.low)} to {number(rate.high)}',
        )
    console.print(table)
    console.print(truth_text(statistics, healthy))
    suspects = Table(title='most suspicious', title_justify='left')
    for name in ('bag', 'arm', 'alarms', 'largest estimate / threshold', 'inconsistent [s]'):
        suspects.add_column(name)
    for row in statistics.ranking[:_SHOWN]:
        alarms = ', '.join(f'{a["count"]} {a["kind"]} of {a["sensor"]}' for a in row['alarm_list'])
        suspects.add_row(
            row['bag'],
            row['unit'] or '-',
            alarms or 'none',
            f'{row["score_1"]:.2f}, {row["score_2"]:.2f}',
            f'{row["inconsistent_time"]:.2f}',
        )
    if statistics.ranking:
        console.print(suspects)
    for trend in statistics.trends:
        if trend.significant:
            console.print(
                f'trend   {trend.unit or "-"}, {arm.sensor_names[trend.sensor]}: '
                f'{trend.slope:+.2e} rad per day over {trend.days[-1]:.3g} days, reaches '
                f'its threshold in {number(trend.days_left)} days'
            )
    for row in statistics.failures[:_SHOWN]:
        console.print(f'failed  {row["bag"]}: {row["error"]}', markup=False)


def _write_report(
    path: Path,
    statistics: FleetStatistics,
    arm: ArmParameters,
    root: Path,
    folder: FleetFolder,
    healthy: bool,
) -> None:
    from lpv_campaign.fleet.report import write_fleet_report

    write_fleet_report(
        path, statistics, arm, f'Bags of {root.resolve().name}', folder.whole_file.name, healthy
    )
