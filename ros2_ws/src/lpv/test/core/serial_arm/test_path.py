import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from fault_injection import with_joints
from nested import changed
from serial_arms import scara, shoulder_arm

from lpv.core.control import path as paths
from lpv.core.control.path import PoseWaypoints, SerialPath
from lpv.core.control.path_follower import PathFollower, approach_speeds
from lpv.core.control.watchdog import StopReason, TrackerLimits, TrackerWatchdog
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import JointLimits, LinkInertia
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.scenario import parse_scenario
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.kinematics import forward
from lpv.files import load_arm, load_scenario

TIMES = (0.5, 2.5, 5.0)
JOINTS = ((0.0, 0.5, -1.0), (0.6, 0.9, -1.4), (-0.3, 0.4, -0.9))
REACHED = ((0.5, 0.0, 0.2), (0.4, 0.3, 0.4), (0.5, -0.2, 0.3))
START = (0.0, 0.6, -1.2)
ARM = shoulder_arm('independent')
KNOTS = (0.5, 2.0, 4.0)
POINTS = ((-0.6, 1.5), (0.0, 1.6), (0.7, 1.4))
STEP = 2_000_000


def test_given_waypoints_or_poses_when_followed_then_the_path_is_smooth_and_meets_them():
    path = SerialPath(ARM, TIMES, JOINTS)
    np.testing.assert_allclose(path.sample(TIMES).position, JOINTS, atol=1e-12)
    for time in (0.0, 0.5, 5.0, 9.0):
        motion = path.sample(time)
        assert np.abs([motion.velocity, motion.acceleration]).max() < 1e-9
    assert_smooth(path.sample(np.arange(0.6, 4.9, 1e-4)), 1e-4, atol=(1e-6, 1e-5))
    path = SerialPath.through_poses(ARM, TIMES, PoseWaypoints(REACHED, START))
    np.testing.assert_allclose(path.sample(TIMES).tip, REACHED, atol=1e-5)
    assert np.abs(np.diff(path.sample(np.linspace(0.0, 5.0, 500)).position, axis=0)).max() < 0.05


def test_given_impossible_poses_when_followed_then_the_error_says_when_and_why():
    for reason, poses in (
        ('out of reach', ((1.5, 0.0, 0.2), (1.4, 0.0, 0.2))),
        ('singularity', ((0.5, 0.0, 0.2), (0.799, 0.0, 0.2))),
        ('singularity|out of reach', ((0.5, 0.0, 0.4), (0.001, 0.0, 0.7))),
    ):
        with pytest.raises(UnreachableError, match=rf'at \d+\.\d\d s .*({reason})'):
            SerialPath.through_poses(ARM, (0.0, 3.0), PoseWaypoints(poses, START))


WIDE = JointLimits(-2.5, 2.5, 2.5, 60.0)


@pytest.mark.parametrize(('reason', 'times', 'joints', 'limits'), [
    (r'takes joint1 to .* rad, whose limit is -0.2 \.\. 0.5', TIMES, JOINTS,
     JointLimits(-0.2, 0.5, 2.5, 60.0)),
    ('rad/s of joint1, whose limit is 0.2', TIMES, JOINTS, JointLimits(-2.5, 2.5, 0.2, 60.0)),
    ('N m of joint1, whose limit is 0.1', TIMES, JOINTS, JointLimits(-2.5, 2.5, 2.5, 0.1)),
    *(('path.waypoints: .*must increase', (0.0, end), JOINTS[:2], WIDE)
      for end in (0.0, -0.5, math.nan, math.inf)),
    *(('path.waypoints: .*two or more', times, JOINTS[:1], WIDE) for times in ((), (0.0,))),
    ('path.waypoints: .*3 joint positions', (0.0, 1.0), ((0.0, 0.0), (0.1, 0.1)), WIDE),
    ('path.waypoints: .*finite', (0.0, 1.0), ((0.0, 0.0, math.nan), JOINTS[0]), WIDE),
])  # fmt: skip
def test_given_what_makes_no_path_then_joint_or_field_is_named(reason, times, joints, limits):
    with pytest.raises(ConfigError, match=reason):
        SerialPath(with_joints(ARM, 0, limits=limits), times, joints)


def test_given_a_long_path_when_it_turns_at_each_waypoint_then_limits_and_tip_are_kept():
    times, back = np.arange(2001.0), np.arange(2001)[:, None] % 2
    slow = with_joints(ARM, 0, limits=JointLimits(-2.5, 2.5, 1.0, 60.0))
    with pytest.raises(ConfigError, match=r'needs 1\.64 rad/s of joint1'):
        SerialPath(slow, times, back * [1.0, 0.0, 0.0] + JOINTS[0])
    tips = REACHED[0] + back[:1001] * [0.0, 0.1, 0.05]
    path = SerialPath.through_poses(ARM, 2.0 * times[:1001], PoseWaypoints(tips.tolist(), START))
    np.testing.assert_allclose(path.sample(times + 0.5).tip[:, 0], REACHED[0][0], atol=1e-6)


