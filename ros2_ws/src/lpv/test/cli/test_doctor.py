import json
import re
import sys
import threading
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import rclpy
import ros
from fault_injection import with_joints, with_sensors
from places import BRINGUP, ROOT
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from serial_bags import ball_joint, crane, crane_file
from simulated_runs import simulated_run
from std_msgs.msg import Header

from lpv import load_arm, save_gains
from lpv.cli.doctor import environment, graph, signals
from lpv.cli.doctor.files import check_files
from lpv.cli.doctor.finding import Level
from lpv.cli.doctor.snapshot import JOINT_STATE, Endpoint, Snapshot
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import JointFriction, JointLimits
from lpv.core.uio.model.joints import JointMap
from lpv_node.qos import stream

PAPER = str(BRINGUP / 'arms' / 'paper.yaml')
GAINS, UR10_GAINS, PANDA_GAINS = (f'{BRINGUP}/gains/{n}.yaml' for n in ('paper', 'ur10', 'panda'))
NODES = ('/lpv/arm_sim', '/lpv/tracker', '/lpv/uio')
NOW = 1_800_000_000_000_000_000
STAMPS = [NOW + k * 2_000_000 for k in range(50)]
JOINTS, UIO = '/lpv/joint_states', '/lpv/uio'
ELSEWHERE = '/lpv/uio subscribes to /lpv/joint_states, which has.*-r joint_states:=/joint_states'


def bad(findings):
    return [f for f in findings if f.level != Level.OK]


def found(findings):
    return [f.check for f in bad(findings)]


def about_its_centre(link):
    mass, x, y, z = link.mass, *link.first_moment
    moved = np.array([y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]) / mass
    return replace(link, inertia=tuple((np.array(link.inertia) - moved).tolist()))


@pytest.fixture(scope='module')
def files(paper_gains, tmp_path_factory):
    """A folder with a serial arm, and with files that cannot be used."""
    folder = tmp_path_factory.mktemp('files')
    crane_file(folder)
    save_arm(ball_joint(), folder / 'ball.yaml')
    save_arm(replace(crane(), name='one', joints=crane().joints[1:2]), folder / 'one.yaml')
    ur10 = load_arm(BRINGUP / 'arms' / 'ur10.yaml')
    for name, (number, changes) in {
        'sliding': (5, {'type': 'prismatic'}),
        'braked': (5, {'rotor_inertia': 0.0, 'friction': JointFriction(viscous=500.0)}),
        'centred': (1, {'link': about_its_centre(ur10.joints[1].link)}),
    }.items():
        arm = with_joints(replace(ur10, name=name), number, **changes)
        save_arm(arm, folder / f'{name}.yaml')
    observer = replace(paper_gains.observer, kappa=3.0 * paper_gains.observer.kappa)
    save_gains(replace(paper_gains, observer=observer), folder / 'changed.yaml')
    scenario = (BRINGUP / 'scenarios' / 'two_faults.yaml').read_text()
    for name, text in {
        'light': Path(PAPER).read_text().replace('mass: 10.0', 'mass: -10.0'),
        'cut': 'x: [',
        'empty': '{}',
        'hollow': '/**: {ros__parameters: {gains: {}}}',
        'bare': '/**: {ros__parameters: {bandwidth: 10.0}}',
        'far': scenario.replace('x: -0.8451', 'x: -8.451'),
        'elbow': scenario.replace('link1_angle', 'elbow'),
        'mujoco': scenario.replace('model: nonlinear', 'model: mujoco'),
    }.items():
        (folder / f'{name}.yaml').write_text(text)
    return folder


