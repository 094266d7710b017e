import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_formulas import inertia, scheduling, weights
from scipy.optimize import nnls

from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.simulation.paper_plant import PaperPlant
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.errors import ConfigError, UnreachableError
from lpv.core.uio.model import polytope
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.kinematics import forward, inverse, refuse_singular
from lpv.core.uio.model.polytope import paper_descriptor, sinc_box, vertex_matrices
from lpv.core.uio.planar import is_planar, planar_links, planar_model, plane_of

ANGLE, RATE, TORQUE = st.floats(-6.0, 6.0), st.floats(-8.0, 8.0), st.floats(-100.0, 100.0)
STATE, EFFORT = st.tuples(ANGLE, ANGLE, RATE, RATE), st.tuples(TORQUE, TORQUE)
ANYWHERE = st.floats(-1e6, 1e6) | st.floats(-1.0, 1.0)
BEARING, LENGTH = st.floats(-math.pi, math.pi), st.floats(0.1, 3.0)
PAIR = st.tuples(st.floats(-10, 10), st.floats(-10, 10)).map(np.array)
SHARE = st.floats(0.001, 0.999) | st.sampled_from([0.0, 1.0])
SHARES = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))


def test_given_factors_or_a_payload_then_links_follow_and_mass_is_positive(paper_model):
    for mass in (-6.0, math.nan):
        pytest.raises(ConfigError, paper_model.with_payload, mass).match('payload')
    one, two = paper_model.links
    first = replace(one, mass=1.2 * one.mass, inertia=1.5 * one.inertia)
    second = replace(two, mass=0.9 * two.mass, inertia=0.5 * two.inertia)
    assert paper_model.scaled((1.2, 0.9), (1.5, 0.5)).links == (first, second)


def conversions(joints):
    kinds = 'position', 'velocity', 'torque'
    return [tuple(getattr(joints, f'{to}_{of}') for to in ('absolute', 'joint')) for of in kinds]


@given(PAIR, PAIR)
def test_given_any_pair_when_converted_then_it_comes_back_and_power_is_kept(arms, pair, rate):
    for arm in arms:
        joints, h = JointMap(arm), 1e-6
        for there, back in conversions(joints):
            np.testing.assert_allclose(back(there(pair)), pair, atol=1e-13)
            np.testing.assert_allclose(there(back(pair)), pair, atol=1e-13)
        absolute = joints.absolute_torque(pair) @ joints.absolute_velocity(rate)
        assert absolute == pytest.approx(pair @ rate, abs=1e-12)
        moved = (joints.absolute_position(pair + h * rate) - joints.absolute_position(pair)) / h
        np.testing.assert_allclose(moved, joints.absolute_velocity(rate), atol=1e-7)


def test_given_both_arms_then_zeros_torques_and_sensors_are_right(paper_model, real_model):
    upright, hanging = JointMap(paper_model), JointMap(real_model)
    np.testing.assert_array_equal(upright.absolute_torque([5.0, 2.0]), [3.0, 2.0])
    np.testing.assert_allclose(upright.absolute_position([math.pi / 2, 0.0]), 0.0, atol=1e-15)
    np.testing.assert_allclose(upright.absolute_position([0.0, 0.0]), -math.pi / 2)
    expected = [math.pi + 0.2, math.pi + 0.5]
    np.testing.assert_allclose(hanging.absolute_position([0.2, 0.3]), expected)
    np.testing.assert_array_equal(upright.sensor_matrix, np.eye(2))
    # A fault of encoder 1 shifts both absolute angles: S^-1 = [[1, 0], [1, 1]].
    np.testing.assert_array_equal(hanging.sensor_matrix, [[1.0, 0.0], [-1.0, 1.0]])


def test_given_a_batch_when_converted_or_solved_then_every_row_alone_and_a_bad_one_is_named(planar):
    batch = np.random.default_rng(3).uniform(0.2, 1.0, (4, 5, 2))
    lengths = 1.0, 0.9
    methods = sum(conversions(JointMap(planar)), ()) + (lambda points: inverse(points, lengths),)
    for method in methods:
        rows = np.array([[method(pair) for pair in row] for row in batch])
        np.testing.assert_allclose(method(batch), rows, rtol=1e-15, atol=1e-15)
    batch[1, 2] = 7.5, 0.25
    for bad in (batch, batch[1]):
        pytest.raises(UnreachableError, inverse, bad, lengths).match(r'\(7.5, 0.25\)')


