import os
import time
from dataclasses import replace

import numpy as np
import pytest
import ros
from bag_messages import JOINT_STATE, TYPESTORE
from bags import decoded, write_bag
from places import BRINGUP
from rclpy.qos import qos_profile_sensor_data
from ros2_commands import ROS2, Running
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from lpv import Alarm, AlarmEvent, Fault
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.monitoring.message_fields import alarm_fields
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate
from lpv_node.qos import latched

pytestmark = pytest.mark.ros

GAINS, ARM = BRINGUP / 'gains' / 'paper.yaml', f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
PERIOD = 4_000_000
"""Between samples [ns]; twice the arm's sample time leaves room for other users of the machine."""
START = 5 * NANOSECONDS
MEASURED, ALARM = '/joint_states', '/lpv/fault_alarm'


@pytest.fixture(scope='module')
def played(paper_arm, paper_gains, two_faults, tmp_path_factory):
    """Every second measurement of 3 s by a driver, with a fault in the second half; with answers of
    an earlier node, in a namespace of its own, that must not be played."""
    faults = (Fault('link2_angle', 'bias', onset=1.5, size=0.3),)
    run = run_closed_loop(paper_arm, replace(two_faults, duration=3.0, faults=faults), paper_gains)
    samples = list(zip(run.measured, run.measured_velocity, run.effort))[:1500:2]
    messages, kind = BagMessages(TYPESTORE, 'base_link'), 'lpv_msgs/msg/FaultAlarm'
    stamps, names = range(START, START + len(samples) * PERIOD, PERIOD), paper_arm.joint_names
    entries = [(MEASURED, t, messages.joint_state(t, names, *s)) for t, s in zip(stamps, samples)]
    old = alarm_fields(Alarm(AlarmEvent.RAISED, 0, 'old', 1, 2, 1.0, 1.0, 'bias', 1.0))
    entries.append((ALARM, stamps[-1], messages.make(kind, stamps[-1], old)))
    path, types = tmp_path_factory.mktemp('played') / 'bag', {MEASURED: JOINT_STATE, ALARM: kind}
    return write_bag(path, entries, types, depth=1000)


def measurements(bag, **limits):
    return {to_nanoseconds(m.header.stamp): m for m in decoded(bag, MEASURED, **limits)}


def player_of(bag, domain, *options):
    program, env = [ROS2.with_name('lpv')], {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    return Running('replay', bag, '--publish', *options, program=program, env=env)


@pytest.mark.realtime
def test_given_a_bag_when_played_then_a_node_hears_its_pace_and_names_the_fault(tmp_path, played):
    domain, sent = ros.next_domain(), measurements(played)
    with ros.graph(tmp_path / 'log', domain) as running:
        remapped = [*ros.command('uio', ARM, files=[GAINS]), '-r', f'joint_states:={MEASURED}']
        running.start('uio', remapped)
        with ros.client(domain) as client:
            heard = client.listen(Clock, '/clock', qos_profile_sensor_data)
            arrived = client.listen(JointState, MEASURED, qos_profile_sensor_data)
            states = client.listen(StateEstimate, 'state_estimate', qos_profile_sensor_data)
            alarms = client.listen(FaultAlarm, 'fault_alarm', latched())
            assert client.wait(lambda: client.node.count_subscribers(MEASURED) == 2)
            # Slowly: discovery of /clock may take a second or two.
            player = player_of(played, domain, '--rate', '0.5')
            assert client.wait(lambda: states and heard)
            begin, first = time.monotonic(), to_nanoseconds(heard[-1].clock)
            assert client.wait(lambda: to_nanoseconds(heard[-1].clock) > START + 2.5 * NANOSECONDS)
            seconds, last = time.monotonic() - begin, to_nanoseconds(heard[-1].clock)
            assert client.wait(lambda: player.process.poll() is not None)
        code, said = player.end()
        ros.end(running)
    assert code == 0 and f'{len(sent)} messages published' in said, said
    # Messages may be late where the machine is busy, and then seem a bit faster.
    assert last - first < 0.75 * NANOSECONDS * seconds, 'half the rate, twice the time'
    clocks = [to_nanoseconds(c.clock) for c in heard]
    steps = np.diff(clocks)  # a busy machine loses some
    assert len(clocks) > 50 and steps.min() == 10_000_000 and not (steps % 10_000_000).any()
    assert START <= clocks[0] < clocks[-1] <= START + 4 * NANOSECONDS
    assert len(arrived) > 0.5 * len(sent)
    for message in arrived:
        expected = sent[to_nanoseconds(message.header.stamp)]
        for name in ('position', 'velocity', 'effort'):
            np.testing.assert_array_equal(getattr(message, name), getattr(expected, name))
    assert {alarm.sensor for alarm in alarms} == {'link2_angle'}


def test_given_a_loop_when_interrupted_then_time_has_started_again_and_the_player_ends(played):
    domain, stamps = ros.next_domain(), []
    with AnyReader([played]) as reader:
        start, stop = (reader.start_time + share * NANOSECONDS // 10 for share in (1, 9))
    chosen = set(measurements(played, start=start, stop=stop))
    with ros.client(domain) as client:
        heard = client.listen(JointState, MEASURED, qos_profile_sensor_data)
        others = client.listen(FaultEstimate, 'fault_estimate', qos_profile_sensor_data)
        options = ['--loop', '--rate', '4', '--clock-rate', '0', '--from', '0.1', '--to', '0.9']
        player = player_of(played, domain, *options)

        def started_again():
            stamps.extend(to_nanoseconds(m.header.stamp) for m in heard[len(stamps) :])
            return (np.diff(stamps) < -NANOSECONDS // 2).sum() >= 2

        assert client.wait(started_again), 'time never started again'
        assert client.node.count_publishers('/clock') == 0
        code, said = player.interrupt(timeout=600)
    assert code == 130 and said.endswith('interrupted\n') and others == [] and set(stamps) <= chosen


def test_given_options_that_make_no_sense_when_played_then_one_line_says_so(played, refused):
    for told, *wrong in (
        ('--rate', '--rate 0', '--rate nan'),
        ('clock', '--clock-rate -1'),
        ('/nowhere', '--topics /nowhere'),
        ('--publish', '--topic /x', '--effort-topic /x', '--inject x', '--report x'),
        ('--publish', '--arm paper', '--gains x', '--parameters x', '--estimates-only'),
        ('--from', '--from -1'),
    ):
        assert all(refused(told, 'replay', played, '--publish', *one.split()) for one in wrong)
