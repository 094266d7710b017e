"""Launch files as the ros2 command of wheel-only machines evaluates them; nothing is started."""

from pathlib import Path

import pytest
from places import BRINGUP

pytest.importorskip('lpv_ros2cli', reason='a real ros2cli is here')

from lpv_ros2cli.command_line.expressions import evaluate  # noqa: E402
from lpv_ros2cli.errors import CliError  # noqa: E402
from lpv_ros2cli.launch.actions import evaluate_file  # noqa: E402
from lpv_ros2cli.launch.arguments import declared, describe_arguments, parse_arguments  # noqa: E402
from lpv_ros2cli.launch.context import Context  # noqa: E402
from lpv_ros2cli.launch.files import launch_files_of  # noqa: E402
from lpv_ros2cli.launch.substitutions import Substitution, parse  # noqa: E402
from lpv_ros2cli.packages import share_of  # noqa: E402

NODE = '<node pkg="lpv_uio" exec="uio"'


@pytest.fixture
def plan_of(tmp_path):
    """Evaluate the text of a launch file; XML unless it begins with ``launch:``."""

    def evaluated(text, environment=None, **arguments):
        suffix = 'yaml' if text.lstrip().startswith('launch:') else 'xml'
        path = tmp_path / f'some.launch.{suffix}'
        path.write_text(text if suffix == 'yaml' else f'<launch>{text}</launch>')
        return evaluate_file(Context(arguments, environment or {'HOME': '/home/me'}), path)

    return evaluated


def options(process, option):
    """What follows each occurrence of an option on a command line."""
    return [b for a, b in zip(process.command, process.command[1:]) if a == option]


def test_given_a_node_with_everything_when_evaluated_then_its_command_line_has_it_all(plan_of):
    plan = plan_of("""
        <arg name="who" default="me"/>
        <group>
          <push_ros_namespace namespace="robot"/>
          <node pkg="lpv_uio" exec="uio" name="obs_$(var who)" namespace="left" args="--x 'a b'"
                ros_args="--log-level debug" output="screen" respawn="true" respawn_delay="2.5"
                cwd="/tmp" exec_name="observer">
            <param from="/some/file.yaml"/>
            <param name="flag" value="true"/>
            <param name="nested"><param name="rate" value="5.0"/><param name="n" value="3"/></param>
            <param name="text" value="12" type="str"/>
            <param name="list" value="1.0,2.0" value-sep="," type="float"/>
            <remap from="a" to="/b_$(var who)"/>
            <env name="MODE" value="fast"/>
          </node>
        </group>""")
    (process,) = plan.processes
    assert process.command[0].endswith('lib/lpv_uio/uio')
    assert process.command[1:6] == ['--x', 'a b', '--ros-args', '--log-level', 'debug']
    assert options(process, '-r') == ['__node:=obs_me', '__ns:=/robot/left', 'a:=/b_me']
    file, values = options(process, '--params-file')
    assert file == '/some/file.yaml'
    assert values == {
        'flag': True,
        'nested': {'rate': 5.0, 'n': 3},
        'text': '12',
        'list': [1.0, 2.0],
    }
    assert (process.name, process.output, process.cwd) == ('observer', 'screen', '/tmp')
    assert (process.respawn, process.respawn_delay) == (True, 2.5)
    assert process.environment == {'HOME': '/home/me', 'MODE': 'fast'}


def test_given_the_same_in_yaml_and_xml_when_evaluated_then_the_commands_are_equal(plan_of):
    xml = plan_of(f"""
        <arg name="a" default="1"/>
        <set_env name="E" value="v"/>
        <group if="$(var a)"><push-ros-namespace namespace="n"/>
          {NODE} name="x"><param name="p" value="2"/><remap from="i" to="o"/></node></group>""")
    yaml = plan_of("""
launch:
- arg: {name: a, default: "1"}
- set_env: {name: E, value: v}
- group:
    if: $(var a)
    children:
    - push_ros_namespace: {namespace: n}
    - node:
        pkg: lpv_uio
        exec: uio
        name: x
        param: [{name: p, value: 2}]
        remap: [{from: i, to: o}]
""")
    assert xml.processes == yaml.processes
    assert len(xml.processes) == 1


