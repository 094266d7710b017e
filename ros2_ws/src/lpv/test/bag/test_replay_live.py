"""Replays against what a node answered on the wall clock, and bags that are played to a node."""

import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros
from places import BRINGUP
from rclpy.qos import qos_profile_sensor_data
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from lpv.bag.replay.replay import Replay
from lpv.bag.rosbag.interfaces import make_typestore
from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.metadata import qos_profile
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.monitoring.message_fields import alarm_fields
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.faults import Fault
from lpv.core.support.timestamps import NANOSECONDS, set_stamp, to_nanoseconds
from lpv_msgs.msg import FaultEstimate, StateEstimate
from lpv_node.qos import stream

pytestmark = pytest.mark.ros

GAINS = BRINGUP / 'gains' / 'paper.yaml'
ARM = f'arm_file:={BRINGUP / "arms" / "paper.yaml"}'
TYPESTORE = make_typestore()
PERIOD = 4_000_000
"""Between samples [ns]; twice the arm's sample time leaves room for other users of the machine."""
_START = 200.0
"""The first start compiles [s]."""
ANSWERS = ('/lpv/state_estimate', '/lpv/fault_estimate', '/lpv/fault_alarm')


@pytest.fixture(scope='module')
def samples(paper_arm, paper_gains, two_faults):
    """Every second measurement of 4 s, with a fault in the second half."""
    fault = Fault('link2_angle', 'bias', onset=2.0, size=0.3)
    scenario = replace(two_faults, duration=4.0, faults=(fault,))
    run = run_closed_loop(paper_arm, scenario, paper_gains)
    return list(zip(run.measured, run.measured_velocity, run.effort))[:2000:2]


def schedule(samples, rng):
    """Delay after the one before [s] and index of each message: jitter, lost, doubled, swapped."""
    order = []
    for k in range(len(samples)):
        kind = rng.random()
        order += [] if kind < 0.03 else [k, k] if kind < 0.05 else [k]
        if 0.05 <= kind < 0.08 and len(order) > 3:
            order[-1], order[-2] = order[-2], order[-1]
    late = rng.random(len(order))
    return [
        (PERIOD / 1e9 * (rng.uniform(0.2, 1.8) if x > 0.01 else rng.uniform(2, 8)), k)
        for x, k in zip(late, order)
    ]


def send(client, samples, names, rng):
    """Publish samples like a driver on a bad day; stamps of all, in the order of sending."""
    out = client.node.create_publisher(JointState, 'joint_states', stream(False))
    assert client.wait(lambda: out.get_subscription_count() == 2, _START), 'nobody listens'
    time.sleep(0.5)
    start, due, stamps = time.time_ns(), time.monotonic(), []
    for delay, k in schedule(samples, rng):
        due += delay
        time.sleep(max(0.0, due - time.monotonic()))
        position, velocity, effort = samples[k]
        message = JointState(name=names, position=position, velocity=velocity, effort=effort)
        set_stamp(message.header.stamp, start + k * PERIOD)
        out.publish(message)
        stamps.append(start + k * PERIOD)
    return stamps


def stamped(bag):
    """By topic, stamp and content of each message, without the padding of its encoding."""
    found = defaultdict(list)
    with AnyReader([bag], default_typestore=TYPESTORE) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if hasattr(message, 'header'):
                stamp = message.header.stamp.sec * NANOSECONDS + message.header.stamp.nanosec
                found[connection.topic].append(
                    (stamp, bytes(TYPESTORE.serialize_cdr(message, connection.msgtype)))
                )
    return found


def without(bag, out, stamps):
    """The measurements of a bag, but not those with some stamps."""
    with AnyReader([bag]) as reader, BagWriter(out) as writer:
        writer.add_topic('/lpv/joint_states', 'sensor_msgs/msg/JointState')
        for c, log_time, data in reader.messages(reader.topics['/lpv/joint_states'].connections):
            header = reader.deserialize(data, c.msgtype).header.stamp
            if header.sec * NANOSECONDS + header.nanosec not in stamps:
                writer.write_raw('/lpv/joint_states', log_time, data)
    return out


