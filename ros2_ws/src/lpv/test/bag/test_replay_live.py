"""Bags that are played to a node, whose answers are those of a replay; and the player's options."""

import os
import time
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
import ros
from bag_messages import JOINT_STATE, TYPESTORE
from bags import write_bag
from places import BRINGUP
from rclpy.qos import qos_profile_sensor_data
from ros2_commands import ROS2, Running
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from runs import copied
from sensor_msgs.msg import JointState

from lpv import Alarm, AlarmEvent, Fault
from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.monitoring.message_fields import alarm_fields
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.support.timestamps import NANOSECONDS, to_nanoseconds
from lpv_msgs.msg import FaultEstimate, StateEstimate

pytestmark = pytest.mark.ros

GAINS, ARM = BRINGUP / 'gains' / 'paper.yaml', f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
PERIOD = 4_000_000
"""Between samples [ns]; twice the arm's sample time leaves room for other users of the machine."""
START = 5 * NANOSECONDS
MEASURED, ALARM = '/lpv/joint_states', '/lpv/fault_alarm'
ANSWERS = ('/lpv/state_estimate', '/lpv/fault_estimate', ALARM)


def schedule(count):
    """Delay after the one before [ns] and index of each message of a driver on a bad day: jitter,
    lost, doubled and swapped ones."""
    rng, order = np.random.default_rng(4), []
    for k in range(count):
        kind = rng.random()
        order += [] if kind < 0.03 else [k, k] if kind < 0.05 else [k]
        if 0.05 <= kind < 0.08 and len(order) > 3:
            order[-1], order[-2] = order[-2], order[-1]
    late = rng.random(len(order)) < 0.01
    delays = np.where(late, rng.uniform(2, 8, len(late)), rng.uniform(0.2, 1.8, len(late)))
    return zip((PERIOD * delays).astype(int).tolist(), order)


@pytest.fixture(scope='module')
def played(paper_arm, paper_gains, two_faults, tmp_path_factory):
    """Every second measurement of 4 s, with a fault in the second half, as of a bad transport; with
    answers of an earlier node that must not be played."""
    log_time, entries = START, []
    faults = (Fault('link2_angle', 'bias', onset=2.0, size=0.3),)
    run = run_closed_loop(paper_arm, replace(two_faults, duration=4.0, faults=faults), paper_gains)
    samples = list(zip(run.measured, run.measured_velocity, run.effort))[:2000:2]
    messages, kind = BagMessages(TYPESTORE, 'base_link'), 'lpv_msgs/msg/FaultAlarm'
    for delay, k in schedule(len(samples)):
        log_time, stamp = log_time + delay, START + k * PERIOD
        message = messages.joint_state(stamp, paper_arm.joint_names, *samples[k])
        entries.append((MEASURED, log_time, message))
    old = alarm_fields(Alarm(AlarmEvent.RAISED, 0, 'old', 1, 2, 1.0, 1.0, 'bias', 1.0))
    entries.append((ALARM, log_time, messages.make(kind, stamp, old)))
    path, types = tmp_path_factory.mktemp('played') / 'bag', {MEASURED: JOINT_STATE, ALARM: kind}
    return write_bag(path, entries, types, depth=1000)


def stamped(bag, **limits):
    """By topic, stamp and content of each message, without the padding of its encoding."""
    found = defaultdict(list)
    with AnyReader([bag], default_typestore=TYPESTORE) as reader:
        for connection, _, data in reader.messages(**limits):
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, 'header'):
                content = bytes(TYPESTORE.serialize_cdr(message, connection.msgtype))
                found[connection.topic].append((to_nanoseconds(message.header.stamp), content))
    return found


