import math
import re
import subprocess
import sys
import threading
import time

import pytest
import ros
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.lifecycle import LifecycleNode
from ros2_commands import Running
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String, UInt8MultiArray

from lpv_msgs.srv import InjectFault
from lpv_ros2cli import command_line, messages
from lpv_ros2cli.main import main


def test_given_the_parser_when_built_then_nothing_heavy_is_imported():
    code = 'import sys; from lpv_ros2cli.main import build_parser; build_parser()\n'
    code += 'print({"rclpy", "yaml", "numpy", "rosbags", "lpv.bag"} & set(sys.modules))'
    assert subprocess.check_output([sys.executable, '-c', code]) == b'set()\n'


STUCK = """
import ctypes
from lpv_ros2cli import graph
graph._LEAVE = 0.1
with graph.command_node() as node:
    node.destroy_node = lambda: ctypes.PyDLL(None).sleep(600)  # as Fast DDS: Python does nothing
"""


def test_given_a_middleware_that_never_returns_when_left_then_the_command_ends():
    done = subprocess.run([sys.executable, '-c', STUCK], capture_output=True, timeout=300)
    assert done.returncode == 1 and b'Timeout' in done.stderr


@pytest.mark.parametrize(('words', 'told'), [
    (('run', 'lpv_uio', 'nix'), "has no program 'nix', only: uio"),
    (('launch', 'lpv_nix', 'x.launch.xml'), "package 'lpv_nix': is not installed"),
    (('launch', 'lpv_bringup', 'nix.launch.xml'), 'name a launch file .* pipeline.launch.xml'),
    (('launch', 'lpv_bringup', 'pipeline.launch.xml', 'arm'), 'malformed launch argument'),
    (('service', 'call', '/x', 'std_srvs/srv/Nix'), 'is not installed'),
    (('service', 'call', '/x', 'lpv_msgs/srv/InjectFault', '{szie: 1}'), 'has no field szie'),
    (('param', 'set', '/x', 'y', '"'), 'not valid YAML'),
    (('bag', 'info', '/nowhere'), 'cannot be read'), (('bag', 'record'), 'what is to be recorded'),
])  # fmt: skip
def test_given_what_is_not_there_when_asked_for_then_one_line_says_so(capsys, words, told):
    assert main(list(words)) == 1
    errors = capsys.readouterr().err
    assert re.search(told, errors) and errors.count('\n') == 1


def test_given_what_is_not_covered_when_asked_for_then_the_code_is_that_of_a_wrong_command_line():
    pytest.raises(SystemExit, main, ['topic', 'pub', '/x']).match('^2$')


@settings(max_examples=50)
@given(st.lists(st.floats(allow_nan=False), max_size=5), st.text(), st.integers(0, 2**31 - 1))
@example([], '\x85', 0)
def test_given_any_values_when_shown_then_they_are_read_back(numbers, text, seconds):
    message = JointState(name=[text], position=numbers)
    message.header.stamp.sec, message.header.frame_id = seconds, text
    assert messages.from_yaml(JointState, messages.to_yaml(message)) == message


def test_given_yaml_when_a_message_is_filled_then_values_take_the_fields_types():
    request = messages.from_yaml(InjectFault.Request, '{kind: 5, size: 1, rate: .inf}')
    assert (request.kind, request.size, request.rate) == ('5', 1.0, math.inf)
    assert messages.from_yaml(InjectFault.Request, '{size: 1e-3}').size == 1e-3
    assert messages.from_yaml(DiagnosticStatus, 'level: 2').level == b'\x02'
    assert bytes(messages.from_yaml(UInt8MultiArray, 'data: [1, 255]').data) == b'\x01\xff'
    nested = messages.from_yaml(DiagnosticArray, 'status: [{name: a, values: [{key: k}]}]')
    assert nested.status[0].values[0].key == 'k'
    assert yaml.safe_load(messages.to_yaml(String(data='x' * 200)))['data'] == 'x' * 128 + '...'


@pytest.mark.parametrize(('kind', 'text', 'told'), [
    (InjectFault.Request, '[1, 2]', 'takes its fields'),
    (InjectFault.Request, '{size: large}', 'field size takes double'),
    (InjectFault.Request, '!!python/object/apply:os.system [ls]', 'not valid YAML'),
    (JointState, '{header: 3}', 'header takes its fields'),
    (JointState, '{header: {stamp: {sec: 1.5}}}', 'field sec takes int32'),
    (JointState, '{position: [1.0, x]}', 'field position takes sequence<double>'),
    (Imu, '{orientation_covariance: [1.0]}', r'takes double\[9\]'),
])  # fmt: skip
def test_given_yaml_that_does_not_fit_when_filled_in_then_the_field_is_named(kind, text, told):
    pytest.raises(command_line.CliError, messages.from_yaml, kind, text).match(told)


