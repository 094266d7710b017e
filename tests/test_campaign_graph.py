"""A run of a campaign and a run of the graph are the same run."""

import numpy as np
import pytest
import ros

from lpv.bag.run.record import load_run
from lpv.campaign.execution.run_to_bag import write_run_bag
from lpv.campaign.execution.runs import plan_run
from lpv.campaign.plan.campaign import resolve
from lpv import AlarmEvent, save_gains

pytestmark = pytest.mark.ros

SPEC = {
    'name': 'graph',
    'seed': 2,
    'plan': {'method': 'random', 'runs': 4},
    'duration': 4.0,
    'designs': ['gains.yaml'],
    'substeps': 3,
    'factors': {
        'path': 'random',
        'fault.kind': 'dropout',  # the arm is stopped, and led back to its path
        'fault.sensor': 'both',
        'fault.onset': {'low': 1.2, 'high': 1.6},
        'fault.duration': 0.5,
        'mass_1': {'low': 0.95, 'high': 1.05},
        'inertia_2': {'low': 0.95, 'high': 1.05},
        'payload': 0.2,
        'friction': 1.3,
        'noise': 1.5,
        'disturbance': 0.7,
        'compensation': ['confirmed', 'always'],
        'diagnosis.clear_dwell': 0.2,
    },
}
STREAMS = ('fault_estimate', 'ground_truth', 'joint_states', 'reference', 'state_estimate',
           'torque_command')  # fmt: skip


def run_graph(folder, files):
    """The nodes in lockstep with the files of a run; the bag that they record."""
    scenario, gains = f'scenario_file:={files}/scenario.yaml', files / 'gains.yaml'
    others = f'arm_file:={files}/arm.yaml', 'await_recorders:=1'
    with ros.graph(folder / 'log') as running:
        for name, given, *more in (
            ('recorder', [f'output:={folder / "graph"}']),
            ('uio', others, gains),
            ('tracker', [scenario, *others], gains),
            ('simulator', [scenario, *others, 'shutdown_at_end:=true']),
        ):
            line = ros.command(name, *given, files=[files / 'parameters.yaml', *more])
            node = running.start(name, line)
        assert node.process.wait(1000) == 0
        ros.end(running)
    return folder / 'graph'


def test_given_a_run_of_a_campaign_when_the_graph_runs_it_then_it_is_the_same(
    paper_gains, tmp_path
):
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    save_gains(paper_gains, tmp_path / 'gains.yaml')
    plan = plan_run(resolve(SPEC, 'spec', tmp_path), 2)
    run, files = plan.simulate(), tmp_path / 'run'
    assert run.safe_stop.any()
    write_run_bag(plan, run, files)
    record = load_run(run_graph(tmp_path, files))
    first = load_run(files)
    assert record.streams.keys() >= set(STREAMS)
    for stream in STREAMS:
        np.testing.assert_array_equal(record.stamps[stream], first.stamps[stream], stream)
        for field, values in record.streams[stream].items():
            expected, name = first.get(stream, field), f'{stream}.{field}'
            np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-12, err_msg=name)
    assert record.alarms == first.alarms
    raised = {a.sensor for a in run.alarms if a.event == AlarmEvent.RAISED}
    assert raised == set(plan.arm.sensor_names)
