"""Six attacks on the running graph of a loaded machine: what the arm does, and what is said.

Each runs the shipped launch file with recorder and live page in real time, beside busy loops.  Bags
tell the largest joint rate of the true arm, the largest error of joint_states_corrected while the
estimate says that it is trustworthy, samples in which a fault estimate is outside its bound, and
values of outputs that are NaN.
"""

import argparse
import math
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import yaml
from node_processes import Client, Graph, client
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from lpv import SerialArm, load_arm
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.run.decoder import Decoder
from lpv.core.support.errors import SampleError
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp
from lpv_msgs.msg import StateEstimate, TorqueCommand
from lpv_msgs.srv import InjectFault
from lpv_node.qos import stream

SCENARIOS = {'paper': 'two_faults', 'ur10': 'ur10'}
DOMAIN, LOAD = 84, ['nice', '-n', '5', sys.executable, '-c', 'while True: pass']
KINDS = {
    'bias': (0.2, 0.0),
    'drift': (0.3, 0.1),
    'scale': (0.2, 0.0),
    'stuck': (0.0, 0.0),
    'noise': (0.02, 0.0),
    'spike': (0.3, 5.0),
    'dropout': (0.0, 0.0),
    'rate_bias': (0.1, 0.0),
}
"""Sizes and rates of injected faults."""
HOSTILE = (1e308, -1e308, math.nan, math.inf, 1e6)
ESTIMATE = 'position velocity compensated_position measured_position measured_velocity'
OUTPUTS = {
    'state_estimate': f'{ESTIMATE} trustworthy',
    'fault_estimate': 'estimate bound threshold',
    'joint_states_corrected': 'position velocity',
    'torque_command': 'torque',
    'reference': 'position velocity acceleration tip_position',
    'fault_alarm': 'size bound confidence',
}
HEAD = (
    'arm', 'attack', 'time [s]', 'largest joint rate [rad/s] (of its limit)',
    'error while trustworthy [rad]: largest, 99 %', 'samples answered, of these trustworthy [%]',
    'outside a bound [%]', 'NaN',
    'alarms', 'stops', 'note',
)  # fmt: skip


class Rig:
    """A running graph, and who attacks it."""

    def __init__(self, arm: SerialArm, graph: Graph, client: Client, seconds: float) -> None:
        self.arm, self.seconds, self.note = arm, seconds, ''
        self.launch, self.rng = graph.nodes[0], np.random.default_rng(1)
        self.node, self._client = client.node, client
        self._last: Any = None

    def log(self) -> str:
        """What the nodes have said."""
        return self.launch.text()

    def wait(self, seconds: float, done: Any = lambda: False) -> None:
        """Take part in the graph for a while, or until something is done."""
        self._client.wait(done, seconds)

    def every(self, seconds: float) -> Iterator[int]:
        """Numbers of turns, until the attack is over."""
        end = time.monotonic() + self.seconds
        for k in range(int(self.seconds / seconds)):
            yield k
            self.wait(min(seconds, end - time.monotonic()))

    def hear(self) -> Any:
        """Begin to hear measurements; a publisher beside their own."""

        def hear(message: JointState) -> None:
            if message.header.frame_id != 'attacker':
                self._last = message

        self.node.create_subscription(JointState, 'joint_states', hear, stream(False))
        publisher = self.node.create_publisher(JointState, 'joint_states', stream(False))
        self.wait(30.0, lambda: self._last and publisher.get_subscription_count() > 1)
        return publisher

    def forged(self, shift: int = 0, offset: float = 0.0) -> JointState:
        """The last measurement as of now and a shift [ns], off by some angle [rad]."""
        header = Header(frame_id='attacker')
        set_stamp(header.stamp, time.time_ns() + shift)
        fields = {name: getattr(self._last, name) for name in ('name', 'velocity', 'effort')}
        position = [value + offset for value in self._last.position]
        return JointState(header=header, position=position, **fields)


def ended_drift(rig: Rig) -> None:
    """A drift ends, then the arm holds still at the end of its path."""
    rig.wait(rig.seconds)


def every_kind(rig: Rig) -> None:
    """Faults of every kind for 5 s each, on sensors drawn at random, with 3 s between."""
    client = rig.node.create_client(InjectFault, 'arm_sim/inject_fault')
    rig.wait(30.0, client.service_is_ready)
    for k in rig.every(8.0):
        kind, (size, rate) = list(KINDS.items())[k % len(KINDS)]
        sensor = str(rig.rng.choice(rig.arm.sensor_names))
        client.call_async(InjectFault.Request(
            sensor=sensor, kind=kind, size=size, rate=rate, duration=5.0))  # fmt: skip


def future(rig: Rig) -> None:
    """Single samples stamped 10 s ahead beside a confirmed fault; half-way the observer dies."""
    publisher = rig.hear()
    for k in rig.every(2.0):
        publisher.publish(rig.forged(10 * 10**9))
        for one in psutil.Process(rig.launch.process.pid).children(True):
            with suppress(psutil.Error):
                if k == int(rig.seconds / 4.0) and one.cmdline()[1].endswith('/uio'):
                    one.kill()
    known = rig.log().count('not trustworthy: the observer was started again')
    rig.note = f'its successor {"knew of the fault" if known else "KNEW NOTHING"}'


