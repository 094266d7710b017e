"""Commands of our ros2: as processes, or in this process on a graph that is known."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROS2 = Path(sys.prefix) / 'bin' / 'ros2'


class Running:
    """A ros2 command as a process that prints lines and is interrupted in the end."""

    def __init__(self, *words, **options):
        self.lines = []
        self.process = subprocess.Popen(
            [str(ROS2), *map(str, words)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            **options,
        )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:  # a test has failed
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.communicate()

    def until(self, pattern, timeout=300.0):
        """Read lines until one matches; all lines so far as one text."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            line = self.process.stdout.readline()
            if not line:
                break
            self.lines.append(line)
            if re.search(pattern, line):
                return ''.join(self.lines)
        raise AssertionError(f'no {pattern!r} in:\n{"".join(self.lines)}')

    def interrupt(self, timeout=300.0):
        """Send SIGINT to the command alone; its exit code and all it printed."""
        self.process.send_signal(signal.SIGINT)
        rest, _ = self.process.communicate(timeout=timeout)
        return self.process.returncode, ''.join(self.lines) + rest


@contextlib.contextmanager
def known_graph():
    """Commands in this process share a participant: each would need up to 3 s to find the graph."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from lpv_ros2cli.graph import discovery

    @contextlib.contextmanager
    def command_node(name=None):
        node = rclpy.create_node(
            name or '_ros2cli_test', start_parameter_services=False, enable_rosout=False
        )
        yield node
        node.destroy_node()

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(discovery, 'command_node', command_node)
        keeper = rclpy.create_node('_keeper')
        discovery.settle(keeper)
        yield
        keeper.destroy_node()
    rclpy.shutdown()
