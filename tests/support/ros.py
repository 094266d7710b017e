"""What the tests of the real graph share: nodes as processes, and a client node in this one."""

import itertools
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from node_processes import Graph
from preloaded import Forked

from lpv.core.support.resources import executable

NAMESPACE = '/lpv'
# Domains up to 101 have ports outside the ephemeral range; processes of one test run take turns, so
# that no two graphs meet, nor one with what is left of an earlier one.
_WORKERS = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
_WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
_START = _WORKER + (os.getppid() if _WORKERS > 1 else os.getpid())
next_domain = partial(next, (1 + (_START + _WORKERS * k) % 100 for k in itertools.count()))
"""A ROS domain that no other running graph of this process has."""
PACKAGES = {'recorder': 'lpv_node', 'simulator': 'lpv_arm_sim', 'view': 'lpv_node'}
"""Of the nodes whose packages are not called after them."""


def lpv(*arguments, timeout=2000):
    """Run the command as users do; it has to succeed, and its output is returned."""
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    line = [Path(sys.executable).parent / 'lpv', *map(str, arguments)]
    given = {**os.environ, 'ROS_DOMAIN_ID': str(next_domain()), 'COLUMNS': '120'}
    done = subprocess.run(line, env=given, text=True, capture_output=True, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def words(*parameters, files=()):
    """Arguments of a node with parameters (``name:=value``) and parameter files."""
    given = [('-r', f'__ns:={NAMESPACE}'), *(('--params-file', str(file)) for file in files)]
    given += [('-p', parameter) for parameter in parameters]
    return ['--ros-args', *itertools.chain(*given)]


def command(name, *parameters, files=()):
    return [executable(PACKAGES.get(name, f'lpv_{name}'), name), *words(*parameters, files=files)]


@contextmanager
def client(domain, make=None, name='client'):
    """A node in this process, on the domain of a graph, with what it needs to spin."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = (make or rclpy.create_node)(name, context=context, namespace=NAMESPACE)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield Client(node, executor)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


class Client:
    """Listens, calls and waits."""

    def __init__(self, node, executor):
        self.node, self.executor = node, executor

    def listen(self, msgtype, topic, qos):
        """A list that receives the topic's messages."""
        received = []
        self.node.create_subscription(msgtype, topic, received.append, qos)
        return received

    def wait(self, condition, timeout=300.0):
        """Spin until the condition holds; False after the timeout."""
        deadline = time.monotonic() + timeout
        while not (found := condition()) and time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.05)
        return bool(found)

    def call(self, srvtype, name, **fields):
        service = self.node.create_client(srvtype, name)
        assert self.wait(service.service_is_ready), f'no service {name}'
        future = service.call_async(srvtype.Request(**fields))
        assert self.wait(future.done), f'no answer of {name}'
        self.node.destroy_client(service)
        return future.result()


def end(running):
    """End all nodes of a graph, which have to end in order."""
    codes = running.stop()
    assert codes and set(codes.values()) == {0}, codes


class _Graph(Graph):
    def _process(self, words):
        if Path(words[0]).is_absolute():  # a node, and no shell that starts one
            return Forked(words, self._environment)
        return super()._process(words)


def graph(log_dir, domain=None):
    """A graph of nodes that ends with the test."""
    return _Graph(log_dir, next_domain() if domain is None else domain)
