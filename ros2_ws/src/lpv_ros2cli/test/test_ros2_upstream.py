"""Our ros2 beside recorded answers of upstream's: output and exit codes."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import ros
import yaml
from ros2_commands import Running, known_graph

pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')

from lpv_ros2cli.main import main  # noqa: E402

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

HERE = Path(__file__).with_name('upstream')
RECORDED = yaml.safe_load((HERE / 'answers.yaml').read_text())
# Definitions behind upstream's answers about ros2cli_test_interfaces.
INTERFACES = {
    'ShortVaried': '# A constant\nbool BOOL_CONST=true # Comment - Nesting Level 1: 1 of 2\n\n'
    '# Bool and array of bools\nbool bool_value\n'
    'bool[<=3] bool_values # Comment - Nesting Level 1: 2 of 2\n\n# Trailing comment\n',
    'ShortVariedNested': '# A short, varied type\n'
    'ShortVaried short_varied # Comment - Nesting Level 2: 1 of 1\n# Trailing comment\n',
    'ShortVariedMultiNested': '# A short, varied, and nested type\n'
    'ShortVariedNested short_varied_nested # Comment - Nesting Level 3: 1 of 1\n'
    '# Trailing comment\n',
}


def interfaces_prefix(folder):
    """An ament prefix with the package ros2cli_test_interfaces."""
    package = 'ros2cli_test_interfaces'
    index = folder / 'share' / 'ament_index' / 'resource_index'
    for kind in ('packages', 'rosidl_interfaces'):
        (index / kind).mkdir(parents=True)
        names = ''.join(f'msg/{name}.msg\n' for name in INTERFACES)
        (index / kind / package).write_text(names)
    (folder / 'share' / package / 'msg').mkdir(parents=True)
    for name, text in INTERFACES.items():
        (folder / 'share' / package / 'msg' / f'{name}.msg').write_text(text)
    return folder


@pytest.fixture(scope='module')
def graph(tmp_path_factory):
    """Upstream's graph, on a domain of its own that commands in this process know."""
    prefix = interfaces_prefix(tmp_path_factory.mktemp('prefix'))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_DOMAIN_ID', str(ros.next_domain()))
        patch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        patch.setenv('AMENT_PREFIX_PATH', str(prefix))
        nodes = subprocess.Popen(
            [sys.executable, HERE / 'nodes.py'], stdout=subprocess.PIPE, text=True
        )
        try:
            assert nodes.stdout.readline() == 'ready\n'
            with known_graph():
                yield
        finally:
            nodes.send_signal(signal.SIGKILL)
            nodes.communicate()


@pytest.mark.parametrize(
    'answer', RECORDED['answers'], ids=[answer['command'] for answer in RECORDED['answers']]
)
def test_given_a_command_when_run_then_it_answers_as_upstream(graph, capsys, answer):
    handler = signal.getsignal(signal.SIGTERM)
    code = main(shlex.split(answer['command']))
    assert signal.getsignal(signal.SIGTERM) == handler
    out, errors = capsys.readouterr()
    assert code == answer['code'], errors
    if 'stdout_matches' in answer:
        assert re.fullmatch(answer['stdout_matches'], out)
    elif answer.get('unordered'):
        assert sorted(out.split('- ')) == sorted(answer['stdout'].split('- '))
    else:
        assert out == answer['stdout']
    assert errors.startswith(answer.get('stderr', ''))
    assert ('stderr' in answer) == (errors != '')


@pytest.mark.parametrize(
    'answer', RECORDED['endless'], ids=[answer['command'] for answer in RECORDED['endless']]
)
def test_given_a_command_without_end_when_run_then_its_lines_and_its_end_are_upstreams(
    graph, answer
):
    environment = {k: v for k, v in os.environ.items() if k != 'AMENT_PREFIX_PATH'}
    with Running(*shlex.split(answer['command']), env=environment) as command:
        command.until(answer['line'])
        code, text = command.interrupt()
    assert code == 2
    assert 'Traceback' not in text


def test_given_the_recorded_answers_when_read_then_each_says_where_it_is_from():
    for answer in (*RECORDED['answers'], *RECORDED['endless']):
        assert answer['kind'] in ('test', 'source', 'docs')
        assert answer['source'] in RECORDED['sources']
