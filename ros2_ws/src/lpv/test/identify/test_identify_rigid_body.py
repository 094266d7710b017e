"""Regressors and base parameters."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest

from lpv.core.serial_arm.description import rotation_from_rpy
from lpv.identify.model.base_parameters import find_base_parameters
from lpv.identify.model.rigid_body import RigidBody


@pytest.fixture(scope='module')
def model(arm):
    return RigidBody(arm)


@pytest.fixture(scope='module')
def samples():
    return np.random.default_rng(0).normal(size=(3, 30, 3))


def peer_of(arm):
    """The arm in Pinocchio."""
    model, parent = pinocchio.Model(), 0
    model.gravity = pinocchio.Motion(arm.gravity_vector(), np.zeros(3))
    for joint in arm.joints:
        place = pinocchio.SE3(rotation_from_rpy(joint.orientation), np.array(joint.position))
        slides = pinocchio.JointModelPrismaticUnaligned, pinocchio.JointModelRevoluteUnaligned
        kind = slides[not joint.is_prismatic](np.array(joint.axis))
        parent = model.addJoint(parent, kind, place, joint.name)
        body = pinocchio.Inertia.FromDynamicParameters(joint.link.to_vector())
        model.appendBodyToJoint(parent, body, pinocchio.SE3.Identity())
    return model


@pytest.mark.parametrize('kind', ['revolute', 'prismatic'])
def test_given_an_arm_when_its_torques_are_computed_then_regressor_and_rnea_agree(
    arm, samples, kind
):
    first, second, third = arm.joints
    second = replace(second, axis=(0.6, 0.0, -0.8), type=kind)
    arm = replace(arm, joints=(first, second, third), base_orientation=(0.3, -0.2, 0.1))
    peer = peer_of(arm)
    data = peer.createData()
    expected = [pinocchio.rnea(peer, data, *sample) for sample in zip(*samples)]
    torque = RigidBody(arm).regressor(*samples)[:, :, :30] @ arm.inertial_parameters()
    assert torque == pytest.approx(np.array(expected), abs=1e-12)


def test_given_any_parameters_when_reduced_to_base_ones_then_torques_stay(model, samples):
    base = find_base_parameters(model)
    x = np.random.default_rng(1).normal(size=33)
    full = model.regressor(*samples)
    assert full[:, :, base.columns] @ (base.combination @ x) == pytest.approx(full @ x, abs=1e-9)
    assert np.linalg.matrix_rank(full[:, :, base.columns].reshape(-1, base.size)) == base.size
