import io
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import reduce
from itertools import starmap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fault_injection import Stream, derived, with_joints
from places import BRINGUP, DATA, ROOT
from rich.console import Console
from serial_bags import ball_joint
from watched import Watched

from lpv import Fault, load_arm, load_scenario, save_gains
from lpv.bag.replay.replay import InjectedFault
from lpv.bag.run.record import RecordedAlarm
from lpv.campaign.falsify.attack import Finding
from lpv.cli import needs, progress
from lpv.cli.commands import demo, falsify, replay, view
from lpv.cli.options import COMMANDS
from lpv.core.export.urdf import arm_urdf
from lpv.core.serial_arm.diagnosis.priors import MODEL_ERROR
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.options import entries
from lpv.core.support.signals import STOPS
from lpv.core.uio.planar import planar_model

HEAVY = ('numpy', 'numba', 'scipy', 'matplotlib', 'cvxpy', 'rosbags', 'pinocchio', 'rclpy', 'rich')

HELP = f"""
import contextlib, sys
from lpv.cli.main import COMMANDS, main
for name in COMMANDS:
    with contextlib.suppress(SystemExit):
        main([name, '--help'])
print([name for name in {HEAVY} if name in sys.modules])"""


def test_given_any_command_when_asked_for_help_then_all_is_explained_and_nothing_heavy_imported():
    for name, table in COMMANDS.items():
        assert [one.name for one in entries(table.partition('\n')[2]) if not one.text] == [], name
    done = subprocess.run([sys.executable, '-c', HELP], capture_output=True, text=True, timeout=120)
    assert done.stdout.endswith('\n[]\n'), done.stderr


def test_given_no_command_or_the_version_when_run_then_it_is_said(call, capsys):
    said = call().out
    assert 'of serial robot arms' in said and 'two-link' not in said
    pytest.raises(SystemExit, call, '--version').match('^0$')
    assert capsys.readouterr().out.startswith('lpv ')


def test_given_work_that_takes_long_when_there_is_no_terminal_then_it_is_said(monkeypatch):
    said = io.StringIO()
    monkeypatch.setattr(progress, 'QUIET', 0.0)
    monkeypatch.setattr(progress, 'PATIENCE', 0.001)
    monkeypatch.setattr(sys, 'stderr', said)
    with progress.announced('lpv identify: identify an arm'):
        end = time.monotonic() + 100.0
        while said.getvalue().count('\n') < 3 and time.monotonic() < end:
            time.sleep(0.005)
    first, second, *_ = said.getvalue().splitlines()
    assert first == 'lpv identify: identify an arm ...' and second.endswith(' s')
    # Lines say how far a bar is.
    monkeypatch.setattr(progress, 'PATIENCE', 0.0)
    with progress.bar(Console(file=said, width=100), 'runs', 200, 50) as show:
        show(51)
        show(60, 'best 0.5')
    for line in ('runs: 51 of 200', 'runs: 60 of 200  best 0.5'):
        assert line in said.getvalue()


def test_given_gains_as_before_then_no_solver_runs(tmp_path, paper_arm, paper_gains, monkeypatch):
    monkeypatch.setitem(sys.modules, 'lpv_design.design_flow', None)
    file, console = tmp_path / 'gains.yaml', Console(file=io.StringIO())
    save_gains(paper_gains, file, demo._design_key(paper_arm, 'paper') + '\nholds: all')
    assert demo._designed(paper_arm, 'paper', tmp_path, console) == file
    assert 'all 1 checks' in console.file.getvalue()
    changed = re.sub('kappa: .*[0-9]', 'kappa: [1.0, 1.0', file.read_text(), count=1)
    for requirement, text in (('paper_literal', file.read_text()), ('paper', changed)):
        file.write_text(text)
        pytest.raises(ImportError, demo._designed, paper_arm, requirement, tmp_path, console)


def test_given_an_arm_whose_loop_is_not_certified_when_told_then_it_is_all_that_is_said():
    arm, console = load_arm(BRINGUP / 'arms' / 'ur10.yaml'), Console(file=io.StringIO(), width=200)
    assert demo._shipped(arm, console) is not None
    assert demo._shipped(replace(arm, name='six'), console) is None
    assert console.file.getvalue().endswith(' its loop has no certificate\n')