def test_given_groups_when_left_then_what_they_set_is_gone_unless_they_are_not_scoped(plan_of):
    plan = plan_of(f"""
        <let name="x" value="outer"/>
        <group><let name="x" value="inner"/><set_env name="E" value="1"/>
          <push_ros_namespace namespace="deep"/><set_parameter name="p" value="1"/>
          <set_remap from="a" to="b"/>{NODE} name="$(var x)"/></group>
        {NODE} name="$(var x)"/>
        <group scoped="false"><let name="x" value="kept"/><unset_env name="HOME"/></group>
        {NODE} name="$(var x)"/>""")
    first, second, third = plan.processes
    assert options(first, '-r') == ['__node:=inner', '__ns:=/deep', 'a:=b']
    assert options(first, '--params-file') == [{'p': 1}]
    assert first.environment == {'HOME': '/home/me', 'E': '1'}
    assert options(second, '-r') == ['__node:=outer']
    assert second.environment == {'HOME': '/home/me'}
    assert options(third, '-r') == ['__node:=kept']
    assert third.environment == {}


@pytest.mark.parametrize(
    ('condition', 'there'),
    [
        ('if="true"', True),
        ('if="0"', False),
        ('unless="False"', True),
        ('unless="1"', False),
        ('if="$(not false)"', True),
        ('if="$(eval \'3 > 2\')"', True),
        ('if="$(equals $(var a) 1.0)"', True),
        ('if="$(and true $(or false false))"', False),
    ],
)
def test_given_conditions_when_evaluated_then_only_what_holds_is_there(plan_of, condition, there):
    assert len(plan_of(f'<arg name="a" default="1"/>{NODE} {condition}/>').processes) == there


def test_given_includes_when_evaluated_then_arguments_are_passed_and_the_folder_is_known(
    tmp_path, plan_of
):
    (tmp_path / 'sub').mkdir()
    (tmp_path / 'sub' / 'inner.launch.xml').write_text(
        '<launch><arg name="n"/>'
        f'{NODE} name="$(var n)"><param from="$(dirname)/p.yaml"/></node></launch>'
    )
    plan = plan_of(
        '<include file="$(dirname)/sub/inner.launch.xml"><arg name="n" value="given"/></include>'
    )
    (process,) = plan.processes
    assert options(process, '-r') == ['__node:=given']
    assert options(process, '--params-file') == [str(tmp_path / 'sub' / 'p.yaml')]
    with pytest.raises(CliError, match="'n' was not provided"):
        plan_of('<include file="$(dirname)/sub/inner.launch.xml"/>')


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        (f'{NODE} nmae="x"/>', "<node uio>: 'nmae' is unknown"),
        ('<node pkg="lpv_uio"/>', "'exec' is missing"),
        ('<node pkg="lpv_nix" exec="x"/>', "'lpv_nix' not found"),
        ('<node pkg="lpv_uio" exec="nix"/>', 'it has: uio'),
        ('<timer period="1"/>', '<timer>: is not covered by this ros2'),
        (f'{NODE} name="$(command ls)"/>', 'is not covered by this ros2'),
        (f'{NODE} name="$(var nix)"/>', "'nix' does not exist"),
        (f'{NODE} name="$(var"/>', 'is not closed'),
        (f'{NODE} if="maybe"/>', 'must be true or false'),
        (f'{NODE} if="1" unless="1"/>', 'exclude each other'),
        (f'{NODE}><param name="a"/></node>', "'value' or nested"),
        (f'{NODE}><param name="a" value="1,b" value-sep=","/></node>', 'values of one type'),
        (f'{NODE}><param name="a" value="x" type="int"/></node>', 'not of type int'),
        ('<arg name="a"/>', "required launch argument 'a'"),
        ('<arg name="a" default="3"><choice value="1"/><choice value="2"/></arg>', 'one of 1, 2'),
        ('<include file="/nowhere.launch.xml"/>', 'nowhere.launch.xml cannot be read'),
        ('<include file="$(filename)"/>', 'included by itself'),
        (f'{NODE} name="x">words</node>', "text 'words' is not expected"),
        ('<let name="a" value="$(eval \'__import__(1)\')"/>', 'is not covered'),
        ('<group', 'not valid XML'),
        ('launch: 3', 'must be a mapping or a list'),
        ('launch:\n- {node: {pkg: a}, x: 1}', 'one key'),
        ('launch: [', 'not valid YAML'),
    ],
)
def test_given_a_wrong_launch_file_when_evaluated_then_one_line_says_file_and_reason(
    plan_of, text, told
):
    with pytest.raises(CliError) as raised:
        plan_of(text)
    assert told in str(raised.value)
    assert 'some.launch.' in str(raised.value)
    assert '\n' not in str(raised.value)


