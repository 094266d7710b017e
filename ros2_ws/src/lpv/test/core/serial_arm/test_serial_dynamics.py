"""Serial chains against Pinocchio and the two-link formulas: dynamics, plant, poses, inversion."""

import math

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv.core.serial_arm.chain import body_parameters, compile_chain, make_chain, workspace
from lpv.core.serial_arm.description import rotation_from_rpy
from lpv.core.serial_arm.dynamics import kinematics
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import payload_parameters, with_payload
from lpv.core.serial_arm.simulation import plant_step
from lpv.core.support.errors import SampleError
from lpv.core.uio.model.arm import ArmParameters, Link
from lpv.core.uio.model.dynamics import inverse_dynamics as two_link_inverse_dynamics
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.planar import serial_from_planar

CASES = given(st.integers(0, 2**31), st.integers(2, 9))


def random_chain(seed, joints):
    """Physical bodies of any shape, joints of any type and direction, a base in any orientation."""
    rng = np.random.default_rng(seed)
    rotation = [rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)) for _ in range(joints)]
    bodies = []
    for _ in range(joints):
        lengths = rng.uniform(0.02, 0.5, 3)
        mass, spread = rng.uniform(0.1, 20.0), lengths**2
        turn = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3))
        inertia = turn @ np.diag(mass / 12 * (spread.sum() - spread)) @ turn.T
        bodies.append(body_parameters(mass, rng.uniform(-0.4, 0.4, 3), inertia))
    tip = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)), rng.uniform(-0.3, 0.3, 3)
    direction = rng.normal(size=3)
    gravity = 9.81 * direction / np.linalg.norm(direction)
    places, motor = rng.uniform(-0.7, 0.7, (joints, 3)), rng.uniform(0.0, 0.5, joints)
    kinds = rng.integers(0, 2, joints)
    return make_chain(rotation, places, bodies, motor, gravity=gravity, tip=tip, prismatic=kinds)


def pinocchio_model(chain):
    """The same arm, built body by body."""
    model = pinocchio.Model()
    for i in range(len(chain.translation)):
        place = pinocchio.SE3(chain.rotation[i], chain.translation[i])
        joint = pinocchio.JointModelPZ if chain.prismatic[i] else pinocchio.JointModelRZ
        model.addJoint(i, joint(), place, f'joint{i}')
        body = pinocchio.Inertia.FromDynamicParameters(chain.inertial[i])
        model.appendBodyToJoint(i + 1, body, pinocchio.SE3.Identity())
    model.armature = np.diag(chain.motor).copy()
    model.gravity.linear = chain.gravity
    return model


def random_motion(seed, joints):
    """Positions, rates and accelerations, shape (3, n)."""
    scale = np.array([[3.0], [2.0], [5.0]])
    return scale * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, joints))


def assert_equal(ours, reference):
    scale = max(1.0, float(np.abs(reference).max()))
    np.testing.assert_allclose(ours, reference, rtol=0.0, atol=1e-10 * scale)


@CASES
def test_given_any_chain_when_moved_then_dynamics_and_poses_are_those_of_pinocchio(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    model, ours = pinocchio_model(chain), SerialModel(chain)
    tip = pinocchio.SE3(chain.tip_rotation, chain.tip_translation)
    frame = model.addFrame(pinocchio.Frame('tip', joints, 0, tip, pinocchio.FrameType.OP_FRAME))
    data, place = model.createData(), pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
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
    turns = pinocchio.computeFrameJacobian(model, data, q, frame, place)
    np.testing.assert_allclose(kinematics.jacobian(chain, q), turns, atol=1e-11)
    pinocchio.framesForwardKinematics(model, data, q)
    rotation, position = kinematics.forward_kinematics(chain, q)
    np.testing.assert_allclose(rotation, data.oMf[frame].rotation, atol=1e-12)
    np.testing.assert_allclose(position, data.oMf[frame].translation, atol=1e-12)


@CASES
def test_given_any_chain_when_moved_then_regressors_and_inversion_fit_its_torques(seed, joints):
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


def test_energy_is_kept_without_friction_and_torque():
    chain = random_chain(3, 4)
    model, state = SerialModel(chain), np.array([[0.3, -0.5, 0.8, 0.1], [0.2, 0.1, -0.3, 0.4]])
    scratch, matrix = np.zeros((44, workspace(chain).shape[1])), np.empty((4, 4))
    peer = pinocchio_model(chain)

    def energy():
        kinetic = 0.5 * state[1] @ model.mass_matrix(state[0]) @ state[1]
        return kinetic + pinocchio.computePotentialEnergy(peer, peer.createData(), state[0])

    before = energy()
    for _ in range(1000):
        assert plant_step(chain, state, np.zeros(4), 5e-4, 1, scratch, matrix)
    assert abs(energy() - before) < 1e-6 * abs(before)
    assert np.abs(state[1]).max() > 1.0


@given(st.integers(0, 2**31), st.integers(6, 9))
def test_nearby_pose_is_reached(seed, joints):
    chain, rng = random_chain(seed, joints), np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, joints)
    rotation, position = kinematics.forward_kinematics(chain, q)
    start = q + rng.uniform(-0.05, 0.05, joints)
    found = kinematics.inverse_kinematics(chain, position, rotation, start)
    assert found.reached
    assert np.abs(kinematics.forward_kinematics(chain, found.q)[1] - position).max() < 1e-6


def planar_arm():
    """Two links of 1 m in a plane."""
    return make_chain(
        [np.eye(3)] * 2, [[0, 0, 0], [1, 0, 0]], np.ones((2, 10)), tip=(np.eye(3), (1.0, 0.0, 0.0))
    )


def test_given_a_pose_out_of_reach_a_singularity_or_limits_then_steps_are_finite_and_limits_kept():
    found = kinematics.inverse_kinematics(planar_arm(), (3.0, 0.0, 0.0), None, (0.4, -0.7))
    assert not found.reached and found.position_error == pytest.approx(1.0, abs=1e-3)
    assert np.isfinite(found.q).all()
    assert kinematics.inverse_kinematics(planar_arm(), (1.2, 0.6, 0.0), None, (0.0, 1e-9)).reached
    limits, point = ((-1.0, -1.0), (1.0, 1.0)), (-1.0, 0.5, 0.0)
    found = kinematics.inverse_kinematics(planar_arm(), point, None, (0.1, 0.1), limits)
    assert not found.reached and (np.abs(found.q) <= 1.0).all()


@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-8, 0.1, 3.0, np.pi - 1e-9, np.pi]))
def test_rotation_vector_inverts_the_exponential(seed, angle):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    vector = kinematics.rotation_vector(pinocchio.exp3(angle * axis))
    np.testing.assert_allclose(pinocchio.exp3(vector), pinocchio.exp3(angle * axis), atol=1e-6)