def test_given_joints_when_findings_are_told_then_each_size_has_its_unit(paper_arm, capsys):
    arm = with_joints(paper_arm, 1, type='prismatic')
    fault = Fault('link2_angle', 'bias', 1.0, size=0.1)
    kinds = (('bias', 0.02), ('rate_bias', None), ('dropout', None))
    said = [RecordedAlarm(0, 1, 'link2_angle', 0, 0, 0.12, 0.03, kind, 1.0) for kind, _ in kinds]
    found = [InjectedFault(fault, True, ('x',), 0.1, a, off) for a, (_, off) in zip(said, kinds)]
    replay.show_injected(found, arm, Console(width=200))
    told = capsys.readouterr().out
    others = '; wrongly alarmed, too: x\n'
    assert f'+0.1200 m (bound 0.0300 m), size error +0.0200 m{others}' in told
    assert f'as rate_bias, +0.1200 m/s (bound 0.0300 m/s){others}' in told
    assert f'as dropout{others}' in told
    worst = Finding(np.array([0.5, 0.7]), np.array([0.2, 0.1]), np.ones(2), False, None)
    falsify._conclude(SimpleNamespace(arm=arm), [worst])
    told = capsys.readouterr().out
    assert 'link1_angle: 0.500 of 0.2000 rad\nlink2_angle: 0.700 of 0.1000 m\n' in told
    assert told.endswith('reached 0.700 of its threshold, 0.1000 m, at 1.00 s\n')


@pytest.fixture
def launch(tmp_path, monkeypatch):
    program, scenario = tmp_path / 'ros2', load_scenario('ur10')
    monkeypatch.setattr(demo.shutil, 'which', lambda *_, **__: str(program))

    def run(script='', console=None):
        program.write_text(f'#!/bin/sh\n{script}\n')
        program.chmod(0o755)
        given = SimpleNamespace(domain_id=None, mode='lockstep', seed=-1, compensation='off')
        return demo._run_graph(given, {}, tmp_path, scenario, console or Console(quiet=True))

    return run


def test_given_an_empty_domain_when_the_demo_runs_then_it_has_one(tmp_path, monkeypatch, launch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '')
    launch('echo $ROS_DOMAIN_ID')
    assert 1 <= int((tmp_path / 'launch.log').read_text()) <= 100


@pytest.mark.usefixtures('signals_as_before')
@pytest.mark.parametrize('number', STOPS)
def test_given_a_signal_then_the_launch_has_ended_before_it(tmp_path, monkeypatch, launch, number):
    console, script = Console(quiet=True), f"trap 'echo > {tmp_path}/ended; exit' INT; echo ALARM"

    def tell(text='', **_):
        if 'ALARM' in str(text):
            signal.raise_signal(number)

    monkeypatch.setattr(console, 'print', tell)
    with pytest.raises((KeyboardInterrupt, SystemExit)) as stopped:
        launch(f'{script}; while :; do sleep 0.02; done', console)
    assert number == signal.SIGINT or stopped.value.code == 128 + number
    assert (tmp_path / 'ended').exists()


def test_given_a_node_that_dies_when_the_demo_runs_then_it_says_so(tmp_path, launch):
    died, over = '[ERROR] [uio-3]: process has died [pid 7]', 'echo the scenario is over'
    for script in (f'echo "{died}"; {over}', f'{over}; exit 1', 'true'):
        assert launch(script).startswith('a node has died, or hangs; ')
        assert ('died' in (tmp_path / 'launch.log').read_text()) == (died in script)
    assert launch(over) == ''


def test_given_a_bag_of_others_when_the_demo_runs_then_it_stays(
    tmp_path, monkeypatch, call, refused
):
    monkeypatch.setattr(demo, 'require_ros', lambda: None)
    monkeypatch.setattr(demo, '_designed', lambda *_: None)
    (tmp_path / 'bag').mkdir()
    assert refused('was not written by this command', 'demo', '--out', tmp_path)
    assert (tmp_path / 'bag').is_dir()
    (tmp_path / 'launch.log').touch()  # as an earlier run has written it
    call('demo', '--out', tmp_path, code=1)
    assert not (tmp_path / 'bag').exists()


