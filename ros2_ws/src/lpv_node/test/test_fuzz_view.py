"""Hostile messages and parameters for the live view: its frames are JSON, and it goes on."""

import time

import pytest
from places import BRINGUP

pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
pytest.importorskip('foxglove', reason='foxglove-sdk is not installed')
pytest.importorskip('lpv_node.view', reason='the workspace is not built')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from fuzzing import bounded_memory  # noqa: E402
from hostile import Output, Refused, damaged_bytes, forge, node_of, run_cases, set_parameters, sized  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402

from lpv_node.view.node import ViewNode  # noqa: E402
from lpv_node.view.server import encode  # noqa: E402
from lpv_node.view.topics import Inbox  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.fuzz]


class View:
    """A view that takes messages and shows them at once."""

    def __init__(self, node):
        self.node, self.frames, self._stamp = node, [], 10**9
        node._server.frame = lambda frame: self.frames.append(encode(frame))

    def good(self, kind):
        """A message of a kind with the next stamp."""
        message = sized(kind(), 2)
        if hasattr(message, 'tip_position'):
            message.tip_position = [0.0] * 3
        self._stamp += 2_000_000
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self._stamp, 10**9)
        arm = self.node._model._arm
        for name, texts in (('name', arm.joint_names), ('sensor_names', arm.sensor_names)):
            if hasattr(message, name):
                setattr(message, name, list(texts))
        return message

    def show(self, inbox, data):
        """The frame after a message's bytes."""
        before = self.refused()
        inbox.store(data)
        self.node._tick()
        assert self.frames
        frame, self.frames = self.frames[-1], []
        if self.refused() > before:
            raise Refused('counted')
        return len(frame)

    def refused(self):
        """Messages that were counted as refused."""
        return sum(self.node._refusals.counts.values()) + self.node._model.misfits

    def is_live(self):
        """Whether good messages are shown."""
        for inbox in 2 * self.node._inboxes:  # what is loaded at first takes its time
            self.show(inbox, serialize_message(self.good(inbox.topic.kind)))
        return all(self.node._model._live(time.monotonic()).values())


@pytest.fixture
def view():
    with node_of(
        ViewNode,
        'view',
        arm_file=BRINGUP / 'arms' / 'paper.yaml',
        scenario_file=BRINGUP / 'scenarios' / 'two_faults.yaml',
        port=0,
        foxglove_port=0,
    ) as node:
        node._inboxes = [
            Inbox(inbox.topic, node._forwarder(Bridge(), inbox.topic), 0.0, node._refusals.add)
            for inbox in node._inboxes
        ]
        yield View(node)


class Bridge:
    """Takes the place of the Foxglove server, whose SDK wants stamps that are not negative."""

    def send(self, name, data, stamp):
        assert name and 0 <= stamp < 2**63

    def restart(self):
        pass


def damaged_or_forged(rng, message):
    """Bytes of one."""
    if rng.random() < 0.4:
        return damaged_bytes(rng, message)
    return serialize_message(forge(rng, message))


def test_given_forged_and_damaged_messages_when_shown_then_frames_are_json_and_good_ones_are_live(
    view,
):
    def case(rng):
        inbox = view.node._inboxes[rng.integers(len(view.node._inboxes))]
        return view.show(inbox, damaged_or_forged(rng, view.good(inbox.topic.kind)))

    with bounded_memory():
        tally = run_cases(350, case)
    assert tally.refused and tally.accepted
    assert view.is_live()


def test_given_hostile_parameters_when_set_then_the_view_goes_on(view):
    assert run_cases(100, lambda rng: set_parameters(view.node, rng)).refused
    assert view.is_live()


def test_given_a_simulated_time_when_the_view_reports_itself_then_it_is_of_that_time(view):
    """A status of the wall clock would look as if the graph's time had restarted."""
    reports = view.node._status.publisher = Output(DiagnosticArray)
    assert view.is_live()
    assert 'view: page' in reports.last.status[0].name
    assert 0 < reports.last.header.stamp.sec < 10


def test_given_arms_of_which_nothing_is_heard_any_more_when_shown_then_none_is_published(
    view, monkeypatch
):
    assert view.is_live()
    published, model = [], view.node._model
    monkeypatch.setattr(view.node, '_publish', lambda name, *_: published.append(name))
    for later in (0.0, 60.0):
        now = time.monotonic() + later
        view.node._publish_arms(model.arms(now), model.frame(now)['sample'], False)
    assert published == ['arm_markers', '/tf']


def test_given_an_arm_with_a_urdf_when_viewed_then_both_descriptions_are_that_urdf():
    arm = BRINGUP / 'arms' / 'ur10.yaml'
    with node_of(ViewNode, 'view', arm_file=arm, port=0, foxglove_port=0) as node:
        first, second = node._described
    assert first == second and b'<joint name="wrist_3_joint"' in first