# The check that finds something, or none; arm, gains and scenario; what is said.
@pytest.mark.parametrize('check, arm, gains, scenario, said', [
    ('', 'paper', GAINS, 'two_faults', "arm 'paper' holds"),
    ('', 'ur10', 'ur10', None, "loop of arm 'ur10' holds"),
    ('', 'paper', None, None, 'observes alone; lpv design designs them'),
    ('', './crane.yaml', None, None, 'the moving horizon observes alone'),
    ('', './sliding.yaml', None, None, 'slide have no certificate'),
    ('', './one.yaml', None, None, 'one joint have no certificate'),
    ('', 'ur10', UR10_GAINS, None, "loop of arm 'ur10' holds"),
    ('', 'panda', PANDA_GAINS, None, "loop of arm 'panda' holds"),
    ('arm', './light.yaml', None, None, r'joints\[0\].link.mass'),
    ('arm', './centred.yaml', None, None, ' the link of shoulder_lift_joint give first moments'),
    ('arm', './ball.yaml', None, None, 'joints a, c turn the same body.* state their rotor'),
    ('arm', './braked.yaml', None, 'ur10', r'joints\[5\].rotor_inertia.*arm-file'),
    ('gains', 'real_arm', GAINS, None, "another arm.*'paper'.*'real_arm'.*--arm real_arm"),
    ('gains', 'paper', './changed.yaml', None, 'does not hold: observer, link 1'),
    *(('gains', 'paper', f'./{bad}.yaml', None, 'lpv design')
      for bad in ('none', 'cut', 'empty', 'hollow')),
    ('gains', './crane.yaml', GAINS, None, 'lpv: is missing'),
    ('gains', 'ur10', PANDA_GAINS, None, 'for another arm'),
    ('gains', 'ur10', 'panda', None, 'another arm.*--arm ur10 --out panda.yaml'),
    ('gains', 'ur10', './bare.yaml', None, 'no certificate'),
    ('scenario', 'paper', None, './far.yaml', 'out of reach'),
    ('scenario', 'paper', None, './elbow.yaml', 'sensor'),
    ('scenario', 'paper', None, './mujoco.yaml', 'needs MuJoCo'),
])  # fmt: skip
def test_given_files_then_misfits_are_said(files, monkeypatch, check, arm, gains, scenario, said):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    names = (name and name.replace('./', f'{files}/') for name in (arm, gains, scenario))
    model, findings = check_files(*names)
    assert (model is None) == (arm == './light.yaml')
    if check:
        (finding,) = bad(findings)
        level = Level.WARN if arm in ('./centred.yaml', './ball.yaml') else Level.ERROR
        assert (finding.check, finding.level) == (check, level)
    else:
        _, finding, *_ = findings
        assert model.name in arm and bad(findings) == []
        assert [f.check for f in findings] == ['arm', 'gains', 'scenario'][: 2 + bool(scenario)]
    assert re.search(said, f'{finding.text} {finding.remedy}', re.DOTALL)


def test_given_this_environment_when_checked_then_nothing_is_found(monkeypatch):
    for name in ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY'):
        monkeypatch.delenv(name, raising=False)
    assert found(environment.check_environment()) == []
    # CVXPY comes without its other solvers there, which does as well.
    wanted = {one for one in environment.REQUIREMENTS if not one.startswith('cvxpy')}
    assert wanted <= set((ROOT / 'requirements' / 'base.txt').read_text().splitlines())


WHEELS = rclpy.__file__.startswith(sys.prefix) and sys.prefix != sys.base_prefix


@pytest.mark.parametrize('name, check, levels', [
    ('ROS_DOMAIN_ID', 'domain', {'x': 'ERROR', '999': 'ERROR', '150': 'WARN', '42': 'OK'}),
    ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'range',
     {'EVERYWHERE': 'ERROR', 'OFF': 'ERROR', 'SUBNET': 'OK'}),
    ('ROS_LOCALHOST_ONLY', 'range', {'1': 'WARN'}),
    ('RMW_IMPLEMENTATION', 'middleware', {'rmw_of_nobody': 'ERROR'}),
    # A sourced ROS 2 beside wheels: only where there are wheels.
    ('ROS_DISTRO', 'ros', {'jazzy': 'ERROR' if WHEELS else 'OK'}),
])  # fmt: skip
def test_given_a_variable_when_checked_then_it_is_judged(monkeypatch, name, check, levels):
    for value, level in levels.items():
        monkeypatch.setenv(name, value)
        finding = getattr(environment, f'check_{check}')()
        assert (finding.level.name, bool(finding.remedy)) == (level, level != 'OK'), value


