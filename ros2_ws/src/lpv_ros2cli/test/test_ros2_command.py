"""The ros2 command of wheel-only machines, every verb against one running pipeline."""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import ros
import yaml
from ros2_commands import ROS2, Running, known_graph

pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')

from rosbags.highlevel import AnyReader  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402

from lpv_node.qos import stream  # noqa: E402
from lpv_ros2cli.main import main  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

NODES = ['/lpv/arm_sim', '/lpv/tracker', '/lpv/uio']
CALM = """
name: calm
duration: 600.0
path:
  waypoints:
    - {t: 0.5, x: -0.8451, y: 1.5893}
    - {t: 20.0, x: 0.8451, y: 1.5893}
"""


@pytest.fixture(scope='module')
def pipeline(tmp_path_factory):
    """A client on the domain of the launched pipeline, which in the end is interrupted."""
    folder = tmp_path_factory.mktemp('pipeline')
    (folder / 'calm.yaml').write_text(CALM)
    domain = ros.next_domain()
    kept = {
        name: os.environ.get(name)
        for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOG_DIR')
    }
    os.environ.update(
        ROS_DOMAIN_ID=str(domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
        ROS_LOG_DIR=str(folder / 'log'),
    )
    launch = Running(
        'launch',
        'lpv_bringup',
        'pipeline.launch.xml',
        'arm:=paper',
        f'scenario_file:={folder / "calm.yaml"}',
    )
    try:
        launch.until(r'\[lpv.uio\]: observing', 240.0)  # the first start compiles
        with ros.client(domain) as client, known_graph():
            states = client.listen(JointState, 'joint_states', stream(False))
            assert client.wait(lambda: len(states) > 100), 'no measurements'
            yield client
    finally:
        code, text = launch.interrupt()
        assert code == 0, text
        assert 'user interrupted with ctrl-c (SIGINT)\n' in text
        for name in ('tracker-1', 'simulator-2', 'uio-3'):
            assert f'[INFO] [{name}]: process has finished cleanly' in text
        for name, value in kept.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


@pytest.fixture
def ros2(pipeline, capsys):
    """Run a command in this process: exit code, stdout, stderr."""

    def run(*words):
        handler = signal.getsignal(signal.SIGTERM)
        try:
            code = main([str(word) for word in words])
        except SystemExit as error:  # of argparse
            code = error.code
        finally:
            signal.signal(signal.SIGTERM, handler)
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def out(ros2):
    """Run a command that succeeds; what it prints."""

    def run(*words):
        code, text, errors = ros2(*words)
        assert (code, errors) == (0, ''), errors
        return text

    return run


def test_given_a_graph_when_listed_then_nodes_topics_and_services_are_there(out):
    alone = subprocess.run([str(ROS2), 'node', 'list'], capture_output=True, text=True, check=True)
    assert [n for n in alone.stdout.split() if n != '/lpv/client'] == NODES
    assert out('node', 'list') == alone.stdout
    assert out('node', 'list', '-c') == '4\n'
    assert out('lifecycle', 'nodes').split() == NODES
    topics = out('topic', 'list').split()
    assert topics == sorted(topics)
    assert {'/lpv/joint_states', '/lpv/fault_alarm', '/diagnostics'} <= set(topics)
    assert '/lpv/fault_alarm [lpv_msgs/msg/FaultAlarm]' in out('topic', 'list', '-t')
    assert int(out('topic', 'list', '--count-topics')) == len(topics)
    verbose = out('topic', 'list', '-v')
    assert ' * /lpv/joint_states [sensor_msgs/msg/JointState] 1 publisher\n' in verbose
    assert ' * /lpv/joint_states [sensor_msgs/msg/JointState] 2 subscribers\n' in verbose
    assert '/lpv/arm_sim/inject_fault [lpv_msgs/srv/InjectFault]' in out('service', 'list', '-t')


def test_given_a_node_and_a_topic_when_asked_then_their_ends_are_told(out):
    info = out('node', 'info', '/lpv/tracker')
    assert info.startswith('/lpv/tracker\n  Subscribers:\n')
    subscribers, publishers = info.split('  Publishers:\n')
    assert '    /lpv/state_estimate: lpv_msgs/msg/StateEstimate\n' in subscribers
    assert '    /lpv/torque_command: lpv_msgs/msg/TorqueCommand\n' in publishers
    assert out('topic', 'info', '/lpv/torque_command') == (
        'Type: lpv_msgs/msg/TorqueCommand\nPublisher count: 1\nSubscription count: 1\n'
    )
    verbose = out('topic', 'info', '-v', '/lpv/fault_alarm')
    assert 'Node name: uio\nNode namespace: /lpv\n' in verbose
    assert 'Durability: TRANSIENT_LOCAL' in verbose


def test_given_a_topic_when_echoed_then_messages_are_yaml_fields_or_values(out):
    text = out('topic', 'echo', '--once', '/lpv/joint_states')
    assert text.endswith('---\n')
    (message,) = (m for m in yaml.safe_load_all(text) if m)
    assert message['name'] == ['joint1', 'joint2']
    assert len(message['position']) == 2
    values = out('topic', 'echo', '--once', '--csv', '/lpv/joint_states').split(',')
    assert values[3:5] == ['joint1', 'joint2']
    stamp = out('topic', 'echo', '--once', '--field', 'header.stamp.sec', '/lpv/joint_states')
    assert re.fullmatch(r'\d+\n---\n', stamp)
    assert (
        out('topic', 'echo', '--once', '--field', 'sensor_names[1]', '/lpv/fault_estimate')
        == 'link2_angle\n---\n'
    )


def test_given_a_topic_when_rate_and_bandwidth_are_asked_then_they_are_told_until_interrupted(
    pipeline,
):
    with (
        Running('topic', 'hz', '/lpv/joint_states') as rate,
        Running('topic', 'bw', '/lpv/joint_states') as bandwidth,
    ):
        text = rate.until('window')
        assert re.search(
            r'average rate: \d+\.\d{3}\n\tmin: [\d.]+s max: [\d.]+s '
            r'std dev: [\d.]+s window: \d+\n',
            text,
        )
        text = bandwidth.until('Message size')
        assert text.startswith('Subscribed to [/lpv/joint_states]\n')
        assert re.search(r'[\d.]+ [KM]?B/s from \d+ messages\n\tMessage size mean: ', text)
        for command in (rate, bandwidth):
            code, text = command.interrupt()
            assert code == 2
            assert 'Traceback' not in text


def test_given_a_message_when_published_then_subscribers_get_it_as_often_as_asked(pipeline, out):
    received = pipeline.listen(String, '/said', 10)
    text = out(
        'topic', 'pub', '-t', '3', '-r', '50', '/said', 'std_msgs/msg/String', '{data: hello}'
    )
    assert "publisher: beginning loop\npublishing #1: std_msgs.msg.String(data='hello')\n\n" in text
    assert pipeline.wait(lambda: len(received) == 3)
    out('topic', 'pub', '--once', '/said', 'std_msgs/String', 'data: 4')
    assert pipeline.wait(lambda: len(received) == 4)
    assert [m.data for m in received] == ['hello'] * 3 + ['4']


def test_given_a_fault_injected_by_a_call_when_the_alarm_topic_is_echoed_then_it_is_there(
    out, ros2
):
    answer = out(
        'service',
        'call',
        '/lpv/arm_sim/inject_fault',
        'lpv_msgs/srv/InjectFault',
        '{sensor: link2_angle, kind: bias, size: 0.3}',
    )
    assert 'requester: making request: lpv_msgs.srv.InjectFault_Request(sensor=' in answer
    assert 'response:\nlpv_msgs.srv.InjectFault_Response(success=True' in answer
    alarm = yaml.safe_load(out('topic', 'echo', '--once', '/lpv/fault_alarm').split('---')[0])
    assert alarm['sensor'] in ('link1_angle', 'link2_angle')
    with Running('topic', 'echo', '/lpv/fault_alarm', '--csv') as alarms:
        alarms.until(',link2_angle,1,0,')  # RAISED
        assert alarms.interrupt()[0] == 2
    assert 'success=True' in out(
        'service', 'call', '/lpv/arm_sim/clear_faults', 'lpv_msgs/srv/ClearFaults'
    )
    answer = out(
        'service',
        'call',
        '/lpv/arm_sim/inject_fault',
        'lpv_msgs/srv/InjectFault',
        '{sensor: elbow, kind: bias, size: 0.3}',
    )
    assert 'success=False' in answer


def test_given_parameters_when_set_then_the_node_validates_them(out, ros2, tmp_path):
    uio, name = '/lpv/uio', 'diagnosis.threshold_factor'
    assert f'  {name}\n' in out('param', 'list', uio)
    code, text, _ = ros2('param', 'list')
    assert code == 1  # the test's own node does not answer; it must not hide the others
    assert re.search(r'^/lpv/client:\n  \(.* did not answer .*\)\n', text, re.M)
    assert re.search(rf'^{uio}:\n(?:  \S+\n)*  {name}\n', text, re.M)
    assert out('param', 'get', uio, name) == 'Double value is: 1.0\n'
    assert out('param', 'set', uio, name, '2') == 'Set parameter successful\n'
    assert out('param', 'get', '--hide-type', uio, name) == '2.0\n'
    description = out('param', 'describe', uio, name)
    assert '  Type: double\n' in description
    assert '    Min value: 0.1\n    Max value: 10.0\n' in description
    for value, expected, told in (
        ('20.0', 0, 'Setting parameter failed: .* out of range'),
        ('.nan', 0, 'Setting parameter failed: .* out of range'),
        ('fast', 0, 'Setting parameter failed: .* type'),
        ('"', 1, 'not valid YAML'),
    ):
        code, text, errors = ros2('param', 'set', uio, name, value)
        assert (code, text) == (expected, '')
        assert re.search(told, errors)
        assert errors.count('\n') == 1
    dump = out('param', 'dump', uio)
    assert yaml.safe_load(dump)[uio]['ros__parameters']['diagnosis']['threshold_factor'] == 2.0
    path = tmp_path / 'parameters.yaml'
    path.write_text('/**:\n  ros__parameters:\n    diagnosis: {threshold_factor: 1}\n')
    assert out('param', 'load', uio, path) == f'Set parameter {name} successful\n'
    assert out('param', 'get', uio, name) == 'Double value is: 1.0\n'
    path.write_text(f'{uio}:\n  ros__parameters:\n    diagnosis: {{threshold_factor: 99.0}}\n')
    code, text, _ = ros2('param', 'load', uio, path)
    assert code == 1
    assert text.startswith(f'Set parameter {name} failed: ')


def test_given_a_managed_node_when_its_state_is_changed_then_it_follows(out, ros2):
    assert out('lifecycle', 'get', '/lpv/tracker') == 'active [3]\n'
    assert out('lifecycle', 'get').splitlines() == [f'{node}: active [3]' for node in NODES]
    assert out('lifecycle', 'set', '/lpv/tracker', 'deactivate') == 'Transitioning successful\n'
    code, _, errors = ros2('lifecycle', 'set', '/lpv/tracker', 'configure')
    assert code == 1
    assert errors.startswith('Unknown transition requested, available ones are:\n- cleanup [2]\n')
    assert out('lifecycle', 'set', '/lpv/tracker', '3') == 'Transitioning successful\n'
    assert out('lifecycle', 'get', '/lpv/tracker') == 'active [3]\n'


def test_given_topics_when_recorded_then_the_bag_is_described_and_played(pipeline, out, tmp_path):
    bag = tmp_path / 'bag'
    with Running('bag', 'record', '-o', bag, '/lpv/joint_states', 'lpv/fault_alarm') as recorder:
        recorder.until(r'rosbag2_recorder\]: recording 2 topics')
        time.sleep(1.5)
        code, text = recorder.interrupt()
    assert code == 0, text
    with AnyReader([bag]) as reader:
        start, chosen = reader.start_time, reader.topics['/lpv/joint_states'].connections
        logged = [stamp for _, stamp, _ in reader.messages(chosen)]
    count = len(logged)
    assert count > 50
    info = out('bag', 'info', bag)
    assert re.search(r'Files: +\S+\.mcap\n', info)
    assert re.search(
        rf'Topic: /lpv/joint_states \| Type: sensor_msgs/msg/JointState \| '
        rf'Count: {count} \| Serialization Format: cdr',
        info,
    )
    received = pipeline.listen(JointState, '/played', stream(False))
    clocks = pipeline.listen(Clock, '/clock', 10)
    text = out(
        'bag',
        'play',
        bag,
        '--rate',
        '5',
        '--topics',
        '/lpv/joint_states',
        '--remap',
        '/lpv/joint_states:=/played',
        '--clock',
    )
    assert f'published {count} messages' in text
    assert pipeline.wait(lambda: len(received) > 2)
    assert list(received[0].name) == ['joint1', 'joint2']
    assert pipeline.wait(lambda: len(clocks) > 3)
    times = np.array([c.clock.sec * 10**9 + c.clock.nanosec for c in clocks])
    assert set(np.diff(times)) <= {125_000_000 * n for n in range(1, 8)}  # 40 a second of ours
    half = (logged[count // 2] - start) / 1e9  # a topic may have been found later than others
    text = out(
        'bag',
        'play',
        bag,
        '--rate',
        '5',
        '--topics',
        '/lpv/joint_states',
        '--remap',
        '/lpv/joint_states:=/played',
        '--start-offset',
        f'{half:.6f}',
    )
    assert int(re.search(r'published (\d+) messages', text).group(1)) == pytest.approx(
        count - count // 2, abs=2
    )


def test_given_a_set_up_machine_when_checked_then_the_doctor_is_content(out):
    assert 'All checks passed' in out('doctor')
    report = out('doctor', '--report')
    for heading in ('PLATFORM INFORMATION', 'ROS 2 INFORMATION', 'NETWORK CONFIGURATION', 'GRAPH'):
        assert f'   {heading}\n' in report
    assert 'rmw_fastrtps_cpp' in report
    assert '/lpv/uio' in report


@pytest.mark.parametrize(
    'words',
    [
        ('topic', 'echo', '/nix'),
        ('topic', 'info', '/nix'),
        ('topic', 'echo', '/lpv/joint_states', '--field', 'nix', '--once'),
        ('topic', 'echo', 'a b'),
        ('topic', 'echo', '/lpv/joint_states', 'nix_msgs/msg/X'),
        ('topic', 'pub', '/said', 'std_msgs/msg/Nix'),
        ('topic', 'pub', '/said', 'std_msgs/msg/String', '{dat: 1}'),
        ('topic', 'pub', '/said', 'std_msgs/msg/String', '{', '--once'),
        ('topic', 'pub', '/said', 'std_msgs/msg/String', '--rate', 'nan'),
        ('topic', 'pub', '--once', '--max-wait-time-secs', '0.1', '/nobody', 'std_msgs/msg/String'),
        ('node', 'info', '/nix'),
        ('param', 'list', '/nix'),
        ('param', 'get', '/lpv/uio', 'nix'),
        ('param', 'describe', '/lpv/uio', 'nix'),
        ('param', 'dump', '/nix'),
        ('param', 'load', '/lpv/uio', '/nowhere.yaml'),
        ('lifecycle', 'get', '/nix'),
        ('lifecycle', 'get', '/lpv/client'),
        ('service', 'call', '/lpv/uio/reset', 'std_srvs/srv/Empty'),
        ('service', 'call', '/lpv/uio/reset', 'std_srvs/srv/Nix'),
        ('interface', 'show', 'std_msgs/msg/Nix'),
        ('interface', 'show', '../../etc'),
        ('pkg', 'prefix', 'nix'),
        ('pkg', 'executables', '..'),
        ('run', 'lpv_uio', 'nix'),
        ('bag', 'info', '/nowhere'),
        ('bag', 'play', '/nowhere'),
        ('bag', 'record', '-o', '/tmp', '/lpv/joint_states'),
        ('bag', 'record', '-e', '('),
        ('launch', 'lpv_bringup', 'nix.launch.xml'),
        ('launch', 'lpv_nix', 'x.launch.xml'),
        ('launch', '/nowhere.launch.xml'),
        ('launch', 'lpv_bringup'),
        ('launch', 'lpv_bringup', 'pipeline.launch.xml', 'arm'),
    ],
    ids=' '.join,
)
def test_given_what_is_not_there_when_asked_for_then_one_line_says_so(ros2, words):
    code, _, errors = ros2(*words)
    assert code == 1
    assert errors.count('\n') == 1
    assert len(errors) > 20


def test_given_no_nodes_when_listed_then_nothing_is_printed(tmp_path):
    environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.next_domain()))
    commands = [
        subprocess.Popen(
            [str(ROS2), *words],
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for words in (('node', 'list'), ('lifecycle', 'nodes'), ('service', 'list'))
    ]
    for command in commands:
        assert command.communicate(timeout=60) == ('', '')
        assert command.returncode == 0


@pytest.mark.parametrize(
    ('words', 'told'),
    [
        (('topic', 'nix'), "topic 'nix' is not covered by this ros2"),
        (('action',), "'action' is not covered by this ros2"),
        (('topic', 'list', '--nix'), "option '--nix' is not covered by this ros2"),
        (('topic', 'ech'), 'covered here: bw, delay, echo, find, hz, info, list, pub, type'),
        (('launch', 'lpv_bringup', 'pipeline.launch.xml', '--nix'), 'not covered by this ros2'),
        (('bag', 'record'), 'what is to be recorded?'),
    ],
)
def test_given_what_is_not_covered_when_asked_for_then_it_is_said_with_code_2(capsys, words, told):
    assert main(list(words)) == 2
    assert told in capsys.readouterr().err


def test_given_packages_and_interfaces_when_asked_then_those_installed_are_shown(capsys):
    def out(*words):
        assert main(list(words)) == 0
        return capsys.readouterr().out

    assert {'lpv_uio', 'lpv_msgs', 'rclpy', 'sensor_msgs'} <= set(out('pkg', 'list').split())
    assert out('pkg', 'executables', 'lpv_uio') == 'lpv_uio uio\n'
    prefix = out('pkg', 'prefix', 'lpv_bringup').strip()
    assert (Path(prefix) / 'share' / 'lpv_bringup' / 'launch').is_dir()
    interfaces = out('interface', 'list')
    assert re.search(r'Messages:\n(?:    \S+\n)*    lpv_msgs/msg/FaultAlarm\n', interfaces)
    assert 'lpv_msgs/srv/InjectFault' in out('interface', 'list', '-s')
    shown = out('interface', 'show', 'lpv_msgs/msg/TorqueCommand', '--no-comments')
    assert shown == (
        'std_msgs/Header header\n\tbuiltin_interfaces/Time stamp\n\t\tint32 sec\n'
        '\t\tuint32 nanosec\n\tstring frame_id\nfloat64[] torque\n'
        'bool safe_stop\n'
    )
    assert out('interface', 'show', 'lpv_msgs/srv/InjectFault').count('---') == 1
    assert out('topic').startswith('usage: ros2 topic')
