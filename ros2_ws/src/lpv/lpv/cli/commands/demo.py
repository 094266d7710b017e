"""``lpv demo``: the whole pipeline with one command."""

import argparse
import contextlib
import hashlib
import importlib
import os
import queue
import re
import shutil
import signal
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

import lpv_design as design_package
from lpv.cli.needs import require_ros
from lpv.cli.processes import Graph, NodeFailure
from lpv.cli.progress import bar
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import Scenario, load_scenario
from lpv.core.support.errors import LpvError
from lpv.core.support.resources import bringup_file, executable, shipped_files
from lpv.core.support.signals import exit_by_signal, handled_signals
from lpv.core.uio.certificate.conditions import require
from lpv.core.uio.certificate.gains import load_gains, save_gains
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.planar import planar_model

NAMESPACE = '/lpv'
_PROGRESS = re.compile(r'scenario time ([0-9.]+) of')
_SILENCE = 900.0
"""Longest time without progress before the run is given up [s]; the first start compiles."""


def run(arguments: argparse.Namespace) -> int:
    """Design, run the graph, report; 1 if a node failed or the design is infeasible."""
    require_ros()
    console = Console(soft_wrap=True, highlight=False)
    # Files first, and what needs time only when they are right.
    files = {'arm': bringup_file('arms', arguments.arm)}
    arm = load_arm(files['arm'])
    is_designed = arm.lpv is not None
    default = 'two_faults' if is_designed else Path(arguments.arm).stem
    files['scenario'] = bringup_file('scenarios', arguments.scenario or default)
    scenario = load_scenario(files['scenario'])
    scenario.path(arm)
    out = Path(arguments.out).resolve()
    for part in ('bag', 'report', 'log'):  # an earlier run's results, and nothing else
        shutil.rmtree(out / part, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    if is_designed:
        gains = _designed(arm, arguments.requirement, out, console)
        if gains is None:
            return 1
    else:
        from lpv.core.simulation.precompile import precompile

        gains = _shipped(arm, console)
        precompile(arguments.arm)  # kept after the first time
    files |= {'gains': gains} if gains else {}
    try:
        _run_graph(arguments, files, out, scenario, console)
    except NodeFailure as error:
        console.print(f'[red]lpv demo: {error}')
        return 1
    console.print('writing the report ...')
    from lpv.report.load import load, planned_path
    from lpv.report.run import write
    from lpv.report.table import print_table

    path = planned_path(files['scenario'], arm)
    title = f'Scenario {scenario.name}, arm “{arm.name}”'
    result = write(load(out / 'bag', arm, path, title, gains), out / 'report')
    print_table(result.table, console)
    console.print(f'bag     {out / "bag"}\nreport  {result.html}')
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
    planar, file = planar_model(arm), out / 'gains.yaml'
    key = _design_key(planar, requirement)
    with contextlib.suppress(LpvError, OSError):
        lines = file.read_text(encoding='utf-8').splitlines()
        head = [line[2:] for line in lines if line.startswith('#')]
        if head[:1] == [key]:
            require(planar, load_gains(file), str(file))
            console.print(f'gains for arm {arm.name!r} are kept from the run before')
            _show_design(head[1:], console)
            return file
    # Only here: what is kept need not wait for the solver.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement
    from lpv_design.solve import InfeasibleError

    console.print(f'designing gains for arm {arm.name!r} ...')
    try:
        result = design(planar, load_requirement(requirement))
    except InfeasibleError as error:
        console.print(f'[red]lpv demo: {error}')
        return None
    save_gains(result.gains, file, '\n'.join([key, *result.lines]))
    _show_design(result.lines, console)
    return file


def _design_key(arm: ArmParameters, requirement: str) -> str:
    """Words that tell a design from all others: arm, requirement, and state of the design."""
    folder, file = Path(design_package.__file__).parent, Path(requirement)
    if file.suffix not in ('.yaml', '.yml'):
        file = folder / 'requirements' / f'{requirement}.yaml'
    files = [*sorted(folder.glob('*.py')), *([file] if file.is_file() else ())]
    found = hashlib.sha256(arm.sha256().encode() + b''.join(one.read_bytes() for one in files))
    return f'Designed by lpv demo, {found.hexdigest()}'


def _show_design(lines: list[str], console: Console) -> None:
    checks = sum(line.startswith('holds') for line in lines)
    console.print(f'  all {checks} checks of the certificate hold')
    console.print(*(f'  {line}' for line in lines if not line.startswith('holds')), sep='\n')


def _commands(
    arguments: argparse.Namespace, files: dict[str, Path], out: Path
) -> dict[str, list[Any]]:
    """Programs of the graph with their arguments, in the order in which they start."""

    def program(package: str, name: str, **values: Any) -> list[Any]:
        line = [executable(package, name), '--ros-args', '-r', f'__ns:={NAMESPACE}']
        if name != 'recorder' and 'gains' in files:
            line += ['--params-file', files['gains']]
        for key, value in {'lockstep': arguments.mode == 'lockstep', **values}.items():
            line += ['-p', f'{key}:={str(value).lower() if isinstance(value, bool) else value}']
        return line

    arm = {'arm_file': files['arm'], 'await_recorders': 1}
    scenario = {'scenario_file': files['scenario']}
    recorded = {'gains_file': files['gains']} if 'gains' in files else {}
    end = {'shutdown_at_end': True, 'seed': arguments.seed}
    compensation = {'compensation': arguments.compensation}
    return {
        'recorder': program('lpv_node', 'recorder', output=out / 'bag', **recorded, **scenario),
        'uio': program('lpv_uio', 'uio', **arm),
        'tracker': program('lpv_tracker', 'tracker', **arm, **scenario, **compensation),
        'simulator': program('lpv_arm_sim', 'simulator', **arm, **scenario, **end),
    }


def _run_graph(
    arguments: argparse.Namespace,
    files: dict[str, Path],
    out: Path,
    scenario: Scenario,
    console: Console,
) -> None:
    domain = arguments.domain_id
    if domain is None:
        domain = int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))
    what = f'{scenario.name!r} ({scenario.duration:g} s, {arguments.mode})'
    console.print(f'running {what} with ROS_DOMAIN_ID {domain} ...')
    # Nodes, in sessions of their own, get neither signal, and must not outlive the command.
    ending = handled_signals(exit_by_signal, signal.SIGTERM, signal.SIGHUP)
    with ending, ThreadPoolExecutor(1) as loader, Graph(out / 'log', domain) as graph:
        for name, command in _commands(arguments, files, out).items():
            graph.start(name, command)
        # While the nodes step one after the other; until then they load on all cores themselves.
        _follow(graph, scenario.duration, console, partial(loader.submit, _load_report))
        codes = graph.stop()
    bad = {name: code for name, code in codes.items() if code != 0}
    if bad:
        raise NodeFailure(f'nodes ended with codes {bad}; their logs are in {out / "log"}')