def second_publisher(rig: Rig) -> None:
    """Fifteen samples in a row with readings that are 0.3 rad off."""
    publisher = rig.hear()
    for _ in rig.every(3.0):
        for _ in range(15):
            publisher.publish(rig.forged(0, 0.3))
            rig.wait(rig.arm.sample_time)
    said = Counter(re.findall(r'refused: (measurement of a second publisher)', rig.log()))
    rig.note = f'said {said.total()} times'


def impossible(rig: Rig) -> None:
    """Measurements, estimates and commands with numbers that nothing has."""
    publishers = [
        (rig.node.create_publisher(kind, topic, stream(False)), kind, fields.split())
        for kind, topic, fields in (
            (JointState, 'joint_states', 'position velocity effort'),
            (StateEstimate, 'state_estimate', ESTIMATE),
            (TorqueCommand, 'torque_command', 'torque'),
        )
    ]
    joints = rig.arm.joint_names
    for _ in rig.every(0.2):
        for publisher, kind, fields in publishers:
            message = kind(name=list(joints)) if kind is JointState else kind()
            message.header.frame_id = 'attacker'
            set_stamp(message.header.stamp, time.time_ns())
            for name in fields:
                setattr(message, name, rig.rng.choice(HOSTILE, len(joints)).tolist())
            publisher.publish(message)


def silent_sockets(rig: Rig) -> None:
    """Sixteen sockets ask for the page's stream and say no more; every 30 s others come."""
    port = int(re.findall(r'page: http://127.0.0.1:(\d+)', rig.log())[0])
    held, waits, since = [], [], math.inf
    for k in rig.every(1.0):
        if k % 30 == 0:
            held = [*held[-16:], *(_ask(port, 0.0)[0] for _ in range(16))]
            continue
        since = min(since, time.monotonic())
        visitor, answer = _ask(port, 2.0)  # who tries again every second
        visitor.close()
        if b' 101 ' in answer:
            waits.append(time.monotonic() - since)
            since = math.inf
    rig.note = f'{len(waits)} visitors got in, after {max(waits, default=math.inf):.0f} s at most'


def _ask(port: int, patience: float) -> tuple[socket.socket, bytes]:
    """A socket that asks for the page's stream, and the beginning of the answer if wanted."""
    one = socket.create_connection(('127.0.0.1', port), timeout=5.0)
    words = ('GET /ws HTTP/1.1', f'Host: 127.0.0.1:{port}', 'Connection: Upgrade',
             'Upgrade: websocket', 'Sec-WebSocket-Version: 13',
             'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==', '', '')  # fmt: skip
    one.sendall('\r\n'.join(words).encode())
    one.settimeout(patience)
    try:
        return one, one.recv(100) if patience else b''
    except OSError:
        return one, b''


FAULTS = {
    ended_drift: {'kind': 'drift', 'size': 0.3, 'rate': 0.05, 'duration': 8.0},
    future: {'kind': 'bias', 'size': 0.2},
}
"""Of the scenario, from 9 s on, on the second sensor."""
ATTACKS = {
    attack.__name__: attack
    for attack in (ended_drift, every_kind, future, second_publisher, impossible, silent_sockets)
}


def scenario(folder: Path, name: str, arm: SerialArm, attack: Any, seconds: float) -> Path:
    """The shipped scenario of an arm, its path again and again, with the fault of an attack."""
    content = yaml.safe_load(Path(bringup_file('scenarios', SCENARIOS[name])).read_text())
    fault = {'sensor': arm.sensor_names[1], 'onset': 9.0, **FAULTS.get(attack, {})}
    content |= {'duration': 1e5, 'faults': [fault] if attack in FAULTS else []}
    if attack is not ended_drift:
        points = content['path']['waypoints']
        content['path']['waypoints'] = points[:1] + [
            {**point, 't': point['t'] + 19.0 * k}
            for k in range(math.ceil(seconds / 19.0) + 2)
            for point in points[1:]
        ]
    path = folder / 'scenario.yaml'
    path.write_text(yaml.safe_dump(content))
    return path


def attacked(folder: Path, name: str, attack: Any, seconds: float, loops: int) -> str:
    """Run an attack on an arm's graph; its row of the table."""
    arm = load_arm(name)
    words = {
        'arm': name, 'scenario': scenario(folder, name, arm, attack, seconds), 'record': 'true',
        'bag': folder / 'bag', 'view': 'true', 'view_port': 0, 'foxglove_port': 0,
        'respawn': 'true',
    }  # fmt: skip
    line = ['ros2', 'launch', 'lpv_bringup', 'pipeline.launch.xml']
    load = [subprocess.Popen(LOAD) for _ in range(loops)]
    try:
        with Graph(folder / 'log', DOMAIN) as graph, client(DOMAIN, name='_attacker') as own:
            graph.start('launch', line + [f'{key}:={value}' for key, value in words.items()])
            rig = Rig(arm, graph, own, seconds)
            # On a new machine the nodes compile first.
            rig.wait(300.0, lambda: 'brakes released' in rig.log() and 'page: ' in rig.log())
            rig.wait(5.0)
            attack(rig)
            log = rig.log()
    finally:
        for one in load:
            one.kill()
    return row(folder / 'bag', arm, attack, rig.note, log)