@given(SHARE, BEARING, st.booleans(), LENGTH, LENGTH)
def test_given_a_reachable_point_when_solved_then_the_tip_is_there(share, bearing, up, l_1, l_2):
    radius = abs(l_1 - l_2) + share * (l_1 + l_2 - abs(l_1 - l_2))
    point = radius * np.array([math.cos(bearing), math.sin(bearing)])
    q = inverse(point, (l_1, l_2), 'positive' if up else 'negative')
    np.testing.assert_allclose(forward(q, (l_1, l_2)), point, atol=1e-12)
    assert q[1] >= 0.0 if up else q[1] <= 0.0


def test_given_a_point_out_of_reach_or_a_singularity_when_solved_then_the_error_says_so():
    for point in ((2.001, 0.0), (0.1, 0.1), (math.nan, 1.0), (0.5, math.inf), (1e308, 1e308)):
        with pytest.raises(UnreachableError, match=r'out of reach.*\[0.4, 2\] m'):
            inverse(point, (1.2, 0.8))
    for q_2 in (0.0, 5e-4, math.pi, -math.pi):
        pytest.raises(UnreachableError, refuse_singular, np.array([0.3, q_2])).match('singularity')
    refuse_singular(np.array([0.3, 2e-3]))


def weights_of(phi, box):
    rho = np.full(8, np.nan)
    polytope.paper_weights(tuple(phi), np.ascontiguousarray(box, float), rho)
    return rho


