"""Start, watch and stop the nodes of a run as separate processes."""

import contextlib
import os
import queue
import signal
import subprocess
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from lpv.core.support.discovery import stay_local
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import PATIENCE
from lpv.core.support.signals import STOPS, handled_signals


class NodeFailure(LpvError):
    """A node ended before its time; the message carries the end of its log."""


@dataclass
class NodeProcess:
    """One running node."""

    name: str  # For messages
    process: subprocess.Popen  # Leader of its own process group
    log: Path  # What it printed
    is_recorder: bool


class Graph:
    """A set of nodes that live and end together, each with its log in a folder."""

    def __init__(self, log_dir: Path, domain_id: int) -> None:
        self._log_dir = Path(log_dir)
        self._log_dir.mkdir(parents=True, exist_ok=True)
        stay_local()
        self._environment = dict(os.environ, ROS_DOMAIN_ID=str(domain_id), PYTHONUNBUFFERED='1')
        self.nodes: list[NodeProcess] = []
        self.lines: queue.Queue[tuple[str, str]] = queue.Queue()

    def __enter__(self) -> 'Graph':
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self, name: str, command: list[Any]) -> NodeProcess:
        """Start a node."""
        words, path = [str(part) for part in command], self._log_dir / f'{name}.log'
        log = open(path, 'w', encoding='utf-8', buffering=1)  # noqa: SIM115
        process = self._process(words)
        is_recorder = any(Path(word).name == 'recorder' for word in words)  # by a shell, too
        node = NodeProcess(name, process, path, is_recorder)
        threading.Thread(target=self._pump, args=(node, log), daemon=True).start()
        self.nodes.append(node)
        return node

    def _process(self, words: list[str]) -> subprocess.Popen:
        return subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=self._environment,
            text=True,
            errors='replace',
            start_new_session=True,
        )

    def _pump(self, node: NodeProcess, log: TextIO) -> None:
        """Thread: hand on what a node prints, which would wait for ever if nobody read it."""
        for line in node.process.stdout or ():
            with contextlib.suppress(OSError):  # of a disk that is full
                log.write(line)
            self.lines.put((node.name, line.rstrip()))
        with contextlib.suppress(OSError):
            log.close()

    def check(self, finite: NodeProcess | None = None) -> None:
        """Raise if a node has ended that should not."""
        for node in self.nodes:
            code = node.process.poll()
            if code is not None and not (node is finite and code == 0):
                log = node.log.read_text(encoding='utf-8') if node.log.exists() else '(no log)'
                end = '\n'.join(log.splitlines()[-15:])
                raise NodeFailure(f'{node.name} ended with code {code}:\n{end}')

    def stop(self, patience: float = 3.0 * PATIENCE) -> dict[str, Any]:
        """Stop all nodes: SIGINT, then SIGTERM, then SIGKILL, to whole process groups.

        Recorders are stopped last: they take what the others send until they end.  Signals do
        not interrupt it, or nodes in sessions of their own would outlive the command.
        """
        with handled_signals(lambda *_: None, *STOPS):
            for last in (False, True):
                _stop([n for n in self.nodes if n.is_recorder == last], patience)
        return {node.name: node.process.poll() for node in self.nodes}


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