def row(bag: Path, arm: SerialArm, attack: Any, note: str, log: str) -> str:
    """What bag and log show."""
    found, missing = read(bag)
    times, position, velocity, fault = found['ground_truth']
    stamps, corrected, _ = found['joint_states_corrected']
    estimates = found['state_estimate']
    is_trusted = estimates[-1][:, 0] != 0
    kept = np.isin(stamps, estimates[0][is_trusted]) & (stamps >= times[0]) & (stamps <= times[-1])
    true = np.stack([np.interp(stamps[kept], times, column) for column in position.T], axis=1)
    error = np.abs(corrected[kept] - true).max(axis=1)
    rates, limit = np.abs(velocity).max(axis=0), np.array(arm.velocity_limit)
    fastest = int((rates / limit).argmax())
    stamps, estimate, bound, _ = found['fault_estimate']
    place = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
    outside = (np.abs(estimate - fault[place]) > bound).any(axis=1)
    said = Counter(re.findall(r'ALARM, \w+: .*?, (\w+), ', log))
    stops = Counter(re.findall(r'(safe stop|brakes engaged): ', log))
    cells = (
        arm.name, attack.__name__.replace('_', ' '), f'{(times[-1] - times[0]) * 1e-9:.0f}',
        f'{rates[fastest]:.2f} ({100 * rates[fastest] / limit[fastest]:.0f} %)',
        f'{error.max():.3f}, {np.percentile(error, 99):.3f}',
        f'{100 * len(estimates[0]) / len(times):.0f}, {100 * np.mean(is_trusted):.0f}',
        f'{100 * outside.mean():.1f}', missing,
        _counted(said), _counted(stops), note or '-',
    )  # fmt: skip
    return f'| {" | ".join(map(str, cells))} |'


def _counted(counts: Counter[str]) -> str:
    return ', '.join(f'{count} {text}' for text, count in counts.most_common(5)) or 'none'


def _columns(message: Any) -> tuple[slice, int]:
    """All columns; the attacker's own messages are no outputs."""
    if message.header.frame_id == 'attacker':
        raise SampleError('of the attacker')
    return slice(None), -1


def read(bag: Path) -> tuple[dict[str, list[np.ndarray]], int]:
    """Stamps and fields by topic, in the order of stamps; how many numbers of outputs are NaN."""
    wanted = {**OUTPUTS, 'ground_truth': 'position velocity fault'}
    parts: dict[str, list[Any]] = {topic: [] for topic in wanted}
    with open_bag(bag) as reader:
        chosen = [c for c in reader.connections if c.topic.rsplit('/', 1)[1] in wanted]
        topics = [c.topic.rsplit('/', 1)[1] for c in chosen]
        decoders = [
            Decoder(reader, c.msgtype, wanted[topic].split(), _columns)
            for c, topic in zip(chosen, topics)
        ]
        for block in reader.blocks(chosen):
            for i, topic in enumerate(topics):
                table = decoders[i].read(block, np.flatnonzero(block.connection == i))
                if table is not None:
                    parts[topic].append([table[1], *table[2].values()])
    found, missing = {}, 0
    for topic, pieces in parts.items():
        columns = [np.concatenate(column) for column in zip(*pieces)]
        order = np.argsort(columns[0], kind='stable') if columns else []
        found[topic] = [column[order] for column in columns]
        if topic in OUTPUTS:
            missing += sum(int(np.isnan(column).sum()) for column in columns[1:])
    return found, missing


def main() -> None:
    """Run the attacks, and print one row for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--arms', nargs='+', default=list(SCENARIOS), choices=SCENARIOS)
    parser.add_argument('--attacks', nargs='+', default=list(ATTACKS), choices=ATTACKS)
    parser.add_argument('--seconds', type=float, default=600.0, help='of each attack')
    parser.add_argument('--loops', type=int, default=2, help='busy loops beside the graph')
    parser.add_argument('--keep', type=Path, help='folder that keeps bags and logs')
    arguments = parser.parse_args()
    print(f'| {" | ".join(HEAD)} |\n{"|---" * len(HEAD)}|', flush=True)
    for name in arguments.arms:
        for attack in arguments.attacks:
            with tempfile.TemporaryDirectory() as folder:
                place = (arguments.keep or Path(folder)) / f'{name}_{attack}'
                place.mkdir(parents=True)
                words = arguments.seconds, arguments.loops
                print(attacked(place, name, ATTACKS[attack], *words), flush=True)


if __name__ == '__main__':
    main()
