import os
import re
import shutil
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from signal import SIGHUP, default_int_handler, signal

import numpy as np
import psutil
import pytest
import ros
import yaml
from bags import contents
from places import BRINGUP
from ros2_commands import Running
from runs import ALL

from lpv import AlarmEvent, DiagnosisParameters, load_arm, load_gains, load_scenario
from lpv.bag.run.record import load_run
from lpv.cli.options import COMMANDS
from lpv.core.control.tracking import COMPENSATION
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.resources import executable
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import planar_model

LPV = Path(sys.executable).parent / 'lpv'
SEED = 2


def shortened(folder, name, *onsets, **changes):
    """File of a shipped scenario with its first faults soon, and other changes."""
    scenario = yaml.safe_load((BRINGUP / 'scenarios' / f'{name}.yaml').read_text())
    for fault, onset in zip(scenario['faults'], onsets):
        fault['onset'] = onset
    (folder / 'scenario.yaml').write_text(yaml.safe_dump({**scenario, **changes}))
    return folder / 'scenario.yaml'


def nodes_of(folder):
    lines = [' '.join(one.info['cmdline'] or ()) for one in psutil.process_iter(['cmdline'])]
    return [line for line in lines if f'{folder}/' in line and '--ros-args' in line]


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    """Output folder, terminal text and recording of the main job, shortened."""
    out = tmp_path_factory.mktemp('demo')
    scenario = shortened(out, 'two_faults', 0.5, 0.8, duration=3.6)
    words = 'demo', '--scenario', scenario, '--seed', SEED, '--out', out
    return out, ros.lpv(*words), load_run(out / 'bag')


def commands_as_offline(record, arm, run):
    """Each command of the graph is that of the loop without nodes, bit by bit; how many."""
    commands = record.get('torque_command', 'torque')
    assert commands.shape[1] == len(arm.joints) and len(commands) <= len(run.torque)
    np.testing.assert_array_equal(commands, run.torque[: len(commands)])
    return len(commands)


@pytest.mark.ros
def test_given_the_demo_when_run_then_it_is_the_loop_without_nodes_and_all_files_are_there(demo):
    """What that loop does on the whole scenario is held to the paper by `test_closed_loop`."""
    out, text, record = demo
    arm, gains = load_arm('paper'), load_gains(out / 'gains.yaml')
    scenario = replace(load_scenario(out / 'scenario.yaml'), seed=SEED)
    assert commands_as_offline(record, arm, run_closed_loop(arm, scenario, gains)) > 1750
    table = r'^ *(\w+) +(?:estimate|tracking).*?rad²\S* +\S+ +\S+ +\S+ x *$'
    signals = 'x1 x2 x3 x4 f1 f2 y1 y2 e_t1 e_t2'
    assert set(re.findall(table, text, re.MULTILINE)) == set(signals.split()), text
    place = JointMap(planar_model(load_arm('paper'))).absolute_position
    streams = 'ground_truth', 'state_estimate', 'reference'
    truth, estimate, reference = (place(record.get(one, 'position')) for one in streams)
    fault = record.get('ground_truth', 'fault') - record.get('fault_estimate', 'estimate')
    for row, error in {'x': truth - estimate, 'f': fault, 'e_t': truth - reference}.items():
        for k, value in enumerate(np.mean(error**2, axis=0), 1):
            assert re.search(rf'^ *{row}{k} .* {value:.2g} ', text, re.MULTILINE), row
    assert {record.counts[f'/lpv/{topic}'] for topic in ALL - {'fault_alarm'}} == {1801}
    raised = [a.sensor for a in record.alarms if a.event == AlarmEvent.RAISED]
    assert raised == ['link1_angle', 'link2_angle']
    report, html = out / 'report', (out / 'report' / 'report.html').read_text()
    assert str(report / 'report.html') in text and 'The certificate holds.' in html
    assert html.count('data:image/png;base64,') == 6
    assert (out / 'bag' / 'gains.yaml').read_bytes() == (out / 'gains.yaml').read_bytes()
    for name in ('timeline', 'path', 'faults', 'measured', 'states', 'torques'):
        assert (report / f'{name}.png').read_bytes().startswith(b'\x89PNG')
    assert list(yaml.safe_load((out / 'gains.yaml').read_text())['/**']) == ['ros__parameters']
    assert load_gains(out / 'gains.yaml').arm_name == 'paper'


