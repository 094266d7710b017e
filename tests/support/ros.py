"""What the tests of the real graph share: nodes as processes, and a client node in this one."""

import itertools
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from node_processes import Graph, client, command, words  # noqa: F401  # tests find all here
from preloaded import Forked

# Domains up to 101 have ports outside the ephemeral range; processes of one test run take turns, so
# that no two graphs meet, nor one with what is left of an earlier one.
_WORKERS = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
_WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
_START = _WORKER + (os.getppid() if _WORKERS > 1 else os.getpid())
next_domain = partial(next, (1 + (_START + _WORKERS * k) % 100 for k in itertools.count()))
"""A ROS domain that no other running graph of this process has."""


def lpv(*arguments, timeout=2000):
    """Run the command as users do; it has to succeed, and its output is returned."""
    pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')
    line = [Path(sys.executable).parent / 'lpv', *map(str, arguments)]
    given = {**os.environ, 'ROS_DOMAIN_ID': str(next_domain()), 'COLUMNS': '120'}
    done = subprocess.run(line, env=given, text=True, capture_output=True, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def change_state(asker, name, transition):
    """Whether a managed node makes a transition."""
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    asked = Transition(id=transition)
    return asker.call(ChangeState, f'{name}/change_state', transition=asked).success


def end(running):
    codes = running.stop()
    assert codes and set(codes.values()) == {0}, codes


class _Graph(Graph):
    def _process(self, line):
        if Path(line[0]).is_absolute():  # a node, and no shell that starts one
            return Forked(line, self._environment)
        return super()._process(line)


def graph(log_dir, domain=None):
    return _Graph(log_dir, next_domain() if domain is None else domain)
