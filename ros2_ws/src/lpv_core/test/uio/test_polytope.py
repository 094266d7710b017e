"""Both polytopes: weights, vertices, and which of them is the arm."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from lpv_core.uio.model.polytope import (
    exact_state_space,
    exact_vertices,
    inverse_inertia_quadrangle,
    paper_scheduling,
    paper_vertices,
    paper_weights,
    sinc,
    sinc_box,
    slope_range,
    vertex_matrices,
)

UNIT = st.floats(0.0, 1.0)
ANGLE = st.floats(-math.pi, math.pi)


def weights_of(phi, box):
    rho = np.full(8, np.nan)
    paper_weights(*phi, np.ascontiguousarray(box, float), rho)
    return rho


def inertia(theta, arm):
    """Xi(theta), written out again from the parameters."""
    c = arm.constants()
    off = c.rotor_coupling + c.coupling * math.cos(theta[0] - theta[1])
    return np.array([[c.inertia[0], off], [off, c.inertia[1]]])


# ------------------------------------------------------------------ the paper's box


@given(UNIT, UNIT, UNIT, st.floats(-0.2, 0.9))
def test_given_a_point_in_the_box_when_weighted_then_the_weights_form_it(a, b, c, s_min):
    box = sinc_box(s_min)
    phi = box[:, 0] + np.array([a, b, c]) * (box[:, 1] - box[:, 0])
    rho = weights_of(phi, box)
    assert rho.min() >= 0.0
    assert rho.sum() == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(rho @ paper_vertices(box), phi, atol=1e-14)


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_given_a_point_anywhere_when_weighted_then_the_nearest_point_of_the_box_is_formed(a, b, c):
    box = sinc_box(-0.2)
    rho = weights_of((a, b, c), box)
    assert rho.min() >= 0.0
    np.testing.assert_allclose(rho @ paper_vertices(box), np.clip((a, b, c), *box.T), atol=1e-14)


@pytest.mark.parametrize('vertex', range(8))
def test_given_a_vertex_when_weighted_then_it_alone_counts(vertex):
    box = sinc_box(-0.2)
    np.testing.assert_array_equal(weights_of(paper_vertices(box)[vertex], box), np.eye(8)[vertex])


def test_given_eqs_11_and_12_when_written_out_then_the_weights_are_theirs():
    box = np.array([[-1.0, 1.0], [-0.2, 1.0], [0.1, 0.9]])
    phi = (0.3, 0.5, 0.25)
    a_1, a_2, a_3 = (1 - 0.3) / 2, (1 - 0.5) / 1.2, (0.9 - 0.25) / 0.8
    expected = [
        a_1 * a_2 * a_3,
        a_1 * a_2 * (1 - a_3),
        a_1 * (1 - a_2) * a_3,
        a_1 * (1 - a_2) * (1 - a_3),
        (1 - a_1) * a_2 * a_3,
        (1 - a_1) * a_2 * (1 - a_3),
        (1 - a_1) * (1 - a_2) * a_3,
        (1 - a_1) * (1 - a_2) * (1 - a_3),
    ]
    np.testing.assert_allclose(weights_of(phi, box), expected, rtol=1e-14)


def test_given_the_vertices_when_listed_then_the_first_four_have_the_smallest_phi_1():
    vertices = paper_vertices(sinc_box(-0.2))
    np.testing.assert_array_equal(vertices[:4, 0], -1.0)
    np.testing.assert_array_equal(vertices[4:, 0], 1.0)
    np.testing.assert_array_equal(vertices[0], [-1.0, -0.2, -0.2])
    np.testing.assert_array_equal(vertices[7], [1.0, 1.0, 1.0])


@given(st.floats(-20.0, 20.0))
def test_given_an_angle_when_its_sinc_is_taken_then_it_is_sine_over_angle(angle):
    assert sinc(angle) == pytest.approx(np.sinc(angle / np.pi), rel=1e-14, abs=1e-15)
    assert sinc(-angle) == sinc(angle)
    assert sinc(angle) >= -0.2173


def test_given_the_border_of_the_series_when_sinc_is_taken_then_both_sides_agree():
    for angle in (0.0, 1e-300, 0.99999e-4, 1e-4, 1.00001e-4):
        assert sinc(angle) == pytest.approx(np.sinc(angle / np.pi), rel=1e-15)


@given(ANGLE, ANGLE)
def test_given_angles_when_scheduled_then_eqs_6_and_9_hold(theta_1, theta_2):
    phi = paper_scheduling(theta_1, theta_2)
    assert phi[0] == math.cos(theta_1 - theta_2)
    assert phi[1] * theta_1 == pytest.approx(math.sin(theta_1), abs=1e-15)
    assert phi[2] * theta_2 == pytest.approx(math.sin(theta_2), abs=1e-15)


def test_given_phi_1_of_zero_when_b_is_interpolated_then_it_is_1_83_times_the_arms(paper_model):
    c, box = paper_model.constants(), sinc_box(-0.2)
    _, b = vertex_matrices(box, c)
    phi = paper_scheduling(math.pi / 4, -math.pi / 4)  # phi1 = cos(pi/2)
    interpolated = np.tensordot(weights_of(phi, box), b, 1)[2:]
    true = np.linalg.inv(inertia((math.pi / 4, -math.pi / 4), paper_model))
    ratio = np.diag(interpolated) / np.diag(true)
    np.testing.assert_allclose(ratio, 1.83, atol=0.01)


# ------------------------------------------------------------------ the exact polytope


def test_given_the_quadrangle_when_walked_around_then_it_is_convex_and_holds_the_whole_arc(arm):
    c = arm.constants()
    corners = inverse_inertia_quadrangle(c)
    s = c.rotor_coupling + c.coupling * np.cos(np.linspace(0.0, np.pi, 2001))
    det = c.inertia[0] * c.inertia[1] - s**2
    arc = np.column_stack([1.0 / det, s / det])
    size = np.prod(np.ptp(corners, axis=0))
    turns, sides = [], []
    for i in range(4):
        a, b, d = corners[i], corners[(i + 1) % 4], corners[(i + 2) % 4]
        turns.append((b[0] - a[0]) * (d[1] - b[1]) - (b[1] - a[1]) * (d[0] - b[0]))
        sides.append((b[0] - a[0]) * (arc[:, 1] - a[1]) - (b[1] - a[1]) * (arc[:, 0] - a[0]))
    orientation = np.sign(turns[0])
    assert np.all(orientation * np.array(turns) > 1e-3 * size)
    assert np.all(orientation * np.array(sides) > -1e-12 * size)


def test_given_the_quadrangle_when_compared_with_the_bounding_box_then_it_is_smaller(arm):
    c = arm.constants()
    corners = inverse_inertia_quadrangle(c)
    s = c.rotor_coupling + c.coupling * np.linspace(-1.0, 1.0, 2001)
    det = c.inertia[0] * c.inertia[1] - s**2
    x, y = corners.T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert area < 0.7 * np.ptp(1.0 / det) * np.ptp(s / det)
    np.testing.assert_allclose(corners[0], [1.0 / det[0], s[0] / det[0]], rtol=1e-12)
    np.testing.assert_allclose(corners[3], [1.0 / det[-1], s[-1] / det[-1]], rtol=1e-12)


def in_region(arm, share_1, share_2):
    """Angles whose slopes fill the arm's region, on both sides of the vertical."""
    angles = []
    for share, near in zip((share_1, share_2), arm.cos_min):
        deviation = share * math.acos(near)  # share in [-1, 1]
        angles.append(deviation + (0.0 if arm.orientation == 'upright' else math.pi))
    return angles