def test_given_entities_that_expand_without_end_when_read_then_they_are_refused(tmp_path):
    path = tmp_path / 'bomb.launch.xml'
    path.write_text('<!DOCTYPE a [<!ENTITY b "bbbb">]><launch><let name="&b;" value=""/></launch>')
    with pytest.raises(CliError, match='document types'):
        evaluate_file(Context({}), path)


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('plain', ('plain',)),
        ('', ()),
        (r'\$(var a)', ('$(var a)',)),
        ('a$(var b)c', ('a', Substitution('var', (('b',),)), 'c')),
        ('$(env \'A B\' "d e")', (Substitution('env', (('A B',), ('d e',))),)),
        ('$(var $(var x))', (Substitution('var', ((Substitution('var', (('x',),)),),)),)),
        ('$(dirname)', (Substitution('dirname', ()),)),
    ],
)
def test_given_texts_when_parsed_then_substitutions_are_found(text, expected):
    assert parse(text) == expected


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('1 + 2 * 3', 7),
        ('-4 // 3', -2),
        ("'a' == 'a' and not False", True),
        ('1 < 2 < 3', True),
        ("'x' in ['x', 'y']", True),
        ('round(math.cos(0.0) + pi)', 4),
        ('[1, 2][1]', 2),
        ('5 if 0 else 6', 6),
        ("float('2.5') * 2", 5.0),
        ("'a' + 'b'", 'ab'),
    ],
)
def test_given_expressions_when_evaluated_then_they_have_pythons_value(text, expected):
    assert evaluate(text) == expected


@pytest.mark.parametrize(
    'text',
    [
        '__import__("os")',
        'open("/etc/passwd")',
        '().__class__',
        '(1).real',
        '[x for x in [1]]',
        'lambda: 1',
        '2 ** 10',
        "'a' * 9999999",
        "'%99999999d' % 1",
        '1 / 0',
        'nix',
        'f"{1}"',
        'math.__dict__',
        'max(',
        'abs(x=1)',
        '(' * 5000,
    ],
)
def test_given_expressions_that_could_do_harm_when_evaluated_then_they_are_refused(text):
    with pytest.raises(CliError):
        evaluate(text)


def test_given_launch_arguments_when_parsed_then_the_last_counts_and_others_are_refused():
    assert parse_arguments(['a:=1', 'b:=x:=y', 'a:=2', 'c:=']) == {'a': '2', 'b': 'x:=y', 'c': ''}
    for word in ('a', ':=1', 'a=1'):
        with pytest.raises(CliError, match='malformed launch argument'):
            parse_arguments([word])


def test_given_arguments_with_spaces_when_used_in_a_command_then_they_stay_one_word(plan_of):
    plan = plan_of(
        '<arg name="f" default="a b"/><executable cmd="echo x$(var f)y \'c d\' $(var f)"/>'
    )
    assert plan.processes[0].command == ['echo', 'xa by', 'c d', 'a b']


def test_given_the_shipped_launch_files_when_evaluated_then_they_are_complete():
    files = launch_files_of('lpv_bringup')
    assert {file.name for file in files} >= {
        'pipeline.launch.xml',
        'simulation.launch.xml',
        'observer.launch.xml',
    }
    for file in files:
        given = {
            name: 'x'
            for name, (_, default, _) in declared(file, Context({})).items()
            if default is None
        }
        if file.name == 'rviz.launch.xml':
            continue  # starts a program of a ROS 2 that may not be here
        evaluate_file(Context(given), file)


