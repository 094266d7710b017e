"""Exported arms against Pinocchio and MuJoCo: planar ones, and shipped arms of more joints."""

import sys

import numpy as np
import pytest
from places import BRINGUP

from lpv_core.export.mjcf import chain_mjcf
from lpv_core.export.urdf import arm_urdf, transforms
from lpv_core.serial_arm.arm_file import load_arm
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.simulation.mujoco_chain import MujocoChain
from lpv_core.support.errors import LpvError

NAMES = ['paper', 'real_arm', 'ur10', 'panda']


@pytest.fixture(params=NAMES)
def chosen(request):
    return load_arm(BRINGUP / 'arms' / f'{request.param}.yaml')


@pytest.fixture
def pin():
    return pytest.importorskip('pinocchio', reason='Pinocchio (pin) is not installed')


@pytest.fixture
def mujoco():
    return pytest.importorskip('mujoco', reason='MuJoCo is not installed')


def states(joints, count=10):
    """Joint positions, rates, accelerations."""
    return np.random.default_rng(2).uniform(-3.0, 3.0, (count, 3, joints))


def close(found, expected):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale)


def pinocchio_arm(pin, arm, inertial):
    """The arm as Pinocchio reads its URDF; its base stands as the arm's does."""
    model = pin.buildModelFromXML(arm_urdf(arm, inertial=inertial))
    model.gravity.linear = arm.gravity_vector()
    return model


def position(pin, model, q):
    """Of Pinocchio: a joint without limits is a point on a circle."""
    return pin.integrate(model, pin.neutral(model), q)


def test_given_an_exported_urdf_when_pinocchio_places_it_then_the_tip_is_where_we_say(pin, chosen):
    model = pinocchio_arm(pin, chosen, inertial=False)
    data, chain = model.createData(), compile_chain(chosen)
    for q, _, _ in states(len(chosen.joints)):
        pin.framesForwardKinematics(model, data, position(pin, model, q))
        place = data.oMf[model.getFrameId('tip')]
        rotation, tip = forward_kinematics(chain, q)
        close(place.translation, tip)
        turned, moved = np.eye(3), np.zeros(3)
        for _, _, translation, quaternion in transforms(chosen, q):
            moved = moved + turned @ translation
            turned = turned @ pin.Quaternion(np.array(quaternion)).toRotationMatrix()
        close(moved, tip)
        np.testing.assert_allclose(place.rotation, turned, atol=1e-9)


def test_given_an_exported_urdf_when_pinocchio_takes_its_masses_then_gravity_is_ours(pin, chosen):
    try:
        model = pinocchio_arm(pin, chosen, inertial=True)
    except ValueError as error:
        assert 'a URDF cannot express that' in str(error)  # noqa: PT017 - identified arms
        return
    data, ours = model.createData(), SerialModel(compile_chain(chosen))
    for q, _, _ in states(len(chosen.joints)):
        found = pin.computeGeneralizedGravity(model, data, position(pin, model, q))
        close(found, ours.gravity(q))


def test_given_an_exported_mjcf_when_mujoco_takes_it_then_mass_matrix_and_forces_are_ours(
    mujoco, chosen
):
    chain = compile_chain(chosen)
    if chosen.name == 'panda':  # identified: its inertias are those of no rigid bodies
        with pytest.raises(LpvError, match='MuJoCo does not take the arm: .*inertia'):
            MujocoChain(chain)
        return
    model = mujoco.MjModel.from_xml_string(chain_mjcf(chain))
    data, ours, n = mujoco.MjData(model), SerialModel(chain), len(chosen.joints)
    for q, v, _ in states(n):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        mass = ours.mass_matrix(q)
        column = np.zeros(n)
        for index, unit in enumerate(np.eye(n)):
            mujoco.mj_mulM(model, data, column, unit)
            close(column, mass[:, index])
        close(np.array(data.qfrc_bias), ours.inverse_dynamics(q, v, np.zeros(n)))


def test_given_a_callback_of_somebody_else_when_the_plant_has_stepped_then_it_is_back(
    mujoco, real_arm
):
    def mine(_model, _data):
        pass

    plant = MujocoChain(compile_chain(real_arm))
    mujoco.set_mjcb_passive(mine)
    try:
        plant.advance(np.array([[0.1, 0.2], [0.1, 0.0]]), np.zeros(2), np.zeros(2), 0.002, 2)
        assert mujoco.get_mjcb_passive() is mine
    finally:
        mujoco.set_mjcb_passive(None)


def test_given_no_mujoco_when_the_plant_is_made_then_the_error_says_what_to_install(
    monkeypatch, paper_arm
):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with pytest.raises(LpvError, match=r"pip install 'mujoco>=3.3.1,<4'"):
        MujocoChain(compile_chain(paper_arm))