def test_given_what_is_old_or_missing_when_checked_then_it_is_named(monkeypatch):
    finding = environment.check_packages(('numpy<1', 'no-such-package-of-ours>=1'))
    assert finding.level == Level.ERROR and 'no-such-package-of-ours is missing' in finding.text
    assert re.search(r'numpy is [\d.]+, <1 is needed', finding.text)
    monkeypatch.setattr('lpv.core.support.jit.COMPILED', False)
    monkeypatch.setattr(sys, 'version_info', (3, 9, 1))
    assert environment.check_compiler().level == environment.check_python().level == Level.WARN
    nothing = environment.RosProbe('', '', "No module named 'rclpy'")
    assert environment.check_ros(nothing).level == Level.ERROR
    assert environment.check_middleware(nothing).level == Level.ERROR
    monkeypatch.setitem(sys.modules, 'lpv_msgs.msg', None)
    assert environment.check_workspace().level == Level.ERROR


def message(stamp, names=('joint1', 'joint2'), effort=(0.0, 0.0), velocity=(0.0, 0.0), position=()):
    position = position if len(position) else [1.5] * len(names)
    parts = {'position': list(position), 'velocity': list(velocity), 'effort': list(effort)}
    return JointState(header=Header(stamp=Time(nanoseconds=stamp).to_msg()), name=names, **parts)


@pytest.fixture
def shot(paper_arm):
    """What is seen of a graph that runs in real time."""
    qos = stream(False)
    shot = Snapshot(domain=7, nodes=list(NODES), states=dict.fromkeys(NODES, 'active'))
    usual = {'use_sim_time': False, 'lockstep': False, 'arm_file': PAPER}
    shot.parameters = {name: dict(usual) for name in NODES}
    shot.parameters[UIO] |= {'torque_source': 'effort', 'gains.arm_sha256': paper_arm.sha256()}
    types = {
        'joint_states': (JOINT_STATE, 'arm_sim', 'uio'),
        'state_estimate': ('lpv_msgs/msg/StateEstimate', 'uio', 'tracker'),
        'torque_command': ('lpv_msgs/msg/TorqueCommand', 'tracker', 'arm_sim'),
    }
    for topic, (msgtype, source, sink) in types.items():
        shot.publishers[f'/lpv/{topic}'] = [Endpoint(f'/lpv/{source}', msgtype, qos)]
        shot.subscriptions[f'/lpv/{topic}'] = [Endpoint(f'/lpv/{sink}', msgtype, qos)]
    shot.measured[JOINTS] = heard()
    return shot


def heard(stamps=STAMPS, delay=1_000_000, **fields):
    return [(stamp + delay, message(stamp, **fields)) for stamp in stamps]


def second_simulator(shot):
    shot.nodes.append('/lpv/arm_sim')
    shot.publishers[JOINTS] *= 2


def elsewhere(shot):
    """The driver publishes on a topic of another name."""
    shot.measured['/joint_states'] = shot.measured.pop(JOINTS)
    shot.publishers['/joint_states'] = shot.publishers.pop(JOINTS)


def still_clock(shot):
    shot.parameters[UIO]['use_sim_time'] = True
    shot.measured[JOINTS], shot.clock = heard([10**9]), [(NOW, 10**9)] * 5


def given(part, key, value):
    return lambda shot: getattr(shot, part).update({key: value})


def sent(**fields):
    return given('measured', JOINTS, heard(**fields))


