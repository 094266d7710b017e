"""Exported arms against Pinocchio and MuJoCo: shipped ones, and arms with prismatic joints."""

import sys

import numpy as np
import pinocchio as pin
import pytest
from places import BRINGUP
from prismatic_arms import middle, mixed_arm, scara, ur10_on_rail

from lpv.core.export.mjcf import chain_mjcf
from lpv.core.export.urdf import arm_urdf, transforms
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics, jacobian
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.simulation import plant_scratch, plant_step
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.simulation.mujoco_chain import MujocoChain
from lpv.core.support.errors import LpvError

PRISMATIC = {'scara': scara, 'ur10_on_rail': ur10_on_rail, 'mixed': mixed_arm}


@pytest.fixture(params=['paper', 'real_arm', 'ur10', 'panda', *PRISMATIC])
def chosen(request):
    if request.param in PRISMATIC:
        return PRISMATIC[request.param]()
    return load_arm(BRINGUP / 'arms' / f'{request.param}.yaml')


@pytest.fixture
def mujoco():
    return pytest.importorskip('mujoco', reason='MuJoCo is not installed')


def states(joints, count=10):
    """Joint positions, rates, accelerations."""
    return np.random.default_rng(2).uniform(-3.0, 3.0, (count, 3, joints))


def close(found, expected):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale)


def pinocchio_arm(arm, inertial):
    """The arm as Pinocchio reads its URDF; its base stands as the arm's does."""
    model = pin.buildModelFromXML(arm_urdf(arm, inertial=inertial))
    model.gravity.linear = arm.gravity_vector()
    return model


def position(model, q):
    """Of Pinocchio: a joint without limits is a point on a circle."""
    return pin.integrate(model, pin.neutral(model), q)


def test_given_an_exported_urdf_when_pinocchio_places_it_then_tip_and_jacobian_are_ours(chosen):
    model = pinocchio_arm(chosen, inertial=False)
    data, chain, tool = model.createData(), compile_chain(chosen), model.getFrameId('tip')
    for q, _, _ in states(len(chosen.joints)):
        place = position(model, q)
        pin.framesForwardKinematics(model, data, place)
        _, tip = forward_kinematics(chain, q)
        close(data.oMf[tool].translation, tip)
        turned, moved = np.eye(3), np.zeros(3)
        for _, _, translation, quaternion in transforms(chosen, q):
            moved = moved + turned @ translation
            turned = turned @ pin.Quaternion(np.array(quaternion)).toRotationMatrix()
        close(moved, tip)
        np.testing.assert_allclose(data.oMf[tool].rotation, turned, atol=1e-9)
        pin.computeJointJacobians(model, data, place)
        close(jacobian(chain, q), pin.getFrameJacobian(model, data, tool, pin.LOCAL_WORLD_ALIGNED))


def test_given_an_exported_urdf_when_read_again_and_by_pinocchio_then_torques_are_the_same(
    chosen, tmp_path
):
    try:
        model = pinocchio_arm(chosen, inertial=True)
    except ValueError as error:
        assert 'a URDF cannot express that' in str(error)  # noqa: PT017 - identified arms
        return
    data, ours = model.createData(), SerialModel(compile_chain(chosen))
    (tmp_path / 'arm.urdf').write_text(arm_urdf(chosen))
    again = read_urdf_chain(tmp_path / 'arm.urdf')
    assert [joint.type for joint in again.joints] == [joint.type for joint in chosen.joints]
    read = SerialModel(compile_chain(again)._replace(gravity=ours.chain.gravity))
    for q, v, a in states(len(chosen.joints)):
        place = position(model, q)
        close(pin.computeGeneralizedGravity(model, data, place), ours.gravity(q))
        torque = pin.rnea(model, data, place, v, a)  # a URDF has no rotors
        close(read.inverse_dynamics(q, v, a), torque)
        close(ours.inverse_dynamics(q, v, a) - ours.chain.motor @ a, torque)


def test_given_an_exported_mjcf_when_mujoco_takes_it_then_dynamics_and_motions_are_ours(
    mujoco, chosen
):
    chain = compile_chain(chosen)
    if chosen.name == 'panda':  # identified: its inertias are those of no rigid bodies
        with pytest.raises(LpvError, match='MuJoCo does not take the arm: .*inertia'):
            MujocoChain(chain)
        return
    model = mujoco.MjModel.from_xml_string(chain_mjcf(chain))
    data, ours, n = mujoco.MjData(model), SerialModel(chain), len(chosen.joints)
    for q, v, torque in states(n):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
        mujoco.mj_forward(model, data)
        column = np.zeros(n)
        for index, unit in enumerate(np.eye(n)):
            mujoco.mj_mulM(model, data, column, unit)
            close(column, ours.mass_matrix(q)[:, index])
        close(np.array(data.qfrc_bias), ours.inverse_dynamics(q, v, np.zeros(n)))
        if chosen.name in PRISMATIC:
            close(ours.inverse_dynamics(q, v, data.qacc), torque)
    if chosen.name in PRISMATIC:  # the shipped ones in loops: `test_simulator`, `test_serial_loop`
        state = np.array([middle(chosen), np.full(n, 0.1)])
        theirs, plant, hold = state.copy(), MujocoChain(chain), ours.gravity(middle(chosen))
        scratch, matrix = plant_scratch(chain), np.empty((n, n))
        for _ in range(100):
            plant.advance(theirs, hold, 0.0 * hold, 0.002, 8)
            assert plant_step(chain, state, hold, 0.002 / 8, 8, scratch, matrix)
        np.testing.assert_allclose(state, theirs, rtol=0.0, atol=1e-8)


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
