"""``lpv demo``: the whole pipeline with one command."""

import argparse
import contextlib
import hashlib
import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Timer
from typing import Any

from rich.console import Console

import lpv_design as design_package
from lpv.cli.needs import require_ros
from lpv.cli.progress import bar
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import Scenario, load_scenario
from lpv.core.support.config import write_parameters
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.resources import bringup_file, prefixes, shipped_files
from lpv.core.support.signals import STOPS, exit_by_signal, handled_signals
from lpv.core.uio.certificate.gains import load_gains

_PROGRESS = re.compile(r'scenario time ([0-9.]+) of')
_LOG = 'launch.log'
_SILENCE = 900.0
"""Longest time without progress before the run is given up [s]; the first start compiles."""


def run(arguments: argparse.Namespace) -> int:
    """Design, run the graph, report; 1 if a node failed or the design is infeasible."""
    require_ros()
    console = Console(soft_wrap=True, highlight=False, markup=False)
    # Files first, and what needs time only when they are right.
    arm, files = arguments.arm, {'arm': arguments.arm_file}
    is_designed = arm.lpv is not None
    default = 'two_faults' if is_designed else arguments.arm_file.stem
    files['scenario'] = bringup_file('scenarios', arguments.scenario or default)
    scenario = load_scenario(files['scenario'])
    scenario.path(arm)
    out = Path(arguments.out).resolve()
    old = [path for path in (out / 'bag', out / 'report') if path.exists()]
    if old and not (out / _LOG).exists():  # an earlier run's results are removed, and nothing else
        raise ConfigError('--out', f'{old[0]} exists already and was not written by this command')
    for path in old:
        shutil.rmtree(path, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    if is_designed:
        gains = _designed(arm, arguments.requirement, out, console)
        if gains is None:
            return 1
    else:
        from lpv.core.simulation.precompile import precompile

        gains = _shipped(arm, console)
        # Kept after the first time.
        precompile(str(arguments.arm_file), str(files['scenario']))
    files |= {'gains_file': gains} if gains else {}
    if problem := _run_graph(arguments, files, out, scenario, console):
        console.print(f'lpv demo: {problem}', style='red', markup=False)
        return 1
    console.print('writing the report ...')
    from lpv.report.history import load
    from lpv.report.run import write
    from lpv.report.table import print_table

    title = f'Scenario {scenario.name}, arm “{arm.name}”'
    found = load(out / 'bag', arm, files['scenario'], title, gains)
    page = write(found, out / 'report')
    print_table(found.table, console)
    console.print(f'bag     {out / "bag"}\nreport  {page}')
    return 0


def _shipped(arm: SerialArm, console: Console) -> Path | None:
    """The shipped gains of the arm, if they are certified for it."""
    from lpv.report.certificate import examine

    text, file = f'arm {arm.name!r} is tracked by computed torque', shipped_files('gains')
    if arm.name in file and examine(file[arm.name], arm).holds:
        console.print(f'{text}; the certificate of its loop holds')
        return file[arm.name]
    # Changed by the user, or of another version: the demo runs without.
    console.print(f'{text}; its loop has no certificate')
    return None


def _designed(arm: SerialArm, requirement: str, out: Path, console: Console) -> Path | None:
    """Gains designed for a requirement, or kept from an earlier run; None if infeasible."""
    file, key = out / 'gains.yaml', _design_key(arm, requirement)
    with contextlib.suppress(LpvError, OSError):
        lines = file.read_text(encoding='utf-8').splitlines()
        head = [line[2:] for line in lines if line.startswith('#')]
        if head[:1] == [key]:
            load_gains(file).require(arm, str(file))
            console.print(f'gains for arm {arm.name!r} are kept from the run before')
            _show_design(head[1:], console)
            return file
    # Only here: what is kept need not wait for the solver.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement
    from lpv_design.solve import InfeasibleError

    console.print(f'designing gains for arm {arm.name!r} ...')
    try:
        result = design(arm, load_requirement(requirement))
    except InfeasibleError as error:
        console.print(f'lpv demo: {error}', style='red')
        return None
    result.gains.save(file, '\n'.join([key, *result.lines]))
    _show_design(result.lines, console)
    return file


def _design_key(arm: SerialArm, requirement: str) -> str:
    """Words that tell a design from all others: arm, requirement, and state of the design."""
    folder = Path(design_package.__file__).parent
    files = [*sorted(folder.glob('*.py')), bringup_file('requirements', requirement)]
    found = hashlib.sha256(arm.sha256().encode() + b''.join(one.read_bytes() for one in files))
    return f'Designed by lpv demo, {found.hexdigest()}'


def _show_design(lines: list[str], console: Console) -> None:
    checks = sum(line.startswith('holds') for line in lines)
    console.print(f'  all {checks} checks of the certificate hold')
    console.print(*(f'  {line}' for line in lines if not line.startswith('holds')), sep='\n')


def _run_graph(
    arguments: argparse.Namespace,
    files: dict[str, Path],
    out: Path,
    scenario: Scenario,
    console: Console,
) -> str:
    """Run the launch file of the whole pipeline; what went wrong, or ''."""
    domain = arguments.domain_id
    if domain is None:  # an empty one counts as none, as for rcl
        domain = os.environ.get('ROS_DOMAIN_ID') or 1 + os.getpid() % 100
    what = f'{scenario.name!r} ({scenario.duration:g} s, {arguments.mode})'
    console.print(f'running {what} with ROS_DOMAIN_ID {domain} ...')
    values = {'seed': arguments.seed, 'compensation': arguments.compensation}
    file, bag = out / 'parameters.yaml', out / 'bag'
    given = {**files, 'params_file': file, 'bag': bag, 'record': 'true'}
    write_parameters(file, {**values, 'shutdown_at_end': True})
    # That of this environment, else of the ROS 2 that is sourced.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get('PATH', '')])
    line = [shutil.which('ros2', path=path) or 'ros2', 'launch', 'lpv_bringup']
    line += ['pipeline.launch.xml', f'mode:={arguments.mode}']
    options: dict[str, Any] = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT}
    options |= {'text': True, 'errors': 'replace', 'start_new_session': True}
    options['env'] = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONUNBUFFERED': '1'}
    if os.environ.get('AMENT_PREFIX_PATH'):  # of a ROS 2 that may not know where this is
        options['env']['AMENT_PREFIX_PATH'] = os.pathsep.join(map(str, prefixes()))
    lines, log = deque[str](maxlen=15), out / _LOG
    with (
        # The nodes, in sessions of their own, get no signal, and must not outlive the command.
        handled_signals(exit_by_signal, signal.SIGTERM, signal.SIGHUP),
        subprocess.Popen([*line, *(f'{k}:={v}' for k, v in given.items())], **options) as process,
    ):
        try:
            has_ended = _follow(process, log, scenario.duration, lines, console)
        finally:
            with handled_signals(lambda *_: None, *STOPS):
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
                process.communicate()
    if has_ended and not process.returncode:
        return ''
    return f'a node has died, or hangs; {log} ends with\n' + ''.join(lines)


