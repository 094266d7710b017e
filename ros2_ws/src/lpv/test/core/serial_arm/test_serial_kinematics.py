"""Pose, Jacobian and inverse kinematics of serial chains."""

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st
from serial_chains import pinocchio_model, random_chain

from lpv.core.serial_arm.chain import make_chain
from lpv.core.serial_arm.dynamics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    jacobian,
    rotation_vector,
)

CASES = given(st.integers(0, 2**31), st.integers(2, 9))


@CASES
def test_pose_and_jacobian_equal_pinocchio(seed, joints):
    chain = random_chain(seed, joints)
    q = np.random.default_rng(seed).uniform(-3.0, 3.0, joints)
    model = pinocchio_model(chain)
    tip = pinocchio.SE3(chain.tip_rotation, chain.tip_translation)
    frame = model.addFrame(pinocchio.Frame('tip', joints, 0, tip, pinocchio.FrameType.OP_FRAME))
    data = model.createData()
    expected = pinocchio.computeFrameJacobian(
        model, data, q, frame, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    pinocchio.framesForwardKinematics(model, data, q)
    rotation, position = forward_kinematics(chain, q)
    np.testing.assert_allclose(rotation, data.oMf[frame].rotation, atol=1e-12)
    np.testing.assert_allclose(position, data.oMf[frame].translation, atol=1e-12)
    np.testing.assert_allclose(jacobian(chain, q), expected, atol=1e-11)


@given(st.integers(0, 2**31), st.integers(6, 9))
def test_nearby_pose_is_reached(seed, joints):
    chain, rng = random_chain(seed, joints), np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, joints)
    rotation, position = forward_kinematics(chain, q)
    found = inverse_kinematics(chain, position, rotation, q + rng.uniform(-0.05, 0.05, joints))
    assert found.reached
    assert np.abs(forward_kinematics(chain, found.q)[1] - position).max() < 1e-6


def planar_arm():
    """Two links of 1 m in a plane."""
    return make_chain(
        [np.eye(3)] * 2, [[0, 0, 0], [1, 0, 0]], np.ones((2, 10)), tip=(np.eye(3), (1.0, 0.0, 0.0))
    )


def test_pose_out_of_reach_ends_stretched_towards_it():
    found = inverse_kinematics(planar_arm(), (3.0, 0.0, 0.0), None, (0.4, -0.7))
    assert not found.reached
    assert found.position_error == pytest.approx(1.0, abs=1e-3)
    assert np.isfinite(found.q).all()


def test_start_in_a_singularity_gives_finite_steps():
    found = inverse_kinematics(planar_arm(), (1.2, 0.6, 0.0), None, (0.0, 1e-9))
    assert found.reached


def test_limits_are_kept():
    limits = (-1.0, -1.0), (1.0, 1.0)
    found = inverse_kinematics(planar_arm(), (-1.0, 0.5, 0.0), None, (0.1, 0.1), limits)
    assert not found.reached
    assert (np.abs(found.q) <= 1.0).all()


@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-8, 0.1, 3.0, np.pi - 1e-9, np.pi]))
def test_rotation_vector_inverts_the_exponential(seed, angle):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    vector = rotation_vector(pinocchio.exp3(angle * axis))
    np.testing.assert_allclose(pinocchio.exp3(vector), pinocchio.exp3(angle * axis), atol=1e-6)
