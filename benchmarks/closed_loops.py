"""Faults in closed loops: the tracker is given what the diagnosis makes of a faulty sensor.

    python benchmarks/closed_loops.py --count 5 --jobs 2
    python benchmarks/closed_loops.py --others --count 4 --jobs 2

Shipped arms follow shipped paths.  `--others` takes the URDFs of the package example-robot-data as
`lpv init` does: they state neither rotors nor sensors, so that joints are light, and a frozen
reading soon makes drives brake.  Rates are differences of the readings; true arms are 5 % off their
files.

`others` = runs that blame a healthy sensor, `outside` = trusted answers whose estimate is outside
its bound (until 0.3 s after the onset, from there to 1 s and to 2 s, before brakes engage), `error`
= median error of the estimate 0.3 s and 1 s after the onset, `path` = largest tracking error while
the loop goes on, median and worst run, `stops` = safe stops in all runs, `position` = worst error
of a position that the loop is closed on.
"""

import argparse
import tempfile
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from io import StringIO
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from fault_injection import shoulder_arm, with_sensors
from rich.console import Console

from lpv import AlarmEvent, Fault, Scenario, SerialArm, load_arm, load_scenario
from lpv.cli.main import main as lpv
from lpv.core.simulation.closed_loop import Run, run_closed_loop
from lpv.core.simulation.scenario import parse_scenario
from lpv.core.support.errors import ConfigError
from lpv.report.table import print_grid

SHIPPED = ('real_arm', 'chain3', 'ur10', 'panda')
PACKAGE = 'example-robot-data'
OTHERS = {
    'TwoDofs': '', 'borinot_flying_arm_2': '', 'double_pendulum_continuous': '', 'so100': '',
    'hextilt_flying_arm_5': '', 'so101': '', 'talos_left_arm': '', 'ur3_robot': '',
    'ur10_robot': '', 'ur5_gripper': '', 'xarm7': '', 'z1': '', 'b1-z1': 'gripperStator',
    'baxter': 'left_wrist', 'centauro': 'arm1_8', 'g1_29dof_rev_1_0': 'left_rubber_hand',
    'go2': 'FL_foot', 'human': 'left_hand', 'icub': 'l_hand', 'kinova': 'j2s6s200_end_effector',
    'panda': 'panda_hand', 'pr2': 'r_wrist_roll_link', 'romeo': 'l_wrist', 'solo12': 'FL_FOOT',
    'talos_reduced': 'arm_left_7_link', 'tiago': 'arm_tool_link', 'tiago_pro': 'arm_left_tool_link',
    'tiago_dual': 'arm_left_tool_link',
}  # fmt: skip
"""Names of the files, and the link at the tip of the arm."""
WAYPOINTS = ([0.0, 0.3, -0.6], [0.8, 0.7, -0.2], [0.2, 0.1, -0.9], [-0.7, 0.6, -0.5])
"""Of the arm with three joints, which is followed for 3.5 s from each to the next [rad]."""
DURATION = 12.0
"""Of a run [s]."""
KINDS = {
    'healthy': None,
    'offset 0.2': Fault('', 'bias', 0.0, size=0.2),
    'drift 0.2': Fault('', 'drift', 0.0, rate=0.2),
    'scale 20 %': Fault('', 'scale', 0.0, size=0.2),
    'frozen': Fault('', 'stuck', 0.0),
    'noise 0.01, 0.5 s': Fault('', 'noise', 0.0, 0.5, 0.01),
    'noise 0.01, 3 s': Fault('', 'noise', 0.0, 3.0, 0.01),
    'noise 0.04, 14 ms': Fault('', 'noise', 0.0, 0.014, 0.04),
    'noise 0.04, 0.5 s': Fault('', 'noise', 0.0, 0.5, 0.04),
    'noise 0.075, 3 s': Fault('', 'noise', 0.0, 3.0, 0.075),
    'noise 0.2, 0.5 s': Fault('', 'noise', 0.0, 0.5, 0.2),
    'noise 0.2, 3 s': Fault('', 'noise', 0.0, 3.0, 0.2),
    'spikes 0.1, 3 /s': Fault('', 'spike', 0.0, size=0.1, rate=3.0),
    'spikes 0.5, 8 /s': Fault('', 'spike', 0.0, size=0.5, rate=8.0),
}
"""By name, with sizes of joints that turn."""
LASTING = tuple(KINDS)[:5]
"""Kinds that are run on others' arms if none are chosen."""
HEADINGS = ('', 'runs', 'named', 'others', 'outside [%]', 'error [rad]', 'path [rad]', 'stops',
            'position [rad]', 'braked: runs, outside, trusted so [%]')  # fmt: skip