def _load_report() -> None:
    """What the first picture of a process loads takes as long as drawing all of a report."""
    importlib.import_module('lpv.report.run')
    importlib.import_module('lpv.report.figures').warm_up()


def _follow(
    graph: Graph, duration: float, console: Console, when_begun: Callable[[], object]
) -> None:
    """Show progress and alarms until the simulator has finished; the others then miss it."""
    simulator, last, done, begun = graph.nodes[-1], time.monotonic(), 0.0, False
    with bar(console, 'scenario', duration, unit='s') as show:
        while simulator.process.poll() is None or not graph.lines.empty():
            try:
                name, line = graph.lines.get(timeout=0.2)
            except queue.Empty:
                graph.check(finite=simulator)
                show(done)
                if time.monotonic() - last > _SILENCE:
                    raise NodeFailure(f'no progress for {_SILENCE:g} s; logs are kept') from None
                continue
            if found := _PROGRESS.search(line):
                last, done = time.monotonic(), float(found.group(1))
                show(done)
                if not begun:
                    begun = True
                    when_begun()
            elif 'ALARM' in line or 'alarm ' in line:
                console.print(f'  {line.split("]: ", 1)[-1]}')
            elif done < duration and ('ERROR' in line or 'FATAL' in line):
                console.print(f'  {name}: {line}')
    graph.check(finite=simulator)
