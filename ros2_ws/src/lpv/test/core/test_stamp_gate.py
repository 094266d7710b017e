"""The gate for stamps: single foreign ones are refused, a clock that is set is followed."""

import pytest

from lpv.core.monitoring.stamp_gate import CONFIRMATIONS, JUMP, StampGate

STEP = 2_000_000
START = 1_700_000_000 * 10**9
FUTURE = 2**31 * 10**9 - 1


@pytest.mark.parametrize('odd', [0, -1, FUTURE])
def test_given_odd_stamps_in_a_stream_when_asked_then_they_alone_are_refused(odd):
    gate = StampGate()
    for k in range(200):
        assert gate.accept(START + k * STEP) and gate.shift == 0
        assert not gate.accept(odd + (k % 2) * 5 * JUMP)


@pytest.mark.parametrize('new', [10**9, START + 2 * JUMP, FUTURE])
def test_given_a_clock_that_is_set_when_asked_then_the_third_stamp_is_believed(new):
    gate = StampGate()
    assert gate.accept(START)
    found = [(gate.accept(new + k * STEP), gate.shift) for k in range(5)]
    assert [one for one, _ in found] == [k + 1 >= CONFIRMATIONS for k in range(5)]
    assert [shift for _, shift in found] == [0, 0, new + 2 * STEP - START, 0, 0]


def test_given_repeated_and_late_stamps_when_asked_then_the_newest_counts_and_an_odd_one_never():
    gate = StampGate()
    assert all(gate.accept(stamp) for stamp in (START, START, START - JUMP, START + JUMP))
    assert gate.last == START + JUMP and not gate.accept(START - JUMP)
    gate = StampGate()
    gate.accept(START)
    assert not any(gate.accept(FUTURE) for _ in range(10))