JUDGED = (0.0, 0.3, 1.0, 2.0)
"""Times after the onset between which answers are judged [s]."""
Shares = tuple[float, ...]


class Outcome(NamedTuple):
    """What came of one run."""

    kind: str
    named: bool
    others: str  # what healthy sensors were blamed with
    outside: Shares = (np.nan, np.nan, np.nan)  # as of the module, NaN where nothing was judged
    error: Shares = (np.nan, np.nan)  # [rad]
    path: float = np.nan  # [rad]
    stops: int = 0
    position: float = np.nan  # [rad]
    after_brakes: Shares = (np.nan, np.nan)  # from 0.2 s on: outside, outside and trusted


@cache
def described(name: str) -> tuple[SerialArm, Scenario]:
    """An arm, and a run of it: shipped, or as the command writes them for a URDF."""
    if name == 'chain3':
        lines = [{'t': 0.5 + 3.5 * k, 'joints': joints} for k, joints in enumerate(WAYPOINTS)]
        about = {'name': name, 'duration': DURATION, 'path': {'waypoints': lines}}
        return shoulder_arm(), parse_scenario(about)
    if name in SHIPPED:
        arm = with_sensors(load_arm(name), rates='derived')
        return arm, replace(load_scenario(name), duration=DURATION)
    name = name.removeprefix('urdf ')
    urdf = next(one.locate() for one in files(PACKAGE) or () if one.name == f'{name}.urdf')
    tip = ['--tip', OTHERS[name]] if OTHERS[name] else []
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()) as said:
        with redirect_stderr(said):
            code = lpv(['init', folder, '--urdf', str(urdf), *tip])
        if code:
            raise SystemExit(f'{name}: {said.getvalue()}')
        return load_arm(Path(folder) / 'arm.yaml'), load_scenario(Path(folder) / 'scenario.yaml')


def one_run(case: tuple[str, str, int]) -> Outcome:
    """Run an arm with a kind of fault of a random joint, sign and onset."""
    name, kind, seed = case
    (arm, scenario), rng = described(name), np.random.default_rng(seed)
    joint, onset = int(rng.integers(len(arm.joints))), float(rng.uniform(4.5, 8.0))
    sign, sensor, fault = float(rng.choice([-1, 1])), arm.sensor_names[joint], KINDS[kind]
    faults: tuple[Fault, ...] = ()
    if fault is not None:
        unit = sign * (1.0 if fault.kind == 'scale' else arm.joints[joint].scale)
        rate = fault.rate * (unit if fault.kind == 'drift' else 1.0)
        size = abs(unit) * fault.size if fault.kind == 'noise' else unit * fault.size
        faults = (replace(fault, sensor=sensor, onset=onset, size=size, rate=rate),)
    scenario = replace(scenario, faults=faults, seed=seed, parameter_error=0.05)
    try:
        run = run_closed_loop(arm, scenario)
    except ConfigError as error:
        return Outcome('not simulated', False, f'{name}, seed {seed}, {kind}: {error}')
    raised = [one for one in run.alarms if one.event == AlarmEvent.RAISED]
    others = [f'{a.sensor} {a.kind}' for a in raised if not faults or a.sensor != sensor]
    text = f'{name}, seed {seed}, {kind} of {sensor}: {", ".join(others)}' if others else ''
    return judged(run, kind, joint, onset)._replace(
        named=any(one.sensor == sensor for one in raised), others=text
    )