@pytest.mark.ros
def test_given_a_signal_then_the_bag_begins_as_before_and_no_node_is_left(demo, tmp_path):
    """That others act alike, and nodes that die, are subjects of `test_commands`."""
    shutil.copy(demo[0] / 'gains.yaml', tmp_path)
    file = shortened(tmp_path, 'two_faults', 0.5, 0.8, duration=300.0)
    words = 'demo', '--scenario', file, '--seed', SEED, '--out', tmp_path
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(ros.next_domain())}
    before = signal(SIGHUP, default_int_handler)  # under nohup it would be ignored
    with Running(*words, program=[LPV], env=environment) as command:
        signal(SIGHUP, before)
        # The second alarm: the bag holds the first one even if its end is missing.
        assert 'are kept from the run before' in command.until('link2_angle: error')
        assert len(nodes_of(tmp_path)) >= 3
        command.process.send_signal(SIGHUP)
        assert command.end(600.0)[0] == 128 + SIGHUP
    assert nodes_of(tmp_path) == []
    first, again = (contents(out / 'bag')[0] for out in (demo[0], tmp_path))
    end = min(first[-1][1], again[-1][1]) - 100_000_000  # what was under way may be missing
    first, again = ([entry for entry in bag if entry[1] < end] for bag in (first, again))
    assert again == first and {topic for topic, *_ in again} >= {f'/lpv/{name}' for name in ALL}


@pytest.mark.ros
def test_given_a_serial_arm_when_shown_then_torques_are_as_offline(tmp_path, call):
    scenario, arm = shortened(tmp_path, 'ur10', 0.5, duration=1.2), load_arm('ur10')
    said = ros.lpv('demo', '--arm', 'ur10', '--scenario', scenario, '--out', tmp_path)
    assert 'ALARM, elbow_encoder: error +0.200 rad' in said
    assert (tmp_path / 'report' / 'report.html').stat().st_size > 10_000
    record = load_run(tmp_path / 'bag', joint_names=arm.joint_names)
    error = record.get('ground_truth', 'position') - record.get('reference', 'position')
    assert len(error) >= 600
    assert np.abs(error).max() < 0.02  # the true arm stayed on its path
    call('compare', tmp_path / 'bag', tmp_path / 'bag', '--exact')
    assert commands_as_offline(record, arm, run_closed_loop(arm, load_scenario(scenario))) >= 600


LAUNCH = BRINGUP / 'launch'
LAUNCH_FILES = sorted({*LAUNCH.glob('*.xml')} - {LAUNCH / 'node.launch.xml'})
"""Without the one that others include, whose variables are theirs."""


def names(tree, *tags):
    return {element.get('name') for tag in tags for element in tree.iter(tag)}


@pytest.mark.parametrize('path', LAUNCH_FILES, ids=lambda p: p.name)
def test_given_a_launch_file_when_read_then_what_it_starts_exists(path):
    tree, text = ElementTree.parse(path), path.read_text()
    nodes, includes = list(tree.iter('node')), list(tree.iter('include'))
    assert nodes or includes
    for include in includes:
        included = ElementTree.parse(path.parent / Path(include.get('file')).name)
        assert names(include, 'arg') <= names(included, 'arg')
    for node in nodes:
        if node.get('pkg').startswith('lpv_'):  # others: of a ROS 2 beside this software
            assert executable(node.get('pkg'), node.get('exec')).is_file()
    assert set(re.findall(r'\$\(var (\w+)\)', text)) <= names(tree, 'arg', 'let')
    for place in re.findall(r'\$\(find-pkg-share lpv_bringup\)/([\w/.]+)', text):
        assert (BRINGUP / place).exists() or place == 'config/', place


def test_given_nodes_in_any_namespace_when_diagnostics_are_grouped_then_each_is_in_a_group():
    given = yaml.safe_load((BRINGUP / 'config' / 'diagnostic_aggregator.yaml').read_text())
    groups = [one for one in given['/**']['ros__parameters'].values() if isinstance(one, dict)]
    for node in ('uio', 'tracker', 'arm_sim', 'recorder', 'view'):
        status = f'/cell/left/{node}: part'
        assert sum(part in status for one in groups for part in one['contains']) == 1


def test_given_the_parameter_files_when_read_then_the_defaults_are_those_of_the_code():
    choices = re.search(r'--compensation {(.*?)}', COMMANDS['demo'])[1]
    assert set(choices.split(',')) == set(COMPENSATION)
    files = [BRINGUP / 'config' / f'{name}.yaml' for name in ('diagnosis', 'realtime', 'lockstep')]
    found = [yaml.safe_load(file.read_text())['/**']['ros__parameters'] for file in files]
    assert DiagnosisParameters(**found[0]['diagnosis']) == DiagnosisParameters()
    assert found[1:] == [{'lockstep': False}, {'lockstep': True}]