@pytest.mark.parametrize(('arm', 'scenario'), [('paper', 'two_faults'), ('ur10', 'ur10')])
def test_given_no_scenario_then_it_is_that_of_the_arm(tmp_path, monkeypatch, call, arm, scenario):
    run = []
    monkeypatch.setattr(demo, 'require_ros', lambda: None)
    monkeypatch.setattr(demo, '_designed', lambda *_: tmp_path)
    monkeypatch.setattr('lpv.core.simulation.precompile.precompile', lambda *_: None)
    monkeypatch.setattr(demo, '_run_graph', lambda _, files, *others: run.append(files) or 'no')
    call('demo', '--arm', arm, '--out', tmp_path, code=1)
    assert [files['scenario'].stem for files in run] == [scenario]


@pytest.mark.parametrize('name', ['cell/left', '/cell/left/', '/cell/left'])
def test_given_a_namespace_when_viewed_then_slashes_at_its_ends_do_not_count(monkeypatch, name):
    lines = []
    monkeypatch.setattr(view.start, 'require_ros', lambda: None)
    monkeypatch.setattr(view.start, 'executable', lambda *names: '/bin/view')
    monkeypatch.setattr(view.start, 'stay_local', lambda: None)
    monkeypatch.setattr('os.execv', lambda _, line: lines.append(line))
    given = {'arm_file': 'paper.yaml', 'scenario': None, 'namespace': name, 'domain_id': None}
    view.run(SimpleNamespace(**given, address='127.0.0.1', port=8090, foxglove_port=8765))
    assert '__ns:=/cell/left' in lines[0]


@pytest.fixture
def init(tmp_path, call):
    """Calls the command for a new folder, with the text of a URDF; the arm and what it prints."""

    def run(*options, urdf=None):
        if urdf:
            (tmp_path / 'arm.urdf').write_text(urdf)
            options = ('--urdf', tmp_path / 'arm.urdf', *options)
        said = call('init', tmp_path / 'new', *options).out
        return load_arm(tmp_path / 'new' / 'arm.yaml'), said

    return run


@pytest.mark.slow
def test_given_an_empty_folder_when_initialised_then_a_design_holds(tmp_path, init, call):
    arm, said = init('--name', 'bench')
    assert arm.name == 'bench' and 'lpv design --arm' in said
    written = re.findall('--out (.*)', said)
    assert len(written) == 3 and not any(Path(path).exists() for path in written)
    names = 'arm', 'requirement', 'gains', 'scenario'
    file, requirement, gains, scenario = (tmp_path / 'new' / f'{name}.yaml' for name in names)
    load_scenario(scenario).path(arm)
    call('design', '--arm', file, '--requirement', requirement, '--out', gains)
    call('verify', gains, '--arm', file)


@pytest.mark.parametrize(('name', 'joints', 'effort'), [
    ('ur10', 6, '330.0'), ('panda', 7, ''), ('ur10', 6, '90.0'),
])  # fmt: skip
def test_given_a_serial_urdf_when_initialised_then_it_fits(tmp_path, init, name, joints, effort):
    # At the last effort drives do not hold the arm in the middle of its ranges.
    text = (BRINGUP / 'urdf' / f'{name}.urdf').read_text()
    text = text.replace('effort="330.0"', f'effort="{effort}"')
    arm, said = init('--name', 'bench', urdf=text)
    assert (arm.name, len(arm.joint_names)) == ('bench', joints) and 'lpv demo --arm' in said
    path = load_scenario(tmp_path / 'new' / 'scenario.yaml').path(arm)
    assert np.ptp(path.sample(np.linspace(0.0, 12.0, 50)).position, axis=0).min() > 0.1


@pytest.mark.parametrize(('name', 'seed'), [('panda', 3), ('ur10', 1)])
def test_given_an_initialised_arm_when_slow_messages_hold_a_drives_noise_then_no_encoder_is_blamed(
    tmp_path, init, name, seed
):
    arm, _ = init(urdf=(BRINGUP / 'urdf' / f'{name}.urdf').read_text())
    scenario = load_scenario(tmp_path / 'new' / 'scenario.yaml')
    changed = replace(scenario, faults=(), seed=seed, parameter_error=0.05, duration=4.0)
    run, every = run_closed_loop(arm, changed), slice(None, None, 25)
    stamps, signals = np.round(1e9 * run.time), (run.measured, run.measured_velocity, run.effort)
    slow = derived(Stream(stamps.astype(np.int64)[every], np.stack(signals, 1)[every]))
    monitor = Watched(replace(arm, sample_time=25 * arm.sample_time))
    monitor.take(slow.stamps, slow.samples)
    assert monitor.alarms == []


