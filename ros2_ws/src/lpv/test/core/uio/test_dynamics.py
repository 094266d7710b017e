"""Rigid-body dynamics: inversion, and the formulas of both arms.

Torques of any planar arm are compared with the chain of Pinocchio in `test_serial_dynamics`.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from parts import energy

from lpv.core.support.errors import ConfigError
from lpv.core.uio.model.dynamics import acceleration, inverse_dynamics

ANGLE = st.floats(-math.pi, math.pi)
RATE = st.floats(-8.0, 8.0)
TORQUE = st.floats(-50.0, 50.0)


@given(ANGLE, ANGLE, RATE, RATE, TORQUE, TORQUE)
def test_given_any_state_when_it_moves_then_its_torques_come_back(
    paper_model, real_model, th_1, th_2, v_1, v_2, u_1, u_2
):
    for arm in (replace(paper_model, viscous=(0.3, 0.2), coulomb=(0.5, 0.4)), real_model):
        c = arm.constants()
        acc = acceleration(th_1, th_2, v_1, v_2, u_1, u_2, c)
        back = inverse_dynamics(th_1, th_2, v_1, v_2, *acc, c)
        assert back == pytest.approx((u_1, u_2), abs=1e-9)


def test_given_the_coriolis_term_dropped_when_links_turn_then_no_centripetal_torque_is_left(
    paper_model,
):
    c = paper_model.constants(coriolis=False)
    still = inverse_dynamics(0.3, -0.4, 0.0, 0.0, 0.1, 0.2, c)
    assert inverse_dynamics(0.3, -0.4, 3.0, -2.0, 0.1, 0.2, c) == pytest.approx(still, rel=1e-14)


def test_given_table_1_when_constants_are_formed_then_they_are_those_of_eq_2_not_eq_5(paper_model):
    c = paper_model.constants()
    assert c.inertia[0] == pytest.approx(10 * 0.25 + 5 * 1.0 + 0.83)  # 8.33; 4.58 as printed
    assert c.inertia[1] == pytest.approx(1.66)
    assert (c.coupling, c.rotor_coupling) == (pytest.approx(2.5), 0.0)
    np.testing.assert_allclose(c.gravity, [98.0, 24.5])


@given(ANGLE, ANGLE, RATE, RATE, st.floats(0.0, 20.0))
def test_given_a_payload_when_energy_is_taken_then_it_is_the_arm_and_a_point_mass_at_the_tip(
    paper_model, real_model, th_1, th_2, v_1, v_2, mass
):
    for arm in (paper_model, real_model):
        lengths, theta = np.array(arm.lengths), np.array([th_1, th_2])
        turn = lengths * np.array([np.cos(theta), -np.sin(theta)])
        tip_rate = turn @ (v_1, v_2)
        extra = 0.5 * mass * tip_rate @ tip_rate + mass * arm.gravity * turn[0].sum()
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
    expected = [1.2 * 2.5 + 1.5 * 0.83 + 0.9 * 5.0, 0.9 * 1.25 + 0.5 * 0.41]
    np.testing.assert_allclose(c.inertia, expected)
    assert c.coupling == pytest.approx(0.9 * 2.5)
    np.testing.assert_allclose(c.gravity, [9.8 * (1.2 * 5.0 + 0.9 * 5.0), 0.9 * 24.5])
    np.testing.assert_array_equal(paper_model.scaled().constants(), paper_model.constants())
    c = paper_model.scaled((1.2, 0.9), (1.5, 0.5)).constants()  # inertias about the joints
    np.testing.assert_allclose(c.inertia, [1.5 * (2.5 + 0.83) + 0.9 * 5.0, 0.5 * (1.25 + 0.41)])
