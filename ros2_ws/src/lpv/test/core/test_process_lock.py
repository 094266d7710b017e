"""What another process does is waited for, but not for ever."""

import signal
import subprocess
import sys

import pytest

from lpv.core.support import process_lock
from lpv.core.support.process_lock import ProcessLock

HOLD = """
import sys, time
from pathlib import Path
from lpv.core.support.process_lock import ProcessLock
with ProcessLock(Path(sys.argv[1])).held('one'):
    print('held', flush=True)
    time.sleep(600)
"""


@pytest.fixture
def other(tmp_path):
    """A process that holds the lock named one."""
    command = [sys.executable, '-c', HOLD, str(tmp_path / 'locks')]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == 'held\n'
        yield process
        process.kill()


def test_given_a_process_that_holds_a_name_then_others_wait_until_it_ends(tmp_path, other):
    lock = ProcessLock(tmp_path / 'locks')
    pauses = []

    def pause(seconds):  # it is seen to wait, then the other process dies
        pauses.append(seconds)
        if len(pauses) == 3:
            other.send_signal(signal.SIGKILL)
            other.wait()

    with pytest.MonkeyPatch.context() as patch, lock.held('another name'):
        patch.setattr(process_lock.time, 'sleep', pause)
        with lock.held('one'), lock.held('one'):  # twice by the same process
            pass
    assert len(pauses) == 3


def test_given_a_process_that_never_goes_on_when_waited_for_then_not_for_ever(
    tmp_path, other, monkeypatch
):
    monkeypatch.setattr(process_lock, '_PATIENCE', 0.05)
    with ProcessLock(tmp_path / 'locks').held('one'):
        assert other.poll() is None


@pytest.mark.parametrize('error', [FileNotFoundError, PermissionError])
def test_given_no_place_for_locks_then_nobody_waits(tmp_path, monkeypatch, error):
    def fail(*_):
        raise error

    monkeypatch.setattr(process_lock.os, 'open', fail)
    monkeypatch.setattr(process_lock.time, 'sleep', lambda _: pytest.fail('it waits'))
    with ProcessLock(tmp_path / 'locks').held('one'):
        pass