def test_given_a_folder_with_a_space_when_initialised_then_shells_read_its_commands(tmp_path, call):
    said = call('init', tmp_path / 'my arm').out
    lines = [shlex.split(line) for line in said.splitlines() if line.startswith('  lpv')]
    assert [line[line.index('--arm') + 1] for line in lines] == 4 * [f'{tmp_path}/my arm/arm.yaml']


def test_given_a_slow_lift_when_initialised_then_its_path_is_as_slow(tmp_path, init):
    lift = '<limit lower="0" upper="0.4" velocity="0.013" effort="9000"/>'
    urdf = re.sub('<limit [^>]*>', lift, GRIPPER.replace('"revolute"', '"prismatic"', 1), count=1)
    arm, _ = init(*HELD, urdf=urdf)
    assert (arm.joints[0].type, arm.velocity_limit[0]) == ('prismatic', 0.013)
    path = load_scenario(tmp_path / 'new' / 'scenario.yaml').path(arm)
    motion = path.sample(np.linspace(0.0, 12.0, 500))
    assert np.ptp(motion.position, axis=0).min() > 0.01
    # The tracker would stop at 0.7.
    assert np.abs(motion.velocity).max(axis=0)[0] < 0.65 * arm.velocity_limit[0]


def test_given_what_a_simulator_adds_when_initialised_then_it_is_left_out(init):
    """Attributes and elements of its own, whose prefix is not declared; limits beyond any drive."""
    urdf = re.sub('velocity="[^"]*"', 'velocity="50000" drake:acceleration="9"', GRIPPER, count=1)
    arm, _ = init(*HELD, urdf=urdf.replace('</robot>', '<drake:chain/></robot>'))
    assert arm.velocity_limit[0] == 100.0  # as of a joint without a limit


@pytest.mark.parametrize(('changes', 'told'), [
    ((('damping="0.5"', 'damping="5e4"'), ('"500"', '"1e6"')),
     r'before it is simulated: joints\[.*rotor_inertia: is too small'),
    ((('ixx="0.1"', 'ixx="0.9"', 2),), '.*no body has the inertia of the link of shoulder'),
    ((('"one"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>',
       '"one"><inertial><mass value="0"/>'),), 'the link of shoulder has no mass'),
    ((('upper="1"', 'upper="150"', 1),), 'shoulder may go to 150 rad: degrees, or mm'),
    ((), 'joints a, c turn the same body in some poses'),  # between which links have no mass
])  # fmt: skip
def test_given_an_odd_urdf_when_initialised_then_it_is_warned(tmp_path, call, changes, told):
    urdf, options = (GRIPPER, HELD) if changes else (arm_urdf(ball_joint()), [])
    urdf = reduce(lambda text, one: text.replace(*one), changes, urdf)
    (tmp_path / 'arm.urdf').write_text(urdf)
    err = call('init', tmp_path / 'new', '--urdf', tmp_path / 'arm.urdf', *options).err
    assert re.search(f'warning: {told}', err) and err.count('warning') == 1


@pytest.mark.parametrize('zero', [None, 0.0, np.pi / 3, np.pi])
def test_given_a_urdf_when_initialised_then_the_arm_is_that_of_the_urdf(init, paper_arm, zero):
    model, wanted = planar_model(paper_arm), paper_arm
    if zero is not None:
        model = replace(model, zero_angle=zero)
        wanted = two_link_arm(model)
    arm, _ = init(urdf=arm_urdf(wanted))
    found = planar_model(arm)
    assert arm.uncertainty.model_error is None  # nobody has measured it
    assert found.model_error == MODEL_ERROR
    for one, other in zip(found.links, model.links):
        assert vars(one) == pytest.approx(vars(other))
    assert np.cos(found.zero_angle - model.zero_angle) == pytest.approx(1.0)
    assert arm.joint_names == wanted.joint_names
    assert arm.torque_limit == pytest.approx(wanted.torque_limit)


@pytest.mark.parametrize(('limit', 'kind'), [(1.9, 'x'), (1.0, 'joints')])
def test_given_a_planar_arm_that_hardly_reaches_up_when_initialised_then_its_path_is_admitted(
    init, paper_arm, tmp_path, limit, kind
):
    urdf = arm_urdf(paper_arm).replace('"continuous"', '"revolute"')
    arm, _ = init(urdf=urdf.replace('<limit ', f'<limit lower="-{limit}" upper="{limit}" '))
    scenario = tmp_path / 'new' / 'scenario.yaml'
    assert f' {kind}: ' in scenario.read_text() and arm.joints[0].limits.upper == limit
    load_scenario(scenario).path(arm)


