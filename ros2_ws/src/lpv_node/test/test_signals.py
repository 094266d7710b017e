import signal
import subprocess
import sys
import time
from functools import partial

import pytest

from lpv.core.support.signals import STOPS, StopRequest, handled_signals, raising_signals


class Dropped(partial):
    """Something whose destructor does more than it should."""

    def __del__(self):
        self()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('lost', [False, True])
def test_given_a_wait_when_a_signal_comes_then_it_ends_even_in_a_destructor(number, lost):
    def state():
        return sys.unraisablehook, signal.getsignal(number), signal.getsignal(signal.SIGALRM)

    before, expected = state(), KeyboardInterrupt if number == signal.SIGINT else SystemExit
    with raising_signals() as received, pytest.raises(expected) as raised:
        if lost:
            Dropped(signal.raise_signal, number)
            assert received == [number]
            for _ in range(500):
                time.sleep(0.01)
        else:
            signal.raise_signal(number)
    assert received == [number] and before == state()
    assert expected is KeyboardInterrupt or raised.value.code == 128 + number


def test_given_the_end_of_a_command_when_a_signal_was_lost_then_none_comes_later(monkeypatch):
    reported = []
    monkeypatch.setattr(sys, 'unraisablehook', lambda it: reported.append(it.exc_type))
    with raising_signals() as received:
        Dropped(int, 'no number')
        assert (received, reported) == ([], [ValueError]), 'other exceptions are reported'
        Dropped(signal.raise_signal, signal.SIGINT)
    time.sleep(0.1)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_given_a_start_when_told_to_stop_then_it_ends_at_once_and_later_in_order():
    with handled_signals(lambda *_: None, *STOPS):
        StopRequest()
        pytest.raises(SystemExit, signal.raise_signal, signal.SIGTERM)
        stop = StopRequest()
        stop.defer()
        signal.raise_signal(signal.SIGTERM)
        assert stop.is_set


START = """
import signal, sys, types; signal.signal(signal.SIGHUP, signal.SIG_DFL)
run = types.SimpleNamespace(run_node=lambda node: node())
sys.modules['lpv_node.managed'] = run  # a node is a function here
from lpv_node.start import start
start(sys.argv[1], 'main')
"""
TELL = 'import os, signal, time\ndef tell(): os.kill(os.getpid(), signal.{}); time.sleep(0.05)\n'
SLOW = 'tell(); tell()\ndef main(): print("started")'
SWALLOWS = 'try: tell()\nexcept BaseException: pass\ndef main(): print("started")'
TOLD_AT_EXIT = 'import atexit\natexit.register(tell)\ndef main(): raise SystemExit(3)'
FAILS = 'def main(): raise ValueError("what failed")'


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
@pytest.mark.parametrize(('source', 'code', 'told'), [
    (SLOW, 0, ''), (SWALLOWS, 0, ''), (TOLD_AT_EXIT, 3, ''), (FAILS, 1, 'what failed'),
], ids=['imports', 'an import that swallows it', 'its end', 'a node that fails'])  # fmt: skip
def test_given_a_node_when_told_to_stop_then_it_leaves_quietly(tmp_path, source, code, told, name):
    (tmp_path / 'some_node.py').write_text(TELL.format(name) + source)
    line = [sys.executable, '-c', START, 'some_node']
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    said = done.stdout + done.stderr
    assert done.returncode == code and (told in said if told else said == ''), said
