import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from places import BRINGUP
from rclpy.qos import qos_profile_sensor_data
from rosbags.highlevel import AnyReader
from runs import ALL
from test_restart import rig_on

from lpv import AlarmEvent
from lpv.bag.run.record import load_run
from lpv.campaign.execution import run_to_bag, runs
from lpv.campaign.plan.campaign import resolve
from lpv_arm_sim.node import SimulatorNode
from lpv_msgs import msg, srv
from lpv_node import managed, qos
from lpv_node.recorder.node import RecorderNode
from lpv_node.view.node import ViewNode
from lpv_tracker.node import TrackerNode
from lpv_uio.node import UioNode

pytestmark = pytest.mark.ros
PAPER = {'arm': BRINGUP / 'arms' / 'paper.yaml', 'gains': BRINGUP / 'gains' / 'paper.yaml'}
ARM = f'-p arm_file:={PAPER["arm"]}'
SCENARIO = f'{ARM} -p scenario_file:='
UR10 = f'-p arm_file:=ur10 --params-file {BRINGUP}/gains/panda.yaml'
CALM = """
name: calm
duration: 600.0
path: {waypoints: [{t: 0.5, x: -0.8451, y: 1.5893}, {t: 20.0, x: 0.8451, y: 1.5893}]}
"""
WRONG = '--params-file wrong.yaml'
UNKNOWN = 'diagnosis.sigma: is not a known parameter; known here: '
NOWHERE = 'there is no file /nowhere/gains.yaml; gains of an arm '


def test_given_a_graph_when_a_fault_is_injected_then_the_alarm_is_on_topic_and_in_bag(tmp_path):
    with rig_on(tmp_path, PAPER, lockstep=True, scenario=CALM) as rig:
        rig.start('recorder')
        rig.start('uio', 'tracker', 'simulator', parameters=['await_recorders:=1'])
        client = rig.client
        alarms = client.listen(msg.FaultAlarm, 'fault_alarm', qos.latched())
        states = client.listen(msg.StateEstimate, 'state_estimate', qos_profile_sensor_data)
        reports = client.listen(DiagnosticArray, '/diagnostics', 10)

        def errors():
            said = (s for report in reports for s in report.status if '/uio:' in s.name)
            return [one for one in said if one.level == DiagnosticStatus.ERROR]

        assert client.wait(lambda: len(states) > 100), 'no estimates'
        fault = {'sensor': 'link2_angle', 'kind': 'bias', 'size': 0.3}
        answer = client.call(srv.InjectFault, 'arm_sim/inject_fault', **fault)
        assert answer.success, answer.message
        assert client.wait(lambda: alarms and errors()), rig.log('uio')
        cleared = client.call(srv.ClearFaults, 'arm_sim/clear_faults', sensor='')
        assert (cleared.success, cleared.cleared) == (True, 1)
        assert client.wait(lambda: alarms[-1].event == msg.FaultAlarm.CLEARED), 'not cleared'
        ros.end(rig.running)
    raised = alarms[0]
    assert (raised.event, raised.sensor) == (msg.FaultAlarm.RAISED, 'link2_angle')
    assert raised.size == pytest.approx(0.3, abs=0.1)
    assert {s.hardware_id for s in errors()} == {'link2_angle'}, errors()
    with AnyReader([tmp_path / 'bag1']) as reader:
        (connection,) = (c for c in reader.connections if c.topic == '/lpv/fault_alarm')
    assert (connection.msgtype, connection.msgdef.format.name) == ('lpv_msgs/msg/FaultAlarm', 'MSG')
    record = load_run(tmp_path / 'bag1')
    assert len(record.alarms) == connection.msgcount
    first, size = record.alarms[0], record.get('fault_estimate', 'estimate')[:, 1]
    assert (first.event, first.sensor, first.size) == (raised.event, raised.sensor, raised.size)
    assert np.nanmax(size) == pytest.approx(0.3, abs=0.1)