DATA = yaml.safe_load("""
name: test
duration: 5.0
plant: {parameter_error: 0.05, payload: 0.4, friction_factor: 1.2}
path: {waypoints: [{t: 0.5, joints: [0.0, 0.5, -1.0]}, {t: 4.0, joints: [0.6, 0.9, -1.4]}]}
faults: [{sensor: encoder2, kind: bias, onset: 1.0, size: 0.1}]
""")
POSES = yaml.safe_load("""
start: [0.0, 0.6, -1.2]
waypoints:
  - {t: 0.5, position: [0.5, 0.0, 0.2], rpy: [0.0, 0.0, 0.0]}
  - {t: 4.0, position: [0.4, 0.3, 0.4], rpy: [0.0, 0.0, 0.1]}
""")


@pytest.mark.parametrize('name', ['ur10', 'panda'])
def test_given_a_shipped_arm_when_its_scenario_is_read_then_the_arm_can_do_it(name):
    arm, scenario = load_arm(name), load_scenario(name)
    assert scenario.path(arm).end <= scenario.duration
    assert {fault.kind for fault in scenario.faults} == {'bias', 'drift'}
    ArmSimulator(arm, scenario)


def test_given_a_scenario_when_used_then_arms_are_drawn_by_seed_and_fields_kept_or_named():
    scenario = parse_scenario(DATA)
    true, nominal = scenario.true_chain(ARM), compile_chain(ARM)
    factor = true.inertial[:2, 0] / nominal.inertial[:2, 0]
    assert np.all(np.abs(factor - 1.0) <= 0.05) and np.ptp(factor) > 0.0
    np.testing.assert_array_equal(true.inertial, scenario.true_chain(ARM).inertial)
    np.testing.assert_allclose(true.friction[:, 1], 1.2 * nominal.friction[:, 1])
    scenario = parse_scenario({**DATA, 'path': POSES})
    assert isinstance(scenario.waypoints, PoseWaypoints)
    assert scenario.waypoints.start == START
    assert scenario.waypoints.orientations[1] == (0.0, 0.0, 0.1)
    with pytest.raises(ConfigError, match='path.start'):
        parse_scenario({**DATA, 'path': {**POSES, 'start': 'anywhere'}})
    with pytest.raises(ConfigError, match=r'waypoints\[0\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[0]', {'t': 0.0}))
    with pytest.raises(ConfigError, match=r'path.waypoints\[1\].joints'):
        parse_scenario(changed(DATA, 'path.waypoints[1].joints', [0.0, 0.1])).path(ARM)
    points = {'waypoints': [{'t': t, 'x': 0.1, 'y': 0.1} for t in (0.0, 1.0)]}
    with pytest.raises(ConfigError, match=f'path.waypoints: x and y are .* {ARM.name} has 3'):
        parse_scenario({**DATA, 'path': points}).path(ARM)
    with pytest.raises(ConfigError, match='plant.mass_factors: must have 3 numbers'):
        parse_scenario(changed(DATA, 'plant', {'mass_factors': [1.0, 1.1]})).true_arm(ARM)
    for plant in ('lpv', 'nonlinear_without_coriolis'):
        with pytest.raises(ConfigError, match='planar arms of two links: it has 3 joints'):
            ArmSimulator(ARM, parse_scenario({**DATA, 'plant': plant}))


def test_given_factors_of_links_when_one_is_massless_then_their_centres_stay():
    still = LinkInertia.from_vector(np.zeros(10))
    arm = with_joints(ARM, 2, link=still, rotor_inertia=0.1)
    scenario = replace(parse_scenario(DATA), parameter_error=0.0, inertia_factors=(1.2,) * 3)
    first, _, last = scenario.true_arm(arm).joints
    link = ARM.joints[0].link
    assert last.link == still and first.link.mass == link.mass
    np.testing.assert_allclose(first.link.center(), link.center())
    np.testing.assert_allclose(first.link.about_center(), 1.2 * link.about_center())


def planar(arm, times=KNOTS, points=POINTS, elbow='positive', obstacle=None):
    return paths.CartesianPath(arm, times, paths.PlanarWaypoints(points, elbow, obstacle))


def in_plane(tip):
    """Forward and up of points in the base frame; the arm's plane is that of x and z."""
    np.testing.assert_array_equal(tip[..., 1], 0.0)
    return tip[..., [0, 2]]


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