def judged(run: Run, kind: str, joint: int, onset: float) -> Outcome:
    """Figures of a run whose sensor ``joint`` may be faulty from the onset on [s]."""
    error = np.abs(run.fault_estimate - run.fault)[:, joint]
    outside, trusted = error > run.bound[:, joint], run.trustworthy
    braked = run.braked & (run.time > onset)
    stopped = run.time[braked.argmax()] if braked.any() else np.inf
    goes_on = ~(run.safe_stop | run.braked) & (run.time > 1.0)
    since = run.time - onset
    shares = [
        _mean(outside[trusted & (since > first) & (since <= last) & (run.time < stopped)])
        for first, last in zip(JUDGED, JUDGED[1:])
    ]
    errors = [error[(since > after).argmax()] for after in JUDGED[1:3] if onset + after < stopped]
    later = braked & (run.time > stopped + 0.2)
    tracking = np.abs(run.position - run.reference).max(1)[goes_on]
    position = np.abs(run.compensated - run.position).max(1)[goes_on & trusted]
    begins = run.braked[1:] & ~run.braked[:-1]
    return Outcome(
        kind, False, '', tuple(shares), (*errors, np.nan, np.nan)[:2],
        tracking.max(initial=0.0), int(begins.sum()), float(np.nanmax(position, initial=0.0)),
        (_mean(outside[later]), _mean((outside & trusted)[later])))  # fmt: skip


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if values.size else np.nan


def print_table(outcomes: Sequence[Outcome], by: Sequence[str]) -> None:
    """One line for each label of the outcomes."""
    rows = []
    for label in dict.fromkeys(by):
        every = [one for one, own in zip(outcomes, by) if own == label]
        braked = [one.after_brakes for one in every if np.isfinite(one.after_brakes[0])]
        means = 100.0 * np.mean(braked, 0) if braked else ()
        paths = [one.path for one in every]
        rows.append((
            label, str(len(every)), str(sum(one.named for one in every)),
            str(sum(bool(one.others) for one in every)),
            ', '.join(f'{100.0 * share:.0f}' for share in _known(one.outside for one in every)),
            ', '.join(f'{error:.2f}' for error in _known((one.error for one in every), np.median)),
            f'{np.median(paths):.3f}, {max(paths):.2f}', str(sum(one.stops for one in every)),
            f'{max(one.position for one in every):.2f}',
            f'{len(braked)}: ' + ', '.join(f'{share:.1f}' for share in means),
        ))  # fmt: skip
    print_grid(Console(), HEADINGS, rows)


def _known(rows: Iterable[Shares], of: Callable[[np.ndarray], Any] = np.mean) -> list[float]:
    """Mean, or another figure, of each column, of what is known of it."""
    columns = (column[np.isfinite(column)] for column in np.array([*rows]).T)
    return [float(of(column)) if column.size else np.nan for column in columns]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--others', action='store_true', help='arms of others, by their URDFs')
    parser.add_argument('--kinds', help='some of them, separated by semicolons')
    parser.add_argument('--count', type=int, default=1, help='runs of each kind and arm')
    parser.add_argument('--first', type=int, default=1, help='seed of the first run')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    given = parser.parse_args()
    if given.others:
        try:
            files(PACKAGE)
        except PackageNotFoundError:
            print(f'{PACKAGE} is not installed: nothing is run')
            return
    arms = [f'urdf {name}' for name in OTHERS] if given.others else SHIPPED
    kinds = given.kinds.split(';') if given.kinds else LASTING if given.others else tuple(KINDS)
    cases = [*product(arms, kinds, range(given.first, given.first + given.count))]
    done = list[Outcome]()
    with ProcessPoolExecutor(given.jobs) as pool:
        for one in pool.map(one_run, cases, chunksize=given.count * len(kinds)):
            if one.others:
                print(one.others, flush=True)
            done.append(one)
    print_table(done, [one.kind for one in done])
    if not given.others:
        print_table(done, [f'{arm}, {kind}' for arm, kind, _ in cases])


if __name__ == '__main__':
    main()
