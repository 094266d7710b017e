import os
import re
import signal
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
import ros
from bags import contents
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from places import BRINGUP
from rcl_interfaces.srv import GetParameters
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.recovery import recover
from lpv.core.support.timestamps import set_stamp
from lpv_node.recorder.node import RecorderNode

pytestmark = pytest.mark.ros
TOPIC = '/lpv/joint_states'
RELIABLE = QoSProfile(depth=1000)
GAINS = BRINGUP / 'gains' / 'paper.yaml'


class Session:
    def __init__(self, client, process, qos):
        self.client, self.process = client, process
        self.sent = []  # stamps [ns]
        self._publisher = client.node.create_publisher(JointState, 'joint_states', qos)
        assert client.wait(lambda: self._publisher.get_subscription_count() == 1)
        self.reports = client.listen(DiagnosticArray, '/diagnostics', 10)

    def publish(self, stamp=None):
        self.sent.append(time.time_ns() if stamp is None else stamp)
        values = [float(len(self.sent) - 1), 0.0]
        message = JointState(name=['a', 'b'], position=values, velocity=values, effort=values)
        set_stamp(message.header.stamp, self.sent[-1])
        self._publisher.publish(message)

    def run(self, seconds, until=lambda: False):
        """Publish at 500 Hz for a while, or until a condition holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self.publish()
            time.sleep(0.002)

    def stop(self, number=signal.SIGINT):
        self.process.send_signal(number)
        return self.process.wait(20)

    def kill(self, number):
        os.killpg(self.process.pid, number)

    def statuses(self):
        return [status for report in self.reports for status in report.status]


def recorded(bag):
    with open_bag(bag) as reader:
        found = [(c.msgtype, data) for c, _, data in reader.messages() if c.topic == TOPIC]
        return [int(reader.deserialize(data, kind).position[0]) for kind, data in found]


@pytest.fixture
def session(tmp_path):
    domain = ros.next_domain()
    with ros.graph(tmp_path / 'log', domain) as running, ros.client(domain) as client:

        def start(*parameters, prefix=(), qos=RELIABLE):
            line = ros.command('recorder', f'output:={tmp_path / "bag"}', *parameters)
            return Session(client, running.start('recorder', [*prefix, *line]).process, qos)

        yield start


@pytest.mark.realtime
def test_given_a_recorder_that_is_killed_when_read_then_at_most_a_second_is_lost(session, tmp_path):
    recorder, bag = session('preset:=zstd_small'), tmp_path / 'bag'
    recorder.run(2.5)
    recorder.kill(signal.SIGKILL)
    killed = time.time_ns()
    assert recorder.process.wait(10) == -signal.SIGKILL
    numbers = recorded(bag)
    assert numbers == list(range(len(numbers)))
    assert killed - recorder.sent[len(numbers) - 1] < 1_000_000_000
    assert any('not finished' in text for text in contents(bag)[1])
    result = recover(bag, tmp_path / 'new')
    assert (result.lost, result.end_missing) == (0, True)
    assert contents(tmp_path / 'new') == (contents(bag)[0], [])


def test_given_simulated_time_when_messages_precede_it_then_none_is_at_zero(session, tmp_path):
    recorder, now = session('use_sim_time:=true'), 5_000_000_000
    clock = recorder.client.node.create_publisher(Clock, '/clock', RELIABLE)
    for _ in range(5):
        recorder.publish()
    assert recorder.client.wait(lambda: len(recorder.reports) > 2)  # one a second

    def is_recorded():
        clock.publish(Clock(clock=Time(nanoseconds=now).to_msg()))
        values = [v for s in recorder.statuses() for v in s.values if v.key == f'{TOPIC} messages']
        return values and values[-1].value == '5'

    assert recorder.client.wait(is_recorded) and recorder.stop() == 0
    assert recorded(tmp_path / 'bag') == [0, 1, 2, 3, 4]
    with open_bag(tmp_path / 'bag') as reader:
        assert reader.start_time == now


def test_given_a_recorder_that_is_held_up_when_read_then_each_loss_is_counted(session, tmp_path):
    recorder = session(qos=qos_profile_sensor_data, prefix=('env', '--default-signal=HUP'))
    recorder.run(0.5)
    # Nothing comes through shared memory, whose ports belong to the process that has their locks.
    opened = [os.readlink(file) for file in Path(f'/proc/{recorder.process.pid}/fd').iterdir()]
    assert opened and not [file for file in opened if re.search(r'port\d+_[es]l$', file)]
    recorder.kill(signal.SIGSTOP)
    for _ in range(8000):
        recorder.publish()
    recorder.kill(signal.SIGCONT)
    recorder.run(1.0)  # the numbers of what comes next tell what is missing
    assert recorder.stop(signal.SIGHUP) == 0  # its terminal is closed
    numbers = recorded(tmp_path / 'bag')
    assert numbers == sorted(set(numbers))
    with open_bag(tmp_path / 'bag') as reader:
        known = reader.known[TOPIC]
    assert known['messages'] == len(numbers)
    assert known['lost'] == numbers[-1] + 1 - numbers[0] - len(numbers) > 0


@pytest.mark.parametrize('shift', [-3600, 0, 3600])
def test_given_a_clock_that_is_set_when_stopping_then_what_is_old_counts(monkeypatch, shift):
    before, now = time.time_ns(), time.time_ns() + (shift * 1000 + 50) * 1_000_000
    heard = [SimpleNamespace(sent=sent, topic='') for sent in (before - 1, now - 1)]
    source = SimpleNamespace(poll=lambda: heard)
    node = SimpleNamespace(_input=source, _taken=0, _writer=None, _stopping=None)
    RecorderNode.stopping(node)
    monkeypatch.setattr(time, 'time_ns', lambda: now)
    monkeypatch.setattr(time, 'monotonic_ns', lambda: node._stopping + 49_000_000)
    RecorderNode._poll(node)
    assert node._taken == (shift >= 0)


def test_given_a_disk_that_gets_full_when_recording_then_what_is_there_is_kept(session, tmp_path):
    # The limit of a file's size stands in for a disk that is full; the recorder leaves 1 MiB alone.
    recorder = session('preset:=none', prefix=['bash', '-c', 'ulimit -f 1600; exec "$@"', '-'])
    noise = recorder.client.node.create_publisher(String, 'torque_command', RELIABLE)
    assert recorder.client.wait(lambda: noise.get_subscription_count() == 1)

    def errors():
        return [s for s in recorder.statuses() if s.level == DiagnosticStatus.ERROR]

    def full():
        noise.publish(String(data='x' * 4000))
        if len(recorder.sent) % 25 == 0:
            recorder.client.wait(lambda: False, 0.01)
        return errors()

    recorder.run(30.0, until=full)
    assert errors()[0].name == '/lpv/recorder: recording' and 'no space left' in errors()[0].message
    assert recorder.process.poll() is None  # it goes on to say so
    (bag,) = (tmp_path / 'bag').glob('*.mcap')
    size = bag.stat().st_size
    assert 300_000 < size < 1600 * 1024
    recorder.run(0.3)
    for step in (4, 2, 1, 3):  # deactivate, clean up, configure, activate
        assert ros.change_state(recorder.client, 'recorder', step)
    recorder.reports.clear()
    recorder.run(30.0, until=full)
    assert recorder.stop() == 1 and bag.stat().st_size == size
    numbers = recorded(tmp_path / 'bag')
    assert numbers == list(range(len(numbers))) and len(numbers) > 50
    assert contents(tmp_path / 'bag')[1] == []
    assert contents(tmp_path / 'bag_1')[1] == []
    said = (tmp_path / 'log' / 'recorder.log').read_text()
    assert said.count('recording stopped: no space left') == 2
    assert said.count('/lpv/ground_truth, /lpv/joint_states_corrected, /lpv/reference') == 4


def test_given_a_recorder_when_active_again_then_another_bag_has_the_rest(session, tmp_path):
    folder = tmp_path / 'bags'
    recorder = session(f'output:={folder / "bag"}')

    change = partial(ros.change_state, recorder.client, 'recorder')

    def record(count):
        first = len(recorder.sent)
        assert recorder.client.wait(lambda: recorder._publisher.get_subscription_count() == 1)
        for _ in range(count):
            recorder.publish()
        return list(range(first, first + count))

    numbers = [record(50)]
    for _ in range(2):
        assert change(Transition.TRANSITION_DEACTIVATE)
        folder.rename(tmp_path / 'elsewhere')  # no bag can be written where a file is
        folder.write_text('')
        assert not change(Transition.TRANSITION_ACTIVATE)
        folder.unlink()
        (tmp_path / 'elsewhere').rename(folder)
        assert change(Transition.TRANSITION_ACTIVATE)
        numbers.append(record(50))
    assert recorder.stop() == 0
    assert [recorded(folder / name) for name in ('bag', 'bag_1', 'bag_2')] == numbers
    assert 'cannot be written' in (tmp_path / 'log' / 'recorder.log').read_text()


def test_given_all_topics_when_told_to_stop_then_the_next_free_bag_is_whole(session, tmp_path):
    taken = [tmp_path / name for name in ('bag', 'bag_1', 'bag_3')]
    for folder in taken:
        folder.mkdir()
        (folder / 'mine').write_text(folder.name)
    left_out = 'exclude:=[/rosout, /parameter_events, "/lpv/no*"]'
    recorder = session('all:=true', left_out, 'split_duration:=1.0', f'gains_file:={GAINS}')
    bag, make = tmp_path / 'bag_2', recorder.client.node.create_publisher
    others = [make(String, name, RELIABLE) for name in ('text', 'noise', '_hidden')]
    make(GetParameters.Event, 'odd', RELIABLE)  # no file has the definition of such a type
    assert recorder.client.wait(lambda: others[0].get_subscription_count() == 1)
    others[0].publish(String(data='hello'))
    recorder.run(1.3)
    recorder.publish(recorder.sent[-1] - 500_000_000)  # late

    def split_twice():  # by the time of arrival, which is that of the load, too
        recorder.run(0.3)
        return len(list(bag.glob('bag_2_*.mcap'))) >= 3

    assert recorder.client.wait(split_twice)
    values = {}

    def counted():
        assert {status.name for status in recorder.statuses()} <= {'/lpv/recorder: recording'}
        values.update((v.key, v.value) for status in recorder.statuses() for v in status.values)
        return values.get(f'{TOPIC} messages') == str(len(recorder.sent))

    assert recorder.client.wait(counted), values
    assert values[f'{TOPIC} lost'] == '0' and 'not installed' in values['/lpv/odd not recorded']
    assert [p.get_subscription_count() for p in others] == [1, 0, 0]
    for _ in range(500):  # more than the recorder takes in at once
        recorder.publish()
    before = len(recorder.sent)
    recorder.process.send_signal(signal.SIGINT)
    # Although more and more comes.
    recorder.run(100.0, until=lambda: recorder.process.poll() is not None)
    assert recorder.process.poll() == 0
    numbers = recorded(bag)
    assert numbers[:before] == list(range(before))
    # By the time of arrival, hence sorted, but for the late one not by stamps.
    assert numbers == list(range(len(numbers)))
    with open_bag(bag) as reader:
        # What the recorder says of itself is not recorded; nobody else is on /diagnostics.
        assert {c.topic for c in reader.connections} == {TOPIC, '/lpv/text'}
        assert reader.known[TOPIC] == {'messages': len(numbers), 'lost': 0, 'late': 1}
        assert reader.warnings == []
    files = {p.name for p in bag.iterdir() if not p.match('bag_2_*.mcap')}
    assert files == {'metadata.yaml', 'gains.yaml'}
    assert (bag / 'gains.yaml').read_bytes() == GAINS.read_bytes()
    for folder in taken:
        assert [p.read_text() for p in folder.iterdir()] == [folder.name]
    said = (tmp_path / 'log' / 'recorder.log').read_text()
    assert '[WARN]' in said and f'{tmp_path / "bag"} exists already: recording into {bag}' in said