@given(ANYWHERE, ANYWHERE, ANYWHERE, st.floats(-0.2, 0.9))
def test_given_a_point_anywhere_then_eqs_11_and_12_form_the_nearest_one(a, b, c, s_min):
    box = sinc_box(s_min) * [[1.0], [1.0], [0.9]]
    rho, vertices = weights_of((a, b, c), box), np.array(list(product(*box)))
    assert rho.min() >= 0.0 and rho.sum() == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(rho, weights((a, b, c), box), rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(rho @ vertices, np.clip((a, b, c), *box.T), atol=1e-14)


@given(st.floats(-20.0, 20.0) | st.sampled_from([0.0, 1e-300, 0.99999e-4, 1e-4, 1.00001e-4]), ANGLE)
def test_given_angles_when_scheduled_then_eqs_6_and_9_hold_also_near_zero(one, two):
    phi = polytope.paper_scheduling(one, two)
    assert phi[0] == math.cos(one - two)
    series = 1.0 - one**2 / 6.0 if abs(one) < 1e-4 else math.sin(one) / one
    assert phi[1] == pytest.approx(series, rel=1e-14, abs=1e-15)
    assert phi[1] * one == pytest.approx(math.sin(one), abs=1e-14)
    assert phi[2] * two == pytest.approx(math.sin(two), abs=1e-15)


def test_given_phi_1_of_zero_when_b_is_interpolated_then_it_is_1_83_times_the_arms(paper_model):
    box, theta = sinc_box(-0.2), (math.pi / 4, -math.pi / 4)  # phi1 = cos(pi/2)
    _, b = vertex_matrices(box, paper_model.constants())
    interpolated = np.tensordot(weights_of(scheduling(theta), box), b, 1)[2:]
    true = np.linalg.inv(inertia(theta, paper_model.constants()))
    np.testing.assert_allclose(np.diag(interpolated) / np.diag(true), 1.83, atol=0.01)


def area(corners):
    x, y = corners.T
    return 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_given_the_quadrangle_of_all_inertias_then_it_is_hardly_larger_than_their_arc(planar):
    c = planar.constants()
    corners = polytope.inverse_inertia_quadrangle(c)
    s = c.rotor_coupling + c.coupling * np.linspace(-1.0, 1.0, 2001)
    det = c.inertia[0] * c.inertia[1] - s**2
    arc = np.column_stack([1.0 / det, s / det])
    assert area(corners) < 1.1 * area(arc)
    np.testing.assert_allclose(corners[[0, 3]], arc[[0, -1]], rtol=1e-12)


def in_region(arm, shares):
    """Angles whose slopes fill the arm's region, on both sides of the vertical."""
    rest = 0.0 if arm.orientation == 'upright' else math.pi
    return rest + np.array(shares) * np.arccos(arm.cos_min)


@settings(max_examples=50)
@given(SHARES)
def test_given_a_configuration_in_the_region_when_combined_then_16_vertices_are_it(arms, shares):
    for arm in arms:
        c, theta = arm.constants(), in_region(arm, shares)
        xi = inertia(theta, c)
        point = np.array([1.0, xi[0, 1]]) / np.linalg.det(xi)
        corners = polytope.inverse_inertia_quadrangle(c)
        scale = np.abs(corners).max(axis=0)
        equations = np.vstack([(corners / scale).T, np.ones(4)])
        corner, rest = nnls(equations, [*point / scale, 1.0])  # a convex combination
        assert rest < 1e-12
        low, high = polytope.slope_range(arm)
        share = (np.cos(theta) - low) / (high - low)
        rho = np.einsum('i,j,k->ijk', corner, *([1.0 - v, v] for v in share)).ravel()
        assert rho.min() >= -1e-12
        vertices = polytope.state_spaces(polytope.exact_vertices(arm), c)
        a, b = (np.tensordot(rho, matrices, 1) for matrices in vertices)
        inverse_xi = np.linalg.inv(xi)
        slope = inverse_xi @ np.diag(c.gravity * np.cos(theta))
        np.testing.assert_allclose(a[2:, :2], slope, atol=1e-6 * np.abs(slope).max())
        np.testing.assert_allclose(b[2:], inverse_xi, atol=1e-6 * np.abs(inverse_xi).max())


@given(SHARES, SHARES)
def test_given_angle_and_estimate_in_the_region_then_the_slope_is_in_the_hull(arms, true, wrong):
    for arm in arms:
        low, high = polytope.slope_range(arm)
        theta, guess = in_region(arm, true), in_region(arm, wrong)
        gap = theta - guess
        apart = np.abs(gap) > 1e-6
        slope = (np.sin(theta) - np.sin(guess))[apart] / gap[apart]
        assert np.all(slope >= low[apart] - 1e-9) and np.all(slope <= high[apart] + 1e-9)


def test_given_both_orientations_when_slopes_are_bounded_then_they_mirror(paper_model):
    upright = replace(paper_model, cos_min=(0.3, 0.5))
    np.testing.assert_array_equal(polytope.slope_range(upright), [[0.3, 0.5], [1.0, 1.0]])
    hanging = replace(upright, orientation='hanging')
    np.testing.assert_array_equal(polytope.slope_range(hanging), [[-1.0, -1.0], [-0.3, -0.5]])


def lpv_right_side(x, u, push=(0.0, 0.0)):
    """Eq. (25) with Table 1: an inertia is 8.33 by eq. (2), not 4.58 as printed in eq. (5)."""
    ranges, total = ((-1.0, 1.0), (-0.2, 1.0), (-0.2, 1.0)), np.array([0.0, 0.0, *push])
    for rho, phi in zip(weights(scheduling(x), ranges), product(*ranges)):
        xi = [[8.33, 2.5 * phi[0]], [2.5 * phi[0], 1.66]]
        force = np.array([98.0 * phi[1], 24.5 * phi[2]]) * x[:2] + u
        total += rho * np.concatenate([x[2:], np.linalg.solve(xi, force)])
    return total


@given(STATE, EFFORT)
def test_given_any_state_then_the_lpv_plant_is_eq_25(paper_model, state, effort):
    x, u, rho = np.array(state), np.array(effort), weights_of(scheduling(state), sinc_box(-0.2))
    a, b = vertex_matrices(sinc_box(-0.2), paper_model.constants(False))
    got = np.tensordot(rho, a @ x + b @ u, 1)
    np.testing.assert_allclose(got, lpv_right_side(x, u), rtol=1e-11, atol=1e-11)


def test_given_a_push_when_the_lpv_plant_steps_then_it_is_runge_kutta(paper_arm, paper_model):
    x, u, push, dt = np.array([0.3, -0.2, 0.5, -0.4]), (20.0, -7.0), (0.14, -0.05), 0.01
    rates = [lpv_right_side(x, u, push)]
    for part in (dt / 2, dt / 2, dt):
        rates.append(lpv_right_side(x + part * rates[-1], u, push))
    expected = x + dt / 6 * np.array([1, 2, 2, 1]) @ rates
    joints = JointMap(paper_model)
    plant = PaperPlant(paper_arm, Scenario('', 1.0, 0, (), (), plant='lpv', sinc_min=-0.2))
    motion = np.array([joints.joint_position(x[:2]), joints.joint_velocity(x[2:])])
    plant.advance(motion, joints.joint_torque(u), joints.joint_velocity(push), dt, 1)
    np.testing.assert_allclose(joints.absolute_position(motion[0]), expected[:2], atol=1e-13)
    np.testing.assert_allclose(joints.absolute_velocity(motion[1]), expected[2:], atol=1e-13)


def test_given_vertices_when_augmented_then_eqs_35_to_37_hold_and_47_has_a_solution(planar):
    a, b = vertex_matrices(sinc_box(-0.2), planar.constants(coriolis=False))
    d, s = paper_descriptor(planar, sinc_box(-0.2)), JointMap(planar).sensor_matrix
    np.testing.assert_array_equal(d.e, np.diag([1, 1, 1, 1, 0, 0]))
    df = np.eye(4)[:, :2]
    np.testing.assert_array_equal(d.c, np.hstack([np.kron(np.eye(2), s), df]))
    np.testing.assert_array_equal(d.bf, [[0, 0]] * 4 + [[1, 0], [0, 1]])
    np.testing.assert_array_equal(d.bd.ravel(), [0, 0, *planar.disturbance_direction, 0, 0])
    # Eq. (36) row by row: x' = A x + B u + Bd d, and 0 = -f + f.
    x, f, u = np.split(np.random.default_rng(5).normal(size=8), [4, 6])
    for i in range(8):
        right = d.a[i] @ np.concatenate([x, f]) + d.b[i] @ u + d.bf @ f
        np.testing.assert_allclose(right[:4], a[i] @ x + b[i] @ u, rtol=1e-12)
        np.testing.assert_array_equal(right[4:], 0.0)
    assert np.linalg.matrix_rank(np.vstack([d.e, d.c])) == 6  # every vertex is causal, y shows f


def test_given_a_shipped_arm_when_converted_back_then_it_is_the_same(arm, planar, gains):
    again = planar_model(two_link_arm(planar))
    assert planar.sha256() == gains.arm_sha256
    assert again.joint_names == arm.joint_names and again.sensor_names == arm.sensor_names
    for field in ('rotor', 'viscous', 'coulomb', 'zero_angle', 'gravity', 'cos_min'):
        one, other = getattr(again, field), getattr(planar, field)
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12, err_msg=field)
    links = [[list(vars(link).values()) for link in one.links] for one in (again, planar)]
    np.testing.assert_allclose(*links, rtol=1e-12, atol=1e-12)
    assert (again.arrangement, again.orientation) == (planar.arrangement, planar.orientation)


