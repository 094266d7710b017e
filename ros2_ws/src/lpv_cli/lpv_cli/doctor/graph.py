"""Checks of a running graph, on what was seen of it."""

from collections import Counter

from rclpy.qos import QoSCompatibility, qos_check_compatible

from lpv_cli.doctor.finding import Finding, error, ok, warn
from lpv_cli.doctor.signals import check_measurements
from lpv_cli.doctor.snapshot import JOINT_STATE, Endpoint, Snapshot
from lpv_core.serial_arm.any_arm import Arm, load_any_arm
from lpv_core.support.errors import LpvError

_SINGLE = ('joint_states', 'torque_command', 'state_estimate', 'ground_truth')
"""Topics of a graph that must have one publisher."""
_DEAD = 'a node that was killed is in the graph for some 20 s more'


def check_graph(shot: Snapshot, arm: Arm | None = None, alone: bool = True) -> list[Finding]:
    """Run all checks of a graph."""
    if not shot.ours() and not shot.measured:
        return [check_anybody(shot, alone)]
    arm = arm or running_arm(shot)
    return [
        check_anybody(shot, alone),
        *check_states(shot),
        *check_names(shot),
        *check_publishers(shot),
        check_clock(shot),
        check_modes(shot),
        *check_gains_in_use(shot, arm),
        *check_connections(shot),
        *check_qos(shot),
        *check_measurements(shot, arm),
    ]


def running_arm(shot: Snapshot) -> Arm | None:
    """The arm of the running observer, or of any other node of ours; None if it is not known."""
    for _, values in sorted(shot.parameters.items(), key=lambda item: '/uio' not in item[0]):
        try:
            return load_any_arm(values['arm_file'])
        except (KeyError, TypeError, LpvError):
            continue  # a node of another machine, or one that could not read it either
    return None


def check_anybody(shot: Snapshot, alone: bool = True) -> Finding:
    """Whether anything of this software runs on this domain."""
    if shot.ours():
        return ok('nodes', f'domain {shot.domain}: {", ".join(shot.ours())}')
    text = f'nothing of this software runs on domain {shot.domain}'
    if shot.measured:
        return warn(
            'nodes',
            f'{text}, but there are measurements',
            'ros2 launch lpv_bringup observer.launch.xml ...; a node that ended at once '
            'said why: no gains, gains of another arm, a file that is not there',
        )
    if not alone:
        return ok('nodes', f'{text}: files were checked')
    remedy = (
        'start it; or set ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE to those of its shell'
    )
    return warn('nodes', text, remedy)


def check_states(shot: Snapshot) -> list[Finding]:
    """Whether managed nodes are active."""
    findings = []
    steps = {'unconfigured': 'configure, then activate', 'inactive': 'activate'}
    for name, state in shot.states.items():
        if state is None:
            remedy = f'it hangs or has died ({_DEAD}): start it again'
            findings.append(error('lifecycle', f'{name} does not answer', remedy))
        elif state != 'active':
            step = steps.get(state, 'activate')
            remedy = f'ros2 lifecycle set {name} {step}; finalized nodes must be restarted'
            findings.append(warn('lifecycle', f'{name} is {state}', remedy))
    return findings or [ok('lifecycle', f'{len(shot.states)} nodes are active')]


def check_names(shot: Snapshot) -> list[Finding]:
    """Whether two nodes have one name: two graphs on one domain."""
    twice = sorted(name for name, count in Counter(shot.nodes).items() if count > 1)
    if not twice:
        return [ok('names', 'no name is used twice')]
    remedy = 'two runs are on one domain: give one another ROS_DOMAIN_ID or namespace; ' + _DEAD
    return [error('names', f'there are several nodes {", ".join(twice)}', remedy)]


def check_publishers(shot: Snapshot) -> list[Finding]:
    """Whether topics of ours, and /clock, have one source each."""
    findings = []
    for topic, ends in sorted(shot.publishers.items()):
        if len(ends) > 1 and (topic == '/clock' or topic.rsplit('/', 1)[1] in _SINGLE):
            by = ', '.join(sorted(e.node for e in ends))
            remedy = 'two simulators, or a driver and a simulator: stop one, or give it '
            remedy += f'another ROS_DOMAIN_ID or namespace; {_DEAD}'
            text = f'{topic} has {len(ends)} publishers: {by}'
            findings.append(error('publishers', text, remedy))
    return findings or [ok('publishers', 'every topic has one source')]


