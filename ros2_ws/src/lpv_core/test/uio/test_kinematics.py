"""Forward, inverse and differential kinematics."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lpv_core.support.errors import UnreachableError
from lpv_core.uio.model.kinematics import forward, inverse, jacobian, joint_motion

LENGTH = st.floats(0.1, 3.0)
Q_1 = st.floats(-3.0, 3.0)
BEND = st.floats(0.05, math.pi - 0.05)


def wrapped(angle):
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


# ------------------------------------------------------------------ positions


@given(Q_1, BEND, st.sampled_from(['positive', 'negative']), LENGTH, LENGTH)
def test_given_a_configuration_when_solved_from_its_tip_then_it_comes_back_on_its_branch(
    q_1, bend, elbow, l_1, l_2
):
    # A tip in the base itself leaves q1 free: equal lengths, folded.
    assume(abs(l_1 - l_2) > 1e-3 or bend < 3.0)
    q = np.array([q_1, bend if elbow == 'positive' else -bend])
    back = inverse(forward(q, (l_1, l_2)), (l_1, l_2), elbow)
    # arccos loses digits near the border of reach, and the bearing near the base.
    np.testing.assert_allclose(wrapped(back - q), 0.0, atol=1e-9)


@given(
    st.floats(0.001, 0.999),
    st.floats(-math.pi, math.pi),
    st.sampled_from(['positive', 'negative']),
    LENGTH,
    LENGTH,
)
def test_given_a_reachable_point_when_solved_then_the_tip_is_there(share, bearing, elbow, l_1, l_2):
    radius = abs(l_1 - l_2) + share * (l_1 + l_2 - abs(l_1 - l_2))
    point = radius * np.array([math.cos(bearing), math.sin(bearing)])
    q = inverse(point, (l_1, l_2), elbow)
    np.testing.assert_allclose(forward(q, (l_1, l_2)), point, atol=1e-12)
    assert q[1] >= 0.0 if elbow == 'positive' else q[1] <= 0.0


def test_given_eqs_32_to_34_when_written_out_then_the_positive_branch_is_theirs():
    x, y, l_1, l_2 = 0.9, 0.7, 1.0, 0.8
    q_2 = math.acos((x**2 + y**2 - l_1**2 - l_2**2) / (2 * l_1 * l_2))
    q_1 = math.atan(y / x) - math.atan(l_2 * math.sin(q_2) / (l_1 + l_2 * math.cos(q_2)))
    np.testing.assert_allclose(inverse((x, y), (l_1, l_2)), [q_1, q_2], rtol=1e-14)


def test_given_a_point_in_the_left_half_plane_when_solved_then_the_quadrant_is_kept():
    point = np.array([-0.9, 0.7])
    np.testing.assert_allclose(forward(inverse(point, (1.0, 1.0)), (1.0, 1.0)), point, atol=1e-14)


@pytest.mark.parametrize(
    'point',
    [(2.0, 0.0), (0.0, -2.0), (2.0 * math.cos(1), 2.0 * math.sin(1)), (0.4, 0.0), (0.0, 0.4)],
)
def test_given_a_point_on_the_border_when_solved_then_rounding_does_not_refuse_it(point):
    lengths = (1.2, 0.8)
    q = inverse(point, lengths)
    np.testing.assert_allclose(forward(q, lengths), point, atol=1e-12)


@given(LENGTH, LENGTH, st.floats(-math.pi, math.pi), st.booleans())
def test_given_any_bearing_on_the_border_when_solved_then_rounding_does_not_refuse_it(
    l_1, l_2, bearing, outer
):
    radius = l_1 + l_2 if outer else abs(l_1 - l_2)
    point = radius * np.array([math.cos(bearing), math.sin(bearing)])
    np.testing.assert_allclose(forward(inverse(point, (l_1, l_2)), (l_1, l_2)), point, atol=1e-12)


@pytest.mark.parametrize(
    'point', [(2.001, 0.0), (0.1, 0.1), (math.nan, 1.0), (0.5, math.inf), (1e308, 1e308)]
)
def test_given_a_point_out_of_reach_when_solved_then_the_error_says_where_and_why(point):
    with pytest.raises(UnreachableError, match=r'out of reach.*\[0.4, 2\] m'):
        inverse(point, (1.2, 0.8))


def test_given_a_batch_with_one_bad_point_when_solved_then_the_error_names_that_point():
    batch = np.array([[1.0, 1.0], [0.5, 0.5], [7.5, 0.25]])
    with pytest.raises(UnreachableError, match=r'\(7.5, 0.25\)'):
        inverse(batch, (1.0, 1.0))


def test_given_a_batch_with_two_axes_when_a_point_is_bad_then_it_is_unreachable_too():
    batch = np.full((2, 3, 2), 0.5)
    batch[1, 2] = 9.0
    with pytest.raises(UnreachableError, match=r'\(9, 9\)'):
        inverse(batch, (1.0, 1.0))


def test_given_a_batch_when_solved_then_every_point_is_solved_alone():
    batch = np.random.default_rng(3).uniform(0.2, 1.0, (4, 5, 2))
    rows = np.array([[inverse(point, (1.0, 0.9)) for point in row] for row in batch])
    np.testing.assert_array_equal(inverse(batch, (1.0, 0.9)), rows)


# ------------------------------------------------------------------ rates


@given(Q_1, st.floats(-3.1, 3.1), LENGTH, LENGTH)
def test_given_a_configuration_when_perturbed_then_the_tip_moves_as_the_jacobian_says(
    q_1, q_2, l_1, l_2
):
    q, h = np.array([q_1, q_2]), 1e-6
    columns = [
        (forward(q + h * e, (l_1, l_2)) - forward(q - h * e, (l_1, l_2))) / (2 * h)
        for e in np.eye(2)
    ]
    np.testing.assert_allclose(jacobian(q, (l_1, l_2)), np.column_stack(columns), atol=1e-8)


def test_given_a_moving_configuration_when_its_tip_motion_is_inverted_then_rates_come_back():
    lengths, times, h = (1.0, 0.8), np.linspace(0.0, 2.0, 21), 1e-4

    def q(t):
        return np.stack([0.4 + 0.8 * np.sin(1.3 * t), 1.2 + 0.5 * np.cos(0.9 * t)], axis=-1)

    def tip(t):
        return forward(q(t), lengths)

    velocity = (tip(times + h) - tip(times - h)) / (2 * h)
    curvature = (tip(times + h) - 2 * tip(times) + tip(times - h)) / h**2
    rate, acceleration = joint_motion(q(times), velocity, curvature, lengths)
    expected_rate = np.stack(
        [0.8 * 1.3 * np.cos(1.3 * times), -0.5 * 0.9 * np.sin(0.9 * times)], axis=-1
    )
    expected = np.stack(
        [-0.8 * 1.3**2 * np.sin(1.3 * times), -0.5 * 0.9**2 * np.cos(0.9 * times)], axis=-1
    )
    np.testing.assert_allclose(rate, expected_rate, atol=1e-7)
    np.testing.assert_allclose(acceleration, expected, atol=1e-6)


@pytest.mark.parametrize('q_2', [0.0, 5e-4, math.pi, -math.pi, math.nan])
def test_given_a_singular_configuration_when_rates_are_asked_then_they_are_refused(q_2):
    if math.isnan(q_2):
        rate, _ = joint_motion(np.array([0.3, q_2]), np.ones(2), np.ones(2), (1.0, 1.0))
        assert np.isnan(rate).all()  # NaN stays NaN, never a number
        return
    with pytest.raises(UnreachableError, match='singularity'):
        joint_motion(np.array([0.3, q_2]), np.ones(2), np.ones(2), (1.0, 1.0))
