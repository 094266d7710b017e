"""Messages of a lockstep run are stored in an order that does not depend on their arrival."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv_node.recorder.stamp_sorter import PATIENCE, WINDOW, StampSorter

STEP = 2_000_000
TOPICS = ('/lpv/joint_states', '/lpv/state_estimate', '/lpv/torque_command')


def stored(arrivals):
    """What is written, in order."""
    written = []
    sorter = StampSorter(lambda *message: written.append(message))
    for message in arrivals:
        sorter.add(*message)
    sorter.flush()
    return written


@pytest.mark.parametrize('seed', range(5))
def test_given_senders_that_are_heard_late_when_sorted_then_the_order_is_the_same(seed):
    rng, arrivals = random.Random(seed), []
    for second in range(10):  # one sender is a second ahead of another
        for topic in rng.sample(TOPICS, len(TOPICS)):
            arrivals += [(topic, (500 * second + k) * STEP, b'') for k in range(500)]
    assert stored(arrivals) == sorted(arrivals, key=lambda message: (message[1], message[0]))


def test_given_reports_of_one_stamp_when_heard_in_any_order_then_they_are_stored_in_one():
    reports = [('/diagnostics', STEP, b'drives'), ('/diagnostics', STEP, b'tracking')]
    assert stored(reports) == stored(reports[::-1]) == reports


def test_given_reports_of_several_senders_when_one_is_heard_late_then_the_order_is_that_of_stamps():
    steps = [('/lpv/joint_states', k * STEP, b'', 1) for k in range(10000)]
    reports = [
        ('/diagnostics', 500 * k * STEP, name, name)
        for k in range(20)
        for name in (b'drives', b'tracking')
    ]
    late = [report for report in reports if report[2] == b'tracking' and report[1] >= 2500 * STEP]
    sent = sorted([*steps, *reports], key=lambda message: message[1])
    # From the fifth second on the tracker is heard three seconds late.
    heard = sorted(sent, key=lambda message: message[1] + 1500 * STEP * (message in late))
    written = [(stamp, topic) for topic, stamp, _ in stored(heard)]
    assert written == sorted(written) and len(written) == len(sent)


def test_given_a_topic_that_ends_when_others_go_on_then_they_are_not_held_back_for_ever():
    written = []
    sorter = StampSorter(lambda *message: written.append(message))
    sorter.add('/lpv/reference', 0, b'')
    for k in range(PATIENCE // STEP + 1000):
        sorter.add('/lpv/joint_states', k * STEP, b'')
    assert len(written) > 500


STAMPS = st.integers(0, 6) | st.integers(0, 5 * WINDOW)
ENTRIES = st.lists(
    st.tuples(STAMPS, st.sampled_from(['/a', '/b', '/c']), st.integers(0, WINDOW)),
    max_size=30,
    unique_by=lambda entry: entry[:2],
)


@given(ENTRIES)
def test_given_delays_within_the_window_when_ordered_then_the_output_does_not_depend_on_them(
    entries,
):
    arrivals = sorted(entries, key=lambda entry: entry[0] + entry[2])
    found = stored([(topic, stamp, (stamp, topic)) for stamp, topic, _ in arrivals])
    assert found == [
        (topic, stamp, (stamp, topic))
        for stamp, topic, _ in sorted(entries, key=lambda entry: entry[:2])
    ]


@given(st.lists(st.tuples(STAMPS, st.sampled_from(['/a', '/b'])), max_size=40))
def test_given_any_arrivals_when_ordered_then_nothing_is_lost_and_equal_ones_keep_their_order(
    arrivals,
):
    entries = [(topic, stamp, k) for k, (stamp, topic) in enumerate(arrivals)]
    found = stored(entries)
    assert sorted(k for _, _, k in found) == list(range(len(entries)))
    for stamp, topic in set(arrivals):
        numbers = [k for t, s, k in found if (t, s) == (topic, stamp)]
        assert numbers == sorted(numbers)


def test_given_a_long_run_when_ordered_then_messages_are_released_while_it_lasts():
    released = []
    order = StampSorter(lambda *entry: released.append(entry))
    for k in range(6000):
        order.add('/a', k * STEP, k)
    assert [k for _, _, k in released] == list(range(5749))  # older than the window of 0.5 s
    order.flush()
    assert [k for _, _, k in released] == list(range(6000))
