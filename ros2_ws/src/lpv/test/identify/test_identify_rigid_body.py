"""Regressors and base parameters."""

from dataclasses import replace

import numpy as np
import pytest

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.identify.model.base_parameters import find_base_parameters
from lpv.identify.model.rigid_body import RigidBody


@pytest.fixture(scope='module')
def model(arm):
    return RigidBody(arm)


@pytest.fixture(scope='module')
def samples():
    return np.random.default_rng(0).normal(size=(3, 30, 3))


@pytest.mark.parametrize('kind', ['revolute', 'prismatic'])
def test_given_an_arm_when_its_torques_are_computed_then_regressor_and_rnea_agree(
    arm, samples, kind
):
    first, second, third = arm.joints
    second = replace(second, axis=(0.6, 0.0, -0.8), type=kind)
    arm = replace(arm, joints=(first, second, third), base_orientation=(0.3, -0.2, 0.1))
    chain = compile_chain(arm)
    peer = SerialModel(chain._replace(motor=0.0 * chain.motor))
    expected = [peer.inverse_dynamics(*sample) for sample in zip(*samples)]
    torque = RigidBody(arm).regressor(*samples)[:, :, :30] @ arm.inertial_parameters()
    assert torque == pytest.approx(np.array(expected), abs=1e-12)


def test_given_any_parameters_when_reduced_to_base_ones_then_torques_stay(model, samples):
    base = find_base_parameters(model)
    x = np.random.default_rng(1).normal(size=33)
    full = model.regressor(*samples)
    assert full[:, :, base.columns] @ (base.combination @ x) == pytest.approx(full @ x, abs=1e-9)
    assert np.linalg.matrix_rank(full[:, :, base.columns].reshape(-1, base.size)) == base.size
