"""Paths of a planar arm through points in its plane, and references for an arm beside its path."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lpv.core.control.path import CartesianPath, Obstacle, PlanarWaypoints, Reference
from lpv.core.control.path_follower import PathFollower
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.kinematics import forward
from lpv.core.uio.planar import serial_from_planar

TIMES = (0.5, 2.0, 4.0)
POINTS = ((-0.6, 1.5), (0.0, 1.6), (0.7, 1.4))
STEP = 2_000_000


def planar(arm, times=TIMES, points=POINTS, elbow='positive', obstacle=None):
    return CartesianPath(arm, times, PlanarWaypoints(points, elbow, obstacle))


def in_plane(tip):
    """Forward and up of points in the base frame; the arm's plane is that of x and z."""
    np.testing.assert_array_equal(tip[..., 1], 0.0)
    return tip[..., [0, 2]]


@pytest.fixture
def path(paper_arm):
    return planar(paper_arm)


@pytest.fixture
def shipped(paper_arm, two_faults):
    return two_faults.path(paper_arm)


def assert_smooth(rows, dt=0.002, atol=(2e-4, 5e-2)):
    """Rates are the derivatives of positions, accelerations those of rates."""
    names = ('position', 'velocity'), ('velocity', 'acceleration')
    for (name, rate), tolerance in zip(names, atol):
        values = getattr(rows, name)
        slope = (values[2:] - values[:-2]) / (2.0 * dt)
        np.testing.assert_allclose(slope, getattr(rows, rate)[1:-1], atol=tolerance)


def test_given_waypoints_when_sampled_then_the_tip_is_there_and_rests_at_both_ends_and_outside(
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
    for times in ((0.5, 4.0), (-3.0, 9.0)):
        reference = path.sample(np.array(times))
        np.testing.assert_allclose(reference.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(reference.acceleration, 0.0, atol=1e-10)
        np.testing.assert_allclose(in_plane(reference.tip), [POINTS[0], POINTS[-1]], atol=1e-12)


def test_given_a_path_when_sampled_then_rates_fit_and_one_time_equals_the_row_of_a_batch(path):
    rows = path.sample(np.linspace(0.0, 4.5, 45001))
    assert_smooth(rows, 1e-4, atol=(1e-6, 1e-2))
    one = path.sample(2.5)
    for name in ('position', 'velocity', 'acceleration', 'tip'):
        assert getattr(one, name).shape == ((3,) if name == 'tip' else (2,))
        np.testing.assert_allclose(getattr(one, name), getattr(rows, name)[25000], atol=1e-12)


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
    shipped, paper_model
):
    fine = shipped.sample(np.linspace(0.0, 20.0, 20001))
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


# ------------------------------------------------------------------ an arm beside its path


def follow(guide, position, start, seconds):
    """Stacked references over a time; the arm is where the reference is."""
    rows = []
    for k in range(round(seconds * 500)):
        rows.append(guide.reference(start + k * STEP, position))
        position = rows[-1].position
    names = 'position', 'velocity', 'acceleration', 'tip'
    return Reference(*(np.array([getattr(row, name) for row in rows]) for name in names))


def assert_starts_at_rest(rows, position):
    np.testing.assert_allclose(rows.position[0], position, atol=1e-12)
    np.testing.assert_allclose(rows.velocity[0], 0.0, atol=1e-12)


def assert_ends_at(rows, path, time):
    """On the path, where it is at a time of its own."""
    np.testing.assert_allclose(rows.position[-1], path.sample(time).position, atol=1e-9)


def test_given_an_arm_at_the_start_when_guided_then_it_follows_the_path_at_once(shipped):
    guide = PathFollower(shipped)
    rows = follow(guide, shipped.sample(0.0).position + 0.01, 1_000_000_000, 3.0)
    for name, values in vars(rows).items():
        expected = np.array([getattr(shipped.sample(STEP * k / 1e9), name) for k in range(1500)])
        np.testing.assert_array_equal(values, expected, err_msg=name)


@pytest.mark.parametrize('offset', [(0.06, 0.0), (-0.1, 0.2), (0.6, -0.4), (-2.0, 0.3)])
def test_given_an_arm_elsewhere_when_guided_then_it_approaches_smoothly_and_takes_its_time(
    shipped, offset
):
    """By a quintic from rest to rest, of at most 0.5 rad/s and at least 1 s."""
    start, distance = shipped.sample(0.0).position, np.abs(offset).max()
    approach = max(1.0, 1.875 * distance / 0.5)
    rows = follow(PathFollower(shipped), start + offset, 0, approach + 2.0)
    assert_starts_at_rest(rows, start + offset)
    assert_smooth(rows)
    n = int(approach * 500)
    fastest, greatest = 1.875 * distance / approach, 5.774 * distance / approach**2
    assert np.abs(rows.velocity[:n]).max() == pytest.approx(fastest, rel=1e-3)
    assert np.abs(rows.acceleration[:n]).max() == pytest.approx(greatest, rel=1e-3)
    np.testing.assert_allclose(rows.position[n + 1], start, atol=1e-6)
    # From then on the path itself, late by the approach.
    assert_ends_at(rows, shipped, 0.002 * (len(rows.position) - 1) - approach)


def test_given_a_stop_on_the_way_when_it_goes_on_then_from_where_it_stopped_and_from_rest(shipped):
    guide = PathFollower(shipped)
    before = follow(guide, shipped.sample(0.0).position, 0, 3.0)
    assert np.abs(before.velocity[-1]).max() > 0.05
    guide.stop()
    assert not guide.running
    left = before.position[-1] + 0.01  # it coasted a little
    rows = follow(guide, left, 60_000_000_000, 2.0)
    assert_starts_at_rest(rows, before.position[-1])
    assert_smooth(rows)
    fastest = np.abs(shipped.sample(np.linspace(0.0, 20.0, 500)).velocity).max()
    assert np.abs(rows.velocity).max() < 1.2 * fastest
    # Half of the ramp's time is lost, nothing else.
    assert_ends_at(rows, shipped, 2.998 + 1.998 - 0.25)


def test_given_a_stop_in_an_approach_when_it_goes_on_then_it_approaches_the_same_point(shipped):
    guide, target = PathFollower(shipped), shipped.sample(0.0).position
    half = follow(guide, target + 0.6, 0, 1.0).position[-1]
    guide.stop()
    rows = follow(guide, half, 9_000_000_000, 3.0)
    assert_starts_at_rest(rows, half)
    assert_ends_at(rows, shipped, 2.998 - 1.875 * np.abs(half - target).max() / 0.5)
