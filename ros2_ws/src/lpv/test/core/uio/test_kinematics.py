"""Forward, inverse and differential kinematics."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lpv.core.support.errors import UnreachableError
from lpv.core.uio.model.kinematics import forward, inverse, jacobian, joint_motion

LENGTH = st.floats(0.1, 3.0)
Q_1 = st.floats(-3.0, 3.0)
BEND = st.floats(0.05, math.pi - 0.05)
BEARING = st.floats(-math.pi, math.pi)
ELBOW = st.sampled_from(['positive', 'negative'])


def wrapped(angle):
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


@given(Q_1, BEND, ELBOW, LENGTH, LENGTH)
def test_given_a_configuration_when_solved_from_its_tip_then_it_comes_back_on_its_branch(
    q_1, bend, elbow, l_1, l_2
):
    # A tip in the base itself leaves q1 free: equal lengths, folded.
    assume(abs(l_1 - l_2) > 1e-3 or bend < 3.0)
    q = np.array([q_1, bend if elbow == 'positive' else -bend])
    back = inverse(forward(q, (l_1, l_2)), (l_1, l_2), elbow)
    # arccos loses digits near the border of reach, and the bearing near the base.
    np.testing.assert_allclose(wrapped(back - q), 0.0, atol=1e-9)


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


@given(Q_1, st.floats(-3.1, 3.1), LENGTH, LENGTH)
def test_given_a_configuration_when_perturbed_then_the_tip_moves_as_the_jacobian_says(
    q_1, q_2, l_1, l_2
):
    q, h, lengths = np.array([q_1, q_2]), 1e-6, (l_1, l_2)
    columns = [
        (forward(q + h * e, lengths) - forward(q - h * e, lengths)) / (2 * h) for e in np.eye(2)
    ]
    np.testing.assert_allclose(jacobian(q, lengths), np.column_stack(columns), atol=1e-8)


def test_given_a_moving_configuration_when_its_tip_motion_is_inverted_then_rates_come_back():
    lengths, times, h = (1.0, 0.8), np.linspace(0.0, 2.0, 21), 1e-4
    size, pace = np.array([0.8, 0.5]), np.array([1.3, 0.9])
    phase = pace * times[:, None] + [0.0, math.pi / 2]

    def tip(step):
        return forward([0.4, 1.2] + size * np.sin(phase + pace * step), lengths)

    velocity = (tip(h) - tip(-h)) / (2 * h)
    curvature = (tip(h) - 2 * tip(0.0) + tip(-h)) / h**2
    q = [0.4, 1.2] + size * np.sin(phase)
    rate, acceleration = joint_motion(q, velocity, curvature, lengths)
    np.testing.assert_allclose(rate, size * pace * np.cos(phase), atol=1e-7)
    np.testing.assert_allclose(acceleration, -size * pace**2 * np.sin(phase), atol=1e-6)


def test_given_a_singular_configuration_when_rates_are_asked_then_they_are_refused():
    ones, lengths = np.ones(2), (1.0, 1.0)
    for q_2 in (0.0, 5e-4, math.pi, -math.pi):
        with pytest.raises(UnreachableError, match='singularity'):
            joint_motion(np.array([0.3, q_2]), ones, ones, lengths)
    rate, _ = joint_motion(np.array([0.3, math.nan]), ones, ones, lengths)
    assert np.isnan(rate).all()  # NaN stays NaN, never a number
