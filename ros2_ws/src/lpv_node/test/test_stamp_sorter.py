from hypothesis import example, given, settings
from hypothesis import strategies as st

from lpv_node.recorder.stamp_sorter import PATIENCE, WINDOW, StampSorter

STEP = 2_000_000


def stored(arrivals):
    written = []
    sorter = StampSorter(lambda *message: written.append(message))
    for message in arrivals:
        sorter.add(*message)
    sorter.flush()
    return written


def in_order(messages):
    """By stamp, then topic; those that agree in both stay as they came."""
    return sorted(messages, key=lambda message: (message[1], message[0]))


SENDERS = (('/diagnostics', b'drives'), ('/diagnostics', b'tracking'), ('/lpv/joint_states', b''))
LATE = st.tuples(st.integers(0, 2 * PATIENCE), st.integers(0, PATIENCE - WINDOW))
"""From when on one of them is heard late, and by how much; it is waited for."""


@settings(max_examples=50)
@given(st.tuples(LATE, LATE, LATE))
@example(((0, 0), (5 * WINDOW, 3 * WINDOW), (0, 2 * WINDOW)))
def test_given_senders_that_are_heard_late_when_sorted_then_the_order_is_that_of_stamps(late):
    heard = []
    for (topic, data), (since, delay) in zip(SENDERS, late):
        for stamp in range(0, 3 * PATIENCE, WINDOW // 5):
            heard.append((stamp + delay * (stamp >= since), topic, stamp, data, data))
    arrivals = [message for _, *message in sorted(heard)]
    in_every_run = sorted((stamp, topic, data) for topic, stamp, data, _ in arrivals)
    assert [(stamp, topic, data) for topic, stamp, data in stored(arrivals)] == in_every_run


STAMPS = st.integers(0, 6) | st.integers(0, 5 * WINDOW) | st.integers(0, 5 * PATIENCE)
SENT = st.tuples(STAMPS, st.sampled_from(['/a', '/b', '/c']), st.integers(0, WINDOW))


@given(st.lists(SENT, max_size=40))
def test_given_short_delays_or_a_short_run_when_sorted_then_nothing_is_lost_or_out_of_order(sent):
    heard = sorted(sent, key=lambda message: message[0] + message[2])
    # Numbers fall: messages of one stamp and topic stay as they came, whatever is in them.
    delayed = [(topic, stamp, -k) for k, (stamp, topic, _) in enumerate(heard)]
    assert stored(delayed) == in_order(delayed)
    in_any_order = [(topic, stamp % PATIENCE, -k) for k, (stamp, topic, _) in enumerate(sent)]
    assert stored(in_any_order) == in_order(in_any_order)


def test_given_a_topic_that_ends_when_others_go_on_then_messages_are_released_while_they_last():
    released = []
    sorter = StampSorter(lambda *message: released.append(message))
    steps = [('/lpv/joint_states', k * STEP, k) for k in range(6000)]
    for message in [('/lpv/reference', 0, -1), *steps]:
        sorter.add(*message)
    assert [k for _, _, k in released] == [0, -1, *range(1, 5749)]  # older than the window of 0.5 s
    sorter.flush()
    assert released[2:] == steps[1:]
    # A first message of another clock does not hold the others back.
    sorter, count = StampSorter(lambda *message: released.append(message)), len(released)
    for message in [('/diagnostics', 1_700_000_000 * 10**9, -1), *steps]:
        sorter.add(*message)
    assert len(released) > count + 5500
