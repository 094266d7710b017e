"""Arms of others' URDFs, as `lpv init` takes them, in closed loops: healthy, and with one fault.

    python benchmarks/urdf_arms.py --count 4 --jobs 2

The URDFs are those of the package example-robot-data.  They state neither rotors nor sensors:
joints are light, rates are differences of noisy readings, and a frozen reading soon makes drives
brake.  The true arms are 5 % off their files.
"""

import argparse
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from io import StringIO
from itertools import product
from pathlib import Path

import numpy as np

from lpv import AlarmEvent, Fault, Scenario, SerialArm, load_arm, load_scenario
from lpv.cli.main import main as lpv
from lpv.core.simulation.closed_loop import Run, run_closed_loop
from lpv.core.support.errors import ConfigError

PACKAGE = 'example-robot-data'
ARMS = {
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
KINDS = ('healthy', 'bias', 'drift', 'scale', 'stuck')
SIZE = 0.2
"""Of offsets [rad], drifts [rad/s] and scale errors."""


@cache
def described(name: str) -> tuple[SerialArm, Scenario]:
    """The arm and the first run that the command writes for a URDF."""
    urdf = next(one.locate() for one in files(PACKAGE) or () if one.name == f'{name}.urdf')
    tip = ['--tip', ARMS[name]] if ARMS[name] else []
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()) as said:
        with redirect_stderr(said):
            code = lpv(['init', folder, '--urdf', str(urdf), *tip])
        if code:
            raise SystemExit(f'{name}: {said.getvalue()}')
        return load_arm(Path(folder) / 'arm.yaml'), load_scenario(Path(folder) / 'scenario.yaml')


def one_run(case: tuple[str, str, int]) -> tuple[str, bool, str, tuple[float, float] | None]:
    """Kind of the fault, whether it was named, what others were blamed with, `after_brakes`."""
    name, kind, seed = case
    (arm, scenario), rng = described(name), np.random.default_rng(seed)
    joint, onset = int(rng.integers(len(arm.joints))), float(rng.uniform(4.5, 8.0))
    size = SIZE * float(rng.choice([-1, 1])) * (1.0 if kind == 'scale' else arm.joints[joint].scale)
    given = {'drift': {'rate': size}, 'stuck': {}}.get(kind, {'size': size})
    sensor = arm.sensor_names[joint]
    faults = () if kind == 'healthy' else (Fault(sensor, kind, onset, **given),)
    scenario = replace(scenario, faults=faults, seed=seed, parameter_error=0.05)
    try:
        run = run_closed_loop(arm, scenario)
    except ConfigError as error:
        return 'not simulated', False, f'{name}, seed {seed}, {kind}: {error}', None
    raised = [one for one in run.alarms if one.event == AlarmEvent.RAISED]
    others = [f'{a.sensor} {a.kind}' for a in raised if not faults or a.sensor != sensor]
    text = f'{name}, seed {seed}, {kind} of {sensor}: {", ".join(others)}' if others else ''
    named = any(one.sensor == sensor for one in raised)
    return kind, named, text, after_brakes(run, joint, onset) if kind == 'stuck' else None


def after_brakes(run: Run, joint: int, onset: float) -> tuple[float, float] | None:
    """Of samples from 0.2 s after drives braked: shares out of the bounds, and trusted then."""
    braked = run.braked & (run.time > onset)
    later = braked & (run.time > run.time[braked.argmax()] + 0.2)
    if not later.any():
        return None
    outside = (np.abs(run.fault_estimate - run.fault) > run.threshold)[later, joint]
    trusted = outside & run.trustworthy[later]
    return float(outside.mean()), float(trusted.mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--count', type=int, default=1, help='runs of each kind and arm')
    parser.add_argument('--first', type=int, default=1, help='seed of the first run')
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    given = parser.parse_args()
    try:
        files(PACKAGE)
    except PackageNotFoundError:
        print(f'{PACKAGE} is not installed: nothing is run')
        return
    cases = product(ARMS, KINDS, range(given.first, given.first + given.count))
    runs, named, blamed = Counter[str](), Counter[str](), Counter[str]()
    held = []
    with ProcessPoolExecutor(given.jobs) as pool:
        done = pool.map(one_run, cases, chunksize=given.count * len(KINDS))
        for kind, was_named, others, outside in done:
            runs[kind] += 1
            named[kind] += was_named
            blamed[kind] += bool(others) and kind in KINDS
            if others:
                print(others, flush=True)
            if outside is not None:
                held.append(outside)
    for kind in runs:
        print(f'{kind}: {runs[kind]} runs, {named[kind]} named, {blamed[kind]} blame others')
    if held:
        outside, trusted = np.mean(held, axis=0)
        print(f'after brakes, {len(held)} runs: outside {outside:.1%}, trusted so {trusted:.1%}')


if __name__ == '__main__':
    main()
