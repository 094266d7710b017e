"""``lpv replay``: observer and diagnosis offline on a recorded bag."""

import shutil
from pathlib import Path

import numpy as np
from rich.console import Console

from lpv_bag.replay import Replay
from lpv_core.arm import load_arm
from lpv_core.config import Section, read_yaml
from lpv_core.errors import ConfigError
from lpv_core.faults import FaultInjector
from lpv_core.gains import load_gains, save_gains
from lpv_core.monitor import SensorMonitor, describe
from lpv_core.resources import bringup_file
from lpv_core.scenario import parse_faults


def add_arguments(parser):
    """Declare the command's arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument('bag', help='rosbag2 directory or MCAP file')
    parser.add_argument('--arm', required=True, help='arm file, or name of a shipped arm')
    source = parser.add_mutually_exclusive_group()
    source.add_argument('--gains', help='gains file of this arm')
    source.add_argument('--requirement', help='requirement to design gains for, a file or a '
                        'shipped one; without both, the shipped one of the arm\'s name')
    parser.add_argument('--out', default='out/replay', help='folder for bag and report')
    parser.add_argument('--topic', help='topic of the measurements, where there are several')
    parser.add_argument('--torque-source', choices=('effort', 'command'), default='effort',
                        help='torques as measured, or the recorded commands (effort)')
    parser.add_argument('--faults', help='YAML file whose list of faults is added to the '
                        'measurements: shows what would be found')


def run(arguments):
    """Replay, report, show what was found.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add_arguments`.

    Returns
    -------
    int
        0; 1 if the design is infeasible.
    """
    from lpv_cli.report import print_table, write_report

    console = Console(soft_wrap=True, highlight=False)
    arm = load_arm(bringup_file('arms', arguments.arm))
    out = Path(arguments.out).resolve()
    if (Path(arguments.bag).resolve() / 'x').is_relative_to(out / 'bag'):
        raise ConfigError('--out', 'would overwrite the bag that is to be replayed')
    gains = _gains(arguments, arm, out, console)
    injector = _injector(arguments.faults, arm)
    for part in ('bag', 'report'):
        shutil.rmtree(out / part, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    monitor = SensorMonitor('/uio', arm, gains)
    replay = Replay(monitor, None, injector,
                    lambda event: console.print(f'  {event.detected / 1e9:.3f} s: '
                                                + describe(event)))
    result = replay.run(arguments.bag, out / 'bag')
    _summary(result, monitor, console)
    report = write_report(out / 'bag', out / 'report', arm,
                          title=f'Replay of {Path(arguments.bag).name} on arm {arm.name}')
    if report.table:
        print_table(report.table, console)
    console.print(f'bag     {out / "bag"}\nreport  {report.html}')
    return 0


def _gains(arguments, arm, out, console):
    if arguments.gains:
        return load_gains(arguments.gains)
    # The solver is imported only where it is needed.
    from lpv_design.pipeline import design
    from lpv_design.requirement import load_requirement

    requirement = load_requirement(arguments.requirement or arm.name)
    console.print(f'designing gains for arm {arm.name!r} ...')
    result = design(arm, requirement)
    save_gains(result.gains, out / 'gains.yaml', '\n'.join(result.lines))
    return result.gains


def _injector(path, arm):
    if path is None:
        return None
    top = Section(read_yaml(path), path)
    faults = parse_faults(top)
    top.finish()
    return FaultInjector(arm.sensor_names, faults, np.random.default_rng(0))


def _summary(result, monitor, console):
    console.print(f'{result.measurements} measurements, {len(result.events)} alarm events')
    for name, count in vars(monitor.counters).items():
        if count:
            console.print(f'  {name.replace("_", " ")}: {count}')
    for text, count in result.rejected.items():
        console.print(f'  rejected {count} times: {text}')
