"""Paths of a planar arm through points in its plane."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lpv_core.control.path import CartesianPath, Obstacle, PlanarWaypoints
from lpv_core.support.errors import ConfigError, UnreachableError
from lpv_core.uio.model.joints import JointMap
from lpv_core.uio.model.kinematics import forward
from lpv_core.uio.planar import serial_from_planar

TIMES = (0.5, 2.0, 4.0)
POINTS = ((-0.6, 1.5), (0.0, 1.6), (0.7, 1.4))


def planar(arm, times=TIMES, points=POINTS, elbow='positive', obstacle=None):
    return CartesianPath(arm, times, PlanarWaypoints(points, elbow, obstacle))


def wrapped(angle):
    return (np.asarray(angle) + math.pi) % (2 * math.pi) - math.pi


def in_plane(tip):
    """Forward and up of points in the base frame; the arm's plane is that of x and z."""
    np.testing.assert_array_equal(tip[..., 1], 0.0)
    return tip[..., [0, 2]]


@pytest.fixture
def path(paper_arm):
    return planar(paper_arm)


def test_given_waypoints_when_sampled_at_their_times_then_the_tip_is_there(
    path, paper_arm, paper_model
):
    reference = path.sample(np.array(TIMES))
    np.testing.assert_allclose(in_plane(reference.tip), POINTS, atol=1e-12)
    # Reference in ROS joints: absolute angles, then the tip by plain trigonometry.
    theta = JointMap(paper_model).absolute_position(reference.position)
    tip = np.stack([-np.sin(theta).sum(axis=-1), np.cos(theta).sum(axis=-1)], axis=-1)
    np.testing.assert_allclose(tip, POINTS, atol=1e-12)


def test_given_an_arm_with_another_zero_when_sampled_then_the_tip_is_the_same(
    paper_arm, paper_model
):
    other_model = replace(paper_model, zero_angle=math.pi)
    other = serial_from_planar(other_model)
    position = planar(other).sample(1.0).position
    here = planar(paper_arm).sample(1.0).position
    difference = JointMap(other_model).absolute_position(position) - JointMap(
        paper_model
    ).absolute_position(here)
    np.testing.assert_allclose(wrapped(difference), 0.0, atol=1e-12)


