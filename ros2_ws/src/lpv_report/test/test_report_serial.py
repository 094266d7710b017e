"""Reports of runs of a serial arm."""

import numpy as np
import pytest
from places import BRINGUP
from runs import rows, text
from serial_bags import crane, crane_file, crane_run, record_crane

from lpv_bag.replay.replay import Replay
from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_bag.run.record import load_run
from lpv_cli.main import main
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.arm_file import load_arm
from lpv_core.serial_arm.simulation import EncoderFault
from lpv_report.certificate import examine
from lpv_report.run import write_report
from lpv_report.table import make_table

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """A replayed run with a step on the second encoder."""
    folder = tmp_path_factory.mktemp('crane')
    run = crane_run(faults=[EncoderFault(1, 'bias', 0.6, 0.05)])
    measured = record_crane(folder / 'measured', run)
    Replay(SerialSensorMonitor('/uio', crane())).run(measured, folder / 'bag')
    return folder / 'bag'


@pytest.fixture(scope='module')
def page(bag, tmp_path_factory):
    result = write_report(bag, tmp_path_factory.mktemp('report'), crane())
    assert [p.stem for p in result.pictures] == [
        'timeline',
        'path',
        'faults',
        'measured',
        'states',
        'torques',
    ]
    return result.html.read_text()


def test_given_a_run_of_three_joints_when_reported_then_the_alarm_of_its_sensor_is_listed(page):
    assert ['encoder2', 'bias'] in [row[:2] for row in rows(page)]
    assert '1 alarm, of encoder2' in text(page)


def test_given_a_serial_arm_when_reported_then_bounds_are_called_statistical(page):
    said = text(page)
    assert 'bounds and thresholds are statistical' in said
    assert 'Mean squared errors (MISE, eq. (70))' not in said
    assert 'joint1, joint2, joint3' in said


def test_given_the_truth_when_tabled_then_each_joint_has_its_errors(tmp_path):
    run = crane_run(0.3)
    with BagWriter(tmp_path / 'bag') as writer:
        messages = BagMessages(writer.typestore, 'crane')
        kinds = {'ground_truth': 'GroundTruth', 'state_estimate': 'StateEstimate'}
        writer.add_topic('/joint_states', 'sensor_msgs/msg/JointState')
        for name, kind in kinds.items():
            writer.add_topic(f'/{name}', f'lpv_msgs/msg/{kind}')
        names = ('position', 'velocity', 'torque', 'fault')
        state = ('position', 'velocity', 'compensated_position', 'measured_position')
        for stamp, sample in zip(run.stamps.tolist(), run.samples):
            measured = messages.joint_state(stamp, crane().joint_names, *sample)
            writer.write('/joint_states', stamp, measured)
            truth = {name: np.zeros(3) for name in names}
            estimate = {name: np.full(3, 0.5) for name in (*state, 'measured_velocity')}
            for topic, fields in (
                ('ground_truth', {**truth, 'disturbance': 0.0}),
                ('state_estimate', {**estimate, 'mode': 0, 'trustworthy': True}),
            ):
                msgtype = f'lpv_msgs/msg/{kinds[topic]}'
                writer.write(f'/{topic}', stamp, messages.make(msgtype, stamp, fields))
    table = make_table(load_run(tmp_path / 'bag', joint_names=crane().joint_names), crane())
    assert [row.signal for row in table] == ['joint1', 'joint2', 'joint3'] * 2
    assert [row.value for row in table] == pytest.approx([0.25] * 6)


def test_given_a_serial_arm_when_reported_on_the_command_line_then_gains_are_refused(
    bag, tmp_path, capsys
):
    arm = str(crane_file(tmp_path))
    arguments = ['report', str(bag), '--arm', arm, '--out', str(tmp_path / 'report')]
    assert main([*arguments, '--gains', 'paper']) == 2
    assert main(arguments) == 0
    assert 'certificate not known' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('gains', 'holds', 'problem'),
    [
        ('ur10', True, ''),
        ('panda', False, 'another arm'),
        ('paper', False, 'gains are designed for its region'),
    ],
)
def test_given_gains_in_a_bag_when_reported_then_the_loop_is_verified_again(gains, holds, problem):
    arm = load_arm(BRINGUP / 'arms' / 'ur10.yaml')
    found = examine(BRINGUP / 'gains' / f'{gains}.yaml', arm)
    assert found.holds == holds and problem in found.problem
    assert not found.bounds_faults


def test_given_a_bag_without_gains_when_reported_then_no_certificate_of_the_loop_is_claimed(page):
    assert 'the bag carries no gains, and none were given' in text(page)