@pytest.fixture(scope='module')
def graph():
    """A managed node that publishes, serves and has a parameter, on a domain of its own."""
    domain = ros.next_domain()

    def inject(request, response):
        response.success, response.message = request.size > 0.0, request.sensor
        return response

    with pytest.MonkeyPatch.context() as patch, ros.client(domain, LifecycleNode, 'arm') as client:
        patch.setenv('ROS_DOMAIN_ID', str(domain))
        node = client.node
        publisher = node.create_publisher(JointState, 'joints', 10)
        node.create_timer(0.02, lambda: publisher.publish(JointState(position=[0.5, -1.0])))
        node.create_service(InjectFault, 'inject', inject)
        limits = [FloatingPointRange(from_value=0.0, to_value=10.0)]
        node.declare_parameter('gain', 1.0, ParameterDescriptor(floating_point_range=limits))
        fixed = {'description': 'of the drives', 'read_only': True}
        own = ParameterDescriptor(floating_point_range=limits, **fixed)
        node.declare_parameter('fixed', 1.0, own)
        thread = threading.Thread(target=client.executor.spin)
        thread.start()
        yield
        client.executor.shutdown()
        thread.join()


@pytest.fixture
def ros2(graph, capsys):
    """Run a command in this process, which has imported rclpy; what it prints, or what is wrong."""

    def run(*words, code=0, fails=False):
        assert main([str(word) for word in words]) == code
        text, errors = capsys.readouterr()
        said, silent = (errors, text) if code or fails else (text, errors)
        assert silent == '', silent
        return said

    return run


@pytest.mark.ros
def test_given_a_graph_when_listed_or_called_then_what_is_there_answers(ros2):
    assert ros2('node', 'list') == '/lpv/arm\n'
    assert '/lpv/joints [sensor_msgs/msg/JointState]\n' in ros2('topic', 'list', '-t')
    assert '/lpv/inject\n' in ros2('service', 'list')
    text = ros2('topic', 'info', '/lpv/joints')
    assert text == 'Type: sensor_msgs/msg/JointState\nPublisher count: 1\nSubscription count: 0\n'
    kind = 'lpv_msgs/srv/InjectFault'
    text = ros2('service', 'call', '/lpv/inject', kind, '{sensor: elbow, size: 1}')
    assert 'requester: making request: lpv_msgs.srv.InjectFault_Request(sensor=' in text
    assert "response:\nlpv_msgs.srv.InjectFault_Response(success=True, message='elbow'" in text
    errors = ros2('service', 'call', '/lpv/inject', 'std_srvs/srv/Empty', code=1)
    assert errors == f"service '/lpv/inject' is of type {kind}\n"


@pytest.mark.ros
def test_given_a_topic_when_echoed_then_messages_are_yaml_and_rates_come_until_interrupted(ros2):
    text = ros2('topic', 'echo', '--once', '/lpv/joints')
    assert text.startswith("header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: ''\n")
    assert text.endswith('position:\n- 0.5\n- -1.0\nvelocity: []\neffort: []\n---\n')
    with Running('topic', 'hz', '/lpv/joints') as rate:
        text = rate.until('window')
        assert re.search(r'average rate: [\d.]+\n\tmin: [\d.]+s max: .* window: \d+\n', text)
        code, text = rate.interrupt()
    assert code == 2 and 'Traceback' not in text


@pytest.mark.ros
def test_given_a_node_when_its_parameters_or_state_are_set_then_it_says_what_it_takes(ros2):
    assert '  gain\n' in ros2('param', 'list', '/lpv/arm')
    assert ros2('param', 'set', '/lpv/arm', 'gain', '2') == 'Set parameter successful\n'
    assert ros2('param', 'get', '/lpv/arm', 'gain') == 'Double value is: 2.0\n'
    errors = ros2('param', 'set', '/lpv/arm', 'gain', '20.0', fails=True)
    assert errors.startswith('Setting parameter failed: ')
    for words in (('/lpv/arm', 'nix'), ('/nix', 'gain')):
        for verb in ('get', 'describe'):
            assert ros2('param', verb, *words, code=1).count('\n') == 1
    text = 'Parameter name: fixed\n  Type: double\n  Description: of the drives\n  Constraints:\n'
    text += '    Read only: true\n    Min value: 0.0\n    Max value: 10.0\n'
    assert ros2('param', 'describe', '/lpv/arm', 'fixed') == text
    assert ros2('lifecycle', 'get', '/lpv/arm') == 'unconfigured [1]\n'
    assert ros2('lifecycle', 'set', '/lpv/arm', 'configure') == 'Transitioning successful\n'
    errors = ros2('lifecycle', 'set', '/lpv/arm', 'configure', code=1)
    assert errors.startswith('Unknown transition requested, available ones are:\n- cleanup [2]\n')
    assert ros2('lifecycle', 'set', '/lpv/arm', '2') == 'Transitioning successful\n'


@pytest.mark.ros
def test_given_a_topic_when_recorded_then_the_bag_is_described(ros2, tmp_path):
    bag = tmp_path / 'bag'
    with Running('bag', 'record', '-o', bag, 'lpv/joints') as recorder:
        recorder.until(r'rosbag2_recorder\]: recording 1 topic')
        begin, patience = (bag / 'bag.mcap').stat().st_size, time.monotonic() + 300.0
        while (bag / 'bag.mcap').stat().st_size == begin and time.monotonic() < patience:
            time.sleep(0.05)  # until the recorder knows of the publisher
        code, text = recorder.interrupt()
    assert code == 0, text
    info = ros2('bag', 'info', bag)
    topic = r'Topic: /lpv/joints \| Type: sensor_msgs/msg/JointState \| Count: [1-9]\d* \| Ser'
    for told in (r'(?m)^Files: +bag.mcap\n', r'Duration: +\d+\.\d{9}s\n', topic):
        assert re.search(told, info), info