def test_given_waypoints_when_sampled_then_tip_rates_and_ends_are_right(paper_arm, paper_model):
    path = planar(paper_arm)
    reference = path.sample(np.array(KNOTS))
    np.testing.assert_allclose(in_plane(reference.tip), POINTS, atol=1e-12)
    # Reference in ROS joints: absolute angles, then the tip by plain trigonometry.
    theta = JointMap(paper_model).absolute_position(reference.position)
    tip = np.stack([-np.sin(theta).sum(axis=-1), np.cos(theta).sum(axis=-1)], axis=-1)
    np.testing.assert_allclose(tip, POINTS, atol=1e-12)
    # Another zero of the joints leaves the tip where it is.
    other = replace(paper_model, zero_angle=math.pi)
    there = planar(two_link_arm(other)).sample(np.array(KNOTS)).position
    turns = (JointMap(other).absolute_position(there) - theta) / (2.0 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    for times in ((0.5, 4.0), (-3.0, 9.0)):
        reference = path.sample(np.array(times))
        np.testing.assert_allclose(reference.velocity, 0.0, atol=1e-12)
        np.testing.assert_allclose(reference.acceleration, 0.0, atol=1e-10)
        np.testing.assert_allclose(in_plane(reference.tip), [POINTS[0], POINTS[-1]], atol=1e-12)
    assert_smooth(path.sample(np.linspace(0.0, 4.5, 45001)), 1e-4, atol=(1e-6, 1e-2))


def test_given_either_elbow_then_q1_is_continuous_and_the_tip_one(paper_arm, paper_model, shipped):
    for elbow, high, low in (('positive', 0.75, -1.2), ('negative', 1.2, -0.75)):
        path = planar(paper_arm, (0.0, 1.0), ((-1.1, high), (-1.1, low)), elbow)
        fine = path.sample(np.linspace(0.0, 1.0, 2001))
        assert np.abs(np.diff(fine.position, axis=0)).max() < 0.02
        tip = forward(fine.position, paper_model.lengths)
        np.testing.assert_allclose(tip, in_plane(fine.tip), atol=1e-12)
    fine = shipped.sample(np.linspace(0.0, 20.0, 20001))
    assert np.abs(np.diff(fine.position, axis=0)).max() < 0.002
    theta = JointMap(paper_model).absolute_position(fine.position)
    assert np.cos(theta).min() > max(paper_model.cos_min)
    positive, negative = (planar(paper_arm, elbow=e).sample(1.0) for e in ('positive', 'negative'))
    np.testing.assert_array_equal(positive.tip, negative.tip)
    assert positive.position[1] > 0.0
    assert negative.position[1] == pytest.approx(-positive.position[1], rel=1e-12)


@pytest.mark.parametrize(('joint', 'low', 'elbow'), [(0, 5.0, 'positive'), (1, 0.0, 'negative')])
def test_given_limits_that_leave_another_turn_then_the_path_takes_it(paper_arm, joint, low, elbow):
    limits = replace(paper_arm.joints[joint].limits, lower=low, upper=low + 6.0)
    turned = planar(with_joints(paper_arm, joint, limits=limits), elbow=elbow).sample(KNOTS)
    usual = planar(paper_arm, elbow=elbow).sample(KNOTS)
    turns = 2.0 * math.pi * np.eye(2)[joint]
    np.testing.assert_allclose(turned.position - usual.position, [turns] * 3, atol=1e-9)
    np.testing.assert_allclose(turned.tip, usual.tip, atol=1e-12)


def test_given_bad_waypoints_or_a_path_for_no_arm_then_it_is_refused(paper_arm):
    planar(paper_arm, obstacle=paths.Obstacle((0.0, 1.9), 0.2))
    with pytest.raises(ConfigError, match='hits the obstacle'):
        planar(paper_arm, obstacle=paths.Obstacle((0.0, 1.7), 0.2))
    with pytest.raises(UnreachableError):  # a chord of the annulus' hole
        planar(replace(paper_arm, tip=(0.5, 0.0, 0.0)), (0.0, 1.0), ((-1.0, 0.05), (1.0, 0.05)))
    with pytest.raises(UnreachableError, match='singularity'):
        planar(paper_arm, (0.0, 1.0), ((0.0, 1.5), (0.0, 2.0)))
    pytest.raises(UnreachableError, planar(paper_arm).sample, math.nan)
    with pytest.raises(ConfigError, match=r'path\.waypoints: .*coordinates x and y'):
        planar(paper_arm, (0.0, 1.0), ((0.0, 1.5, 0.0), (0.1, 1.5, 0.0)))
    pytest.raises(ConfigError, planar, paper_arm, elbow='left').match(r'path\.elbow')


def follow(guide, position, start, seconds):
    """References over a time; those that are asked for one by one are the same bits."""
    stamps = start + STEP * np.arange(round(seconds * 500))
    guide.reference(start, position)
    rows = guide.ahead(stamps)
    for k in (*range(0, len(stamps), 25), -1):
        for name, values in vars(guide.reference(int(stamps[k]), position)).items():
            np.testing.assert_array_equal(values, getattr(rows, name)[k])
    return rows


def assert_goes(rows, start, path, time):
    """From rest to where the path is at a time of its own."""
    np.testing.assert_allclose([rows.position[0] - start, rows.velocity[0]], 0.0, atol=1e-12)
    np.testing.assert_allclose(rows.position[-1], path.sample(time).position, atol=1e-9)


def test_given_an_arm_at_the_start_when_guided_then_it_follows_the_path_at_once(shipped):
    rows = follow(PathFollower(shipped), shipped.sample(0.0).position + 0.01, 1_000_000_000, 3.0)
    for k in range(1500):
        for name, values in vars(shipped.sample(STEP * k / 1e9)).items():
            np.testing.assert_array_equal(getattr(rows, name)[k], values, err_msg=name)


@pytest.mark.parametrize('offset', [(0.06, 0.0), (-0.1, 0.2), (0.6, -0.4), (-2.0, 0.3)])
def test_given_an_arm_elsewhere_when_guided_then_it_approaches_smoothly_and_slowly(shipped, offset):
    """By a quintic from rest to rest, of at most 0.5 rad/s and at least 1 s."""
    start, distance = shipped.sample(0.0).position, np.abs(offset).max()
    approach = max(1.0, 1.875 * distance / 0.5)
    rows = follow(PathFollower(shipped), start + offset, 0, approach + 2.0)
    assert_smooth(rows)
    n = int(approach * 500)
    fastest, greatest = 1.875 * distance / approach, 5.774 * distance / approach**2
    assert np.abs(rows.velocity[:n]).max() == pytest.approx(fastest, rel=1e-3)
    assert np.abs(rows.acceleration[:n]).max() == pytest.approx(greatest, rel=1e-3)
    np.testing.assert_allclose(rows.position[n + 1], start, atol=1e-6)
    # From then on the path itself, late by the approach.
    assert_goes(rows, start + offset, shipped, 0.002 * (len(rows.position) - 1) - approach)


def test_given_a_stop_when_it_goes_on_then_from_where_it_stopped_to_the_same_path(shipped):
    guide = PathFollower(shipped)
    before = follow(guide, shipped.sample(0.0).position, 0, 3.0)
    assert np.abs(before.velocity[-1]).max() > 0.05
    guide.stop()
    assert not guide.running
    left = before.position[-1] + 0.01  # it coasted a little
    rows = follow(guide, left, 60_000_000_000, 2.0)
    assert_smooth(rows)
    fastest = np.abs(shipped.sample(np.linspace(0.0, 20.0, 500)).velocity).max()
    assert np.abs(rows.velocity).max() < 1.2 * fastest
    # Half of the ramp's time is lost, nothing else.
    assert_goes(rows, before.position[-1], shipped, 2.998 + 1.998 - 0.25)
    guide, target = PathFollower(shipped), shipped.sample(0.0).position
    half = follow(guide, target + 0.6, 0, 1.0).position[-1]
    guide.stop()
    rows = follow(guide, half, 9_000_000_000, 3.0)
    assert_goes(rows, half, shipped, 2.998 - 1.875 * np.abs(half - target).max() / 0.5)


@pytest.mark.parametrize('arm, joint, offset', [
    (with_joints(ARM, 0, limits=JointLimits(velocity=0.3)), 0, 1.0), (scara(), 2, 0.03),
    (scara(), 2, 0.1), (scara(), 1, 0.04),
], ids=['slow', 'near', 'far', 'at_once'])  # fmt: skip
def test_given_slow_or_sliding_joints_when_guided_then_no_watchdog_stops_them(arm, joint, offset):
    place = np.array([0.1, 0.3, -0.12, 0.2][: len(arm.joints)])
    path = SerialPath(arm, (0.0, 1.0), np.array([place, place + 0.01]))
    dog, limits = TrackerWatchdog(arm, TrackerLimits()), TrackerLimits()
    guide = PathFollower(path, approach_speeds(arm, limits.speed), arm.scales())
    position, rate = place + offset * (np.arange(len(place)) == joint), np.zeros(len(place))
    end, k = path.sample(1.0).position, 0
    while k < 500 or np.abs(position - end).max() > 1e-3:
        assert k < 7000, position
        assert dog.check_estimate(k * STEP, 0, 0, True, rate, rate) is StopReason.NONE
        row = guide.reference(k * STEP, position)
        assert dog.check_motion(k * STEP, row.position, position, position) is StopReason.NONE
        rate = (row.position - position) / 0.05  # late by 0.05 s
        position, k = position + 0.002 * rate, k + 1