def check_clock(shot: Snapshot) -> Finding:
    """Whether /clock runs where nodes wait for it."""
    waiting = sorted(n for n, values in shot.parameters.items() if values.get('use_sim_time'))
    if not waiting:
        return ok('clock', 'nodes run on the wall clock')
    if len({told for _, told in shot.clock}) > 1:
        return ok('clock', f'/clock runs; {", ".join(waiting)} use it')
    state = 'stands still' if shot.clock else 'is silent'
    remedy = 'start what publishes /clock (simulator in lockstep, bag player with --clock), '
    remedy += 'or start the nodes without use_sim_time:=true'
    return error('clock', f'/clock {state}, but {", ".join(waiting)} use it', remedy)


def check_modes(shot: Snapshot) -> Finding:
    """Whether all nodes of a graph run in the same mode."""
    modes = {n: v['lockstep'] for n, v in shot.parameters.items() if v.get('lockstep') is not None}
    if len(set(modes.values())) < 2:
        return ok('mode', 'lockstep' if True in modes.values() else 'real time')
    stepping = ', '.join(sorted(n for n, mode in modes.items() if mode))
    remedy = 'start all with the same mode:=lockstep or mode:=realtime'
    return error('mode', f'only some nodes are in lockstep: {stepping}', remedy)


def check_gains_in_use(shot: Snapshot, arm: Arm | None) -> list[Finding]:
    """Whether running nodes have gains of the arm."""
    found = {name: values.get('gains.arm_sha256') for name, values in shot.parameters.items()}
    hashes = {name: value for name, value in found.items() if value}
    if arm is None or not hashes:
        return []
    others = sorted(n for n, value in hashes.items() if value != arm.sha256())
    if not others:
        return [ok('gains in use', f'those of arm {arm.name!r}')]
    text = f'{", ".join(others)}: gains of another arm than {arm.name!r}'
    remedy = 'design gains for this arm file (lpv design) and start the nodes with them'
    return [error('gains in use', text, remedy)]


def check_connections(shot: Snapshot) -> list[Finding]:
    """Whether what nodes of ours listen to has a source, and commands have subscribers."""
    findings = []
    for topic, ends in sorted(shot.subscriptions.items()):
        # Recorder and live view take what there is.
        listeners = [
            e for e in ends if e.node in shot.ours() and not e.node.endswith(('/recorder', '/view'))
        ]
        if not listeners or shot.publishers.get(topic):
            continue
        remedy = 'start what publishes it, or remap the topic'
        others = sorted(t for t in shot.measured if t != topic)
        if listeners[0].msgtype == JOINT_STATE and others:
            remedy = (
                f'measurements are on {", ".join(others)}: joint_states:={others[0]} of '
                f'the launch file, or -r joint_states:={others[0]}'
            )
        text = f'{listeners[0].node} subscribes to {topic}, which has no publisher'
        findings.append(error('connections', text, remedy))
    return findings or [ok('connections', 'every input has a source')]


def check_qos(shot: Snapshot) -> list[Finding]:
    """Whether publishers and subscriptions of a topic can talk to each other."""
    remedy = 'give all nodes the same mode (lockstep or realtime); a driver should offer reliable, '
    remedy += 'or be subscribed to best effort'
    findings = [
        error('qos', f'{topic}: {sink.node} receives nothing from {source.node}: {reason}', remedy)
        for topic, publishers in sorted(shot.publishers.items())
        for source in publishers
        for sink in shot.subscriptions.get(topic, ())
        if {source.node, sink.node} & set(shot.ours()) and (reason := _mismatch(source, sink))
    ]
    return findings or [ok('qos', 'publishers and subscriptions fit')]


def _mismatch(source: Endpoint, sink: Endpoint) -> str:
    if source.msgtype != sink.msgtype:
        return f'types {source.msgtype} and {sink.msgtype}'
    compatible, reason = qos_check_compatible(source.qos, sink.qos)
    return '' if compatible != QoSCompatibility.ERROR else ' '.join(reason.split()).rstrip(';')
