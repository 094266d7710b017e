"""Checks of a running graph, on what was seen of it."""

from collections import Counter
from collections.abc import Iterator

from rclpy.qos import QoSCompatibility, qos_check_compatible

from lpv.cli.doctor.finding import Finding, error, ok, warn
from lpv.cli.doctor.signals import check_measurements
from lpv.cli.doctor.snapshot import JOINT_STATE, Snapshot
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import LpvError
from lpv.core.support.resources import bringup_file

_SINGLE = ('joint_states', 'torque_command', 'state_estimate', 'ground_truth')
"""Topics of a graph that must have one publisher."""
_DEAD = 'a node that was killed is in the graph for some 20 s more'


def check_graph(shot: Snapshot, arm: SerialArm | None = None, alone: bool = True) -> list[Finding]:
    """Run all checks of a graph."""
    found = [check_anybody(shot, alone)]
    if not shot.ours() and not shot.measured:
        return found
    if arm is None:
        arm = running_arm(shot)
        found += _arms(shot, arm)
    for check, name, text in (
        (_states, 'lifecycle', f'{len(shot.states)} nodes are active'),
        (_names, 'names', 'no name is used twice'),
        (_publishers, 'publishers', 'every topic has one source'),
        (_clock, 'clock', 'nodes run on the wall clock, or /clock runs'),
        (_modes, 'mode', 'all nodes are in one mode'),
        (check_connections, 'connections', 'every input has a source'),
        (_qos, 'qos', 'publishers and subscriptions fit'),
    ):
        found += list(check(shot)) or [ok(name, text)]
    return [*found, *_gains(shot, arm), *check_measurements(shot, arm)]


def running_arm(shot: Snapshot) -> SerialArm | None:
    """The arm of the running observer, or of any other node of ours; None if it is not known."""
    for _, values in sorted(shot.parameters.items(), key=lambda item: '/uio' not in item[0]):
        try:
            return load_arm(bringup_file('arms', values['arm_file']))
        except (KeyError, TypeError, LpvError):
            continue  # a node of another machine, or one that could not read it either
    return None


def _arms(shot: Snapshot, arm: SerialArm | None) -> Iterator[Finding]:
    """Of several arms in the graph the one whose measurements are checked."""
    files = {values.get('arm_file') for values in shot.parameters.values()} - {None, ''}
    if arm is not None and len(files) > 1:
        others = ', '.join(sorted(map(str, files)))
        yield ok('arm', f'{arm.name!r} alone is checked; --arm names another one of {others}')


def check_anybody(shot: Snapshot, alone: bool) -> Finding:
    """Whether anything of this software runs on this domain."""
    if shot.ours():
        return ok('nodes', f'domain {shot.domain}: {", ".join(shot.ours())}')
    text = f'nothing of this software runs on domain {shot.domain}'
    if shot.measured:
        remedy = 'ros2 launch lpv_bringup observer.launch.xml ...; a node that ended at once '
        remedy += 'said why: no gains, gains of another arm, a file that is not there'
        return warn('nodes', f'{text}, but there are measurements', remedy)
    if not alone:
        return ok('nodes', f'{text}: files were checked')
    remedy = 'start it; or set ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as its shell has'
    return warn('nodes', text, f'{remedy} them')


def _states(shot: Snapshot) -> Iterator[Finding]:
    steps = {'unconfigured': 'configure, then activate', 'inactive': 'activate'}
    for name, state in shot.states.items():
        if state is None:
            remedy = f'it hangs or has died ({_DEAD}): start it again'
            yield error('lifecycle', f'{name} does not answer', remedy)
        elif state != 'active':
            step = steps.get(state, 'activate')
            remedy = f'ros2 lifecycle set {name} {step}; finalized nodes must be restarted'
            yield warn('lifecycle', f'{name} is {state}', remedy)


def _names(shot: Snapshot) -> Iterator[Finding]:
    twice = sorted(name for name, count in Counter(shot.nodes).items() if count > 1)
    if twice:
        remedy = 'two runs are on one domain: give one another ROS_DOMAIN_ID or namespace; '
        yield error('names', f'there are several nodes {", ".join(twice)}', remedy + _DEAD)


