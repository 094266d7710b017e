"""``lpv replay``: observer and diagnosis offline on a bag, or the bag into a live graph."""

import os
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from lpv_bag.mcap.writer import PRESETS
from lpv_bag.replay.replay import Replay, ReplayOptions
from lpv_bag.replay.writer import MARK
from lpv_bag.rosbag.output_folder import GAINS_NAME
from lpv_core.certificate.gains import load_gains, save_gains
from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.model.arm import load_arm
from lpv_core.monitoring.monitor import SensorMonitor, describe
from lpv_core.simulation.faults import FaultInjector
from lpv_core.simulation.scenario import parse_faults
from lpv_core.support.config import Section, read_yaml
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


def add_arguments(parser) -> None:
    """Declare the command's arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument('bag', help='rosbag2 directory, MCAP or sqlite3 file')
    add_diagnosis(parser)
    parser.add_argument(
        '--out',
        default='out/replay',
        help='bag to write (out/replay); an earlier result of this command is replaced',
    )
    parser.add_argument('--report', help='folder for a report of the new bag')
    add_reading(parser)
    parser.add_argument(
        '--inject',
        '--faults',
        metavar='FAULTS',
        help='YAML file whose list of '
        'faults is added to the measurements: shows what would be found',
    )
    parser.add_argument(
        '--estimates-only',
        action='store_true',
        help='write estimates, alarms and diagnostics alone; otherwise all topics are copied, too',
    )
    parser.add_argument(
        '--compression',
        choices=tuple(PRESETS),
        default='zstd_fast',
        help='of the new bag (zstd_fast)',
    )
    _add_publishing(parser)


def add_diagnosis(parser) -> None:
    """Declare the arguments that say what observes.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument(
        '--arm',
        help='arm file, or name of a shipped arm; the one that the gains '
        'were designed for if not given',
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument('--gains', help='gains file of this arm')
    source.add_argument(
        '--requirement',
        help='requirement to design gains for, a file or a '
        "shipped one; without both, the shipped one of the arm's name",
    )
    parser.add_argument(
        '--parameters',
        help='parameter file of the node, for its diagnosis, initial_samples and max_gap',
    )


def add_reading(parser) -> None:
    """Declare the arguments that say what of a bag is read.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Receives them.
    """
    parser.add_argument(
        '--from',
        dest='start',
        type=float,
        metavar='S',
        help='leave out what is before this time, counted from the first message of the bag [s]',
    )
    parser.add_argument(
        '--to',
        dest='end',
        type=float,
        metavar='S',
        help='leave out what is at this time or later [s]',
    )
    parser.add_argument('--topic', help='topic of the measurements, where there are several')
    parser.add_argument(
        '--effort-topic',
        help='topic of torques to use in place of the measured '
        'efforts: TorqueCommand, JointState, Float64MultiArray, JointTrajectory',
    )
    parser.add_argument(
        '--torque-source',
        choices=('effort', 'command'),
        default='effort',
        help='torques as measured, or the recorded commands (effort)',
    )


def _add_publishing(parser) -> None:
    parser.add_argument(
        '--publish',
        action='store_true',
        help='play the bag into the live graph, with /clock, and run nothing offline; needs ROS 2',
    )
    parser.add_argument('--rate', type=float, default=1.0, help='with --publish: speed (1)')
    parser.add_argument('--loop', action='store_true', help='with --publish: again and again')
    parser.add_argument(
        '--clock-rate',
        type=float,
        default=100.0,
        help='with --publish: messages on /clock per second of the bag, 0 for none (100)',
    )
    parser.add_argument(
        '--topics',
        nargs='+',
        help='with --publish: topics to play; all but the answers of the diagnosis if not given',
    )
    parser.add_argument(
        '--wait',
        type=float,
        default=5.0,
        help='with --publish: longest time to '
        'wait for a subscriber before the first message [s] (5)',
    )


def run(arguments) -> int:
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
    console = Console(soft_wrap=True, highlight=False)
    if arguments.publish:
        return _publish(arguments, console)
    out = Path(arguments.out).resolve()
    _check_out(out, Path(arguments.bag).resolve())
    arm, gains = arm_and_gains(arguments, console)
    diagnosis, others = diagnosis_parameters(arguments.parameters)
    monitor = SensorMonitor('/uio', arm, gains, diagnosis, **others)
    injector = _injector(arguments.inject, arm)
    _remove(out)
    begin = time.perf_counter()
    result = Replay(
        monitor,
        _options(arguments),
        injector,
        lambda event: console.print(f'  {event.detected / 1e9:.3f} s: ' + describe(event)),
    ).run(arguments.bag, out)
    save_gains(gains, out / GAINS_NAME, 'Gains that this bag was replayed with.')
    _summary(result, monitor, time.perf_counter() - begin, console)
    console.print(f'bag     {out}')
    if arguments.report:
        _report(arguments, arm, out, console)
    return 0


def _publish(arguments, console):
    # Nobody else's business: unless the user wants more, nodes of this machine only.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    try:
        from lpv_bag.replay.player import Player
    except ImportError as error:
        raise ConfigError('--publish', f'needs ROS 2 ({error})') from error

    player = Player(
        arguments.bag,
        arguments.topics,
        arguments.topic,
        arguments.rate,
        arguments.loop,
        arguments.clock_rate,
        arguments.wait,
        (arguments.start, arguments.end),
    )
    count = player.run(lambda text: console.print(text))
    console.print(f'{count} messages published')
    return 0


def _options(arguments):
    names = ('topic', 'effort_topic', 'start', 'end', 'estimates_only')
    return ReplayOptions(
        torque_from_command=arguments.torque_source == 'command',
        preset=arguments.compression,
        **{name: getattr(arguments, name) for name in names},
    )


def _check_out(out, bag) -> None:
    if bag == out or bag.is_relative_to(out):
        raise ConfigError('--out', 'would overwrite the bag that is to be replayed')
    if out.is_relative_to(bag):
        raise ConfigError('--out', 'is inside the bag that is to be replayed')
    if out.exists() and not _is_ours(out):
        raise ConfigError('--out', f'{out} exists already and was not written by this command')


def _is_ours(out) -> bool:
    try:
        information = read_yaml(out / 'metadata.yaml')['rosbag2_bagfile_information']
        return MARK in (information.get('custom_data') or ())
    except (ConfigError, TypeError, KeyError, AttributeError):
        return False


def _remove(out) -> None:
    if out.exists():
        shutil.rmtree(out)


def arm_and_gains(arguments, console) -> tuple[Any, ...]:
    """Arm and gains as arguments say.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add_diagnosis`.
    console : rich.console.Console
        Is told of a design.

    Returns
    -------
    tuple
        `ArmParameters` and `Gains`.

    Raises
    ------
    LpvError
        If a file is wrong, or the design is infeasible.
    """
    gains = load_gains(arguments.gains) if arguments.gains else None
    name = arguments.arm or (gains and gains.arm_name)
    if not name:
        raise ConfigError('--arm', 'is needed where no gains are given')
    arm = load_arm(bringup_file('arms', name))
    return arm, gains or _design(arguments, arm, console)


def _design(arguments, arm, console):
    # The solver is imported only where it is needed.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    requirement = load_requirement(arguments.requirement or arm.name)
    console.print(f'designing gains for arm {arm.name!r} ...')
    return design(arm, requirement).gains


def diagnosis_parameters(path: str | None) -> tuple[Any, ...]:
    """Tuning of the diagnosis in a parameter file of the node.

    Parameters
    ----------
    path : str or None
        The file; None for what the node has without one.

    Returns
    -------
    tuple
        `DiagnosisParameters`, and a dict with what is given of ``max_gap`` and
        ``initial_samples``.

    Raises
    ------
    ConfigError
        Naming what is wrong.
    """
    if not path:
        return DiagnosisParameters(), {}
    try:
        values = dict(read_yaml(path)['/**']['ros__parameters'])
        diagnosis = DiagnosisParameters(**values.get('diagnosis') or {})
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            '/**.ros__parameters', f'is no set of parameters ({error})', path
        ) from error
    chosen = {name: values[name] for name in ('max_gap', 'initial_samples') if name in values}
    for name, value in (*vars(diagnosis).items(), *chosen.items()):
        if not isinstance(value, (int, float)) or not 0.0 <= value < 1e9:
            raise ConfigError(name, f'must be a number from 0, got {value!r}', path)
    return diagnosis, chosen


def _injector(path, arm):
    if path is None:
        return None
    top = Section(read_yaml(path), path)
    faults = parse_faults(top)
    top.finish()
    return FaultInjector(arm.sensor_names, faults, np.random.default_rng(0))


def _summary(result, monitor, seconds, console) -> None:
    console.print(
        f'{result.measurements} measurements, {len(result.events)} alarm events, {seconds:.2f} s'
    )
    for name, count in vars(monitor.counters).items():
        if count:
            console.print(f'  {name.replace("_", " ")}: {count}')
    for text, count in result.rejected.items():
        console.print(f'  rejected {count} times: {text}')


def _report(arguments, arm, out, console) -> None:
    from lpv_report.run import print_table, write_report

    folder = Path(arguments.report).resolve()
    if folder == out:
        raise ConfigError('--report', 'must be another folder than the bag')
    report = write_report(
        out, folder, arm, title=f'Replay of {Path(arguments.bag).name} on arm {arm.name}'
    )
    if report.table:
        print_table(report.table, console)
    console.print(f'report  {report.html}')
