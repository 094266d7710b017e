"""The pipeline of a serial arm as a user runs it: ``lpv demo --arm ur10``, and its bag."""

import numpy as np
import pytest
import ros
from places import BRINGUP

from lpv.bag.run.record import load_run
from lpv.cli.main import main
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.scenario import load_scenario

pytestmark = pytest.mark.ros


def test_given_the_demo_of_a_serial_arm_when_run_then_the_fault_is_named_and_torques_as_offline(
    tmp_path,
):
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    scenario, arm = tmp_path / 'short.yaml', load_arm(BRINGUP / 'arms' / 'ur10.yaml')
    text = (BRINGUP / 'scenarios' / 'ur10.yaml').read_text().replace('onset: 6.0', 'onset: 1.0')
    scenario.write_text(text.replace('duration: 20.0', 'duration: 2.0'))
    said = ros.lpv('demo', '--arm', 'ur10', '--scenario', scenario, '--out', tmp_path)
    assert 'ALARM, elbow_encoder: error +0.200 rad' in said
    assert (tmp_path / 'report' / 'report.html').stat().st_size > 10_000
    record = load_run(tmp_path / 'bag', joint_names=arm.joint_names)
    error = record.get('ground_truth', 'position') - record.get('reference', 'position')
    assert error.shape[1] == 6 and len(error) >= 1000
    assert np.abs(error).max() < 0.02  # the true arm stayed on its path
    bag = str(tmp_path / 'bag')
    assert main(['compare', bag, bag, '--exact']) == 0
    run = run_closed_loop(arm, load_scenario(scenario))
    commands = record.get('torque_command', 'torque')
    count = min(len(commands), len(run.torque))
    np.testing.assert_array_equal(commands[:count], run.torque[:count])
