"""The recorder as a process: killed, stopped, out of space, splitting, recording all there is."""

import os
import signal
import time

import pytest
import ros
from bags import contents
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from places import BRINGUP
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.recovery import recover

pytestmark = pytest.mark.ros

TOPIC = '/lpv/joint_states'
RELIABLE = QoSProfile(depth=1000)
PERIOD = 0.002
GAINS = BRINGUP / 'gains' / 'paper.yaml'


class Source:
    """Publishes numbered measurements, stamped with the time of their publication."""

    def __init__(self, client, qos=RELIABLE):
        self._client = client
        self._publisher = client.node.create_publisher(JointState, 'joint_states', qos)
        self.sent = []  # stamps [ns]

    def wait(self):
        assert self._client.wait(lambda: self._publisher.get_subscription_count() == 1)

    def publish(self, stamp=None):
        stamp = time.time_ns() if stamp is None else stamp
        message = JointState(
            name=['a', 'b'],
            position=[float(len(self.sent)), 0.0],
            velocity=[0.0, 0.0],
            effort=[0.0, 0.0],
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        self._publisher.publish(message)
        self.sent.append(stamp)

    def run(self, until):
        """Publish at 500 Hz until a condition holds."""
        while not until():
            self.publish()
            time.sleep(PERIOD)


def after(seconds):
    end = time.monotonic() + seconds
    return lambda: time.monotonic() > end


def recorded(bag):
    """Numbers of the measurements in a bag."""
    with open_bag(bag) as reader:
        return [
            int(reader.deserialize(data, c.msgtype).position[0])
            for c, _, data in reader.messages()
            if c.topic == TOPIC
        ]


@pytest.fixture
def session(tmp_path):
    """Starts a recorder; gives its process, a source of measurements, and a client."""
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running, ros.client(domain) as client:

        def start(*parameters, prefix=(), qos=RELIABLE):
            line = ros.command('recorder', f'output:={tmp_path / "bag"}', *parameters)
            node = running.start('recorder', [*prefix, *line])
            return node.process, Source(client, qos), client

        yield start


@pytest.mark.realtime
def test_given_a_recorder_that_is_killed_when_read_then_at_most_a_second_is_lost(session, tmp_path):
    process, source, _ = session('preset:=zstd_small')
    source.wait()
    source.run(after(2.5))
    os.killpg(process.pid, signal.SIGKILL)
    killed = time.time_ns()
    assert process.wait(10) == -signal.SIGKILL
    numbers = recorded(tmp_path / 'bag')
    assert numbers == list(range(len(numbers)))
    assert killed - source.sent[len(numbers) - 1] < 1_000_000_000
    assert any('not finished' in text for text in contents(tmp_path / 'bag')[1])
    result = recover(tmp_path / 'bag', tmp_path / 'new')
    assert (result.lost, result.end_missing) == (0, True)
    assert contents(tmp_path / 'new') == (contents(tmp_path / 'bag')[0], [])


def test_given_publishers_that_go_on_when_told_to_stop_then_nothing_is_lost_in_the_next_free_bag(
    session, tmp_path
):
    for name in ('bag', 'bag_1', 'bag_3'):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'mine').write_text(name)
    process, source, _ = session(f'gains_file:={GAINS}')
    source.wait()
    source.run(after(1.0))
    for _ in range(500):  # more than the recorder takes in at once
        source.publish()
    process.send_signal(signal.SIGINT)
    before, told = len(source.sent), time.monotonic()
    source.run(lambda: process.poll() is not None or time.monotonic() > told + 20.0)
    assert process.wait(10) == 0
    assert time.monotonic() - told < 8.0
    bag = tmp_path / 'bag_2'
    numbers = recorded(bag)
    assert numbers[:before] == list(range(before))
    assert numbers == list(range(len(numbers)))
    assert contents(bag)[1] == []
    assert {p.name for p in bag.iterdir()} == {'bag_2.mcap', 'metadata.yaml', 'gains.yaml'}
    assert (bag / 'gains.yaml').read_bytes() == GAINS.read_bytes()
    for name in ('bag', 'bag_1', 'bag_3'):
        assert [p.read_text() for p in (tmp_path / name).iterdir()] == [name]
    said = (tmp_path / 'log' / 'recorder.log').read_text()
    assert '[WARN]' in said
    assert f'{tmp_path / "bag"} exists already: recording into {bag}' in said