DRIVERS = [Endpoint(node, JOINT_STATE, stream(False)) for node in ('/driver', '/lpv/arm_sim')]
CLOCKS = [Endpoint(node, 'rosgraph_msgs/msg/Clock', stream(True)) for node in ('/a', '/b')]
RELIABLE = Endpoint(UIO, JOINT_STATE, QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE))
TEXTS = Endpoint(UIO, 'std_msgs/msg/String', stream(False))
OTHER_GAINS = {'gains.arm_sha256': '0' * 64}
MISTAKES = [
    (second_simulator, 'names, publishers', 'several nodes /lpv/arm_sim'),
    (given('publishers', JOINTS, DRIVERS), 'publishers', '2 publishers: /driver, /lpv/arm_sim'),
    (given('publishers', '/clock', CLOCKS), 'publishers', '/clock has 2 publishers'),
    (given('states', UIO, 'inactive'), 'lifecycle', '/lpv/uio is inactive'),
    (given('states', UIO, None), 'lifecycle', '/lpv/uio does not answer'),
    (given('parameters', UIO, {'use_sim_time': True}), 'clock', '/clock is silent'),
    (still_clock, 'clock', '/clock stands still'),
    (given('parameters', UIO, {'lockstep': True}), 'mode', 'some nodes are in lockstep: /lpv/uio'),
    (given('parameters', UIO, OTHER_GAINS), 'gains in use', "another arm than 'paper'"),
    (elsewhere, 'connections', ELSEWHERE),
    (given('subscriptions', JOINTS, [RELIABLE]), 'qos', 'uio receives nothing from /lpv/arm_sim'),
    (given('subscriptions', JOINTS, [TEXTS]), 'qos', 'JointState and std_msgs/msg/String'),
    (sent(stamps=[]), 'measurements', '/lpv/joint_states is silent'),
    (sent(names=('shoulder', 'elbow')), 'joints', r"of other joints: \['shoulder'"),
    (sent(names=('joint1', 'finger')), 'joints', "'joint2' occurs 0.*one message carry all"),
    (sent(effort=()), 'efforts', '50 of 50 messages carry no effort'),
    (sent(velocity=()), 'values', '50 messages not used: velocity has 0 values for 2 joints'),
    (sent(velocity=(float('nan'), 0.0)), 'values', 'that are not numbers'),
    (sent(stamps=[0] * 50), 'stamps', 'stamps are zero'),
    (sent(delay=3600 * 10**9), 'stamps', r'3.6e\+03 s behind the clock of this machine'),
    (sent(delay=-2 * 10**9), 'stamps', 'stamps are 2 s ahead of'),
    (sent(stamps=STAMPS[:25] * 2), 'stamps', 'time goes backwards 1 times'),
    (sent(stamps=STAMPS[::5]), 'rate', 'every 10 ms, the arm file says 2 ms'),
]


def test_given_a_healthy_graph_when_checked_then_nothing_is_found(shot):
    findings = graph.check_graph(shot)
    assert found(findings) == []
    checks = {'nodes', 'lifecycle', 'names', 'publishers', 'clock', 'mode', 'connections', 'qos'}
    assert {f.check for f in findings} == checks | {'measurements', 'gains in use'}
    # The same in lockstep, stamps and /clock from 1 s on.
    for values in shot.parameters.values():
        values |= {'lockstep': True, 'use_sim_time': True}
    stamps = [stamp - NOW + 10**9 for stamp in STAMPS]
    shot.measured[JOINTS] = heard(stamps, delay=NOW)
    shot.clock = [(stamp + NOW, stamp) for stamp in stamps[:2]]
    assert found(graph.check_graph(shot)) == []
    # Where torques are those of commands, measurements need none.
    shot.measured[JOINTS] = heard(stamps, delay=NOW, effort=())
    shot.parameters[UIO]['torque_source'] = 'command'
    assert found(graph.check_graph(shot)) == []


@pytest.mark.parametrize(('spoil', 'checks', 'text'), MISTAKES, ids=[m[2] for m in MISTAKES])
def test_given_a_mistake_in_a_graph_when_checked_then_it_alone_is_found(shot, spoil, checks, text):
    spoil(shot)
    findings = bad(graph.check_graph(shot))
    assert sorted(set(found(findings))) == checks.split(', ') and all(f.remedy for f in findings)
    assert re.search(text, '\n'.join(f'{f.text} {f.remedy}' for f in findings))


def test_given_another_arm_or_nothing_when_checked_then_it_is_said(shot, paper_arm, real_arm):
    assert graph.running_arm(shot) == paper_arm
    assert found(graph.check_graph(shot, real_arm)) == ['gains in use']
    shot.parameters['/right/uio'] = {'arm_file': 'ur10'}
    (beside,) = (one for one in graph.check_graph(shot) if one.check == 'arm')
    assert beside.text.startswith("'paper' alone is checked; --arm names another one of ")
    (nothing,) = graph.check_graph(Snapshot())  # no word of what there is not
    assert found([nothing]) == ['nodes']
    assert found(graph.check_graph(Snapshot(), alone=False)) == []
    driver = Snapshot(measured=shot.measured, publishers=shot.publishers)
    findings = graph.check_graph(driver)
    assert {'publishers', 'measurements'} <= {f.check for f in findings}
    (finding,) = bad(findings)
    assert 'but there are measurements' in finding.text and 'no gains' in finding.remedy
    driver.measured = {JOINTS: heard(effort=())}
    assert 'efforts' in found(graph.check_graph(driver)), 'before an observer runs, too'


