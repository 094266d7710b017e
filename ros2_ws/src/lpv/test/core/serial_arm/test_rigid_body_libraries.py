"""Arms against Pinocchio and MuJoCo, as URDF and as files: shipped ones, and with slides."""

import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from places import BRINGUP
from prismatic_arms import middle, mixed_arm, scara, ur10_on_rail

from lpv.cli.main import main
from lpv.core.export.mjcf import chain_mjcf
from lpv.core.export.urdf import arm_urdf, transforms
from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.certificate.model_bounds import chain_numbers
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics, jacobian
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.simulation import plant_scratch, plant_step
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.simulation.mujoco_chain import MujocoChain
from lpv.core.support.errors import ConfigError, LpvError

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


def test_given_an_exported_urdf_when_read_by_pinocchio_then_torques_are_ours(chosen, tmp_path):
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


def test_given_an_exported_mjcf_when_mujoco_takes_it_then_motions_are_ours(mujoco, chosen):
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


def test_given_a_foreign_callback_when_the_plant_has_stepped_then_it_is_back(mujoco, real_arm):
    def mine(_model, _data):
        pass

    plant = MujocoChain(compile_chain(real_arm))
    mujoco.set_mjcb_passive(mine)
    try:
        plant.advance(np.array([[0.1, 0.2], [0.1, 0.0]]), np.zeros(2), np.zeros(2), 0.002, 2)
        assert mujoco.get_mjcb_passive() is mine
    finally:
        mujoco.set_mjcb_passive(None)


def test_given_no_mujoco_when_a_plant_is_made_then_an_install_is_asked_for(monkeypatch, paper_arm):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with pytest.raises(LpvError, match=r"pip install 'mujoco>=3.3.1,<4'"):
        MujocoChain(compile_chain(paper_arm))


def test_given_odd_names_or_an_inertia_of_no_body_when_written_then_it_is_xml_or_refused(paper_arm):
    joints = [replace(j, name=n) for j, n in zip(paper_arm.joints, ('x<1>', 'y&2'))]
    arm = replace(paper_arm, name='a <b> & "c"', joints=tuple(joints))
    robot = ElementTree.fromstring(arm_urdf(arm))
    assert robot.get('name') == arm.name
    assert [j.get('name') for j in robot.findall('joint')][:2] == list(arm.joint_names)
    link = replace(paper_arm.joints[1].link, inertia=tuple(1e-3 * np.array([1, 0, 1, 0, 0, 1])))
    joints = paper_arm.joints[0], replace(paper_arm.joints[1], link=link)
    arm = replace(paper_arm, joints=joints)
    with pytest.raises(ConfigError, match=r'joints\[1\]\.link\.inertia'):
        arm_urdf(arm)
    assert '<inertial>' not in arm_urdf(arm, inertial=False)


def test_given_the_command_when_run_then_it_prints_the_urdf_of_a_file(paper_arm, capsys, tmp_path):
    file = str(BRINGUP / 'arms' / 'paper.yaml')
    assert main(['urdf', '--arm', file]) == 0
    assert capsys.readouterr().out == arm_urdf(paper_arm)
    assert main(['urdf', '--arm', file, '--out', str(tmp_path / 'a.urdf')]) == 0
    assert (tmp_path / 'a.urdf').read_text() == arm_urdf(paper_arm)


@pytest.mark.parametrize('make', PRISMATIC.values(), ids=PRISMATIC)
def test_given_an_arm_file_when_written_and_read_then_it_is_the_same(make, tmp_path):
    arm = make()
    save_arm(arm, tmp_path / 'arm.yaml')
    again = load_arm(tmp_path / 'arm.yaml')
    assert again == arm and again.sha256() == arm.sha256()
    data = to_mapping(arm)
    data['joints'][0]['type'] = 'helical'
    with pytest.raises(ConfigError, match='revolute, prismatic'):
        parse_arm(data)


def test_given_a_prismatic_joint_then_its_range_counts_as_a_turn_and_it_has_no_certificate():
    scales = dict(zip(scara().joint_names, scara().scales()))
    assert scales['turn_1'] == 1.0 and scales['lift'] == pytest.approx(0.2 / (2 * np.pi))
    rail = ur10_on_rail().joints[0]
    for end, scale, span in ((20.0, 1.0, (-20.0, 20.0)), (np.inf, None, (-0.5, 0.5))):
        joint = replace(rail, limits=replace(rail.limits, lower=-end, upper=end))
        assert joint.range == span and scale in (joint.scale, None)
    with pytest.raises(ConfigError, match='rail is prismatic'):
        chain_numbers(ur10_on_rail())
