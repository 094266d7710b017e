"""Messages of the ros2 command: from YAML, to YAML and to comma-separated values."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')

from builtin_interfaces.msg import Time  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus  # noqa: E402
from sensor_msgs.msg import BatteryState, Imu, JointState  # noqa: E402
from std_msgs.msg import String, UInt8MultiArray  # noqa: E402

from lpv_msgs.msg import FaultEstimate  # noqa: E402
from lpv_msgs.srv import InjectFault  # noqa: E402
from lpv_ros2cli.errors import CliError  # noqa: E402
from lpv_ros2cli.graph.receiving import message_filter  # noqa: E402
from lpv_ros2cli.message.from_text import message_from_text  # noqa: E402
from lpv_ros2cli.message.to_text import Style, field_of, to_csv, to_yaml  # noqa: E402
from lpv_ros2cli.message.types import full_type, load  # noqa: E402
from lpv_ros2cli.topic.bw import Bandwidth  # noqa: E402
from lpv_ros2cli.topic.delay import Delays  # noqa: E402
from lpv_ros2cli.topic.hz import Rate  # noqa: E402
from lpv_ros2cli.topic.statistics import table  # noqa: E402

FINITE = st.floats(allow_nan=False, width=64)


def test_given_a_message_when_shown_then_it_is_block_yaml_in_the_order_of_its_fields():
    message = JointState(name=['a', 'b'], position=[0.5, -1.0])
    message.header.stamp.sec = 3
    assert to_yaml(message) == (
        "header:\n  stamp:\n    sec: 3\n    nanosec: 0\n  frame_id: ''\n"
        'name:\n- a\n- b\nposition:\n- 0.5\n- -1.0\nvelocity: []\neffort: []\n'
    )
    assert to_yaml(message, Style(flow=True)) == (
        "header:\n  stamp:\n    sec: 3\n    nanosec: 0\n  frame_id: ''\n"
        'name: [a, b]\nposition: [0.5, -1.0]\nvelocity: []\neffort: []\n'
    )
    assert to_csv(message) == '3,0,,a,b,0.5,-1.0,,'
    assert to_csv(DiagnosticStatus(level=b'\x02', message='m')) == "b'\\x02',,m,,"
    assert to_csv(message, Style(truncate=1)) == '3,0,,a,...,0.5,...,,'
    assert to_csv(message, Style(no_arr=True)).endswith(',<sequence type: double, length: 0>')


def test_given_long_fields_when_shown_then_they_are_shortened_or_left_out():
    message = JointState(name=['x' * 10], position=[float(i) for i in range(200)])
    shown = yaml.safe_load(to_yaml(message, Style(truncate=4)))
    assert shown['name'] == ['xxxx...']
    assert shown['position'] == [0.0, 1.0, 2.0, 3.0, '...']
    assert len(yaml.safe_load(to_yaml(message, Style(truncate=None)))['position']) == 200
    shown = yaml.safe_load(to_yaml(message, Style(no_arr=True)))
    assert shown['position'] == '<sequence type: double, length: 200>'
    assert yaml.safe_load(to_yaml(Imu(), Style(no_arr=True)))['orientation_covariance'] == (
        '<array type: double[9]>'
    )
    assert yaml.safe_load(to_yaml(String(data='abc'), Style(no_str=True)))['data'] == (
        '<string length: <3>>'
    )


def test_given_fields_by_path_when_asked_then_nested_ones_and_elements_are_found():
    message = DiagnosticArray(status=[DiagnosticStatus(name='one'), DiagnosticStatus(name='two')])
    assert field_of(message, 'status[1].name') == 'two'
    assert field_of(message, 'header.stamp') == Time()
    assert field_of(FaultEstimate(bound=[1.0, 2.0]), 'bound[1]') == 2.0
    for path in (
        'nix',
        'status[2]',
        'status[x]',
        'header.nix',
        '',
        'status.',
        '__class__',
        'header.stamp.sec.real',
        'get_fields_and_field_types',
    ):
        with pytest.raises(CliError, match='Invalid field'):
            field_of(message, path)


@given(st.lists(FINITE, max_size=5), st.text(max_size=20), st.integers(0, 2**31 - 1))
def test_given_any_values_when_shown_and_read_back_then_the_message_is_the_same(
    numbers, text, seconds
):
    message = JointState(name=[text], position=numbers)
    message.header.stamp.sec, message.header.frame_id = seconds, text
    assert message_from_text(JointState, to_yaml(message, Style(truncate=None))) == message


def test_given_yaml_when_a_message_is_filled_then_numbers_take_the_fields_types():
    request = message_from_text(
        InjectFault.Request, '{sensor: link1_angle, kind: bias, size: 1, rate: .inf}'
    )
    assert (request.sensor, request.size, request.rate) == ('link1_angle', 1.0, math.inf)
    assert message_from_text(InjectFault.Request, '').sensor == ''
    assert message_from_text(InjectFault.Request, '{size: 1e-3}').size == 1e-3
    assert message_from_text(String, 'data: 5').data == '5'
    assert message_from_text(DiagnosticStatus, 'level: 2').level == b'\x02'
    assert bytes(message_from_text(UInt8MultiArray, 'data: [1, 255]').data) == b'\x01\xff'
    nested = message_from_text(DiagnosticArray, 'status: [{name: a, values: [{key: k}]}]')
    assert nested.status[0].values[0].key == 'k'
    assert message_from_text(BatteryState, 'present: true').present is True


def test_given_now_and_auto_when_a_message_is_filled_then_the_present_time_is_in_it():
    now = Time(sec=7, nanosec=8)
    assert message_from_text(JointState, 'header: auto', now).header.stamp == now
    message = message_from_text(JointState, 'header: {stamp: now, frame_id: f}', now)
    assert (message.header.stamp, message.header.frame_id) == (now, 'f')


@pytest.mark.parametrize(
    ('kind', 'text', 'told'),
    [
        (InjectFault.Request, '{szie: 1}', 'has no field szie; it has: sensor, kind, size'),
        (InjectFault.Request, '[1, 2]', 'takes a mapping'),
        (InjectFault.Request, '3', 'takes a mapping'),
        (InjectFault.Request, '{size: large}', 'takes a number of type double'),
        (InjectFault.Request, '{size: [1]}', 'takes a number'),
        (InjectFault.Request, '{sensor: [a]}', 'takes a text'),
        (InjectFault.Request, '{sensor:', 'not valid YAML'),
        (InjectFault.Request, '{a: &x [*x]}', 'has no field a'),
        (InjectFault.Request, '!!python/object/apply:os.system [ls]', 'not valid YAML'),
        (JointState, '{header: 3}', 'takes a mapping'),
        (JointState, '{header: {stamp: {sec: 1.5}}}', 'header.stamp.sec takes a whole number'),
        (JointState, '{header: {stamp: {sec: 3000000000}}}', 'whole number of type int32'),
        (JointState, '{header: {stamp: {nanosec: -1}}}', 'whole number of type uint32'),
        (JointState, '{position: 1.0}', 'takes a list'),
        (JointState, '{position: [1.0, x]}', r'position\[1\] takes a number'),
        (Imu, '{orientation_covariance: [1.0]}', 'takes 9 elements, got 1'),
        (BatteryState, '{present: 1}', 'takes true or false'),
    ],
)
def test_given_yaml_that_does_not_fit_when_a_message_is_filled_then_the_field_is_named(
    kind, text, told
):
    with pytest.raises(CliError, match=told):
        message_from_text(kind, text)


def test_given_type_names_when_loaded_then_wrong_ones_are_told():
    assert load('std_msgs/String', 'msg') is load('std_msgs/msg/String', 'msg')
    for name in ('nix', 'a/b/c/d', 'std_msgs/srv/String', '../x/String', 'std_msgs/msg/'):
        with pytest.raises(CliError, match='is invalid'):
            full_type(name, 'msg')
    for name in ('std_msgs/msg/Nix', 'nix_msgs/msg/String', 'std_msgs/msg/os'):
        with pytest.raises(CliError, match='not installed'):
            load(name, 'msg')


def test_given_messages_at_known_times_when_rate_and_bandwidth_are_asked_then_they_are_exact():
    rate, bandwidth, delays = Rate(window=100), Bandwidth(window=100), Delays(window=100)
    assert rate.news() is None
    assert delays.report() == ''
    assert bandwidth.describe(0.0) == ''
    for i in range(11):
        rate.add(0.1 * i)
        bandwidth.add(0.1 * i, 200 + i)
        delays.add(0.25)
    news = rate.news()
    assert news.mean == pytest.approx(0.1)
    assert news.spread() == 'min: 0.100s max: 0.100s std dev: 0.00000s window: 10'
    assert rate.news() is None
    assert delays.report() == (
        'average delay: 0.250\n\tmin: 0.250s max: 0.250s std dev: 0.00000s window: 10'
    )
    assert delays.report() == 'no new messages'
    assert bandwidth.describe(1.1) == (
        '2.05 KB/s from 11 messages\n\tMessage size mean: 0.20 KB min: 0.20 KB max: 0.21 KB'
    )


def test_given_rates_of_topics_when_tabulated_then_columns_are_as_wide_as_their_entries():
    assert table(('topic', 'rate'), [('/a', '10.000'), ('/longer', '9.5')]) == (
        ' topic     rate \n================\n/a        10.000\n/longer   9.5   \n'
    )


def test_given_a_filter_when_applied_then_it_sees_fields_of_messages_and_nothing_else():
    matches = message_filter('m.header.frame_id == "a" and len(m.position) > 1')
    message = JointState(position=[1.0, 2.0])
    assert not matches(message)
    message.header.frame_id = 'a'
    assert matches(message)
    for text in ('m.__class__', 'm.header.__init__', 'open("x")', 'm.nix', 'n'):
        with pytest.raises(CliError, match='--filter: .* is not covered'):
            message_filter(text)(message)
    with pytest.raises(CliError, match='--filter: '):
        message_filter('m.position[5] > 0')(message)
    with pytest.raises(CliError, match='--filter: '):
        message_filter('m.')