def test_given_a_recorder_that_is_held_up_when_the_transport_overflows_then_each_loss_is_counted(
    session, tmp_path
):
    process, source, _ = session(qos=qos_profile_sensor_data)
    source.wait()
    source.run(after(0.5))
    os.killpg(process.pid, signal.SIGSTOP)
    for _ in range(8000):
        source.publish()
    os.killpg(process.pid, signal.SIGCONT)
    source.run(after(1.0))  # the numbers of what comes next tell what is missing
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0
    numbers = recorded(tmp_path / 'bag')
    assert numbers == sorted(set(numbers))
    with open_bag(tmp_path / 'bag') as reader:
        known = reader.known[TOPIC]
    assert known['messages'] == len(numbers)
    assert known['lost'] == numbers[-1] + 1 - numbers[0] - len(numbers) > 0


# The limit of a file's size stands in for a disk that is full; the recorder leaves 1 MiB alone.
LIMITED = ('bash', '-c', 'ulimit -f 1600; exec "$@"', '-')


def test_given_a_disk_that_gets_full_when_recording_then_it_stops_and_keeps_what_is_there(
    session, tmp_path
):
    process, source, client = session('preset:=none', prefix=LIMITED)
    reports = client.listen(DiagnosticArray, '/diagnostics', 10)
    noise = client.node.create_publisher(String, 'torque_command', RELIABLE)
    source.wait()
    assert client.wait(lambda: noise.get_subscription_count() == 1)

    def full():
        noise.publish(String(data='x' * 4000))
        if len(source.sent) % 25 == 0:
            client.wait(lambda: False, 0.01)
        return any(s.level == DiagnosticStatus.ERROR for r in reports for s in r.status)

    limit = after(30.0)
    source.run(lambda: full() or limit())
    status = next(s for r in reports for s in r.status if s.level == DiagnosticStatus.ERROR)
    assert status.name == '/lpv/recorder: recording'
    assert 'no space left' in status.message
    assert process.poll() is None  # it goes on to say so
    (bag,) = (tmp_path / 'bag').glob('*.mcap')
    size = bag.stat().st_size
    assert 300_000 < size < 1600 * 1024
    source.run(after(0.3))
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 1
    assert bag.stat().st_size == size
    numbers = recorded(tmp_path / 'bag')
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > 50
    assert contents(tmp_path / 'bag')[1] == []
    assert 'recording stopped: no space left' in (tmp_path / 'log' / 'recorder.log').read_text()


def test_given_all_topics_when_recording_then_hidden_and_excluded_ones_are_left_out(
    session, tmp_path
):
    process, source, client = session(
        'all:=true', 'exclude:=[/rosout, /parameter_events, "/lpv/no*"]', 'split_duration:=1.0'
    )
    reports = client.listen(DiagnosticArray, '/diagnostics', 10)
    others = [
        client.node.create_publisher(String, name, RELIABLE)
        for name in ('text', 'noise', '_hidden')
    ]
    source.wait()
    assert client.wait(lambda: others[0].get_subscription_count() == 1)
    others[0].publish(String(data='hello'))
    source.run(after(1.3))
    source.publish(source.sent[-1] - 500_000_000)  # late
    source.run(after(0.9))
    values = {}

    def counted():
        assert {s.name for r in reports for s in r.status} <= {'/lpv/recorder: recording'}
        values.update((v.key, v.value) for r in reports for v in r.status[0].values)
        return values.get(f'{TOPIC} messages') == str(len(source.sent))

    assert client.wait(counted), values
    assert values[f'{TOPIC} lost'] == '0'
    assert [p.get_subscription_count() for p in others] == [1, 0, 0]
    process.send_signal(signal.SIGTERM)
    assert process.wait(20) == 0
    assert len(list((tmp_path / 'bag').glob('bag_*.mcap'))) >= 3
    with open_bag(tmp_path / 'bag') as reader:
        # What the recorder says of itself is not recorded; nobody else is on /diagnostics.
        assert {c.topic for c in reader.connections} == {TOPIC, '/lpv/text'}
        assert reader.known[TOPIC] == {'messages': len(source.sent), 'lost': 0, 'late': 1}
        assert reader.warnings == []
    # By the time of arrival, hence sorted, but for the late one not by stamps.
    assert recorded(tmp_path / 'bag') == list(range(len(source.sent)))
