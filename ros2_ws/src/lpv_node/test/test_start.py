"""Signals while a node's process starts and ends."""

import subprocess
import sys

import pytest

START = """
import sys, types
run = types.SimpleNamespace(run_node=lambda node, argv: node(argv))
sys.modules['lpv_node.managed'] = run  # a node is a function here
from lpv_node.start import start
start(sys.argv[1], 'main')
"""
TELL = 'import os, signal, time\ndef tell(): os.kill(os.getpid(), signal.{}); time.sleep(0.05)\n'


@pytest.fixture
def leave(tmp_path):
    """Exit code and output of a process that starts a node of some source."""

    def run(source: str, name: str = 'SIGINT') -> tuple[int, str]:
        (tmp_path / 'some_node.py').write_text(TELL.format(name) + source)
        line = [sys.executable, '-c', START, 'some_node']
        done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=600)
        return done.returncode, done.stdout + done.stderr

    return run


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_given_imports_that_last_when_told_to_stop_then_the_process_leaves_quietly(leave, name):
    assert leave('tell(); tell()\ndef main(argv): print("started")', name) == (0, '')


def test_given_an_import_that_swallows_it_when_told_to_stop_then_the_node_does_not_start(leave):
    swallowed = 'try: tell()\nexcept BaseException: pass\ndef main(argv): print("started")'
    assert leave(swallowed) == (0, '')


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_given_a_node_that_ended_when_told_to_stop_again_then_its_exit_code_stays(leave, name):
    source = 'import atexit\natexit.register(tell)\ndef main(argv): raise SystemExit(3)'
    assert leave(source, name) == (3, '')


def test_given_a_node_that_fails_when_it_ends_then_its_error_is_shown(leave):
    code, said = leave('def main(argv): raise ValueError("what failed")')
    assert code == 1 and 'what failed' in said
