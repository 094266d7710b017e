"""Dynamics of serial chains against Pinocchio and against the two-link formulas."""

import math

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial_chains import pinocchio_model, random_chain, random_motion

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import payload_parameters, with_payload
from lpv.core.support.errors import SampleError
from lpv.core.uio.model.arm import ArmParameters, Link
from lpv.core.uio.model.dynamics import inverse_dynamics as two_link_inverse_dynamics
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import serial_from_planar

CASES = given(st.integers(0, 2**31), st.integers(2, 9))


def assert_equal(ours, reference):
    scale = max(1.0, float(np.abs(reference).max()))
    np.testing.assert_allclose(ours, reference, rtol=0.0, atol=1e-10 * scale)


@CASES
def test_given_any_chain_when_moved_then_torques_momentum_and_gravity_are_those_of_pinocchio(
    seed, joints
):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    model, ours = pinocchio_model(chain), SerialModel(chain)
    data = model.createData()
    assert_equal(ours.inverse_dynamics(q, v, a), pinocchio.rnea(model, data, q, v, a))
    mass = np.array(pinocchio.crba(model, data, q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    coriolis = pinocchio.computeCoriolisMatrix(model, data, q, v)
    gravity = pinocchio.computeGeneralizedGravity(model, data, q)
    momentum, force = ours.momentum_balance(q, v)
    assert_equal(ours.mass_matrix(q), mass)
    assert_equal(momentum, mass @ v)
    assert_equal(force, coriolis.T @ v - gravity)
    assert_equal(ours.gravity(q), gravity)
    gradient = pinocchio.computeGeneralizedGravityDerivatives(model, data, q)
    assert_equal(ours.gravity_gradient(q), gradient)


@CASES
def test_given_any_chain_when_moved_then_regressors_payload_and_inversion_fit_its_torques(
    seed, joints
):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    ours, phi = SerialModel(chain), chain.inertial.ravel()
    torque, (momentum, force) = ours.inverse_dynamics(q, v, a), ours.momentum_balance(q, v)
    matrix, (momentum_matrix, force_matrix) = ours.regressor(q, v, a), ours.momentum_regressor(q, v)
    assert_equal(matrix @ phi + chain.motor @ a, torque)
    assert_equal(momentum_matrix @ phi + chain.motor @ v, momentum)
    assert_equal(force_matrix @ phi, force)
    load = 1.5, (0.1, -0.2, 0.05), np.diag([0.02, 0.03, 0.04])
    loaded = SerialModel(with_payload(chain, *load)).inverse_dynamics(q, v, a)
    assert_equal(loaded, torque + matrix[:, -10:] @ payload_parameters(chain, *load))
    scale = np.linalg.cond(ours.mass_matrix(q)) * max(1.0, np.abs(a).max())
    assert np.abs(ours.acceleration(q, v, torque) - a).max() < 1e-12 * scale


@given(st.integers(0, 2**31))
def test_given_any_planar_arm_when_moved_then_its_chain_equals_the_two_link_formulas(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform([0.1, 0.1, 0.05, 0.1], [20.0, 2.0, 1.0, 2.0], (2, 4))
    inertia, ratio = rng.uniform(0.0, 0.01), rng.uniform(1.0, 50.0)
    # The rotor of motor 2 turns at q1' - r q2'; that of motor 1 at r q1'.
    rotor = inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2
    arm = ArmParameters(
        'random', tuple(Link(*map(float, size)) for size in sizes), gravity=rng.uniform(1.0, 20.0),
        rotor=rotor, viscous=(0.3, 0.2), coulomb=(0.5, 0.4),
        zero_angle=rng.uniform(-math.pi, math.pi))  # fmt: skip
    (q, v, a), joints = random_motion(seed, 2), JointMap(arm)
    rates = (*joints.absolute_velocity(v), *joints.absolute_velocity(a))
    absolute = two_link_inverse_dynamics(*joints.absolute_position(q), *rates, arm.constants())
    found = SerialModel(compile_chain(serial_from_planar(arm))).torque(q, v, a)
    assert_equal(found, joints.joint_torque(np.array(absolute)))


def test_given_load_dependent_friction_when_moved_then_it_grows_with_the_torque(paper_arm):
    chain, q, v = compile_chain(paper_arm), np.array([0.3, 0.4]), np.array([1.0, -1.0])
    friction = chain.friction.copy()
    friction[:, 2] = 0.1
    ours = SerialModel(chain._replace(friction=friction))
    rigid = ours.inverse_dynamics(q, v, np.zeros(2))
    extra = ours.torque(q, v, np.zeros(2)) - rigid
    np.testing.assert_allclose(extra, np.sign(v) * 0.1 * np.abs(rigid), rtol=0.01)


def test_given_a_wrong_sample_when_asked_then_it_is_named(paper_arm):
    ours = SerialModel(compile_chain(paper_arm))
    with pytest.raises(SampleError, match='v must have 2 numbers'):
        ours.inverse_dynamics([0.0, 0.0], [0.0], [0.0, 0.0])
    with pytest.raises(SampleError, match='q must be finite'):
        ours.gravity([0.0, math.nan])