@pytest.mark.parametrize('together', [True, False])
def test_given_a_gripper_beside_the_arm_when_checked_then_the_arm_alone_counts(shot, together):
    """In its messages with values that it has no sensor for, or of a publisher of its own."""
    names, nan = ('joint2', 'finger', 'joint1'), float('nan')
    if together:
        shot.measured[JOINTS] = heard(names=names, effort=(0.0, nan, 0.0), velocity=(0.0, nan, 0.0))
    else:
        finger = heard(delay=3_000_000, names=('finger',), effort=(), velocity=())
        late = [(time, message(time - 8_000_000, ('finger',), (), ())) for time, _ in finger]
        shot.measured[JOINTS] = sorted(shot.measured[JOINTS] + late, key=lambda one: one[0])
        shot.publishers[JOINTS] = DRIVERS
    assert found(graph.check_graph(shot)) == []


def test_given_two_arms_in_one_graph_when_checked_then_each_is_not_blamed_for_the_other(shot):
    shot.measured['/right/joint_states'] = heard(names=('shoulder', 'elbow'))
    findings = graph.check_graph(shot)
    assert found(findings) == []
    assert any('not checked' in f.text and '--arm' in f.text for f in findings)


def test_given_efforts_of_0_when_the_arm_moves_then_none_are_measured(shot, paper_arm):
    moving = [(stamp, message(stamp, position=[0.01 * k, 1.5])) for k, stamp in enumerate(STAMPS)]
    finding = signals.check_efforts(signals.hear(JOINTS, moving, paper_arm), shot)
    assert finding is not None and finding.text.endswith('50 of 50 messages carry no effort')
    for _, one in moving:
        one.effort[1] = 2.0  # of the other joint
    finding = signals.check_efforts(signals.hear(JOINTS, moving, paper_arm), shot)
    assert finding.text.endswith(f'carry no effort of {paper_arm.joint_names[0]}')


def test_given_files_when_the_command_runs_then_code_0_and_3_if_not(call, refused, monkeypatch):
    line = ['doctor', '--gains', GAINS, '--offline', '--arm']
    assert 'nothing found' in call(*line, 'paper').out
    said = call(*line, 'real_arm', code=3).out
    assert '-> lpv design --arm real_arm' in ' '.join(said.split())
    told = json.loads(call(*line, 'real_arm', '--json', code=3).out)
    assert told['ok'] is False
    assert [f['check'] for f in told['findings'] if f['level'] == 'ERROR'] == ['gains']
    for seconds in ('nan', '-1', '1e9'):
        assert refused('--seconds', 'doctor', '--seconds', seconds)
    # Another middleware is a finding, too.
    monkeypatch.setenv('RMW_IMPLEMENTATION', 'rmw_of_nobody')
    told = json.loads(call('doctor', '--json', code=3).out)
    levels = {f['check']: f['level'] for f in told['findings']}
    # The graph is left out: looking would end the process.
    assert levels['middleware'] == 'ERROR' and levels['ros'] == 'OK' and 'nodes' not in levels


@pytest.mark.ros
def test_given_two_simulators_alone_when_the_command_runs_then_all_is_found(monkeypatch, call):
    from rclpy.lifecycle import LifecycleNode

    domain, over = ros.next_domain(), threading.Event()
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    with ros.client(domain) as client:
        names, own = ('arm_sim', 'arm_sim', 'uio'), {'context': client.node.context}
        nodes = [LifecycleNode(name, namespace='lpv', **own) for name in names]
        for node in nodes[:2]:
            node.create_publisher(JointState, 'joint_states', 10)
            node.create_subscription(JointState, 'torque_command', print, 10)
        for node in nodes:
            client.node.executor.add_node(node)
        thread = threading.Thread(target=client.wait, args=(over.is_set,))
        thread.start()
        try:
            for _ in range(30):  # nodes of a busy machine find each other late
                told = json.loads(call('doctor', '--seconds', '1', '--json', code=3).out)
                texts = {f['check']: f['text'] for f in told['findings'] if f['level'] != 'OK'}
                if {'publishers', 'names', 'lifecycle', 'connections'} <= texts.keys():
                    break
        finally:
            over.set()
            thread.join()
            for node in nodes:
                node.destroy_node()
    assert '/lpv/joint_states has 2 publishers' in texts['publishers']
    assert 'several nodes /lpv/arm_sim' in texts['names']
    assert '/lpv/uio is unconfigured' in texts['lifecycle']
    assert '/lpv/torque_command, which has no publisher' in texts['connections']
    assert '/lpv/joint_states is silent' in texts['measurements']