def share_of_same_answers(bag, arm, gains, tmp_path, sent):
    """Replay what the node got, and compare every answer; how many of all there were."""
    online, measured = stamped(bag), {stamp for stamp, _ in stamped(sent)[MEASURED]}
    for topic in ANSWERS:
        # Apart from answers the node says when it has not heard anything for long.
        online[topic] = [entry for entry in online[topic] if entry[0] in measured]
    answered, lost, missing = {stamp for t in ANSWERS for stamp, _ in online[t]}, set(), {0}

    def received(_, data):
        stamp = TYPESTORE.deserialize_cdr(data, JOINT_STATE).header.stamp
        return None if to_nanoseconds(stamp) in lost else data

    # A busy node misses messages.  Where one is taken away, the one that it had overtaken counts.
    while missing:
        source, out = (tmp_path / f'{name}{len(lost)}' for name in ('received', 'replayed'))
        copied(sent, source, MEASURED.__eq__, received)
        Replay(SerialSensorMonitor('', arm, gains=gains)).run(source, out)
        replayed = stamped(out)
        given = {stamp for stamp, _ in replayed['/lpv/state_estimate']}
        missing = given - answered
        lost |= missing
    assert given == answered
    for topic in ANSWERS:
        # An answer may be lost on its way to the recorder, too; what arrived must be the same.
        arrived = set(online[topic])
        assert online[topic] == [entry for entry in replayed[topic] if entry in arrived], topic
    return len(online['/lpv/state_estimate']) / len(measured)


def player_of(bag, domain, *options):
    program, env = [ROS2.with_name('lpv')], {**os.environ, 'ROS_DOMAIN_ID': str(domain)}
    return Running('replay', bag, '--publish', *options, program=program, env=env)


@pytest.mark.realtime
def test_given_bad_transport_when_played_then_as_replayed(tmp_path, paper_arm, paper_gains, played):
    stamps = np.array([stamp for stamp, _ in stamped(played)[MEASURED]])
    assert (np.diff(stamps) == 0).any(), 'no message came twice'
    assert (np.diff(stamps) < 0).any(), 'no message was overtaken'
    assert (np.diff(stamps) >= 2 * PERIOD).any(), 'no message was lost'
    domain, bag = ros.next_domain(), tmp_path / 'bag'
    with ros.graph(tmp_path / 'log', domain) as running:
        running.start('recorder', ros.command('recorder', f'output:={bag}'))
        running.start('uio', ros.command('uio', ARM, 'await_recorders:=1', files=[GAINS]))
        with ros.client(domain) as client:
            heard = client.listen(Clock, '/clock', qos_profile_sensor_data)
            states = client.listen(StateEstimate, 'state_estimate', qos_profile_sensor_data)
            assert client.wait(lambda: client.node.count_subscribers('joint_states') == 1)
            # Slowly: discovery of /clock may take a second or two.
            player = player_of(played, domain, '--rate', '0.5')
            assert client.wait(lambda: states)
            begin = time.monotonic()
            assert client.wait(lambda: player.process.poll() is not None)
            seconds = time.monotonic() - begin
        code, said = player.end()
        ros.end(running)
    assert code == 0 and f'{len(stamps)} messages published' in said, said
    # Of eight seconds, counted from the first answer, which may be late, too.
    assert seconds > 2.7, 'half the rate, twice the time'
    clocks = [to_nanoseconds(c.clock) for c in heard]
    assert len(clocks) > 50 and set(np.diff(clocks)) <= {10_000_000 * n for n in range(1, 30)}
    assert START <= clocks[0] < clocks[-1] <= START + 5 * NANOSECONDS
    assert share_of_same_answers(bag, paper_arm, paper_gains, tmp_path, played) > 0.7
    alarms = stamped(bag)[ALARM]
    assert alarms and not any(b'old\0' in content for _, content in alarms)


def test_given_a_loop_when_interrupted_then_time_has_started_again_and_the_player_ends(played):
    domain, stamps = ros.next_domain(), []
    with AnyReader([played]) as reader:
        start, stop = (reader.start_time + share * NANOSECONDS // 10 for share in (1, 9))
    chosen = {stamp for stamp, _ in stamped(played, start=start, stop=stop)[MEASURED]}
    with ros.client(domain) as client:
        heard = client.listen(JointState, 'joint_states', qos_profile_sensor_data)
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
        ('/nowhere', '--topics /nowhere', '--topic /nowhere'),
        ('--from', '--from -1'),
    ):
        assert all(refused(told, 'replay', played, '--publish', *one.split()) for one in wrong)
