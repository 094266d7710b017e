"""Regressors and base parameters."""

import numpy as np
import pinocchio
import pytest

from lpv_identify.model.base_parameters import find_base_parameters
from lpv_identify.model.rigid_body import build_model, torque_regressor


@pytest.fixture(scope='module')
def model(arm):
    return build_model(arm)


@pytest.fixture(scope='module')
def samples():
    return np.random.default_rng(0).normal(size=(3, 30, 3))


def test_given_an_arm_when_its_torques_are_computed_then_regressor_and_rnea_agree(
    arm, model, samples
):
    data = model.createData()
    expected = [pinocchio.rnea(model, data, *sample) for sample in zip(*samples)]
    torque = torque_regressor(model, *samples) @ arm.inertial_parameters()
    assert torque == pytest.approx(np.array(expected), abs=1e-12)


def test_given_any_parameters_when_reduced_to_base_ones_then_torques_stay(model, samples):
    base = find_base_parameters(model)
    x = np.random.default_rng(1).normal(size=33)
    full = np.concatenate(
        [torque_regressor(model, *samples), samples[2][:, :, None] * np.eye(3)], axis=2
    )
    assert full[:, :, base.columns] @ (base.combination @ x) == pytest.approx(full @ x, abs=1e-9)
    assert np.linalg.matrix_rank(full[:, :, base.columns].reshape(-1, base.size)) == base.size