SHARE = st.floats(-1.0, 1.0)


def test_given_both_orientations_when_slopes_are_bounded_then_they_mirror(paper_model):
    low, high = slope_range(replace(paper_model, cos_min=(0.3, 0.5)))
    np.testing.assert_array_equal([low, high], [[0.3, 0.5], [1.0, 1.0]])
    low, high = slope_range(replace(paper_model, cos_min=(0.3, 0.5), orientation='hanging'))
    np.testing.assert_array_equal([low, high], [[-1.0, -1.0], [-0.3, -0.5]])


def convex_weights(point, corners):
    """Convex combination of the quadrangle's corners, by linear programming."""
    found = linprog(
        np.zeros(4),
        A_eq=np.vstack([corners.T / np.abs(corners).max(axis=0)[:, None], np.ones(4)]),
        b_eq=[*(point / np.abs(corners).max(axis=0)), 1.0],
    )
    return found.x if found.success else None


@settings(max_examples=50)
@given(SHARE, SHARE)
def test_given_a_configuration_in_the_region_when_combined_then_16_vertices_are_the_arm(
    paper_model, real_model, share_1, share_2
):
    for arm in (paper_model, real_model):
        c, theta = arm.constants(), in_region(arm, share_1, share_2)
        inverse = np.linalg.inv(inertia(theta, arm))
        det = np.linalg.det(inertia(theta, arm))
        point = np.array([1.0 / det, inertia(theta, arm)[0, 1] / det])
        corner = convex_weights(point, inverse_inertia_quadrangle(c))
        assert corner is not None
        low, high = slope_range(arm)
        share = (np.cos(theta) - low) / (high - low)
        ends = [np.array([1.0 - v, v]) for v in share]
        rho = np.einsum('i,j,k->ijk', corner, *ends).ravel()
        assert rho.min() >= -1e-12
        pairs = [exact_state_space(v, c) for v in exact_vertices(arm)]
        a = sum(w * a_i for w, (a_i, _) in zip(rho, pairs))
        b = sum(w * b_i for w, (_, b_i) in zip(rho, pairs))
        slope = inverse @ np.diag([c.gravity[0], c.gravity[1]] * np.cos(theta))
        np.testing.assert_allclose(a[2:, :2], slope, atol=1e-6 * np.abs(slope).max())
        np.testing.assert_allclose(b[2:], inverse, atol=1e-6 * np.abs(inverse).max())


@given(SHARE, SHARE, SHARE, SHARE)
def test_given_angle_and_estimate_in_the_region_when_sines_differ_then_the_slope_is_in_the_hull(
    paper_model, real_model, one, two, three, four
):
    for arm in (paper_model, real_model):
        low, high = slope_range(arm)
        theta, guess = np.array(in_region(arm, one, two)), np.array(in_region(arm, three, four))
        gap = theta - guess
        apart = np.abs(gap) > 1e-6
        slope = (np.sin(theta) - np.sin(guess))[apart] / gap[apart]
        assert np.all(slope >= low[apart] - 1e-9)
        assert np.all(slope <= high[apart] + 1e-9)
