"""Start, watch and stop the nodes of a run as separate processes, and take part in their graph."""

import contextlib
import itertools
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from lpv.core.support.discovery import stay_local
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import PATIENCE
from lpv.core.support.resources import executable
from lpv.core.support.signals import STOPS, handled_signals

NAMESPACE = '/lpv'
PACKAGES = {'recorder': 'lpv_node', 'simulator': 'lpv_arm_sim', 'view': 'lpv_node'}
"""Of the nodes whose packages are not called after them."""


def words(*parameters: str, files: Iterable[Any] = ()) -> list[str]:
    """Arguments of a node with parameters (``name:=value``) and parameter files."""
    given = [('-r', f'__ns:={NAMESPACE}'), *(('--params-file', str(file)) for file in files)]
    given += [('-p', parameter) for parameter in parameters]
    return ['--ros-args', *itertools.chain(*given)]


def command(name: str, *parameters: str, files: Iterable[Any] = ()) -> list[Any]:
    """Command line of a node."""
    program = executable(PACKAGES.get(name, f'lpv_{name}'), name)
    return [program, *words(*parameters, files=files)]


class NodeFailure(LpvError):
    """A node ended before its time; the message carries the end of its log."""


@dataclass
class NodeProcess:
    """One running node."""

    name: str  # For messages
    process: subprocess.Popen  # Leader of its own process group
    log: Path  # What it printed
    is_recorder: bool

    def text(self) -> str:
        """What it has printed so far."""
        return self.log.read_text(encoding='utf-8', errors='replace')


class Graph:
    """A set of nodes that live and end together, each with its log in a folder."""

    def __init__(self, log_dir: Path, domain_id: int) -> None:
        self._log_dir = Path(log_dir)
        self._log_dir.mkdir(parents=True, exist_ok=True)
        stay_local()
        self._environment = dict(os.environ, ROS_DOMAIN_ID=str(domain_id), PYTHONUNBUFFERED='1')
        self.nodes: list[NodeProcess] = []

    def __enter__(self) -> 'Graph':
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, command: list[Any]) -> NodeProcess:
        """Start a node."""
        line, path = [str(part) for part in command], self._log_dir / f'{name}.log'
        log = open(path, 'w', encoding='utf-8', buffering=1)  # noqa: SIM115
        is_recorder = any(Path(word).name == 'recorder' for word in line)  # by a shell, too
        node = NodeProcess(name, self._process(line), path, is_recorder)
        # By a pipe: nodes that print end with who started them.
        threading.Thread(target=_write_log, args=(node.process, log), daemon=True).start()
        self.nodes.append(node)
        return node

    def _process(self, line: list[str]) -> subprocess.Popen:
        options: dict[str, Any] = {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT}
        options |= {'env': self._environment, 'text': True, 'errors': 'replace'}
        return subprocess.Popen(line, start_new_session=True, **options)

    def check(self) -> None:
        """Raise if a node has ended."""
        for node in self.nodes:
            code = node.process.poll()
            if code is not None:
                end = '\n'.join(node.text().splitlines()[-15:])
                raise NodeFailure(f'{node.name} ended with code {code}:\n{end}')

    def text(self) -> str:
        """What all nodes have printed so far."""
        return '\n'.join(node.text() for node in self.nodes)

    def stop(self, patience: float = 3.0 * PATIENCE) -> dict[str, Any]:
        """Stop all nodes: SIGINT, then SIGTERM, then SIGKILL, to whole process groups.

        Recorders are stopped last: they take what the others send until they end.  Signals do
        not interrupt it, or nodes in sessions of their own would outlive the command.
        """
        with handled_signals(lambda *_: None, *STOPS):
            for last in (False, True):
                _stop([n for n in self.nodes if n.is_recorder == last], patience)
        return {node.name: node.process.poll() for node in self.nodes}


def _write_log(process: subprocess.Popen, log: TextIO) -> None:
    """Thread: take what a node prints, which would wait for ever if nobody read it."""
    with contextlib.suppress(OSError), log:  # of a disk that is full
        for line in process.stdout or ():
            with contextlib.suppress(OSError):
                log.write(line)


def _stop(nodes: list[NodeProcess], patience: float) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
        running = [node for node in nodes if node.process.poll() is None]
        for node in running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(node.process.pid, number)
        deadline = time.monotonic() + patience
        for node in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                node.process.wait(max(0.0, deadline - time.monotonic()))


@contextlib.contextmanager
def client(domain: int, make: Any = None, name: str = 'client') -> Iterator['Client']:
    """A node in this process, on the domain of a graph, with what it needs to spin."""
    from lpv.bag.rosbag.live import node_alone

    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    given = {'make': make} if make else {}
    with node_alone(name, domain, namespace=NAMESPACE, **given) as pair:
        yield Client(*pair)


class Client:
    """Listens, calls and waits."""

    def __init__(self, node: Any, executor: Any) -> None:
        self.node, self.executor = node, executor

    def listen(self, msgtype: type, topic: str, qos: Any) -> list[Any]:
        """A list that receives the topic's messages."""
        received: list[Any] = []
        self.node.create_subscription(msgtype, topic, received.append, qos)
        return received

    def wait(self, condition: Callable[[], Any], timeout: float = 300.0) -> bool:
        """Spin until the condition holds; False after the timeout [s]."""
        end = time.monotonic() + timeout
        while not (found := condition()) and time.monotonic() < end:
            # Always with the same timeout: with another one rclpy forgets whose turn it is.
            self.executor.spin_once(timeout_sec=0.05)
        return bool(found)

    def call(self, srvtype: Any, name: str, **fields: Any) -> Any:
        """Answer of a service."""
        service = self.node.create_client(srvtype, name)
        assert self.wait(service.service_is_ready), f'no service {name}'
        future = service.call_async(srvtype.Request(**fields))
        assert self.wait(future.done), f'no answer of {name}'
        self.node.destroy_client(service)
        return future.result()
