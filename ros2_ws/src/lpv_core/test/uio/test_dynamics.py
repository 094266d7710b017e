"""Rigid-body dynamics: conservation laws, inversion, and the formulas of both arms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from parts import energy

from lpv_core.support.errors import ConfigError
from lpv_core.uio.model.dynamics import acceleration, friction, inverse_dynamics, runge_kutta_step
from lpv_core.uio.model.joints import JointMap

ANGLE = st.floats(-math.pi, math.pi)
RATE = st.floats(-8.0, 8.0)
TORQUE = st.floats(-50.0, 50.0)


def frictionless(arm):
    return replace(arm, viscous=(0.0, 0.0), coulomb=(0.0, 0.0))


def roll(state, dt, steps, c, torque=(0.0, 0.0), push=(0.0, 0.0)):
    def slope(x):
        acc_1, acc_2 = acceleration(*x, *torque, c)
        return np.array([x[2], x[3], acc_1 + push[0], acc_2 + push[1]])

    state = np.array(state)
    for _ in range(steps):
        state = runge_kutta_step(slope, state, dt)
    return state


def inertia(theta, c):
    """Xi from what a unit acceleration costs at rest."""
    rest = np.array(inverse_dynamics(*theta, 0.0, 0.0, 0.0, 0.0, c))
    return np.column_stack(
        [
            np.array(inverse_dynamics(*theta, 0.0, 0.0, *unit, c)) - rest
            for unit in ((1.0, 0.0), (0.0, 1.0))
        ]
    )


def coriolis_torque(theta, rate, c):
    """O(theta, theta') theta' as inverse dynamics has it."""
    rest = np.array(inverse_dynamics(*theta, 0.0, 0.0, 0.0, 0.0, c))
    return np.array(inverse_dynamics(*theta, *rate, 0.0, 0.0, c)) - rest


# ------------------------------------------------------------------ conservation


def test_given_no_torque_no_friction_when_the_arm_falls_then_its_energy_stays(arm):
    c = frictionless(arm).constants()
    state = (0.4, -0.7, 1.5, -2.0)
    start = energy(*state, c)
    spread = c.gravity[0] + c.gravity[1]  # potential energy between its extremes, halved
    drift = []
    for _ in range(20):
        state = tuple(roll(state, 1e-3, 100, c))
        drift.append(abs(energy(*state, c) - start))
    assert max(drift) < 1e-6 * spread
    assert abs(state[0] - 0.4) > 0.5  # it did move


def test_given_half_the_step_when_integrated_then_the_error_falls_by_two_to_the_fourth(arm):
    c = frictionless(arm).constants()
    state, span = (0.4, -0.7, 1.5, -2.0), 0.4
    exact = roll(state, span / 1280, 1280, c)
    coarse = np.abs(roll(state, span / 40, 40, c) - exact).max()
    fine = np.abs(roll(state, span / 80, 80, c) - exact).max()
    assert 13.0 < coarse / fine < 19.0
    assert fine > 1e-13  # above rounding, so that the quotient means something


@given(ANGLE, ANGLE, RATE, RATE, TORQUE, TORQUE)
def test_given_any_state_when_it_moves_then_energy_changes_by_torque_and_friction_power(
    paper_model, real_model, th_1, th_2, v_1, v_2, u_1, u_2
):
    for arm in (replace(paper_model, viscous=(0.3, 0.2), coulomb=(0.5, 0.4)), real_model):
        c = arm.constants()
        acc = acceleration(th_1, th_2, v_1, v_2, u_1, u_2, c)
        flow = np.array([v_1, v_2, *acc])
        h = 1e-5 / (1.0 + np.abs(flow).max())
        state = np.array([th_1, th_2, v_1, v_2])
        rate = (energy(*(state + h * flow), c) - energy(*(state - h * flow), c)) / (2.0 * h)
        loss = np.dot(friction(v_1, v_2, c), (v_1, v_2))
        power = u_1 * v_1 + u_2 * v_2 - loss
        # Rounding of the difference quotient: eps * E / h.
        scale = abs(energy(*state, c)) + c.gravity[0]
        assert abs(rate - power) < 1e-15 * scale / h + 1e-6 * (1.0 + abs(power))


@given(ANGLE, ANGLE, RATE, RATE, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_given_any_motion_when_the_coriolis_matrix_is_read_off_then_xi_rate_minus_2o_is_skew(
    paper_model, real_model, th_1, th_2, v_1, v_2, x_1, x_2
):
    for arm in (paper_model, frictionless(real_model)):
        c = arm.constants()
        theta, rate, x = np.array([th_1, th_2]), np.array([v_1, v_2]), np.array([x_1, x_2])
        # Column j of O is linear in rate j alone: two motions with one moving link give all of it.
        o = np.column_stack(
            [
                coriolis_torque(theta, (1.0, 0.0), c) * v_1,
                coriolis_torque(theta, (0.0, 1.0), c) * v_2,
            ]
        )
        np.testing.assert_allclose(o @ rate, coriolis_torque(theta, rate, c), atol=1e-11)
        h = 1e-6
        xi_rate = (inertia(theta + h * rate, c) - inertia(theta - h * rate, c)) / (2.0 * h)
        form = x @ (xi_rate - 2.0 * o) @ x
        assert abs(form) < 1e-6 * (1.0 + x @ x) * (1.0 + np.abs(rate).max())


@given(ANGLE, ANGLE, RATE, RATE)
def test_given_any_motion_when_christoffel_symbols_are_formed_then_they_give_the_same_torque(
    paper_model, real_model, th_1, th_2, v_1, v_2
):
    for arm in (paper_model, frictionless(real_model)):
        c = arm.constants()
        theta, rate, h = np.array([th_1, th_2]), np.array([v_1, v_2]), 1e-5
        slope = [
            (inertia(theta + h * e, c) - inertia(theta - h * e, c)) / (2.0 * h) for e in np.eye(2)
        ]
        christoffel = np.zeros((2, 2))
        for i in range(2):
            for j in range(2):
                christoffel[i, j] = sum(
                    0.5 * (slope[k][i, j] + slope[j][i, k] - slope[i][j, k]) * rate[k]
                    for k in range(2)
                )
        np.testing.assert_allclose(
            christoffel @ rate, coriolis_torque(theta, rate, c), atol=1e-6 * (1.0 + rate @ rate)
        )


def test_given_the_coriolis_term_dropped_when_links_turn_then_no_centripetal_torque_is_left(
    paper_model,
):
    c = paper_model.constants(coriolis=False)
    still = inverse_dynamics(0.3, -0.4, 0.0, 0.0, 0.1, 0.2, c)
    assert inverse_dynamics(0.3, -0.4, 3.0, -2.0, 0.1, 0.2, c) == pytest.approx(still, rel=1e-14)
    full = inverse_dynamics(0.3, -0.4, 3.0, -2.0, 0.1, 0.2, paper_model.constants())
    swirl = 2.5 * math.sin(0.7)
    assert full[0] - still[0] == pytest.approx(swirl * 4.0, rel=1e-12)
    assert full[1] - still[1] == pytest.approx(-swirl * 9.0, rel=1e-12)


# ------------------------------------------------------------------ inversion


@given(ANGLE, ANGLE, RATE, RATE, TORQUE, TORQUE)
def test_given_an_acceleration_from_torques_when_inverted_then_the_torques_come_back(
    paper_model, real_model, th_1, th_2, v_1, v_2, u_1, u_2
):
    for arm in (paper_model, real_model):
        c = arm.constants()
        acc = acceleration(th_1, th_2, v_1, v_2, u_1, u_2, c)
        back = inverse_dynamics(th_1, th_2, v_1, v_2, *acc, c)
        assert back == pytest.approx((u_1, u_2), abs=1e-9)


def test_given_a_push_when_one_small_step_is_made_then_it_acts_as_an_acceleration(arm):
    c, dt = arm.constants(), 1e-8
    state = (0.2, 0.1, 0.0, 0.0)
    pushed = roll(state, dt, 1, c, push=(0.7, -0.3))
    free = roll(state, dt, 1, c)
    np.testing.assert_allclose((pushed - free)[2:] / dt, [0.7, -0.3], rtol=1e-4)


# ------------------------------------------------------------------ the paper's arm


def test_given_table_1_when_constants_are_formed_then_they_are_those_of_eq_2_not_eq_5(paper_model):
    c = paper_model.constants()
    assert c.inertia[0] == pytest.approx(10 * 0.25 + 5 * 1.0 + 0.83)  # 8.33
    assert c.inertia[0] == pytest.approx(8.33)
    assert c.inertia[0] != pytest.approx(4.58, abs=0.1)  # eqs. (5), (14), (15) as printed
    assert c.inertia[1] == pytest.approx(1.66)
    assert c.coupling == pytest.approx(2.5)
    assert c.rotor_coupling == 0.0
    assert c.gravity[0] == pytest.approx(98.0)
    assert c.gravity[1] == pytest.approx(24.5)


def test_given_eqs_2_and_3_written_out_when_evaluated_then_inverse_dynamics_is_the_same(
    paper_model,
):
    m_1, m_2, l_1, lc_1, lc_2, i_1, i_2, g = 10.0, 5.0, 1.0, 0.5, 0.5, 0.83, 0.41, 9.8
    rng = np.random.default_rng(2)
    for t_1, t_2, v_1, v_2, a_1, a_2 in rng.uniform(-3, 3, (20, 6)):
        u_1 = (
            (m_1 * lc_1**2 + m_2 * l_1**2 + i_1) * a_1
            + m_2 * l_1 * lc_2 * math.cos(t_1 - t_2) * a_2
            + m_2 * l_1 * lc_2 * math.sin(t_1 - t_2) * v_2**2
            - (m_1 * lc_1 + m_2 * l_1) * g * math.sin(t_1)
        )
        u_2 = (
            m_2 * l_1 * lc_2 * math.cos(t_1 - t_2) * a_1
            + (m_2 * lc_2**2 + i_2) * a_2
            - m_2 * l_1 * lc_2 * math.sin(t_1 - t_2) * v_1**2
            - m_2 * g * lc_2 * math.sin(t_2)
        )
        got = inverse_dynamics(t_1, t_2, v_1, v_2, a_1, a_2, paper_model.constants())
        assert got == pytest.approx((u_1, u_2), rel=1e-12, abs=1e-12)


def test_given_upright_and_hanging_when_at_rest_then_both_are_equilibria_and_only_one_stable(arm):
    c = arm.constants()
    for theta in (0.0, math.pi):
        assert acceleration(theta, theta, 0, 0, 0, 0, c) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert acceleration(0.1, 0.1, 0, 0, 0, 0, c)[0] > 0.0  # falls away from upright
    assert acceleration(math.pi + 0.1, math.pi + 0.1, 0, 0, 0, 0, c)[0] < 0.0  # swings back


# ------------------------------------------------------------------ the recorded arm


def recorded_arm_torque(q, v, a):
    """The identified model, joint coordinates, zero where the arm hangs down."""
    i_1, i_2 = 0.031887199591513114, 0.05086984812807257
    m_1, m_2, l_1 = 0.5234602302310271, 0.6255677234174437, 0.2
    r_1, r_2 = 0.2, 0.25569305436052964
    rotor, ratio, g = 6.287203962819607e-05, 6, 9.81
    viscous, coulomb = (0.001, 0.001), (0.16, 0.12)
    h = m_2 * l_1 * r_2
    m_12 = i_2 + h * math.cos(q[1]) - ratio * rotor
    mass = np.array(
        [
            [i_1 + i_2 + m_2 * l_1**2 + 2 * h * math.cos(q[1]) + (ratio**2 + 1) * rotor, m_12],
            [m_12, i_2 + ratio**2 * rotor],
        ]
    )
    quadratic = np.array(
        [-h * math.sin(q[1]) * (2 * v[0] * v[1] + v[1] ** 2), h * math.sin(q[1]) * v[0] ** 2]
    )
    lower = m_2 * r_2 * g * math.sin(q[0] + q[1])
    gravity = np.array([(m_1 * r_1 + m_2 * l_1) * g * math.sin(q[0]) + lower, lower])
    rub = [viscous[i] * v[i] + coulomb[i] * (2 / math.pi) * math.atan(100 * v[i]) for i in range(2)]
    return mass @ a + quadratic + gravity + rub


@given(ANGLE, ANGLE, RATE, RATE, RATE, RATE)
def test_given_joint_coordinates_when_the_recorded_arm_moves_then_the_identified_model_holds(
    real_model, q_1, q_2, v_1, v_2, a_1, a_2
):
    q, v, a = np.array([q_1, q_2]), np.array([v_1, v_2]), np.array([a_1, a_2])
    joints = JointMap(real_model)
    absolute = inverse_dynamics(
        *joints.absolute_position(q),
        *joints.absolute_velocity(v),
        *joints.absolute_velocity(a),
        real_model.constants(),
    )
    np.testing.assert_allclose(
        joints.joint_torque(np.array(absolute)),
        recorded_arm_torque(q, v, a),
        rtol=1e-11,
        atol=1e-12,
    )


# ------------------------------------------------------------------ friction, payload, scaling


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_given_any_rates_when_joints_rub_then_power_is_lost_and_never_gained(real_model, v_1, v_2):
    c = real_model.constants()
    torque = friction(v_1, v_2, c)
    lost = np.dot(torque, (v_1, v_2))
    joint = (v_1, v_2 - v_1)
    expected = sum(
        0.001 * w**2 + f * (2 / math.pi) * math.atan(100 * w) * w
        for w, f in zip(joint, (0.16, 0.12))
    )
    assert lost == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert lost >= -1e-12
    assert friction(-v_1, -v_2, c) == pytest.approx((-torque[0], -torque[1]), abs=1e-15)


def test_given_friction_when_the_arm_swings_freely_then_energy_falls_in_every_step(real_model):
    c = real_model.constants()
    state = (math.pi + 1.0, math.pi - 0.5, 0.0, 0.0)
    values = []
    for _ in range(50):
        values.append(energy(*state, c))
        state = tuple(roll(state, 1e-3, 10, c))
    assert np.all(np.diff(values) < 0.0)
    assert values[-1] > energy(math.pi, math.pi, 0.0, 0.0, c)


@given(ANGLE, ANGLE, RATE, RATE, st.floats(0.0, 20.0))
def test_given_a_payload_when_energy_is_taken_then_it_is_the_arm_and_a_point_mass_at_the_tip(
    paper_model, real_model, th_1, th_2, v_1, v_2, mass
):
    for arm in (paper_model, real_model):
        l_1, l_2 = arm.lengths
        tip_rate = np.array(
            [
                l_1 * math.cos(th_1) * v_1 + l_2 * math.cos(th_2) * v_2,
                -l_1 * math.sin(th_1) * v_1 - l_2 * math.sin(th_2) * v_2,
            ]
        )
        height = l_1 * math.cos(th_1) + l_2 * math.cos(th_2)
        extra = 0.5 * mass * tip_rate @ tip_rate + mass * arm.gravity * height
        loaded = energy(th_1, th_2, v_1, v_2, arm.with_payload(mass).constants())
        bare = energy(th_1, th_2, v_1, v_2, arm.constants())
        assert loaded == pytest.approx(bare + extra, rel=1e-10, abs=1e-9)


@pytest.mark.parametrize('mass', [-6.0, math.nan])
def test_given_an_impossible_payload_when_attached_then_it_is_refused_by_name(paper_model, mass):
    with pytest.raises(ConfigError, match='payload'):
        paper_model.with_payload(mass)


def test_given_factors_when_the_arm_is_scaled_then_each_constant_follows_its_link(paper_model):
    own = tuple(replace(b, inertia=i) for b, i in zip(paper_model.links, (0.83, 0.41)))
    about_center = replace(paper_model, links=own, inertia_reference='center_of_mass')
    c = about_center.scaled((1.2, 0.9), (1.5, 0.5)).constants()
    assert c.inertia[0] == pytest.approx(1.2 * 2.5 + 1.5 * 0.83 + 0.9 * 5.0)
    assert c.inertia[1] == pytest.approx(0.9 * 1.25 + 0.5 * 0.41)
    assert c.coupling == pytest.approx(0.9 * 2.5)
    assert c.gravity[0] == pytest.approx(9.8 * (1.2 * 5.0 + 0.9 * 5.0))
    assert c.gravity[1] == pytest.approx(0.9 * 24.5)
    np.testing.assert_array_equal(paper_model.scaled().constants(), paper_model.constants())
    c = paper_model.scaled((1.2, 0.9), (1.5, 0.5)).constants()  # inertias about the joints
    assert c.inertia[0] == pytest.approx(1.5 * (2.5 + 0.83) + 0.9 * 5.0)
    assert c.inertia[1] == pytest.approx(0.5 * (1.25 + 0.41))
