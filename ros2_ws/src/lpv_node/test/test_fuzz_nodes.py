import time
from functools import partial

import pytest
from bags import contents
from diagnostic_msgs.msg import DiagnosticArray
from hostile import Output, Refused, damaged_bytes, forge, node_of, run_cases, set_parameters, sized
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from lpv.bag.rosbag import message_loss, metadata
from lpv.core.support.timestamps import leading_stamp, set_stamp
from lpv_msgs.msg import FaultAlarm, StateEstimate
from lpv_node.recorder.input import Heard
from lpv_node.recorder.node import RecorderNode
from lpv_node.view import server
from lpv_node.view.foxglove_bridge import FoxgloveBridge
from lpv_node.view.node import ViewNode
from lpv_node.view.topics import TOPICS, Inbox

pytestmark = [pytest.mark.ros, pytest.mark.fuzz]
KINDS = (JointState, StateEstimate, FaultAlarm)


class Recorder:
    def __init__(self, node):
        self.node, self.sent, self._stamp = node, [], 10**18
        for kind in KINDS:
            topic = kind.__name__
            node._types[topic] = f'{kind.__module__.split(".")[0]}/msg/{topic}'
            node._announced[topic] = metadata.qos_profile(True, False, 10)
            node._counts[topic] = message_loss.TopicCount()

    def good(self, kind):
        self._stamp += 2_000_000
        message = kind()
        set_stamp(message.header.stamp, self._stamp)
        return message

    def hear(self, kind, data):
        stamp, topic = self._stamp, kind.__name__
        heard = Heard(stamp, topic, data, stamp, None, None, leading_stamp(data))
        self.node._take(self.node._writer, heard)
        self.sent.append((topic, data))

    def stored(self):
        path = self.node._writer.path
        self.node.end()
        return [(topic, data) for topic, _, data in contents(path)[0]]


@pytest.fixture(params=['false', 'true'], ids=['real time', 'lockstep'])
def recorder(request, tmp_path):
    with node_of(RecorderNode, output=tmp_path / 'bag', lockstep=request.param) as node:
        yield Recorder(node)


def test_given_hostile_input_when_recorded_then_all_messages_are_stored_as_sent(recorder):
    def case(rng):
        kind = KINDS[rng.integers(len(KINDS))]
        message, is_forged = recorder.good(kind), rng.random() < 0.5
        data = serialize_message(forge(rng, message)) if is_forged else damaged_bytes(rng, message)
        recorder.hear(kind, data)

    assert run_cases(100, lambda rng: set_parameters(recorder.node, rng)).refused
    run_cases(150, case)
    for kind in KINDS:
        recorder.hear(kind, serialize_message(recorder.good(kind)))
    stored = recorder.stored()
    assert len(stored) == len(recorder.sent)
    if not recorder.node.lockstep:  # where padding is zeroed
        assert stored == recorder.sent


class View:
    def __init__(self, node):
        self.node, self.frames, self._stamp = node, [], 10**9
        node._server.frame = lambda frame: self.frames.append(server.encode(frame))
        ways = (partial(Bridge().forward, one.name, one.every) for one in TOPICS)
        node._inboxes = [Inbox(*each, 0.0, node._refusals.add) for each in zip(TOPICS, ways)]

    def good(self, kind):
        message = sized(kind())
        if hasattr(message, 'tip_position'):
            message.tip_position = [0.0] * 3
        self._stamp += 2_000_000
        set_stamp(message.header.stamp, self._stamp)
        arm = self.node._model._arm
        for name, texts in (('name', arm.joint_names), ('sensor_names', arm.sensor_names)):
            if hasattr(message, name):
                setattr(message, name, list(texts))
        return message

    def show(self, inbox, data):
        """The length of the frame after a message's bytes; those that are counted are `Refused`."""
        before = self._refused()
        inbox.store(data)
        self.node._tick()
        frame, self.frames = self.frames[-1], []
        if self._refused() > before:
            raise Refused('counted')
        return len(frame)

    def _refused(self):
        return sum(self.node._refusals.counts.values())

    def is_live(self):
        for inbox in 2 * self.node._inboxes:  # what is loaded at first takes its time
            self.show(inbox, serialize_message(self.good(inbox.topic.kind)))
        return all(self.node._model.frame(time.monotonic())['live'].values())


class Bridge(FoxgloveBridge):
    """Has no Foxglove server, whose SDK wants stamps that are not negative."""

    def __init__(self):
        self.restart()

    def send(self, topic, data, stamp):
        assert topic and 0 <= stamp < 2**63

    def restart(self):
        self._time = 0


@pytest.fixture
def view():
    files = {'arm_file': 'paper', 'scenario_file': 'two_faults'}
    with node_of(ViewNode, port=0, foxglove_port=0, **files) as node:
        yield View(node)


def test_given_hostile_input_when_shown_then_frames_are_json_and_good_messages_are_live(view):
    def case(rng):
        inbox = view.node._inboxes[rng.integers(len(view.node._inboxes))]
        message, is_damaged = view.good(inbox.topic.kind), rng.random() < 0.4
        data = damaged_bytes(rng, message) if is_damaged else serialize_message(forge(rng, message))
        return view.show(inbox, data)

    assert run_cases(350, case).refused and view.is_live()
    assert run_cases(100, lambda rng: set_parameters(view.node, rng)).refused and view.is_live()


def test_given_simulated_time_when_shown_then_reports_and_arms_follow_it(view):
    reports = view.node._status.publisher = Output(DiagnosticArray)
    assert view.is_live() and 'view: page' in reports.last.status[0].name
    assert 0 < reports.last.header.stamp.sec < 10, 'not of the wall clock'
    published, model = Output(MarkerArray), view.node._model
    view.node._markers_out = published
    for later in (0.0, 60.0):  # then nothing is heard any more
        now = time.monotonic() + later
        view.node._publish_arms(model.arms(now), model.frame(now)['sample'], False)
    assert len(published.sent) == 1