def assert_same_answers(bag, arm, gains, tmp_path, sent=None):
    """Replay what the node got, and compare every answer; the share of answers compared."""
    online, sent = stamped(bag), sent or bag
    measured = {stamp for stamp, _ in stamped(sent)['/lpv/joint_states']}
    for topic in ANSWERS:
        # Apart from answers the node says when it has not heard anything for long.
        online[topic] = [entry for entry in online[topic] if entry[0] in measured]
    answered = {stamp for topic in ANSWERS for stamp, _ in online[topic]}
    # Best effort: on a busy machine the recorder has messages that the node never got.  Where one
    # is taken away, the one that it had overtaken counts.
    lost, missing = set(), None
    while missing is None or missing:
        source = without(sent, tmp_path / f'received{len(lost)}', lost)
        Replay(SerialSensorMonitor('', arm, gains=gains)).run(
            source, tmp_path / f'replayed{len(lost)}'
        )
        replayed = stamped(tmp_path / f'replayed{len(lost)}')
        missing = {stamp for stamp, _ in replayed['/lpv/state_estimate']} - answered
        lost |= missing
    assert {stamp for stamp, _ in replayed['/lpv/state_estimate']} == answered
    for topic in ANSWERS:
        # An answer may be lost on its way to the recorder, too; what arrived must be the same.
        assert set(online[topic]) <= set(replayed[topic]), topic
        order = [entry for entry in replayed[topic] if entry in set(online[topic])]
        assert online[topic] == order, topic
    return len(online['/lpv/state_estimate']) / len(measured)


def record(tmp_path, play):
    """A bag of what node and recorder got while something was played to them."""
    domain, bag = ros.next_domain(), tmp_path / 'bag'
    with ros.graph(tmp_path / 'log', domain) as running:
        running.start('recorder', ros.command('recorder', f'output:={bag}'))
        running.start('uio', ros.command('uio', ARM, 'await_recorders:=1', files=[GAINS]))
        with ros.client(domain) as client:
            play(client, domain)
        codes = running.stop()
    assert set(codes.values()) == {0}, codes
    return bag


@pytest.mark.realtime
def test_given_a_real_time_run_with_bad_transport_when_replayed_then_answers_agree_bit_by_bit(
    tmp_path, paper_arm, paper_gains, samples
):
    for attempt in range(4):
        sent, place = [], tmp_path / str(attempt)
        place.mkdir()
        bag = record(
            place,
            lambda client, _, sent=sent: sent.extend(
                send(client, samples, paper_arm.joint_names, np.random.default_rng(4))
            ),
        )
        # A bag that lacks what the node got proves nothing: best effort, on a busy machine.
        if [stamp for stamp, _ in stamped(bag)['/lpv/joint_states']] == sent:
            break
    else:
        pytest.fail('the recorder lost messages in every attempt')
    assert assert_same_answers(bag, paper_arm, paper_gains, tmp_path) > 0.7
    found = stamped(bag)
    stamps = np.array([stamp for stamp, _ in found['/lpv/joint_states']])
    assert (np.diff(stamps) == 0).any(), 'no message came twice'
    assert (np.diff(stamps) < 0).any(), 'no message was overtaken'
    assert (np.diff(stamps) >= 2 * PERIOD).any(), 'no message was lost'
    assert found['/lpv/fault_alarm']


@pytest.fixture(scope='module')
def healthy_bag(samples, paper_arm, tmp_path_factory):
    """1 s of measurements, with answers of an earlier node that must not be played."""
    path = tmp_path_factory.mktemp('played') / 'bag'
    messages = BagMessages(TYPESTORE, 'base_link')
    with BagWriter(path) as writer:
        profiles = [qos_profile(True, False, 1000)]
        writer.add_topic('/lpv/joint_states', 'sensor_msgs/msg/JointState', profiles)
        writer.add_topic('/lpv/fault_alarm', 'lpv_msgs/msg/FaultAlarm')
        for k, sample in enumerate(samples[:250]):
            stamp = 5 * NANOSECONDS + k * PERIOD
            message = messages.joint_state(stamp, paper_arm.joint_names, *sample)
            writer.write('/lpv/joint_states', stamp, message)
        old = Alarm(AlarmEvent.RAISED, 0, 'old', 1, 2, 1.0, 1.0, 'bias', 1.0)
        alarm = messages.make('lpv_msgs/msg/FaultAlarm', stamp, alarm_fields(old))
        writer.write('/lpv/fault_alarm', stamp, alarm)
    return path


