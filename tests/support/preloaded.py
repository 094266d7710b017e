"""Nodes as processes that are forked from one that has read their modules.

To read a thousand modules takes a node longer than all else until it runs.
"""

import multiprocessing
import os
import runpy
import subprocess
import sys

_forks = multiprocessing.get_context('forkserver')
_forks.set_forkserver_preload([
    'lpv_arm_sim.node', 'lpv_node.recorder.node', 'lpv_tracker.node', 'lpv_uio.node',
    'scipy.interpolate',
])  # fmt: skip


class Forked:
    """What `subprocess.Popen` is of a Python program that leads a session, its output in a pipe."""

    def __init__(self, words, environment):
        read, write = _forks.Pipe(duplex=False)
        given = write, words, environment, os.getcwd()
        self._process = _forks.Process(target=_run, args=given)
        with read, write:
            self._process.start()
            self.stdout = open(os.dup(read.fileno()), encoding='utf-8', errors='replace')  # noqa: SIM115
        self.pid = self._process.pid

    def poll(self):
        return self._process.exitcode

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout)
        return self.poll()


def _run(output, words, environment, folder):
    os.setsid()
    with output:
        for number in (1, 2):
            os.dup2(output.fileno(), number)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = words
    runpy.run_path(words[0], run_name='__main__')