def _follow(
    process: 'subprocess.Popen[str]', log: Path, duration: float, last: deque[str], console: Console
) -> bool:
    """Show progress and alarms until all has ended; whether it did so with the scenario."""
    done, is_over, has_died = 0.0, False, False
    guard = _give_up_later(process)
    with (
        bar(console, 'scenario', duration, unit='s') as show,
        ThreadPoolExecutor(1) as loader,
        open(log, 'w', 1, encoding='utf-8') as file,
    ):
        for line in process.stdout or ():
            with contextlib.suppress(OSError):  # of a disk that is full
                file.write(line)
            last.append(line)
            if found := _PROGRESS.search(line):
                if not done:  # nodes step one after the other; before, they use all cores
                    # What the first picture loads takes as long as drawing all of a report.
                    loader.submit(importlib.import_module, 'lpv.report.run')
                    loader.submit(lambda: importlib.import_module('lpv.report.figures').warm_up())
                done = float(found.group(1))
                guard.cancel()
                guard = _give_up_later(process)
            elif 'ALARM' in line or 'alarm ' in line:
                console.print(f'  {line.rstrip().split("]: ", 1)[-1]}')
            elif done < duration and ('ERROR' in line or 'FATAL' in line):
                console.print(f'  {line.rstrip()}', markup=False)
            has_died |= 'process has died' in line
            is_over |= 'the scenario is over' in line
            show(done)
    guard.cancel()
    return is_over and not has_died


def _give_up_later(process: 'subprocess.Popen[str]') -> Timer:
    """Stops a graph that makes no progress, unless it is cancelled."""
    timer = Timer(_SILENCE, process.send_signal, [signal.SIGINT])
    timer.daemon = True
    timer.start()
    return timer