def start_player(bag, domain, *options):
    program = Path(sys.executable).parent / 'lpv'
    return subprocess.Popen(
        [program, 'replay', bag, '--publish', *options],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
    )


@pytest.mark.realtime
def test_given_a_bag_when_played_to_a_node_then_it_answers_as_the_replay_does(
    tmp_path, paper_arm, paper_gains, healthy_bag
):
    clocks, seconds = [], []

    def play(client, domain):
        heard = client.listen(Clock, '/clock', qos_profile_sensor_data)
        states = client.listen(StateEstimate, 'state_estimate', qos_profile_sensor_data)
        assert client.wait(lambda: client.node.count_subscribers('joint_states') == 1, _START)
        # Slowly: discovery of /clock may take a second or two.
        player = start_player(healthy_bag, domain, '--rate', '0.2')
        assert client.wait(lambda: states)
        begin = time.monotonic()
        assert client.wait(lambda: player.poll() is not None)
        seconds.append(time.monotonic() - begin)
        said, errors = player.communicate()
        assert player.returncode == 0, errors
        assert '250 messages published' in said
        clocks.extend(to_nanoseconds(c.clock) for c in heard)

    bag = record(tmp_path, play)
    assert assert_same_answers(bag, paper_arm, paper_gains, tmp_path, healthy_bag) > 0.7
    assert stamped(bag)['/lpv/fault_alarm'] == []
    assert len(clocks) > 50
    assert set(np.diff(clocks)) <= {10_000_000 * n for n in range(1, 30)}
    assert 5 * NANOSECONDS <= clocks[0] < clocks[-1] <= 5 * NANOSECONDS + 250 * PERIOD
    # Of five seconds, counted from the first answer, which may be late, too.
    assert seconds[0] > 1.7, 'a fifth of the rate, five times the time'


def test_given_a_loop_when_interrupted_then_time_has_started_again_and_the_player_ends(healthy_bag):
    domain = ros.next_domain()
    with ros.client(domain) as client:
        heard = client.listen(JointState, 'joint_states', qos_profile_sensor_data)
        others = client.listen(FaultEstimate, 'fault_estimate', qos_profile_sensor_data)
        options = ['--loop', '--rate', '4', '--clock-rate', '0', '--from', '0.1', '--to', '0.9']
        player = start_player(healthy_bag, domain, *options)
        stamps = []
        assert client.wait(
            lambda: (
                stamps.extend(to_nanoseconds(m.header.stamp) for m in heard[len(stamps) :])
                or (np.diff(stamps) < 0).sum() >= 2
            )
        ), 'time never started again'
        assert client.node.count_publishers('/clock') == 0
        player.send_signal(signal.SIGINT)
        _, errors = player.communicate(timeout=600)
    assert player.returncode == 130
    assert errors.endswith('interrupted\n')
    assert others == []
    assert 5.1 * NANOSECONDS <= min(stamps) <= max(stamps) < 5.9 * NANOSECONDS


@pytest.mark.parametrize(
    ('options', 'named'),
    [
        (['--rate', '0'], '--rate'),
        (['--rate', 'nan'], '--rate'),
        (['--clock-rate', '-1'], 'clock'),
        (['--topics', '/nowhere'], '/nowhere'),
        (['--topic', '/nowhere'], '/nowhere'),
        (['--from', '-1'], '--from'),
    ],
    ids=str,
)
def test_given_options_that_make_no_sense_when_played_then_one_line_says_so(
    healthy_bag, refused, options, named
):
    assert refused(named, 'replay', healthy_bag, '--publish', *options)