def test_given_links_in_no_vertical_plane_when_initialised_then_it_has_no_region(init, paper_arm):
    arm, _ = init(urdf=arm_urdf(paper_arm).replace('xyz="0 -1.0 0"', 'xyz="0 0 1"'))
    assert [joint.axis for joint in arm.joints] == [(0.0, 0.0, 1.0)] * 2 and arm.lpv is None


def jointed(parent, link, x=0, kind='fixed'):
    ends = f'<parent link="{parent}"/><child link="{link}"/><origin xyz="{x} 0 0"/>'
    return f'<link name="{link}"/><joint name="{link}" type="{kind}">{ends}</joint>'


GRIPPER = (DATA / 'gripper.urdf').read_text()
HOLDS = ['--lock left_finger=0.02 --lock right_finger',
         '--lock left_finger=0.02,right_finger', '--joints shoulder,elbow,wrist',
         '--joints shoulder elbow wrist', '--tip tool']  # fmt: skip
HELD = HOLDS[-1].split()
SIDES = 'tool', 'other tool'


@pytest.mark.parametrize('options', HOLDS)
def test_given_a_gripper_when_held_then_the_arm_has_the_others_and_their_friction(init, options):
    arm, _ = init(*options.split(), urdf=GRIPPER)
    assert (arm.name, arm.joint_names) == ('my_arm', ('shoulder', 'elbow', 'wrist'))
    assert dict(arm.locked).keys() == {'left_finger', 'right_finger'}
    assert dict(arm.locked)['left_finger'] == (0.02 if '--lock' in options else 0.0)
    friction = [(j.friction.viscous, j.friction.coulomb) for j in arm.joints]
    assert friction == [(0.5, 0.25), (0.0, 0.0), (0.0, 0.0)]
    if '--tip' in options:
        assert arm.tip == (0.0, 0.0, 0.3)


def test_given_two_arms_when_initialised_then_their_names_differ(init, tmp_path):
    body, head = GRIPPER.split('<joint', 1)[0], GRIPPER.split('</robot>')[0]
    links = ''.join(re.findall('(?s)<link.*?</link>', body)[1:])
    joints = ''.join(re.findall('(?s)<joint.*?</joint>', GRIPPER))
    other = re.sub('(name|link)="(?!base")', r'\1="other ', links + joints)
    neck = jointed('base', 'neck', 0, 'continuous') + jointed('neck', 'face', 0, 'continuous')
    names = []
    for tip, more in (('tool', ''), ('tool', neck), *((side, other) for side in SIDES)):
        arm, _ = init('--tip', tip, urdf=f'{head}{more}</robot>')
        names.append((arm.name, arm.joint_names[0]))
        shutil.rmtree(tmp_path / 'new')
    alone, headed, *both = names
    assert alone == headed == ('my_arm', 'shoulder')
    assert both == [('my_arm_tool', 'shoulder'), ('my_arm_other_tool', 'other shoulder')]


@pytest.mark.parametrize(('frames', 'tip', 'other', 'x'), [
    ((('tool', 'mount', 0), ('mount', 'tcp', 0.2), ('hand', 'zz', 1)), 'tcp', 'zz', 0.2),
    ([('left', 'pad')], 'tool', 'pad', 0.0),  # a finger that is deeper than the tool
])  # fmt: skip
def test_given_links_on_the_wrist_then_the_tip_is_the_deepest(init, frames, tip, other, x):
    urdf = GRIPPER.replace('</robot>', ''.join(starmap(jointed, frames)) + '</robot>')
    arm, said = init('--joints', 'shoulder,elbow,wrist', urdf=urdf)
    assert f'tip: {tip}, where loads sit; --tip names another: ' in said and f' {other}' in said
    assert arm.tip == pytest.approx((x, 0.0, 0.3))


def test_given_a_urdf_with_friction_when_a_motion_is_planned_then_torques_hold_it(tmp_path, call):
    (tmp_path / 'arm.urdf').write_text(GRIPPER.replace('friction="0.25"', 'friction="300"'))
    options = '--urdf', tmp_path / 'arm.urdf', '--out', tmp_path / 'motion', '--trials', 1
    said = call('excite', *options, *HELD).out
    assert float(re.search(r'shoulder: largest torque (\S+) N m', said)[1]) > 300.0
    # A floor of no height would be none.
    again = *options[:3], tmp_path / 'other', '--lowest', 'nan'
    assert '--lowest: must lie within' in call('excite', *again, *HELD, code=2).err
    assert not (tmp_path / 'other').exists()


