"""The node graph beside an empty one: lockstep rate, latency, missed samples, CPU share.

The empty graph has the same three nodes, topics, types, QoS and executor, and does nothing but
publish message objects, as rclpy programs do.  Lockstep: samples a second with all nodes in one
process and with one process for each; goals are 60 % and 70 % of the empty graph.  Real time, at
500 Hz and 1 kHz: from the time of a sample to its torque, as a fourth process sees it, samples
without a torque, and the CPU share of each node, without and with recorder and live view.  Load of
the machine is printed with each figure: ratios of one run are worth more than rates.

Before that, and alone with `--observer`: CPU time of a measurement in the observer's node, of arms
with 2, 6 and 7 joints, beside the relay of the empty graph; what takes messages from the network,
or sends them to readers, is left out of both.
"""

import argparse
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
import yaml
from node_processes import NAMESPACE, Graph, command, words
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from simulated_runs import simulated_run

from lpv import load_arm
from lpv.core.support.discovery import stay_local
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp, to_nanoseconds
from lpv_msgs.msg import FaultEstimate, GroundTruth, JointReference, StateEstimate, TorqueCommand
from lpv_node.arguments import use_profiles
from lpv_node.managed import ManagedNode, make_executor
from lpv_node.qos import stream

ROUNDS = 3
SAMPLES = 3000
"""Of one lockstep run, after the first second of the scenario."""
RATE = 500
"""Of the shipped arm [Hz]."""
WINDOW = 10.0
"""Of one real-time run [s]."""
WARM_UP = 4.0
"""Before that, so that the arm is on its path [s]."""
_LOST = 2.0
"""After so long a first sample without an answer is sent again [s]."""
DOMAIN = 83
ARMS = ('real_arm', 'ur10', 'panda')
"""Whose measurements the observer's node takes."""
NODES = ('tracker', 'uio', 'simulator')


# ---------------------------------------------------------------- the empty graph


class Source(Node):
    """Publishes what the simulator does, once for each command; counts and times the answers."""

    def __init__(self) -> None:
        super().__init__('arm_sim')
        qos = stream(True)
        self._clock = self.create_publisher(Clock, '/clock', qos)
        self._truth = self.create_publisher(GroundTruth, 'ground_truth', qos)
        self._states = self.create_publisher(JointState, 'joint_states', qos)
        self.create_subscription(TorqueCommand, 'torque_command', self._next, qos)
        self._message = JointState(
            name=['a', 'b'], position=[0.0] * 2, velocity=[0.0] * 2, effort=[0.0] * 2
        )
        self.count, self._start = 0, 0.0
        self.rate: float | None = None

    def begin(self) -> bool:
        """Send the first sample if the others are there."""
        if self._states.get_subscription_count() and self.count_publishers('torque_command'):
            self._publish()
            return True
        return False

    def _next(self, _message: TorqueCommand) -> None:
        self.count += 1
        if self.count == RATE:
            self._start = time.perf_counter()
            print('begin', flush=True)
        if self.count == RATE + SAMPLES:
            self.rate = SAMPLES / (time.perf_counter() - self._start)
        else:
            self._publish()

    def _publish(self) -> None:
        stamp = self.count * 10**9 // RATE
        clock, truth = Clock(), GroundTruth()
        for name in ('position', 'velocity', 'torque', 'fault'):
            setattr(truth, name, self._message.position)
        set_stamp(clock.clock, stamp)
        set_stamp(truth.header.stamp, stamp)
        set_stamp(self._message.header.stamp, stamp)
        self._clock.publish(clock)
        self._truth.publish(truth)
        self._states.publish(self._message)


def _two_joints(kind: type) -> Any:
    """A message whose arrays have two elements."""
    message = kind()
    for name, field in kind.get_fields_and_field_types().items():
        element = {'double': 0.0, 'uint8': 0, 'boolean': False, 'string': 'x'}
        if field.startswith('sequence<'):
            setattr(message, name, [element[field[9:-1]]] * 2)
    return message


