"""Paths of a planar arm through points in its plane."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lpv.core.control.path import CartesianPath, Obstacle, PlanarWaypoints
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.kinematics import forward
from lpv.core.uio.planar import serial_from_planar

TIMES = (0.5, 2.0, 4.0)
POINTS = ((-0.6, 1.5), (0.0, 1.6), (0.7, 1.4))


def planar(arm, times=TIMES, points=POINTS, elbow='positive', obstacle=None):
    return CartesianPath(arm, times, PlanarWaypoints(points, elbow, obstacle))


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
    # Another zero of the joints leaves the tip where it is.
    other = replace(paper_model, zero_angle=math.pi)
    there = planar(serial_from_planar(other)).sample(np.array(TIMES)).position
    turns = (JointMap(other).absolute_position(there) - theta) / (2.0 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)


def test_given_both_ends_when_sampled_then_the_arm_rests_there_and_outside(path):
    for times in ((0.5, 4.0), (-3.0, 9.0)):
        reference = path.sample(np.array(times))
        np.testing.assert_allclose(reference.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(reference.acceleration, 0.0, atol=1e-10)
        np.testing.assert_allclose(in_plane(reference.tip), [POINTS[0], POINTS[-1]], atol=1e-12)


def test_given_a_path_when_differentiated_then_rates_and_accelerations_are_its_own(path):
    times, h = np.linspace(0.0, 4.5, 1000), 1e-4
    before, now, after = (path.sample(times + d) for d in (-h, 0.0, h))
    for slope, name, rate, atol in (
        (10.0, 'position', 'velocity', 1e-6),
        (100.0, 'velocity', 'acceleration', 1e-2),
    ):
        found = (getattr(after, name) - getattr(before, name)) / (2 * h)
        np.testing.assert_allclose(found, getattr(now, rate), atol=atol)
        # No jumps anywhere.
        assert np.abs(np.diff(getattr(now, rate), axis=0)).max() < slope * (times[1] - times[0])


def test_given_one_time_when_sampled_then_it_equals_the_row_of_a_batch(path):
    batch, one = path.sample(np.array([1.0, 2.5])), path.sample(2.5)
    for name in ('position', 'velocity', 'acceleration', 'tip'):
        assert getattr(one, name).shape == ((3,) if name == 'tip' else (2,))
        np.testing.assert_array_equal(getattr(one, name), getattr(batch, name)[1])


def test_given_the_other_elbow_when_sampled_then_the_tip_stays_and_q2_changes_sign(paper_arm):
    positive, negative = (planar(paper_arm, elbow=e).sample(1.0) for e in ('positive', 'negative'))
    np.testing.assert_array_equal(positive.tip, negative.tip)
    assert positive.position[1] > 0.0
    assert negative.position[1] == pytest.approx(-positive.position[1], rel=1e-12)


@pytest.mark.parametrize(
    ('elbow', 'high', 'low'), [('positive', 0.75, -1.2), ('negative', 1.2, -0.75)]
)
def test_given_link_1_crosses_the_negative_x_axis_when_sampled_then_q1_is_continuous(
    paper_arm, paper_model, elbow, high, low
):
    path = planar(paper_arm, (0.0, 1.0), ((-1.1, high), (-1.1, low)), elbow)
    fine = path.sample(np.linspace(0.0, 1.0, 2001))
    assert np.abs(np.diff(fine.position, axis=0)).max() < 0.02
    tip = forward(fine.position, paper_model.lengths)
    np.testing.assert_allclose(tip, in_plane(fine.tip), atol=1e-12)


def test_given_the_shipped_path_when_sampled_then_q1_is_continuous_and_in_the_region(
    paper_arm, two_faults, paper_model
):
    fine = two_faults.path(paper_arm).sample(np.linspace(0.0, 20.0, 20001))
    assert np.abs(np.diff(fine.position, axis=0)).max() < 0.002
    theta = JointMap(paper_model).absolute_position(fine.position)
    assert np.cos(theta).min() > max(paper_model.cos_min)


def test_given_bad_waypoints_when_a_path_is_made_then_the_field_is_named(paper_arm):
    pair, flat = ((0.0, 1.5), (0.1, 1.5)), ((0.0, 1.5, 0.0), (0.1, 1.5, 0.0))
    ends = (0.0, 0.0), (1.0, 0.5), (0.0, math.nan), (0.0, math.inf)
    other = pair[:1], flat, (pair[0], (math.nan, 1.5))
    bad = [((0.0,), pair[:1]), ((), ()), *((times, pair) for times in ends)]
    for times, points in (*bad, *(((0.0, 1.0), points) for points in other)):
        with pytest.raises(ConfigError, match=r'path\.waypoints'):
            planar(paper_arm, times, points)
    with pytest.raises(ConfigError, match=r'path\.elbow'):
        planar(paper_arm, elbow='left')


def test_given_a_path_that_no_arm_can_follow_when_made_or_sampled_then_it_is_refused(
    paper_arm, path, two_faults
):
    joints = tuple(replace(j, limits=replace(j.limits, velocity=0.2)) for j in paper_arm.joints)
    with pytest.raises(ConfigError, match='needs 0.2.* rad/s of joint1, whose velocity_limit'):
        two_faults.path(replace(paper_arm, joints=joints))
    planar(paper_arm, obstacle=Obstacle((0.0, 1.9), 0.2))
    with pytest.raises(ConfigError, match='hits the obstacle'):
        planar(paper_arm, obstacle=Obstacle((0.0, 1.7), 0.2))
    with pytest.raises(UnreachableError):  # a chord of the annulus' hole
        planar(replace(paper_arm, tip=(0.5, 0.0, 0.0)), (0.0, 1.0), ((-1.0, 0.05), (1.0, 0.05)))
    with pytest.raises(UnreachableError, match='singularity'):
        planar(paper_arm, (0.0, 1.0), ((0.0, 1.5), (0.0, 2.0)))
    with pytest.raises(UnreachableError):
        path.sample(math.nan)
