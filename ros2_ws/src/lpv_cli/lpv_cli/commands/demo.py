"""``lpv demo``: the whole pipeline with one command."""

import argparse
import os
import queue
import re
import shutil
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from lpv_cli.needs import require_ros
from lpv_cli.processes import Graph, NodeFailure, NodeProcess, ended_by_signals
from lpv_core.certificate.gains import save_gains
from lpv_core.control.path import CartesianPath
from lpv_core.control.tracking import COMPENSATION
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.serial_arm.certificate.conditions import require_loop
from lpv_core.serial_arm.certificate.loop_gains import load_loop_gains
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.any_scenario import AnyScenario, load_any_scenario, new_path
from lpv_core.simulation.precompile import precompile
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file, executable, shipped_files

NAMESPACE = '/lpv'
_PROGRESS = re.compile(r'scenario time ([0-9.]+) of')
_SILENCE = 900.0
"""Longest time without progress before the run is given up [s]; the first start compiles."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('--arm', default='paper', help='shipped arm or arm file (paper)')
    parser.add_argument(
        '--requirement',
        default='paper',
        help='shipped requirement or requirement file (paper); serial arms need none',
    )
    parser.add_argument(
        '--scenario',
        help='shipped scenario or scenario file (two_faults, or that of the same name as a '
        'serial arm)',
    )
    parser.add_argument(
        '--mode',
        choices=('lockstep', 'realtime'),
        default='lockstep',
        help='step on /clock as fast as the transport allows, reproducibly, or '
        'run on the wall clock (lockstep)',
    )
    parser.add_argument(
        '--compensation',
        choices=COMPENSATION,
        default='confirmed',
        help='position in the tracking loop (confirmed)',
    )
    parser.add_argument('--seed', type=int, default=-1, help="seed instead of the scenario's")
    parser.add_argument('--out', default='out/demo', help='folder for everything (out/demo)')
    parser.add_argument(
        '--domain-id',
        type=int,
        default=None,
        help="ROS_DOMAIN_ID of the run; otherwise the environment's, or one of its own",
    )


def run(arguments: argparse.Namespace) -> int:
    """Design gains where the arm's kind has some, run the graph, write and show the report.

    Exit code: 0; 1 if a node failed or the design is infeasible.
    """
    from lpv_report.run import print_table, read_used_gains, write_report

    require_ros()
    console = Console(soft_wrap=True)
    files = {'arm': bringup_file('arms', arguments.arm)}
    arm = load_any_arm(files['arm'])
    designed = isinstance(arm, ArmParameters)
    default = 'two_faults' if designed else Path(arguments.arm).stem
    files['scenario'] = bringup_file('scenarios', arguments.scenario or default)
    scenario = load_any_scenario(files['scenario'], arm)
    path = new_path(arm, scenario)
    out = _fresh_folder(arguments.out)
    if isinstance(arm, ArmParameters):
        files['gains'] = out / 'gains.yaml'
        if not _design(arm, arguments.requirement, files['gains'], console):
            return 1
    else:
        files.update(_certified_loop(arm, console))
        precompile(arguments.arm)  # kept after the first time
    try:
        _run_graph(arguments, files, out, scenario, console)
    except NodeFailure as error:
        console.print(f'[red]lpv demo: {error}', highlight=False)
        return 1
    console.print('writing the report ...')
    result = write_report(
        out / 'bag',
        out / 'report',
        arm=arm,
        path=path if isinstance(path, CartesianPath) else None,
        title=f'Scenario {scenario.name}, arm “{arm.name}”',
        used=read_used_gains(files['gains']) if designed else None,
    )
    print_table(result.table, console)
    console.print(f'bag     {out / "bag"}\nreport  {result.html}', highlight=False)
    return 0


def _fresh_folder(name: str) -> Path:
    """The output folder, emptied of an earlier run's results and of nothing else."""
    out = Path(name).resolve()
    for part in ('bag', 'report', 'log'):
        shutil.rmtree(out / part, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    return out


def _certified_loop(arm: SerialArm, console: Console) -> dict[str, Path]:
    """Shipped parameters of a serial arm's loop, if their certificate is about this arm."""
    file = shipped_files('gains').get(arm.name)
    text = f'arm {arm.name!r} is tracked by computed torque'
    try:
        if file is not None:
            require_loop(arm, load_loop_gains(file))
            console.print(f'{text}; the certificate of its loop holds')
            return {'gains': file}
    except ConfigError:
        pass  # changed by the user, or of another version: the demo runs without
    console.print(f'{text}; its loop has no certificate: lpv design --arm {arm.name} writes one')
    return {}


def _design(arm: ArmParameters, requirement: str, gains_file: Path, console: Console) -> bool:
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement
    from lpv_design.solve import InfeasibleError

    console.print(f'designing gains for arm {arm.name!r} ...')
    try:
        result = design(arm, load_requirement(requirement))
    except InfeasibleError as error:
        console.print(f'[red]lpv demo: {error}', highlight=False)
        return False
    save_gains(result.gains, gains_file, '\n'.join(result.lines))
    checks = len(result.gains.certificate['margins'])
    console.print(f'  all {checks} checks of the certificate hold', highlight=False)
    for line in result.lines[checks:]:
        console.print(f'  {line}', highlight=False)
    return True


def _commands(
    arguments: argparse.Namespace, files: dict[str, Path], out: Path
) -> dict[str, list[Any]]:
    """Programs of the graph with their arguments, in the order in which they start."""
    lockstep = str(arguments.mode == 'lockstep').lower()
    common = ['--ros-args', '-r', f'__ns:={NAMESPACE}', '-p', f'lockstep:={lockstep}']
    arm = ['-p', f'arm_file:={files["arm"]}', '-p', 'await_recorders:=1']
    gains = ['--params-file', files['gains']] if 'gains' in files else []
    recorded = ['-p', f'gains_file:={files["gains"]}'] if gains else []
    scenario = ['-p', f'scenario_file:={files["scenario"]}']
    return {
        'recorder': [
            executable('lpv_bag', 'recorder'),
            *common,
            '-p',
            f'output:={out / "bag"}',
            *recorded,
            *scenario,
        ],
        'uio': [executable('lpv_uio', 'uio'), *common, *gains, *arm],
        'tracker': [
            executable('lpv_tracker', 'tracker'),
            *common,
            *gains,
            *arm,
            *scenario,
            '-p',
            f'compensation:={arguments.compensation}',
        ],
        'simulator': [
            executable('lpv_arm_sim', 'simulator'),
            *common,
            *gains,
            *arm,
            *scenario,
            '-p',
            'shutdown_at_end:=true',
            '-p',
            f'seed:={arguments.seed}',
        ],
    }


def _run_graph(
    arguments: argparse.Namespace,
    files: dict[str, Path],
    out: Path,
    scenario: AnyScenario,
    console: Console,
) -> None:
    domain = arguments.domain_id
    if domain is None:
        domain = int(os.environ.get('ROS_DOMAIN_ID', 1 + os.getpid() % 100))
    console.print(
        f'running {scenario.name!r} ({scenario.duration:g} s, {arguments.mode}) with '
        f'ROS_DOMAIN_ID {domain} ...',
        highlight=False,
    )
    with ended_by_signals(), Graph(out / 'log', domain) as graph:
        for name, command in _commands(arguments, files, out).items():
            graph.start(name, command)
        _follow(graph, scenario.duration, console)
        codes = graph.stop()
    bad = {name: code for name, code in codes.items() if code != 0}
    if bad:
        raise NodeFailure(f'nodes ended with codes {bad}; their logs are in {out / "log"}')


def _follow(graph: Graph, duration: float, console: Console) -> None:
    """Show progress and alarms until the simulator has finished; the others then miss it."""
    simulator = graph.nodes[-1]
    columns = (
        TextColumn('scenario'),
        BarColumn(),
        TextColumn('{task.completed:.1f} s'),
        TimeElapsedColumn(),
    )
    last = time.monotonic()
    with Progress(*columns, console=console) as progress:
        task = progress.add_task('scenario', total=duration)
        while simulator.process.poll() is None or not graph.lines.empty():
            try:
                name, line = graph.lines.get(timeout=0.2)
            except queue.Empty:
                _check_running(graph, simulator, last)
                continue
            found = _PROGRESS.search(line)
            if found:
                last = time.monotonic()
                progress.update(task, completed=float(found.group(1)))
            elif 'ALARM' in line or 'alarm ' in line:
                progress.console.print(f'  {line.split("]: ", 1)[-1]}', highlight=False)
            elif not progress.finished and ('ERROR' in line or 'FATAL' in line):
                progress.console.print(f'  {name}: {line}', highlight=False)
    graph.check(finite=simulator)


def _check_running(graph: Graph, simulator: NodeProcess, last: float) -> None:
    graph.check(finite=simulator)
    if time.monotonic() - last > _SILENCE:
        raise NodeFailure(f'no progress for {_SILENCE:g} s; logs are kept')