class Relay(Node):
    """Answers each message of one topic with messages on others."""

    def __init__(self, name: str, source: tuple[type, str], outputs: dict[str, type]) -> None:
        super().__init__(name)
        qos = stream(True)
        self._outputs = [
            (self.create_publisher(kind, topic, qos), _two_joints(kind))
            for topic, kind in outputs.items()
        ]
        self.create_subscription(*source, self._answer, qos)

    def _answer(self, message: Any) -> None:
        for publisher, answer in self._outputs:
            answer.header.stamp = message.header.stamp
            publisher.publish(answer)


EMPTY: dict[str, Callable[[], Node]] = {
    'arm_sim': Source,
    'uio': lambda: Relay(
        'uio',
        (JointState, 'joint_states'),
        {'state_estimate': StateEstimate, 'fault_estimate': FaultEstimate},
    ),
    'tracker': lambda: Relay(
        'tracker',
        (StateEstimate, 'state_estimate'),
        {'torque_command': TorqueCommand, 'reference': JointReference},
    ),
}


def node_classes() -> dict[str, Callable[[], ManagedNode]]:
    """The real nodes."""
    from lpv_arm_sim.node import SimulatorNode
    from lpv_tracker.node import TrackerNode
    from lpv_uio.node import UioNode

    return {'arm_sim': SimulatorNode, 'uio': UioNode, 'tracker': TrackerNode}


def run_empty(names: list[str]) -> None:
    """Role of a process: some nodes of the empty graph, until all samples are answered."""
    nodes = {name: EMPTY[name]() for name in names}
    executor = make_executor()
    for node in nodes.values():
        executor.add_node(node)
    source = nodes.get('arm_sim')
    sent = -math.inf
    while source is None or source.rate is None:
        # The first sample is lost where two of the others have not found each other yet.
        if source is not None and source.count == 0 and time.monotonic() - sent > _LOST:
            sent = time.monotonic() if source.begin() else sent
        executor.spin_once(timeout_sec=0.2)
    print(f'rate {source.rate:.1f}', flush=True)
    time.sleep(60.0)  # until stopped: the CPU time is read first


def run_ours() -> None:
    """Role of a process: all real nodes on one executor, until the scenario is over."""
    nodes = [node() for node in node_classes().values()]
    executor = make_executor()
    for node in nodes:
        node.trigger_configure()
        node.trigger_activate()
        executor.add_node(node)
    while not nodes[0].finished:
        executor.spin_once(timeout_sec=0.2)


# ---------------------------------------------------------------- runs


def role(*given: str) -> list[str]:
    """Command line of this program in a role."""
    return [sys.executable, __file__, *given, *words()]


def parameters(folder: Path, rate: int, lockstep: bool, recorders: int) -> Path:
    """Parameter file of the whole graph; gains of an arm that is sampled faster are designed."""
    arm = yaml.safe_load(Path(bringup_file('arms', 'paper')).read_text())
    arm['sample_time'] = 1.0 / rate
    arm_file, gains_file = folder / f'arm_{rate}.yaml', folder / f'gains_{rate}.yaml'
    arm_file.write_text(yaml.safe_dump(arm))
    if rate == RATE:
        gains_file = Path(bringup_file('gains', 'paper'))
    elif not gains_file.exists():
        words = ['--arm', str(arm_file), '--requirement', 'paper', '--out', str(gains_file)]
        subprocess.run(['lpv', 'design', *words], check=True, stdout=subprocess.DEVNULL)
    scenario = yaml.safe_load(Path(bringup_file('scenarios', 'two_faults')).read_text())
    scenario['duration'] = 1.0 + SAMPLES / RATE + 0.5 if lockstep else 3600.0
    (folder / 'scenario.yaml').write_text(yaml.safe_dump(scenario))
    common = {
        'lockstep': lockstep,
        'arm_file': str(arm_file),
        'scenario_file': str(folder / 'scenario.yaml'),
        'await_recorders': recorders,
    }
    gains = yaml.safe_load(gains_file.read_text())
    (section,) = gains.values()
    section['ros__parameters'].update(common)
    path = folder / 'parameters.yaml'
    path.write_text(yaml.safe_dump({'/**': section}))
    return path


