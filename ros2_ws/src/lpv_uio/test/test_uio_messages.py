"""Messages of the observer's topics, from plain fields."""

from types import SimpleNamespace

import numpy as np
from rclpy.serialization import deserialize_message

from lpv.core.monitoring.answers import answer_type
from lpv_msgs.msg import FaultEstimate, StateEstimate
from lpv_uio.messages import OutputMessages

STAMP = 3_000_000_007
ALARM = {'sensor': 'link2_angle', 'sensor_index': 1, 'event': 0, 'onset': 1_000_000_000,
         'detected': 2_500_000_000, 'size': 0.3, 'bound': 0.01, 'kind': 'bias',
         'confidence': 0.9}  # fmt: skip


def messages_of(joints):
    """Messages of an arm of so many joints."""
    names = [f'j{i}' for i in range(joints)]
    arm = SimpleNamespace(name='some_arm', joint_names=names, sensor_names=names)
    return OutputMessages(arm, answer_type(joints))


def test_given_numbers_that_are_nan_when_filled_then_the_last_ones_are_sent_and_not_trusted():
    messages, record = messages_of(3), np.zeros(1, answer_type(3))
    state, fault = record['state'][0], record['fault'][0]
    state['position'], state['trustworthy'], fault['bound'] = 1.0, True, [0.1, 0.2, np.inf]
    assert messages.fill(record[0]) and messages.record == record
    fault['bound'][1] = fault['threshold'][1] = np.nan
    assert not messages.fill(record[0])
    sent = messages.record['fault'][0]
    assert sent['bound'].tolist() == [0.1, 0.2, np.inf] and sent['threshold'].tolist() == [0.0] * 3
    assert sent['state'].tolist() == [0, FaultEstimate.STALE, 0]
    assert messages.record['state']['mode'] == 0 and not messages.record['state']['trustworthy']
    state['position'][0] = np.inf
    assert not messages.fill(record[0])
    sent = deserialize_message(messages.state.at(STAMP), StateEstimate)
    assert (list(sent.position), sent.mode) == ([1.0] * 3, StateEstimate.STALE)


def test_given_alarms_when_put_into_messages_then_each_is_its_own_and_nan_means_not_known():
    messages = messages_of(2)
    first = messages.alarm(STAMP, ALARM)
    second = messages.alarm(STAMP, {**ALARM, 'kind': 'drift', 'size': np.nan, 'bound': np.nan})
    assert (first.kind, first.size, first.bound) == ('bias', 0.3, 0.01)
    assert (second.kind, second.size, second.bound) == ('drift', 0.0, np.inf)