def test_given_names_when_the_pipeline_is_evaluated_then_it_starts_the_installed_files():
    share = share_of('lpv_bringup')
    plan = evaluate_file(
        Context(
            {'arm': 'paper', 'scenario': 'two_faults', 'record': 'true', 'bag': 'here'},
            {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
        ),
        share / 'launch' / 'pipeline.launch.xml',
    )
    assert [p.name for p in plan.processes] == ['recorder', 'tracker', 'simulator', 'uio']
    for process in plan.processes[1:]:
        sources = options(process, '--params-file')
        values = {k: v for s in sources if isinstance(s, dict) for k, v in s.items()}
        assert values['arm_file'] == str(share / 'arms' / 'paper.yaml')
        assert values['await_recorders'] == 1
        assert '__ns:=/lpv' in options(process, '-r')
        # The drives' latency limits follow from the gains, too.
        assert str(share / 'gains' / 'paper.yaml') in sources
        for source in sources:
            assert isinstance(source, dict) or Path(source).is_file()
        assert process.environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'SUBNET'
        assert process.sigterm_timeout == 30.0
    plan = evaluate_file(Context({}, {}), share / 'launch' / 'pipeline.launch.xml')
    assert len(plan.processes) == 3
    assert plan.processes[0].environment == {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}


@pytest.mark.parametrize(
    ('arm', 'scenario'), [('paper', 'two_faults'), ('real_arm', 'real_arm'), ('ur10', 'ur10')]
)
def test_given_an_arm_alone_when_the_pipeline_is_evaluated_then_its_own_scenario_runs(
    arm, scenario
):
    file = BRINGUP / 'launch' / 'pipeline.launch.xml'
    [simulator] = [
        p for p in evaluate_file(Context({'arm': arm}, {}), file).processes if p.name == 'simulator'
    ]
    sources = options(simulator, '--params-file')
    files = [s['scenario_file'] for s in sources if isinstance(s, dict) and 'scenario_file' in s]
    assert [Path(f) for f in files] == [share_of('lpv_bringup') / 'scenarios' / f'{scenario}.yaml']
    assert Path(files[0]).is_file()


def test_given_view_and_respawn_when_the_pipeline_is_evaluated_then_the_nodes_have_them():
    share = share_of('lpv_bringup')
    file = share / 'launch' / 'pipeline.launch.xml'
    given = {
        'view': 'true',
        'respawn': 'true',
        'view_port': '0',
        'foxglove_port': '9',
        'record': 'true',
    }
    plan = evaluate_file(Context(given, {}), file)
    assert [p.name for p in plan.processes] == ['recorder', 'tracker', 'simulator', 'view', 'uio']
    assert all(p.respawn and p.respawn_delay == 1.0 for p in plan.processes)
    assert all(not p.respawn for p in evaluate_file(Context({}, {}), file).processes)
    recorder, _, _, view, _ = plan.processes
    values = {
        k: v for s in options(view, '--params-file') if isinstance(s, dict) for k, v in s.items()
    }
    assert values == {
        'arm_file': str(share / 'arms' / 'paper.yaml'),
        'scenario_file': str(share / 'scenarios' / 'two_faults.yaml'),
        'port': 0,
        'foxglove_port': 9,
    }
    values = {
        k: v
        for s in options(recorder, '--params-file')
        if isinstance(s, dict)
        for k, v in s.items()
    }
    assert values['gains_file'] == str(share / 'gains' / 'paper.yaml')


def test_given_the_pipeline_when_its_arguments_are_shown_then_each_is_described():
    text = describe_arguments(declared(BRINGUP / 'launch' / 'pipeline.launch.xml', Context({})))
    assert text.startswith("Arguments (pass arguments as '<name>:=<value>'):\n\n    'arm':\n")
    assert "(default: FindPackageShare(pkg='lpv_bringup') + '/arms/' + LaunchConfig('arm')" in text
    assert 'no description given' not in text