moving = cache(simulated_run)


def recorded(arm, duration=1.2, scale=1.0, rate_scale=1.0, sign=1.0, rates=True):
    run, messages = moving(arm, duration), []
    for stamp, (q, v, tau) in zip(run.stamps.tolist(), run.samples):
        velocity = rate_scale * v if rates else ()
        messages.append(message(NOW + stamp, arm.joint_names, sign * tau, velocity, scale * q))
    return messages


def of(arm, messages):
    return signals.hear('/joint_states', [(NOW, one) for one in messages], arm)


def test_given_degrees_when_checked_then_they_are_named(paper_arm, paper_model):
    paper_arm = with_joints(paper_arm, limits=JointLimits(-3.1, 3.1, 10.0, 100.0))
    scales = (57.3, 57.3), (57.3, 1.0), (1.0, 57.3)
    for said, (scale, rate_scale) in zip(
        ('limits: degrees', 'degrees', 'rates in degrees'), scales
    ):
        messages = recorded(paper_arm, scale=scale, rate_scale=rate_scale)
        finding = signals.check_units(of(paper_arm, messages), paper_arm)
        assert finding.level == Level.ERROR and said in finding.text
    # Small angles in degrees are found by gravity.
    joints, rest = JointMap(paper_model), np.array([5.0, 0.0])  # below two turns
    held = -paper_model.constants().gravity * np.sin(joints.absolute_position(np.radians(rest)))
    messages = [message(stamp, effort=joints.joint_torque(held), position=rest) for stamp in STAMPS]
    finding = signals.check_units(of(paper_arm, messages), paper_arm)
    assert finding is not None and 'torques fit gravity' in finding.text


def test_given_millimetres_of_a_joint_that_slides_when_checked_then_only_they_are_named(shot):
    quill = replace(crane().joints[2], type='prismatic', limits=JointLimits(-0.2, 0.0, 1.0, 50.0))
    arm, zeros = replace(crane(), joints=(*crane().joints[:2], quill)), (0.0, 0.0, 0.0)
    for place, checks in ((-0.15, []), (-150.0, ['units'])):
        position = [0.1, -0.2, place]
        run = [message(s, arm.joint_names, zeros, zeros, position) for s in STAMPS]
        shot.measured[JOINTS] = list(zip(STAMPS, run))
        said = bad(signals.check_measurements(shot, arm))
        assert [f.check for f in said if f.check != 'stamps'] == checks
        assert not checks or 'joint3 are -150 to -150 m, beyond its limits: mill' in said[0].text


@pytest.mark.slow
def test_given_moving_arms_when_checked_then_units_and_rates_are_as_their_files_say(paper_arm):
    for arm, said in ((paper_arm, 'joint1 independent'), (crane(), 'joint1 derived')):
        seen = of(arm, recorded(arm))
        assert signals.check_units(seen, arm) is None
        finding = signals.check_rate_source(seen, arm)
        assert finding.level == Level.OK and said in finding.text
    derived = with_sensors(paper_arm, rates='derived')
    finding = signals.check_rate_source(of(paper_arm, recorded(derived)), paper_arm)
    assert finding.level == Level.WARN and 'joint1 derived' in finding.text
    # An arm that derives them does without.
    without = recorded(crane(), 0.1, rates=False)
    seen = of(crane(), without)
    assert signals.check_use(seen) is signals.check_values(seen, rates=False) is None
    assert signals.check_use(of(None, without)).check == 'values'


@pytest.mark.parametrize(('sign', 'step', 'level', 'said'), [
    (1.0, 0.0, Level.OK, ''), (-1.0, 0.0, Level.ERROR, 'of all joints count against the motion'),
    (1.0, 0.1, Level.WARN, '7.0 s: ALARM, encoder2: error +0.1'),
])  # fmt: skip
def test_given_a_moving_arm_then_a_wrong_sign_or_faulty_reading_is_named(sign, step, level, said):
    messages = recorded(crane(), 8.0, sign=sign)
    for late in messages[7 * len(messages) // 8 :]:
        late.position[1] += step
    finding = signals.check_setup(of(crane(), messages), crane())
    assert finding.level == level and said in finding.text
    assert (finding.check == 'health') == (step > 0.0)