@pytest.mark.parametrize(('kind', 'words', 'told'), [
    (UioNode, '', 'arm_file: must be set'), (UioNode, '-p arm_file:=/nowhere.yaml', 'nowhere.yaml'),
    (UioNode, '-p arm_file:=~/nowhere.yaml', f"'{Path.home()}/nowhere.yaml' is neither"),
    (UioNode, f'-p arm_file:={BRINGUP / "arms" / "real_arm.yaml"}', 'for another arm'),
    (UioNode, f'{ARM} -p torque_source:=guess', 'torque_source'),
    (UioNode, f'{ARM} -p diagnosis.sigma:=5.0', f'{UNKNOWN}hours_between_false_alarms, '),
    (UioNode, '-p broken', '--ros-args: '), (UioNode, '--nix', '--ros-args: '),
    (UioNode, '-r __ns:=/lpv/', '--ros-args: '),
    (UioNode, '--params-file /nowhere/gains.yaml', f'{NOWHERE}are written by: lpv design'),
    (UioNode, '--params-file /nowhere/gains/nix.yaml', 'is a shipped arm or a file, NAME.yaml'),
    (UioNode, f'{ARM} {WRONG}', 'the certificate does not hold: observer, link 1'),
    (TrackerNode, f'{SCENARIO}two_faults {WRONG}', 'does not hold: observer, link 1'),
    (TrackerNode, f'{UR10} -p scenario_file:=ur10', 'designed for another arm'),
    (TrackerNode, f'{SCENARIO}/nowhere.yaml', 'nowhere.yaml'),
    (SimulatorNode, ARM, 'must be set, for launch files as scenario_file:=...'),
    (RecorderNode, '-p output:=/proc/nothing/bag', 'cannot be written'),
    (RecorderNode, f'-p output:=bag -p gains_file:={PAPER["arm"]}', 'not a gains file'),
    (RecorderNode, '-p output:=/', 'output: is the root of all folders'),
    (RecorderNode, '-p output:=bag -p topics:=["/a//b"]', "topics: '/a//b': failed to resolve"),
    (ViewNode, f'{ARM} -p port:=70000', 'port'), (ViewNode, '', 'arm_file: must be set'),
    (ViewNode, f'{SCENARIO}/no/x.yaml', 'neither a file nor shipped'),
    (ViewNode, f'{ARM} -p address:=192.0.2.1 -p port:=0', 'cannot listen on 192.0.2.1'),
])  # fmt: skip
@pytest.mark.usefixtures('signals_as_before')
def test_given_a_node_that_cannot_start_when_run_then_it_says_why_and_ends_with_code_1(
    tmp_path, capfd, monkeypatch, paper_gains, kind, words, told
):
    monkeypatch.chdir(tmp_path)
    wrong = replace(paper_gains.observer, kappa=3.0 * paper_gains.observer.kappa)
    replace(paper_gains, observer=wrong).save('wrong.yaml')
    given = ['--ros-args', *words.split()]
    if kind in (UioNode, TrackerNode) and '--params-file' not in words:
        given += ['--params-file', str(PAPER['gains'])]
    monkeypatch.setattr(sys, 'argv', given)
    assert managed.run_node(kind) == 1
    said = capfd.readouterr().err
    assert told in said and 'Traceback' not in said, said
    assert [path.name for path in tmp_path.iterdir()] == ['wrong.yaml'], 'no bag'


SPEC = {
    'name': 'graph', 'seed': 2, 'plan': {'method': 'random', 'runs': 4}, 'duration': 2.5,
    'arm': 'ur10', 'scenario': 'ur10', 'substeps': 3,
    'factors': {
        'path': 'random',
        'fault.kind': 'dropout',  # the arm is stopped, and led back to its path
        'fault.sensor': 'both', 'fault.onset': {'low': 1.2, 'high': 1.6}, 'fault.duration': 0.5,
        'parameter_error': 0.05, 'payload': 1.5, 'friction': 1.3, 'noise': 1.5,
        'compensation': ['confirmed', 'always'], 'diagnosis.sigmas': 5.0,
    },
}  # fmt: skip


def test_given_a_run_of_a_campaign_when_the_graph_runs_it_then_it_is_that(tmp_path):
    """That of an arm without a region; one with a region is the subject of `test_demo`."""
    plan = runs.plan_run(resolve(SPEC, 'spec', tmp_path), 2)
    run, files = plan.simulate(), tmp_path / 'run'
    assert run.safe_stop.any()
    run_to_bag.write_run_bag(plan, run, files)
    scenario, gains = f'scenario_file:={files}/scenario.yaml', BRINGUP / 'gains' / 'ur10.yaml'
    others = f'arm_file:={files}/arm.yaml', 'await_recorders:=1'
    with ros.graph(tmp_path / 'log') as running:
        for name, given, *more in (
            ('recorder', [f'output:={tmp_path}/graph']),
            ('uio', others, gains),
            ('tracker', [scenario, *others], gains),
            ('simulator', [scenario, *others, 'shutdown_at_end:=true']),
        ):
            line = ros.command(name, *given, files=[files / 'parameters.yaml', *more])
            node = running.start(name, line)
        assert node.process.wait(1000) == 0
        ros.end(running)
    names = {'joint_names': plan.arm.joint_names}
    record, first = (load_run(bag, **names) for bag in (tmp_path / 'graph', files))
    for stream in ALL - {'fault_alarm'}:
        np.testing.assert_array_equal(record.stamps[stream], first.stamps[stream], stream)
        for field, values in record.streams[stream].items():
            expected, name = first.get(stream, field), f'{stream}.{field}'
            np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-12, err_msg=name)
    assert record.alarms == first.alarms
    raised = {a.sensor for a in run.alarms if a.event == AlarmEvent.RAISED}
    assert raised == {fault.sensor for fault in plan.scenario.faults}
