from dataclasses import astuple

import numpy as np
import pytest

from lpv.core.control.path_follower import PathFollower
from lpv_tracker.upcoming import UpcomingReferences

STEP = 2_000_000


def steps(count, *changes):
    """Stamps of samples; (k, n) in ``changes`` leaves n samples out after the k-th."""
    intervals = np.full(count, STEP)
    for k, left_out in changes:
        intervals[k] += left_out * STEP
    return (5 * STEP + np.cumsum(intervals)).tolist()


@pytest.mark.parametrize(('stamps', 'stops'), [
    (steps(700), ()), (steps(700), (150, 151, 400)),
    (steps(700, (90, 1), (91, 3), (300, 200)), (500,)),
    ([s + 137 * (k % 3) for k, s in enumerate(steps(300))], ()),
], ids=['even', 'stops', 'gaps', 'jitter'])  # fmt: skip
@pytest.mark.parametrize('away', [0.0, 0.3])
def test_given_stamps_when_ahead_then_as_one_by_one(paper_arm, two_faults, stamps, stops, away):
    path = two_faults.path(paper_arm)
    alone = PathFollower(path)
    ahead = UpcomingReferences(PathFollower(path), STEP, 2, 3)
    position, found, wanted = path.sample(0.0).position + away, [], []
    for k, stamp in enumerate(stamps):
        if k in stops:
            alone.stop()
            ahead.stop()
        expected = alone.reference(stamp, position)
        ahead.advance(stamp, position)
        found.append(np.hstack(astuple(ahead.reference)))
        wanted.append(np.hstack(astuple(expected)))
        position = expected.position + away * (k in stops)
    np.testing.assert_array_equal(found, wanted)
    ahead.reset()
    ahead.advance(stamps[0], path.sample(0.0).position)
    np.testing.assert_array_equal(ahead.reference.position, path.sample(0.0).position)
