"""Dynamics of serial chains against Pinocchio and against the two-link formulas."""

import math

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial_chains import pinocchio_model, random_chain, random_motion

from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.serial_arm.dynamics.payload import payload_parameters, with_payload
from lpv_core.support.errors import SampleError
from lpv_core.uio.model.arm import ArmParameters, Link
from lpv_core.uio.model.dynamics import inverse_dynamics as two_link_inverse_dynamics
from lpv_core.uio.model.joints import JointMap
from lpv_core.uio.planar import serial_from_planar

CASES = given(st.integers(0, 2**31), st.integers(2, 9))


def assert_equal(ours, reference):
    scale = max(1.0, float(np.abs(reference).max()))
    np.testing.assert_allclose(ours, reference, rtol=0.0, atol=1e-10 * scale)


@CASES
def test_inverse_dynamics_equal_pinocchio(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    model = pinocchio_model(chain)
    expected = pinocchio.rnea(model, model.createData(), q, v, a)
    assert_equal(SerialModel(chain).inverse_dynamics(q, v, a), expected)


@CASES
def test_mass_matrix_and_momentum_balance_equal_pinocchio(seed, joints):
    chain, (q, v, _) = random_chain(seed, joints), random_motion(seed, joints)
    model, ours = pinocchio_model(chain), SerialModel(chain)
    data = model.createData()
    mass = np.array(pinocchio.crba(model, data, q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    coriolis = pinocchio.computeCoriolisMatrix(model, data, q, v)
    gravity = pinocchio.computeGeneralizedGravity(model, data, q)
    momentum, force = ours.momentum_balance(q, v)
    assert_equal(ours.mass_matrix(q), mass)
    assert_equal(momentum, mass @ v)
    assert_equal(force, coriolis.T @ v - gravity)
    assert_equal(ours.gravity(q), gravity)


@CASES
def test_gravity_gradient_equals_pinocchio_derivatives(seed, joints):
    chain, (q, _, _) = random_chain(seed, joints), random_motion(seed, joints)
    model = pinocchio_model(chain)
    expected = pinocchio.computeGeneralizedGravityDerivatives(model, model.createData(), q)
    assert_equal(SerialModel(chain).gravity_gradient(q), expected)


@CASES
def test_regressors_reproduce_torque_and_momentum_balance(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    ours, phi = SerialModel(chain), chain.inertial.ravel()
    momentum, force = ours.momentum_balance(q, v)
    momentum_matrix, force_matrix = ours.momentum_regressor(q, v)
    assert_equal(ours.regressor(q, v, a) @ phi + chain.motor @ a, ours.inverse_dynamics(q, v, a))
    assert_equal(momentum_matrix @ phi + chain.motor @ v, momentum)
    assert_equal(force_matrix @ phi, force)


@CASES
def test_forward_dynamics_undo_inverse_dynamics(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    ours = SerialModel(chain)
    back = ours.acceleration(q, v, ours.inverse_dynamics(q, v, a))
    scale = np.linalg.cond(ours.mass_matrix(q)) * max(1.0, np.abs(a).max())
    assert np.abs(back - a).max() < 1e-12 * scale


@CASES
def test_payload_adds_its_column_of_the_regressor(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    load = 1.5, (0.1, -0.2, 0.05), np.diag([0.02, 0.03, 0.04])
    loaded = SerialModel(with_payload(chain, *load)).inverse_dynamics(q, v, a)
    column = SerialModel(chain).regressor(q, v, a)[:, -10:] @ payload_parameters(chain, *load)
    assert_equal(loaded, SerialModel(chain).inverse_dynamics(q, v, a) + column)


def planar_chain(arm):
    return compile_chain(serial_from_planar(arm))


def rotor_terms(inertia, ratio):
    """The rotor of motor 2 turns at q1' - r q2'; that of motor 1 at r q1'."""
    return inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2


@given(st.integers(0, 2**31))
def test_two_link_chain_equals_the_two_link_formulas(seed):
    rng = np.random.default_rng(seed)
    links = tuple(
        Link(
            rng.uniform(0.1, 20.0),
            rng.uniform(0.1, 2.0),
            rng.uniform(0.05, 1.0),
            rng.uniform(0.1, 2.0),
        )
        for _ in range(2)
    )
    arm = ArmParameters(
        'random',
        links,
        gravity=rng.uniform(1.0, 20.0),
        rotor=rotor_terms(rng.uniform(0.0, 0.01), rng.uniform(1.0, 50.0)),
        viscous=(0.3, 0.2),
        coulomb=(0.5, 0.4),
        zero_angle=rng.uniform(-math.pi, math.pi),
    )
    q, v, a = random_motion(seed, 2)
    joints = JointMap(arm)
    absolute = two_link_inverse_dynamics(
        *joints.absolute_position(q),
        *joints.absolute_velocity(v),
        *joints.absolute_velocity(a),
        arm.constants(),
    )
    expected = joints.joint_torque(np.array(absolute))
    np.testing.assert_allclose(
        SerialModel(planar_chain(arm)).torque(q, v, a),
        expected,
        rtol=0.0,
        atol=1e-10 * max(1.0, np.abs(expected).max()),
    )


def test_load_dependent_friction_grows_with_the_torque(paper_like_chain):
    q, v = np.array([0.3, 0.4]), np.array([1.0, -1.0])
    friction = paper_like_chain.friction.copy()
    friction[:, 2] = 0.1
    ours = SerialModel(paper_like_chain._replace(friction=friction))
    rigid = ours.inverse_dynamics(q, v, np.zeros(2))
    extra = ours.torque(q, v, np.zeros(2)) - rigid
    np.testing.assert_allclose(extra, np.sign(v) * 0.1 * np.abs(rigid), rtol=0.01)


def test_wrong_sample_is_named(paper_like_chain):
    ours = SerialModel(paper_like_chain)
    with pytest.raises(SampleError, match='v must have 2 numbers'):
        ours.inverse_dynamics([0.0, 0.0], [0.0], [0.0, 0.0])
    with pytest.raises(SampleError, match='q must be finite'):
        ours.gravity([0.0, math.nan])


@pytest.fixture
def paper_like_chain():
    links = Link(10.0, 1.0, 0.5, 0.83), Link(5.0, 1.0, 0.5, 0.41)
    return planar_chain(ArmParameters('paper', links))