@contextmanager
def processes(commands: dict[str, list[Any]]) -> Iterator[Graph]:
    """Nodes as processes."""
    with tempfile.TemporaryDirectory() as folder, Graph(Path(folder), DOMAIN) as graph:
        for name, line in commands.items():
            graph.start(name, line)
        yield graph


def scenario_rate(text: str) -> float:
    """Samples a second from the simulator's remarks, from the first second of the scenario on."""
    found = re.findall(r'\[(\d+\.\d+)\].*scenario time (\d+\.\d)', text)
    marks = [(float(at), float(time)) for at, time in found if float(time) >= 1.0]
    (first, begin), (last, end) = marks[0], marks[-1]
    return RATE * (end - begin) / (last - first)


def empty_rate(split: bool) -> tuple[float, float]:
    """Lockstep rate of the empty graph [samples/s], and its CPU time [s/sample]."""
    groups = [[name] for name in EMPTY] if split else [list(EMPTY)]
    with processes({'_'.join(names): role('empty', *names) for names in groups}) as graph:
        wait_for(graph, 'begin')
        before = total_cpu_time(graph)
        rate = float(wait_for(graph, r'rate ([\d.]+)')[1])
        return rate, (total_cpu_time(graph) - before) / SAMPLES


def our_rate(split: bool, folder: Path) -> tuple[float, float]:
    """Lockstep rate of the real graph [samples/s], and its CPU time [s/sample]."""
    file = parameters(folder, RATE, True, 0)
    if split:
        commands = {name: command(name, files=[file]) for name in NODES}
    else:
        commands = {'graph': [*role('ours'), '--params-file', str(file)]}
    with processes(commands) as graph:
        wait_for(graph, r'scenario time 1\.0 ')
        before = total_cpu_time(graph)
        wait_for(graph, rf'scenario time {1 + SAMPLES // RATE}\.0 ')
        used = total_cpu_time(graph) - before
        return scenario_rate(graph.text()), used / SAMPLES


def wait_for(graph: Graph, pattern: str, timeout: float = 600.0) -> re.Match[str]:
    """The first place that matches in what the nodes print; an error if one has died."""
    deadline = time.monotonic() + timeout
    while not (found := re.search(pattern, graph.text())):
        graph.check()
        if time.monotonic() > deadline:
            raise TimeoutError(f'no node says {pattern!r}')
        time.sleep(0.02)
    return found


