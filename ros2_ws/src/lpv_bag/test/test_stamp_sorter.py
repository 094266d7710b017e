"""Messages of a lockstep run are stored in an order that does not depend on their arrival."""

import random

import pytest

from lpv_bag.recorder.stamp_sorter import PATIENCE, StampSorter

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


def test_given_events_of_one_sender_and_stamp_when_sorted_then_they_stay_in_their_order():
    events = [('/lpv/fault_alarm', STEP, b'b'), ('/lpv/fault_alarm', STEP, b'a')]
    assert stored(events) == events


def test_given_a_topic_that_ends_when_others_go_on_then_they_are_not_held_back_for_ever():
    written = []
    sorter = StampSorter(lambda *message: written.append(message))
    sorter.add('/lpv/reference', 0, b'')
    for k in range(PATIENCE // STEP + 1000):
        sorter.add('/lpv/joint_states', k * STEP, b'')
    assert len(written) > 500