NAMES = ('left: j1', 'left, j1', 'left #1', '{left}_j1', '*j1', '${prefix}j1', "it's", '1e5')


@pytest.mark.parametrize('name', NAMES)
def test_given_a_joint_of_any_name_when_initialised_then_its_sensor_fails(tmp_path, init, name):
    arm, _ = init(*HELD, urdf=GRIPPER.replace('"shoulder"', f'"{name}"'))
    scenario = load_scenario(tmp_path / 'new' / 'scenario.yaml')
    assert scenario.faults[0].sensor == arm.sensor_names[0] == f'{name}_encoder'


LINKS = ['tool', *(f'more{k}' for k in range(40))]
MORE = ''.join(jointed(*pair, 0, 'continuous') for pair in zip(LINKS, LINKS[1:]))
"""Forty more joints behind the tool."""


def test_given_what_cannot_be_used_when_initialised_then_it_is_named(tmp_path, refused):
    urdf, new = tmp_path / 'arm.urdf', tmp_path / 'new'
    for old, bad, options, said in (
        ('', '', [], "off 'wrist' beside left_finger: the arm is not a chain; lock"),
        ('parent link="two"', 'parent link="base"', [], 'off the base beside shoulder: the arm'),
        ('', '', ['--lock', 'left_finger=open'], "'open' is not a number"),
        ('', '', ['--lock', 'left_finger=nan'], "'nan' is not a number"),
        ('', '', ['--lock', 'thumb', '--joints', 'elbow'], "no moving joint 'thumb'"),
        ('', '', [*HELD, '--joints', 'elbow'], 'give one of them'),
        ('<mass value="2"', '<mass value="heavy"', HELD, 'mass'),
        ('child link="one"', 'child link="nix"', HOLDS[0].split(), 'link [nix] of joint'),
        ('effort="500"', 'effort="0.1"', HELD, 'N m of shoulder, whose limit is 0.1'),
        ('<robot', '<!DOCTYPE x [<!ENTITY y "z">]><robot', HELD, 'document type'),
        ('</robot>', '', HELD, 'no element found'),
        ('</robot>', MORE + '</robot>', ['--tip', 'more39'], 'more than 32; lock what is not of'),
        ('damping="0.5"', 'damping="-1"', HELD, "'shoulder': damping must not be negative"),
    ):
        assert old in GRIPPER
        urdf.write_text(GRIPPER.replace(old, bad))
        assert refused(said, 'init', new, '--urdf', urdf, *options) and not new.exists()
    urdf.write_text(re.sub('<inertial>.*?</inertial>', '', GRIPPER, flags=re.DOTALL))
    assert refused('shoulder moves no mass', 'excite', '--urdf', urdf, '--out', new, *HELD)
    # Files that are there are not overwritten.
    (tmp_path / 'scenario.yaml').write_text('mine')
    assert refused('exists already', 'init', tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {'scenario.yaml', 'arm.urdf'}


def test_given_a_missing_module_when_explained_then_its_installation_is_named(monkeypatch):
    for said, *modules in (
        ('make setup-extras', 'pyarrow.parquet', 'optuna'),
        ('ROS 2 is needed', 'lpv_msgs.msg', 'rclpy'),
        ('pip install rich', 'rich'),
        ('lpv_design, which designs gains, is not installed', 'lpv_design.main'),
    ):
        assert all(said in needs.remedy(module) for module in modules)
    monkeypatch.setattr('lpv.cli.needs.installed_version', lambda name: '0.1.0')
    assert "pip install 'lpv-arm-fdi[campaign]'" in needs.remedy('pyarrow.parquet')


def test_given_a_checkout_with_a_space_in_its_path_when_set_up_then_it_is_refused_at_once(tmp_path):
    script = tmp_path / 'my checkout' / 'tools' / 'setup.sh'
    script.parent.mkdir(parents=True)
    script.write_text((ROOT / 'tools' / 'setup.sh').read_text())
    done = subprocess.run(['bash', script], capture_output=True, text=True)
    assert done.returncode == 1 and 'contains a space' in done.stderr
    assert not (tmp_path / 'my checkout' / '.venv').exists()
