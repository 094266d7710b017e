"""Forward and inverse kinematics; rates and accelerations are those of `test_path`."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv.core.support.errors import UnreachableError
from lpv.core.uio.model.kinematics import forward, inverse, joint_motion

LENGTH = st.floats(0.1, 3.0)
BEARING = st.floats(-math.pi, math.pi)
ELBOW = st.sampled_from(['positive', 'negative'])


@given(st.floats(0.001, 0.999) | st.sampled_from([0.0, 1.0]), BEARING, ELBOW, LENGTH, LENGTH)
def test_given_a_reachable_point_or_one_on_the_border_when_solved_then_the_tip_is_there(
    share, bearing, elbow, l_1, l_2
):
    radius = abs(l_1 - l_2) + share * (l_1 + l_2 - abs(l_1 - l_2))
    point = radius * np.array([math.cos(bearing), math.sin(bearing)])
    q = inverse(point, (l_1, l_2), elbow)
    np.testing.assert_allclose(forward(q, (l_1, l_2)), point, atol=1e-12)
    assert q[1] >= 0.0 if elbow == 'positive' else q[1] <= 0.0


@pytest.mark.parametrize(
    'point', [(2.001, 0.0), (0.1, 0.1), (math.nan, 1.0), (0.5, math.inf), (1e308, 1e308)]
)
def test_given_a_point_out_of_reach_when_solved_then_the_error_says_where_and_why(point):
    with pytest.raises(UnreachableError, match=r'out of reach.*\[0.4, 2\] m'):
        inverse(point, (1.2, 0.8))


def test_given_a_batch_when_solved_then_every_point_alone_and_a_bad_one_is_named():
    batch = np.random.default_rng(3).uniform(0.2, 1.0, (4, 5, 2))
    rows = np.array([[inverse(point, (1.0, 0.9)) for point in row] for row in batch])
    np.testing.assert_array_equal(inverse(batch, (1.0, 0.9)), rows)
    batch[1, 2] = 7.5, 0.25
    for bad in (batch, batch[1]):
        with pytest.raises(UnreachableError, match=r'\(7.5, 0.25\)'):
            inverse(bad, (1.0, 0.9))


def test_given_a_singular_configuration_when_rates_are_asked_then_they_are_refused():
    ones, lengths = np.ones(2), (1.0, 1.0)
    for q_2 in (0.0, 5e-4, math.pi, -math.pi):
        with pytest.raises(UnreachableError, match='singularity'):
            joint_motion(np.array([0.3, q_2]), ones, ones, lengths)
    rate, _ = joint_motion(np.array([0.3, math.nan]), ones, ones, lengths)
    assert np.isnan(rate).all()  # NaN stays NaN, never a number