def _publishers(shot: Snapshot) -> Iterator[Finding]:
    for topic, ends in sorted(shot.publishers.items()):
        if len(ends) > 1 and (topic == '/clock' or topic.rsplit('/', 1)[1] in _SINGLE):
            if topic in shot.measured and _share(shot.measured[topic], len(ends)):
                continue
            by = ', '.join(sorted(e.node for e in ends))
            remedy = 'two simulators, or a driver and a simulator: stop one, or give it '
            remedy += f'another ROS_DOMAIN_ID or namespace; {_DEAD}'
            yield error('publishers', f'{topic} has {len(ends)} publishers: {by}', remedy)


def _share(heard: list, publishers: int) -> bool:
    """Whether each publisher has joints of its own, as of an arm and of its gripper."""
    parts = {frozenset(message.name) for _, message in heard}
    return len(parts) == publishers and sum(map(len, parts)) == len(frozenset().union(*parts))


def _clock(shot: Snapshot) -> Iterator[Finding]:
    waiting = sorted(n for n, values in shot.parameters.items() if values.get('use_sim_time'))
    if waiting and len({told for _, told in shot.clock}) < 2:
        state = 'stands still' if shot.clock else 'is silent'
        remedy = 'start what publishes /clock (simulator in lockstep, bag player with --clock), '
        remedy += 'or start the nodes without use_sim_time:=true'
        yield error('clock', f'/clock {state}, but {", ".join(waiting)} use it', remedy)


def _modes(shot: Snapshot) -> Iterator[Finding]:
    modes = {n: v['lockstep'] for n, v in shot.parameters.items() if v.get('lockstep') is not None}
    if len(set(modes.values())) > 1:
        stepping = ', '.join(sorted(n for n, mode in modes.items() if mode))
        remedy = 'start all with the same mode:=lockstep or mode:=realtime'
        yield error('mode', f'only some nodes are in lockstep: {stepping}', remedy)


def _gains(shot: Snapshot, arm: SerialArm | None) -> Iterator[Finding]:
    found = {name: values.get('gains.arm_sha256') for name, values in shot.parameters.items()}
    others = sorted(n for n, sha in found.items() if sha and arm and sha != arm.sha256())
    if others and arm is not None:
        remedy = 'design gains for this arm file (lpv design) and start the nodes with them'
        text = f'{", ".join(others)}: gains of another arm than {arm.name!r}'
        yield error('gains in use', text, remedy)
    elif arm is not None and any(found.values()):
        yield ok('gains in use', f'those of arm {arm.name!r}')


def check_connections(shot: Snapshot) -> Iterator[Finding]:
    """Whether what nodes of ours listen to has a source, and commands have subscribers."""
    # Recorder and live view take what there is.
    ours = {name for name in shot.ours() if not name.endswith(('/recorder', '/view'))}
    for topic, ends in sorted(shot.subscriptions.items()):
        listeners = [e for e in ends if e.node in ours]
        if not listeners or shot.publishers.get(topic):
            continue
        remedy = 'start what publishes it, or remap the topic'
        others = sorted(t for t in shot.measured if t != topic)
        if listeners[0].msgtype == JOINT_STATE and others:
            remedy = f'measurements are on {", ".join(others)}: joint_states:={others[0]} of the '
            remedy += f'launch file, or -r joint_states:={others[0]}'
        text = f'{listeners[0].node} subscribes to {topic}, which has no publisher'
        yield error('connections', text, remedy)


def _qos(shot: Snapshot) -> Iterator[Finding]:
    remedy = 'give all nodes the same mode (lockstep or realtime); a driver should offer reliable, '
    remedy += 'or be subscribed to best effort'
    for topic, publishers in sorted(shot.publishers.items()):
        for source in publishers:
            for sink in shot.subscriptions.get(topic, ()):
                fits, why = qos_check_compatible(source.qos, sink.qos)
                reason = ' '.join(why.split()).rstrip(';') if fits == QoSCompatibility.ERROR else ''
                if source.msgtype != sink.msgtype:
                    reason = f'types {source.msgtype} and {sink.msgtype}'
                if reason and {source.node, sink.node} & set(shot.ours()):
                    text = f'{topic}: {sink.node} receives nothing from {source.node}: {reason}'
                    yield error('qos', text, remedy)
