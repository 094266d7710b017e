"""Signals as exceptions, also where Python cannot raise."""

import signal
import sys
import time

import pytest

from lpv.core.support.signals import raising_signals


class Dropped:
    """Something whose destructor a signal falls into."""

    def __init__(self, number):
        self.number = number

    def __del__(self):
        signal.raise_signal(self.number)
        raise AssertionError('the handler has not raised')


def wait():
    deadline = time.monotonic() + 5.0
    while time.monotonic() < deadline:
        time.sleep(0.01)
    return 'waited'


@pytest.mark.parametrize(
    ('number', 'expected'), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)]
)
@pytest.mark.parametrize('lost', [False, True])
def test_given_a_wait_when_a_signal_comes_then_it_ends_even_from_a_destructor(
    number, expected, lost
):
    def state():
        return sys.unraisablehook, signal.getsignal(number), signal.getsignal(signal.SIGALRM)

    before = state()
    with raising_signals() as received, pytest.raises(expected) as raised:
        if lost:
            Dropped(number)
            assert received == [number]
            wait()
        else:
            signal.raise_signal(number)
    assert received == [number] and before == state()
    assert expected is KeyboardInterrupt or raised.value.code == 128 + number


def test_given_the_end_of_a_command_when_a_signal_was_lost_then_none_comes_later():
    with raising_signals():
        Dropped(signal.SIGINT)
    time.sleep(0.1)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_given_another_exception_in_a_destructor_when_reported_then_as_without_a_command(
    monkeypatch,
):
    class Broken:
        def __del__(self):
            raise ValueError('broken')

    reported = []
    monkeypatch.setattr(sys, 'unraisablehook', lambda it: reported.append(it.exc_type))
    with raising_signals() as received:
        Broken()
        assert received == []
    assert reported == [ValueError]