def test_given_both_ends_when_sampled_then_the_arm_rests_there_and_outside(path):
    for times in ((0.5, 4.0), (-3.0, 9.0)):
        reference = path.sample(np.array(times))
        np.testing.assert_allclose(reference.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(reference.acceleration, 0.0, atol=1e-10)
        np.testing.assert_allclose(in_plane(reference.tip), [POINTS[0], POINTS[-1]], atol=1e-12)


def test_given_a_path_when_differentiated_then_rates_and_accelerations_are_its_own(path):
    times, h = np.linspace(0.6, 3.9, 67), 1e-4
    before, now, after = (path.sample(times + d) for d in (-h, 0.0, h))
    np.testing.assert_allclose(
        (after.position - before.position) / (2 * h), now.velocity, atol=1e-6
    )
    np.testing.assert_allclose(
        (after.velocity - before.velocity) / (2 * h), now.acceleration, atol=1e-5
    )


def test_given_a_path_when_sampled_finely_then_position_rate_and_acceleration_have_no_jumps(path):
    for step in (1e-3, 1e-4):
        fine = path.sample(np.arange(0.0, 4.5, step))
        for signal, slope in (
            (fine.position, 3.0),
            (fine.velocity, 10.0),
            (fine.acceleration, 100.0),
        ):
            assert np.abs(np.diff(signal, axis=0)).max() < slope * step


def test_given_one_time_when_sampled_then_it_equals_the_row_of_a_batch(path):
    batch = path.sample(np.array([1.0, 2.5]))
    one = path.sample(2.5)
    for name in ('position', 'velocity', 'acceleration', 'tip'):
        assert getattr(one, name).shape == ((3,) if name == 'tip' else (2,))
        np.testing.assert_array_equal(getattr(one, name), getattr(batch, name)[1])


def test_given_the_other_elbow_when_sampled_then_the_tip_stays_and_q2_changes_sign(paper_arm):
    positive = planar(paper_arm, elbow='positive').sample(1.0)
    negative = planar(paper_arm, elbow='negative').sample(1.0)
    np.testing.assert_array_equal(positive.tip, negative.tip)
    assert positive.position[1] > 0.0
    assert negative.position[1] == pytest.approx(-positive.position[1], rel=1e-12)


def crossing(arm, elbow):
    """Path on which link 1 crosses the negative x-axis."""
    high, low = (0.75, -1.2) if elbow == 'positive' else (1.2, -0.75)
    return planar(arm, (0.0, 1.0), ((-1.1, high), (-1.1, low)), elbow)


@pytest.mark.parametrize('elbow', ['positive', 'negative'])
def test_given_link_1_crosses_the_negative_x_axis_when_sampled_then_q1_is_continuous(
    paper_arm, elbow
):
    fine = crossing(paper_arm, elbow).sample(np.linspace(0.0, 1.0, 2001))
    assert np.abs(np.diff(fine.position, axis=0)).max() < 0.02


@pytest.mark.parametrize('elbow', ['positive', 'negative'])
def test_given_link_1_crosses_the_negative_x_axis_when_sampled_then_the_jump_is_a_full_turn_at_most(
    paper_arm, elbow, paper_model
):
    fine = crossing(paper_arm, elbow).sample(np.linspace(0.0, 1.0, 2001))
    np.testing.assert_allclose(
        np.abs(wrapped(np.diff(fine.position, axis=0))).max(), 0.0, atol=0.02
    )
    np.testing.assert_allclose(
        forward(fine.position, paper_model.lengths), in_plane(fine.tip), atol=1e-12
    )


def test_given_the_shipped_path_when_sampled_then_q1_is_continuous_and_in_the_region(
    paper_arm, two_faults, paper_model
):
    fine = two_faults.path(paper_arm).sample(np.linspace(0.0, 20.0, 20001))
    assert np.abs(np.diff(fine.position, axis=0)).max() < 0.002
    theta = JointMap(paper_model).absolute_position(fine.position)
    assert np.cos(theta).min() > max(paper_model.cos_min)


@pytest.mark.parametrize(
    ('times', 'points'),
    [
        ((0.0,), ((0.0, 1.5),)),  # one point
        ((), ()),  # none
        ((0.0, 1.0), ((0.0, 1.5, 0.0), (0.1, 1.5, 0.0))),  # three coordinates
        ((0.0, 1.0), ((0.0, 1.5),)),  # more times than points
        ((0.0, 0.0), ((0.0, 1.5), (0.1, 1.5))),  # time stands
        ((1.0, 0.5), ((0.0, 1.5), (0.1, 1.5))),  # time runs back
        ((0.0, math.nan), ((0.0, 1.5), (0.1, 1.5))),
        ((0.0, math.inf), ((0.0, 1.5), (0.1, 1.5))),
    ],
)
def test_given_bad_waypoints_when_a_path_is_made_then_the_field_is_named(paper_arm, times, points):
    with pytest.raises(ConfigError, match=r'path\.waypoints'):
        planar(paper_arm, times, points)


def test_given_a_waypoint_of_nan_when_a_path_is_made_then_the_field_is_named(paper_arm):
    with pytest.raises(ConfigError, match=r'path\.waypoints'):
        planar(paper_arm, (0.0, 1.0), ((0.0, 1.5), (math.nan, 1.5)))


def test_given_an_unknown_elbow_when_a_path_is_made_then_the_field_is_named(paper_arm):
    with pytest.raises(ConfigError, match=r'path\.elbow'):
        planar(paper_arm, elbow='left')


def test_given_an_obstacle_on_the_path_when_it_is_made_then_the_hit_is_refused(paper_arm):
    planar(paper_arm, obstacle=Obstacle((0.0, 1.9), 0.2))
    with pytest.raises(ConfigError, match='hits the obstacle'):
        planar(paper_arm, obstacle=Obstacle((0.0, 1.7), 0.2))


def test_given_a_path_that_leaves_reach_between_waypoints_when_it_is_made_then_it_is_refused(
    paper_arm,
):
    with pytest.raises(UnreachableError):  # a chord of the annulus' hole
        planar(replace(paper_arm, tip=(0.5, 0.0, 0.0)), (0.0, 1.0), ((-1.0, 0.05), (1.0, 0.05)))


def test_given_a_path_through_the_stretched_arm_when_it_is_made_then_it_is_refused(paper_arm):
    with pytest.raises(UnreachableError, match='singularity'):
        planar(paper_arm, (0.0, 1.0), ((0.0, 1.5), (0.0, 2.0)))


def test_given_a_time_of_nan_when_sampled_then_no_reference_is_made_up(path):
    with pytest.raises(UnreachableError):
        path.sample(math.nan)
