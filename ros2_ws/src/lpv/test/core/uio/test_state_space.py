"""The paper's LPV model, eqs. (13)-(31), and its descriptor form, (35)-(37)."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv.core.simulation.paper_plant import PaperPlant
from lpv.core.simulation.scenario import Scenario
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import sinc_box, vertex_matrices
from lpv.core.uio.model.state_space import (
    Descriptor,
    disturbance_matrix,
    lpv_acceleration,
    output_matrices,
)

ANGLE, RATE, TORQUE = st.floats(-6.0, 6.0), st.floats(-5.0, 5.0), st.floats(-100.0, 100.0)


@pytest.fixture(scope='module')
def published(paper_model):
    """Vertices over the published box."""
    return vertex_matrices(sinc_box(-0.2), paper_model.constants(coriolis=False))


def lpv_right_side(x, u, push=(0.0, 0.0)):
    """Eq. (25) with the numbers of Table 1, written again without the code under test."""
    phi = (math.cos(x[0] - x[1]), np.sinc(x[0] / np.pi), np.sinc(x[1] / np.pi))
    ranges = ((-1.0, 1.0), (-0.2, 1.0), (-0.2, 1.0))
    alpha = [min(max((high - p) / (high - low), 0.0), 1.0) for p, (low, high) in zip(phi, ranges)]
    total = np.array([0.0, 0.0, *push])
    for i in range(8):
        bits = [i >> 2 & 1, i >> 1 & 1, i & 1]
        rho = np.prod([1 - a if bit else a for a, bit in zip(alpha, bits)])
        vertex = [r[bit] for r, bit in zip(ranges, bits)]
        xi = [[8.33, 2.5 * vertex[0]], [2.5 * vertex[0], 1.66]]
        force = np.array([98.0 * vertex[1], 24.5 * vertex[2]]) * x[:2] + u
        total += rho * np.concatenate([x[2:], np.linalg.solve(xi, force)])
    return total


@given(ANGLE, ANGLE, RATE, RATE, TORQUE, TORQUE)
def test_given_any_state_when_the_lpv_plant_is_evaluated_then_it_is_eq_25(
    published, th_1, th_2, v_1, v_2, u_1, u_2
):
    x, u, got = np.array([th_1, th_2, v_1, v_2]), np.array([u_1, u_2]), np.empty(2)
    lpv_acceleration(x, u, (*published, sinc_box(-0.2)), got)
    np.testing.assert_allclose(got, lpv_right_side(x, u)[2:], rtol=1e-11, atol=1e-11)


def test_given_torque_and_disturbance_when_the_lpv_plant_steps_then_it_is_runge_kutta(
    paper_arm, paper_model
):
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


def test_given_both_arrangements_when_outputs_and_disturbance_are_formed_then_eqs_29_to_31_hold(
    paper_model, real_model
):
    c, df = output_matrices(paper_model)
    np.testing.assert_array_equal(c, np.eye(4))
    np.testing.assert_array_equal(df, np.eye(4)[:, :2])
    c, df = output_matrices(real_model)
    np.testing.assert_array_equal(c, np.kron(np.eye(2), [[1.0, 0.0], [-1.0, 1.0]]))
    # In absolute coordinates a fault of encoder 1 shifts both angles: Df = [[1, 0], [1, 1], ...].
    np.testing.assert_allclose(np.linalg.inv(c) @ df, [[1, 0], [1, 1], [0, 0], [0, 0]])
    np.testing.assert_array_equal(disturbance_matrix(paper_model), [[0], [0], [0.7], [0]])
    np.testing.assert_array_equal(disturbance_matrix(real_model), [[0], [0], [1.0], [0]])


def test_given_vertices_when_augmented_then_eqs_35_to_37_hold_and_47_has_a_solution(arm):
    a, b = vertex_matrices(sinc_box(-0.2), arm.constants(coriolis=False))
    d, (c, df) = Descriptor(a, b, arm), output_matrices(arm)
    np.testing.assert_array_equal(d.e, np.diag([1, 1, 1, 1, 0, 0]))
    np.testing.assert_array_equal(d.c, np.hstack([c, df]))
    np.testing.assert_array_equal(d.bf, [[0, 0]] * 4 + [[1, 0], [0, 1]])
    np.testing.assert_array_equal(d.bd, np.vstack([disturbance_matrix(arm), np.zeros((2, 1))]))
    # Eq. (36) row by row: x' = A x + B u + Bd d, and 0 = -f + f.
    x, f, u = np.split(np.random.default_rng(5).normal(size=8), [4, 6])
    for i in range(8):
        right = d.a[i] @ np.concatenate([x, f]) + d.b[i] @ u + d.bf @ f
        np.testing.assert_allclose(right[:4], a[i] @ x + b[i] @ u, rtol=1e-12)
        np.testing.assert_array_equal(right[4:], 0.0)
    assert np.linalg.matrix_rank(np.vstack([d.e, d.c])) == 6  # every vertex is causal, y shows f
