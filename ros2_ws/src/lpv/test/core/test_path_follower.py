"""References for an arm that is not where its path is."""

import numpy as np
import pytest

from lpv.core.control.path_follower import PathFollower

STEP = 2_000_000


@pytest.fixture
def path(paper_arm, two_faults):
    return two_faults.path(paper_arm)


def follow(guide, position, start, seconds):
    """Stacked references over a time; the arm is where the reference is."""
    rows = []
    for k in range(round(seconds * 500)):
        rows.append(guide.reference(start + k * STEP, position))
        position = rows[-1].position
    return {
        name: np.array([getattr(r, name) for r in rows])
        for name in ('position', 'velocity', 'acceleration', 'tip')
    }


def assert_smooth(rows):
    """Rates are the derivatives of positions, accelerations those of rates."""
    for name, rate, atol in (('position', 'velocity', 2e-4), ('velocity', 'acceleration', 5e-2)):
        slope = (rows[name][2:] - rows[name][:-2]) / 0.004
        np.testing.assert_allclose(slope, rows[rate][1:-1], atol=atol)


def test_given_an_arm_at_the_start_when_guided_then_it_follows_the_path_at_once(path):
    rows = follow(PathFollower(path), path.sample(0.0).position + 0.01, 1_000_000_000, 3.0)
    for name, values in rows.items():
        expected = np.array([getattr(path.sample(STEP * k / 1e9), name) for k in range(1500)])
        np.testing.assert_array_equal(values, expected, err_msg=name)


@pytest.mark.parametrize('offset', [(0.6, -0.4), (-2.0, 0.3)])
def test_given_an_arm_elsewhere_when_guided_then_it_approaches_smoothly_and_slowly(path, offset):
    there = path.sample(0.0).position + np.array(offset)
    approach = 1.875 * np.abs(offset).max() / 0.5
    rows = follow(PathFollower(path), there, 0, approach + 4.0)
    np.testing.assert_allclose(rows['position'][0], there, atol=1e-12)
    np.testing.assert_allclose(rows['velocity'][0], 0.0, atol=1e-12)
    assert_smooth(rows)
    n = int(approach * 500)
    assert np.abs(rows['velocity'][:n]).max() == pytest.approx(0.5, rel=1e-3)
    np.testing.assert_allclose(rows['position'][n + 1], path.sample(0.0).position, atol=1e-6)
    # From then on the path itself, late by the approach.
    late = (len(rows['position']) - 1) * 0.002 - approach
    np.testing.assert_allclose(rows['position'][-1], path.sample(late).position, atol=1e-9)


@pytest.mark.parametrize('offset', [(0.06, 0.0), (-0.1, 0.2)])
def test_given_an_arm_near_its_path_when_guided_then_it_takes_its_time(path, offset):
    start = path.sample(0.0).position
    rows = follow(PathFollower(path), start + np.array(offset), 0, 3.0)
    assert_smooth(rows)
    # A quintic from rest to rest in T: at most 5.774 d / T^2.
    greatest = 5.774 * np.abs(offset).max()
    assert np.abs(rows['acceleration'][:499]).max() == pytest.approx(greatest, rel=1e-3)
    np.testing.assert_allclose(rows['position'][501], start, atol=1e-6)


def test_given_a_stop_on_the_way_when_it_goes_on_then_from_where_it_stopped_and_from_rest(path):
    guide = PathFollower(path)
    before = follow(guide, path.sample(0.0).position, 0, 3.0)
    assert np.abs(before['velocity'][-1]).max() > 0.05
    guide.stop()
    assert not guide.running
    left = before['position'][-1] + 0.01  # it coasted a little
    rows = follow(guide, left, 60_000_000_000, 2.0)
    np.testing.assert_allclose(rows['position'][0], before['position'][-1], atol=1e-12)
    np.testing.assert_allclose(rows['velocity'][0], 0.0, atol=1e-12)
    assert_smooth(rows)
    fastest = np.abs(path.sample(np.linspace(0.0, 20.0, 500)).velocity).max()
    assert np.abs(rows['velocity']).max() < 1.2 * fastest
    # Half of the ramp's time is lost, nothing else.
    reached = 2.998 + 1.998 - 0.25
    np.testing.assert_allclose(rows['position'][-1], path.sample(reached).position, atol=1e-9)


def test_given_a_stop_in_an_approach_when_it_goes_on_then_it_approaches_the_same_point(path):
    guide = PathFollower(path)
    target = path.sample(0.0).position
    half = follow(guide, target + 0.6, 0, 1.0)['position'][-1]
    guide.stop()
    rows = follow(guide, half, 9_000_000_000, 3.0)
    np.testing.assert_allclose(rows['position'][0], half, atol=1e-12)
    time = 2.998 - 1.875 * np.abs(half - target).max() / 0.5
    np.testing.assert_allclose(rows['position'][-1], path.sample(time).position, atol=1e-9)