def test_given_an_arm_when_converted_then_it_may_turn_but_needs_a_region(paper_arm, paper_model):
    turned = replace(paper_arm, base_orientation=(0.0, 0.0, 0.7))
    assert planar_model(turned) == planar_model(paper_arm)
    origin, plane = plane_of(paper_arm)
    np.testing.assert_allclose(plane, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-12)
    np.testing.assert_array_equal(origin, 0.0)
    arm = replace(paper_arm, lpv=None)
    pytest.raises(ConfigError, planar_model, arm).match('lpv: is missing')
    assert planar_links(arm).links == paper_model.links
    with pytest.raises(ConfigError, match='sensor_matrix'):
        planar_model(replace(paper_arm, sensor_matrix=((1.0, 0.0), (0.5, 1.0))))


def test_given_an_arm_that_is_not_planar_when_converted_then_the_reason_is_said(paper_arm):
    assert is_planar(paper_arm)
    one, two = paper_arm.joints
    beside = replace(one.link, first_moment=(5.0, 0.0, 0.5))
    for change in (
        {'joints': (one, two, replace(two, name='x'))},
        {'joints': (one, replace(two, orientation=(0.3, 0.0, 0.0)))},  # skew axes
        {'tip': (0.0, 0.0, 0.0)},  # no length
        {'joints': (replace(one, link=beside), two)},  # a mass beside its link
        {'base_orientation': (np.pi / 2, 0.0, 0.0)},  # no vertical plane
    ):
        arm = replace(paper_arm, **change)
        assert not is_planar(arm), change
        with pytest.raises(ConfigError, match='lpv: is for planar arms of two links: '):
            planar_model(arm)
