"""The pipeline of a serial arm as a user runs it: ``lpv demo --arm ur10``, and its bag."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import ros
from places import BRINGUP

from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.serial_arm.arm_file import load_arm
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.scenario import load_scenario

pytestmark = pytest.mark.ros

SHORT = (
    (BRINGUP / 'scenarios' / 'ur10.yaml')
    .read_text()
    .replace('duration: 20.0', 'duration: 3.0')
    .replace('onset: 6.0', 'onset: 1.0')
)


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    """Output folder, scenario file and terminal text of a short run."""
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    out = tmp_path_factory.mktemp('serial')
    scenario = out / 'short.yaml'
    scenario.write_text(SHORT)
    program = Path(sys.executable).parent / 'lpv'
    result = subprocess.run(
        [program, 'demo', '--arm', 'ur10', '--scenario', scenario, '--out', out],
        env={**os.environ, 'ROS_DOMAIN_ID': str(ros.next_domain()), 'COLUMNS': '120'},
        text=True,
        capture_output=True,
        timeout=2000,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return out, scenario, result.stdout


def test_given_the_demo_of_a_serial_arm_when_run_then_the_faulty_encoder_is_named(demo):
    out, _, text = demo
    assert 'ALARM, elbow_encoder: error +0.200 rad' in text
    assert (out / 'report' / 'report.html').stat().st_size > 10_000


def test_given_the_bag_of_a_serial_arm_when_read_then_the_true_arm_stayed_on_its_path(demo):
    record = load_run(
        demo[0] / 'bag', joint_names=load_arm(BRINGUP / 'arms' / 'ur10.yaml').joint_names
    )
    error = record.get('ground_truth', 'position') - record.get('reference', 'position')
    assert error.shape[1] == 6 and len(error) >= 1500
    assert np.abs(error).max() < 0.02
    assert main(['compare', str(demo[0] / 'bag'), str(demo[0] / 'bag'), '--exact']) == 0


def test_given_one_scenario_when_run_in_the_graph_and_offline_then_torques_are_the_same(demo):
    out, scenario, _ = demo
    arm = load_arm(BRINGUP / 'arms' / 'ur10.yaml')
    record = load_run(out / 'bag', joint_names=arm.joint_names)
    run = run_closed_loop(arm, load_scenario(scenario))
    commands = record.get('torque_command', 'torque')
    count = min(len(commands), len(run.torque))
    np.testing.assert_array_equal(commands[:count], run.torque[:count])
