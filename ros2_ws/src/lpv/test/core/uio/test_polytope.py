"""Both polytopes: weights, vertices, and which of them is the arm."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from lpv.core.uio.model import polytope

ANYWHERE = st.floats(-1e6, 1e6) | st.floats(-1.0, 1.0)
ANGLE = st.floats(-math.pi, math.pi)
SHARE = st.floats(-1.0, 1.0)


def weights_of(phi, box):
    rho = np.full(8, np.nan)
    polytope.paper_weights(*phi, np.ascontiguousarray(box, float), rho)
    return rho


def inertia(theta, arm):
    """Xi(theta), written out again from the parameters."""
    c = arm.constants()
    off = c.rotor_coupling + c.coupling * math.cos(theta[0] - theta[1])
    return np.array([[c.inertia[0], off], [off, c.inertia[1]]])


@given(ANYWHERE, ANYWHERE, ANYWHERE, st.floats(-0.2, 0.9))
def test_given_a_point_anywhere_when_weighted_then_the_nearest_point_of_the_box_is_formed(
    a, b, c, s_min
):
    box = polytope.sinc_box(s_min)
    rho = weights_of((a, b, c), box)
    assert rho.min() >= 0.0 and rho.sum() == pytest.approx(1.0, abs=1e-14)
    nearest = np.clip((a, b, c), *box.T)
    np.testing.assert_allclose(rho @ polytope.paper_vertices(box), nearest, atol=1e-14)


def test_given_eqs_11_and_12_when_written_out_then_the_weights_are_theirs_and_vertices_in_order():
    box = np.array([[-1.0, 1.0], [-0.2, 1.0], [0.1, 0.9]])
    a_1, a_2, a_3 = (1 - 0.3) / 2, (1 - 0.5) / 1.2, (0.9 - 0.25) / 0.8
    expected = [x * y * z for x in (a_1, 1 - a_1) for y in (a_2, 1 - a_2) for z in (a_3, 1 - a_3)]
    np.testing.assert_allclose(weights_of((0.3, 0.5, 0.25), box), expected, rtol=1e-14)
    vertices = polytope.paper_vertices(polytope.sinc_box(-0.2))
    np.testing.assert_array_equal(vertices[:, 0], [-1.0] * 4 + [1.0] * 4)
    np.testing.assert_array_equal(vertices[[0, 7]], [[-1.0, -0.2, -0.2], [1.0, 1.0, 1.0]])
    alone = [weights_of(vertex, polytope.sinc_box(-0.2)) for vertex in vertices]
    np.testing.assert_array_equal(alone, np.eye(8))


@given(st.floats(-20.0, 20.0) | st.sampled_from([0.0, 1e-300, 0.99999e-4, 1e-4, 1.00001e-4]), ANGLE)
def test_given_angles_when_scheduled_then_eqs_6_and_9_hold_also_where_the_series_ends(one, two):
    assert polytope.sinc(one) == pytest.approx(np.sinc(one / np.pi), rel=1e-14, abs=1e-15)
    phi = polytope.paper_scheduling(one, two)
    assert phi[0] == math.cos(one - two)
    assert phi[1] * one == pytest.approx(math.sin(one), abs=1e-14)
    assert phi[2] * two == pytest.approx(math.sin(two), abs=1e-15)


def test_given_phi_1_of_zero_when_b_is_interpolated_then_it_is_1_83_times_the_arms(paper_model):
    box, theta = polytope.sinc_box(-0.2), (math.pi / 4, -math.pi / 4)  # phi1 = cos(pi/2)
    _, b = polytope.vertex_matrices(box, paper_model.constants())
    rho = weights_of(polytope.paper_scheduling(*theta), box)
    interpolated = np.tensordot(rho, b, 1)[2:]
    true = np.linalg.inv(inertia(theta, paper_model))
    np.testing.assert_allclose(np.diag(interpolated) / np.diag(true), 1.83, atol=0.01)


def cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def test_given_the_quadrangle_when_compared_with_the_arc_then_it_holds_it_and_is_no_bounding_box(
    arm,
):
    c = arm.constants()
    corners = polytope.inverse_inertia_quadrangle(c)
    s = c.rotor_coupling + c.coupling * np.linspace(-1.0, 1.0, 2001)
    det = c.inertia[0] * c.inertia[1] - s**2
    arc, size = np.column_stack([1.0 / det, s / det]), np.prod(np.ptp(corners, axis=0))
    side = np.roll(corners, -1, axis=0) - corners
    turns = cross(side, np.roll(side, -1, axis=0))
    inside = cross(side[:, None], arc - corners[:, None])
    assert np.all(np.sign(turns[0]) * turns > 1e-3 * size)  # convex
    assert np.all(np.sign(turns[0]) * inside > -1e-12 * size)
    x, y = corners.T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert area < 0.7 * np.prod(np.ptp(arc, axis=0))
    np.testing.assert_allclose(corners[[0, 3]], arc[[0, -1]], rtol=1e-12)


def in_region(arm, *shares):
    """Angles whose slopes fill the arm's region, on both sides of the vertical."""
    rest = 0.0 if arm.orientation == 'upright' else math.pi
    return rest + np.array(shares) * np.arccos(arm.cos_min)


@settings(max_examples=50)
@given(SHARE, SHARE)
def test_given_a_configuration_in_the_region_when_combined_then_16_vertices_are_the_arm(
    paper_model, real_model, share_1, share_2
):
    for arm in (paper_model, real_model):
        c, theta = arm.constants(), in_region(arm, share_1, share_2)
        xi = inertia(theta, arm)
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
        pairs = [polytope.exact_state_space(v, c) for v in polytope.exact_vertices(arm)]
        a, b = (np.tensordot(rho, [pair[i] for pair in pairs], 1) for i in range(2))
        inverse = np.linalg.inv(xi)
        slope = inverse @ np.diag(c.gravity * np.cos(theta))
        np.testing.assert_allclose(a[2:, :2], slope, atol=1e-6 * np.abs(slope).max())
        np.testing.assert_allclose(b[2:], inverse, atol=1e-6 * np.abs(inverse).max())


@given(SHARE, SHARE, SHARE, SHARE)
def test_given_angle_and_estimate_in_the_region_when_sines_differ_then_the_slope_is_in_the_hull(
    paper_model, real_model, one, two, three, four
):
    for arm in (paper_model, real_model):
        low, high = polytope.slope_range(arm)
        theta, guess = in_region(arm, one, two), in_region(arm, three, four)
        gap = theta - guess
        apart = np.abs(gap) > 1e-6
        slope = (np.sin(theta) - np.sin(guess))[apart] / gap[apart]
        assert np.all(slope >= low[apart] - 1e-9) and np.all(slope <= high[apart] + 1e-9)


def test_given_both_orientations_when_slopes_are_bounded_then_they_mirror(paper_model):
    upright = replace(paper_model, cos_min=(0.3, 0.5))
    np.testing.assert_array_equal(polytope.slope_range(upright), [[0.3, 0.5], [1.0, 1.0]])
    hanging = replace(upright, orientation='hanging')
    np.testing.assert_array_equal(polytope.slope_range(hanging), [[-1.0, -1.0], [-0.3, -0.5]])
