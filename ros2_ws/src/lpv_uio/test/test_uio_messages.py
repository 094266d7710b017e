"""Messages of the observer's topics, from plain fields."""

from array import array

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

from lpv_uio.messages import OutputMessages  # noqa: E402

STAMP = 3_000_000_007
ALARM = {
    'sensor': 'link2_angle',
    'sensor_index': 1,
    'event': 0,
    'onset': 1_000_000_000,
    'detected': 2_500_000_000,
    'size': 0.3,
    'bound': 0.01,
    'kind': 'bias',
    'confidence': 0.9,
}


def test_given_an_alarm_when_put_into_a_message_then_times_and_fields_are_in_it():
    message = OutputMessages('some_arm').alarm(STAMP, ALARM)
    assert (message.header.frame_id, message.header.stamp.sec) == ('some_arm', 3)
    assert message.header.stamp.nanosec == 7
    assert (message.onset.sec, message.detected.nanosec) == (1, 500_000_000)
    assert (message.sensor, message.sensor_index, message.kind) == ('link2_angle', 1, 'bias')


def test_given_two_alarms_when_put_into_messages_then_each_is_its_own():
    messages = OutputMessages('some_arm')
    first = messages.alarm(STAMP, ALARM)
    messages.alarm(STAMP, {**ALARM, 'kind': 'drift'})
    assert first.kind == 'bias'


def test_given_a_status_when_put_into_diagnostics_then_level_and_values_are_those_of_ros():
    status = {'name': 'a', 'level': 2, 'message': 'm', 'hardware_id': 'h', 'values': {'k': 'v'}}
    array = OutputMessages.diagnostics(STAMP, [status])
    assert array.header.stamp.sec == 3
    assert array.status[0].level == b'\x02'
    assert [(v.key, v.value) for v in array.status[0].values] == [('k', 'v')]


@pytest.mark.parametrize('joints', [1, 2, 7])
def test_given_estimates_of_any_number_of_joints_when_put_into_messages_then_all_are_in_them(
    joints,
):
    messages = OutputMessages('some_arm')
    fields = {'estimate': np.arange(float(joints)), 'state': [0] * joints}
    message = messages.fault(STAMP, {**fields, 'alarm': [True] * joints})
    assert message.estimate == array('d', range(joints))
    assert list(message.state) == [0] * joints and message.alarm == [True] * joints
