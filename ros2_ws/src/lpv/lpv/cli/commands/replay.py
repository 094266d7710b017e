"""``lpv replay``: observer and diagnosis offline on a bag, or the bag into a live graph."""

import argparse
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from lpv.bag.errors import BagError
from lpv.bag.replay.replay import InjectedFault, Replay, judge
from lpv.bag.replay.writer import MARK
from lpv.bag.rosbag.metadata import read_metadata
from lpv.bag.rosbag.output_folder import GAINS_NAME, replaced
from lpv.bag.run.record import RecordedAlarm
from lpv.cli.observing import arm_and_gains, diagnosis_parameters, reading_options
from lpv.cli.options import refuse
from lpv.core.monitoring.alarm_text import count_texts, describe
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent, size_unit
from lpv.core.simulation.faults import Fault, FaultInjector
from lpv.core.simulation.scenario import load_scenario, parse_faults
from lpv.core.support.config import Section, read_yaml
from lpv.core.support.discovery import stay_local
from lpv.core.support.errors import ConfigError
from lpv.core.support.formatting import decimals, sized
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import NANOSECONDS

_PLAYED = ('topics', 'rate', 'loop', 'clock_rate', 'wait')
"""Options of a `lpv.bag.replay.player.Player`, which has their defaults."""
_OFFLINE = (
    *('out', 'preset', 'inject', 'report', 'topic', 'effort_topic', 'torque_source'),
    *('arm', 'gains', 'requirement', 'parameters', 'estimates_only'),
)
"""Options of a replay that runs offline."""


def run(arguments: argparse.Namespace) -> int:
    """Replay, report, show what was found; 1 if the design is infeasible."""
    console = Console(soft_wrap=True, highlight=False, markup=False)
    if arguments.publish:
        reason = 'has no effect on --publish, which plays the bag as it is'
        refuse(arguments, _OFFLINE, reason)
        return _publish(arguments, console)
    refuse(arguments, _PLAYED, 'is for a bag that is played: give --publish')
    out = Path(arguments.out).resolve()
    _check_out(out, Path(arguments.bag).resolve())
    if arguments.report and Path(arguments.report).resolve() == out:
        raise ConfigError('--report', 'must be another folder than the bag')
    arm, gains = arm_and_gains(arguments, console)
    diagnosis, others = diagnosis_parameters(arguments.parameters)
    monitor = SerialSensorMonitor('/uio', arm, diagnosis, gains, **others)
    faults, injector = None, None
    if arguments.inject is not None:
        faults = _faults(arguments.inject)
        injector = FaultInjector(arm.sensor_names, faults, np.random.default_rng(0))
    begin = time.perf_counter()
    options = reading_options(
        arguments, preset=arguments.preset, estimates_only=arguments.estimates_only
    )
    replay = Replay(
        monitor, options, injector, lambda event, time: console.print(_alarm_line(event, time))
    )
    with replaced(out) as new:
        result = replay.run(arguments.bag, new)
        if gains is not None:
            gains.save(new / GAINS_NAME, 'Gains that this bag was replayed with.')
    span = ((result.last_stamp or 0) - (result.first_stamp or 0)) / NANOSECONDS
    counts = f'{result.measurements} measurements of {span:.4g} s'
    counts += f', {len(result.events)} alarm events'
    console.print(f'{counts}; replayed in {time.perf_counter() - begin:.2f} s')
    for text in count_texts(monitor.counters):
        console.print(f'  {text}')
    for text, count in result.rejected.items():
        console.print(f'  {count} messages not used: {text}')
    for at, text in result.notes:
        console.print(f'  warning at {at:.3f} s: {text}')
    if faults is not None:
        show_injected(judge(faults, result), arm, console)
    console.print(f'bag     {out}')
    if arguments.report:
        # Only here: drawing is not asked for always.
        from lpv.report.history import load
        from lpv.report.run import write
        from lpv.report.table import print_table

        title = f'Replay of {Path(arguments.bag).name}, arm “{arm.name}”'
        found = load(out, arm, title=title, topic=result.topic)
        page = write(found, Path(arguments.report).resolve())
        print_table(found.table, console)
        console.print(f'report  {page}')
    return 0


def _publish(arguments: argparse.Namespace, console: Console) -> int:
    """The bag into the live graph."""
    stay_local()
    from lpv.bag.replay.player import Player

    given = vars(arguments)
    options = {name: given[name] for name in _PLAYED if given[name] is not None}
    player = Player(given['bag'], interval=(given['from'], given['to']), **options)
    console.print(f'{player.run(console.print)} messages published')
    return 0


def _faults(name: str) -> tuple[Fault, ...]:
    """Faults of a list in a file, or of a scenario, which may be a shipped one."""
    path = bringup_file('scenarios', name)
    data = read_yaml(path)
    if 'path' in data:
        return load_scenario(path).faults
    top = Section(data, str(path))
    faults = parse_faults(top)
    top.finish()
    return faults


def _check_out(out: Path, bag: Path) -> None:
    if bag == out or bag.is_relative_to(out):
        raise ConfigError('--out', 'would overwrite the bag that is to be replayed')
    if out.is_relative_to(bag):
        raise ConfigError('--out', 'is inside the bag that is to be replayed')
    if not out.exists():
        return
    try:
        is_ours = MARK in read_metadata(out).custom
    except BagError:
        is_ours = False
    if not is_ours:
        raise ConfigError('--out', f'{out} exists already and was not written by this command')


def _alarm_line(event: RecordedAlarm, time: float) -> str:
    """One alarm event: its time [s], what it says, and how long before that the fault began."""
    line = f'  {time:.3f} s: {describe(event)}'
    if event.event == AlarmEvent.RAISED and event.onset < event.stamp:
        line += f'; began {(event.stamp - event.onset) / NANOSECONDS:.3f} s before'
    return line


def show_injected(found: list[InjectedFault], arm: SerialArm, console: Console) -> None:
    """Show what was found of the injected faults."""
    right = sum(one.last is not None for one in found)
    acted = sum(one.acted for one in found)
    console.print(f'{right} of {acted} injected faults found on the right sensor')
    for one in found:
        fault, last = one.fault, one.last
        text = f'  {fault.sensor}, {fault.kind} from {fault.onset:.3f} s on: {one.verdict}'
        if last is not None:
            unit = arm.position_units[arm.sensor_names.index(fault.sensor)]
            unit, digits = size_unit(last.kind, unit), decimals(unit)
            text += f' after {one.delay:.3f} s as {last.kind}'
            if last.kind != 'dropout':  # which has no size
                text += f', {sized(last.size, last.bound, unit)}'
            if one.error is not None:
                text += f', size error {one.error:+.{digits}f} {unit}'
            if one.wrong_sensors:
                text += f'; wrongly alarmed, too: {", ".join(one.wrong_sensors)}'
        console.print(text)