def cpu_time(pid: int) -> float:
    """CPU time that a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def total_cpu_time(graph: Graph) -> float:
    """CPU time that all nodes have used [s]."""
    return sum(cpu_time(node.process.pid) for node in graph.nodes)


class Listener(Node):
    """Notes when torques come, and for which samples."""

    def __init__(self) -> None:
        super().__init__('_listener', namespace=NAMESPACE)
        self.delays: dict[int, float] = {}
        self.create_subscription(TorqueCommand, 'torque_command', self._note, stream(False))

    def _note(self, message: TorqueCommand) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self.delays[stamp] = (time.time_ns() - stamp) * 1e-6

    def listen(self, seconds: float) -> None:
        """Receive for a while."""
        executor = make_executor()
        executor.add_node(self)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.1)
        executor.remove_node(self)


def real_time(rate: int, extras: bool, folder: Path) -> str:
    """One line about a real-time run."""
    file = parameters(folder, rate, False, int(extras))
    commands = {}
    if extras:
        bag = folder / f'bag_{rate}'
        commands['recorder'] = command('recorder', f'output:={bag}', files=[file])
        commands['view'] = command('view', 'port:=0', 'foxglove_port:=0', files=[file])
    commands |= {name: command(name, files=[file]) for name in NODES}
    with processes(commands) as graph:
        wait_for(graph, 'brakes released')
        listener = Listener()
        listener.listen(WARM_UP)
        listener.delays.clear()
        before = {node.name: cpu_time(node.process.pid) for node in graph.nodes}
        start = time.monotonic()
        listener.listen(WINDOW)
        span = time.monotonic() - start
        shares = {
            node.name: (cpu_time(node.process.pid) - before[node.name]) / span
            for node in graph.nodes
        }
        graph.check()
        listener.destroy_node()
    delays = np.array([listener.delays[stamp] for stamp in sorted(listener.delays)])
    stamps = sorted(listener.delays)
    expected = round((stamps[-1] - stamps[0]) * 1e-9 * rate) + 1
    share = ', '.join(f'{name} {100 * value:.0f} %' for name, value in shares.items())
    return (
        f'{rate} Hz{", recorder and view" if extras else ""}: sample to torque '
        f'{np.median(delays):.2f} ms (median), {np.percentile(delays, 99):.2f} ms (99 %), '
        f'{delays.max():.1f} ms (longest); {expected - len(stamps)} of {expected} without; '
        f'CPU: {share}'
    )


def measurements(name: str) -> list[bytes]:
    """JointStates of a shipped arm that moves, as they come."""
    arm, found = load_arm(name), []
    for stamp, sample in zip(*simulated_run(arm, (1 + ROUNDS) * SAMPLES * arm.sample_time)[:2]):
        fields = dict(zip(('position', 'velocity', 'effort'), sample))
        message = JointState(name=list(arm.joint_names), **fields)
        set_stamp(message.header.stamp, int(stamp) + 10**9)
        found.append(serialize_message(message))
    return found


def measurement_cost(name: str) -> str:
    """One line about the CPU time of a measurement in the observer's node."""
    rclpy.init(args=words(f'arm_file:={name}'))
    node, relay = node_classes()['uio'](), EMPTY['uio']()
    node.setup()
    found, every = [], np.array(measurements(name), object).reshape(-1, SAMPLES)
    for part in every:
        for answer in (node._on_measurement, relay._answer):
            begin = time.process_time()
            for data in part:
                answer(deserialize_message(data, JointState))
            found.append((time.process_time() - begin) / SAMPLES)
    ours, empty = np.array(found).reshape(-1, 2)[1:].T  # the horizon is full
    node.destroy_node()
    relay.destroy_node()
    rclpy.shutdown()
    ratio, ours, empty = (np.median(one) for one in (ours / empty, 1e6 * ours, 1e6 * empty))
    return (
        f'{name}: {ours:.0f} us a measurement, relay {empty:.0f}: {ratio:.1f} '
        f'(median of {ROUNDS} rounds; {load()})'
    )


def load() -> str:
    """Load of the machine in the last minute."""
    return f'load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores'


def measure(only_observer: bool) -> None:
    """Measure, and print one line for each figure."""
    stay_local()
    os.environ['ROS_DOMAIN_ID'] = str(DOMAIN)
    for name in ARMS:
        print(measurement_cost(name), flush=True)
    if only_observer:
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for split, where, goal in ((False, 'one process', 60), (True, 'three processes', 70)):
            # By round; ours and empty; samples a second and CPU time for each.
            found = np.array([(our_rate(split, folder), empty_rate(split)) for _ in range(ROUNDS)])
            ratio, cpu_ratio = np.median(found[:, 0] / found[:, 1], axis=0)
            (ours, our_cpu), (empty, empty_cpu) = np.median(found, axis=0)
            print(
                f'lockstep, {where}: {ours:.0f} samples/s, empty graph {empty:.0f}: '
                f'{100 * ratio:.0f} % (goal {goal} %); CPU time {1e6 * our_cpu:.0f} and '
                f'{1e6 * empty_cpu:.0f} us per sample: {cpu_ratio:.2f} (median of {ROUNDS} rounds; '
                f'{load()})',
                flush=True,
            )
        rclpy.init(args=[])
        for rate in (RATE, 2 * RATE):
            for extras in (False, True):
                print(f'{real_time(rate, extras, folder)} ({load()})', flush=True)
        rclpy.shutdown()


def main() -> None:
    """Measure, or be a process of a graph."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('role', nargs='?', choices=('empty', 'ours'), help=argparse.SUPPRESS)
    parser.add_argument('nodes', nargs='*', help=argparse.SUPPRESS)
    parser.add_argument('--observer', action='store_true', help='a measurement of the observer')
    arguments, _ = parser.parse_known_args()
    if arguments.role is None:
        measure(arguments.observer)
        return
    use_profiles()
    rclpy.init(args=sys.argv)
    if arguments.role == 'empty':
        run_empty(arguments.nodes)
    else:
        run_ours()


if __name__ == '__main__':
    main()
