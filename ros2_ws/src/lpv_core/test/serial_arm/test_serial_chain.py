"""Compiled chains from described arms and from inline parameters."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from places import RECORDINGS

from lpv_core.serial_arm.chain import axis_frame, compile_chain, make_chain
from lpv_core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.serial_arm.urdf_chain import read_urdf_chain
from lpv_core.support.errors import ConfigError

DATA = RECORDINGS

URDF = """<robot name="small"><link name="base"/><link name="tool"/>
<link name="one"><inertial><origin xyz="0.1 0.02 0" rpy="0.3 0 0.2"/><mass value="3"/>
  <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0.002" izz="0.04"/></inertial></link>
<link name="two"><inertial><origin xyz="0 0.2 0"/><mass value="2"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.02"/></inertial></link>
<link name="left"><inertial><origin xyz="0 0 0.05"/><mass value="0.4"/>
  <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/>
  <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="two"/>
  <origin xyz="0.4 0 0"/><axis xyz="1 2 -1"/>
  <limit lower="-1" upper="2" velocity="3" effort="50"/></joint>
<joint name="mount" type="fixed"><parent link="two"/><child link="tool"/>
  <origin xyz="0 0 0.1" rpy="0 0.5 0"/></joint>
<joint name="finger" type="prismatic"><parent link="tool"/><child link="left"/>
  <origin xyz="0 0.02 0"/><axis xyz="0 1 0"/>
  <limit lower="0" upper="0.05" velocity="1" effort="5"/></joint></robot>"""


def assert_same_torques(model, chain):
    rng = np.random.default_rng(1)
    ours, data = SerialModel(chain), model.createData()
    for _ in range(20):
        q, v, a = rng.uniform(-1.5, 1.5, (3, ours.joints))
        expected = pinocchio.rnea(model, data, q, v, a)
        np.testing.assert_allclose(ours.inverse_dynamics(q, v, a), expected, rtol=0, atol=1e-10)


def test_gripper_is_locked_where_it_was_told_and_axes_point_anywhere(tmp_path):
    (tmp_path / 'small.urdf').write_text(URDF)
    found = read_urdf_chain(tmp_path / 'small.urdf', {'finger': 0.03})
    full = pinocchio.buildModelFromXML(URDF)
    model = pinocchio.buildReducedModel(full, [full.getJointId('finger')], np.array([0, 0, 0.03]))
    assert found.joint_names == ('a', 'b')
    assert_same_torques(model, compile_chain(found))


def test_tip_is_that_of_the_urdf(tmp_path):
    (tmp_path / 'small.urdf').write_text(URDF.replace('name="left"', 'name="tool"', 0))
    chain = compile_chain(read_urdf_chain(tmp_path / 'small.urdf', {'finger': 0.0}))
    model = pinocchio.buildModelFromXML(URDF)
    data, q = model.createData(), np.array([0.4, -0.3, 0.0])
    pinocchio.framesForwardKinematics(model, data, q)
    expected = data.oMf[model.getFrameId('left')].translation
    np.testing.assert_allclose(forward_kinematics(chain, q[:2])[1], expected, atol=1e-12)


def test_base_on_the_wall_turns_gravity(tmp_path):
    (tmp_path / 'small.urdf').write_text(URDF)
    arm = read_urdf_chain(tmp_path / 'small.urdf', {'finger': 0.0})
    chain = compile_chain(replace(arm, base_orientation=(0.0, np.pi / 2, 0.0)))
    np.testing.assert_allclose(chain.gravity, [9.81, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize('path', ['ur10/ur10.urdf', 'panda/fer.urdf'])
def test_arm_of_a_manufacturer_equals_pinocchio(path):
    if not (DATA / path).exists():
        pytest.skip(f'{DATA / path} is not there')
    model = pinocchio.buildModelFromUrdf(str(DATA / path))
    model.armature = np.zeros(model.nv)
    assert_same_torques(model, compile_chain(read_urdf_chain(DATA / path)))


@pytest.mark.parametrize(
    ('field', 'value'),
    [
        ('rotation', [2.0 * np.eye(3)]),
        ('rotation', [np.eye(2)]),
        ('translation', np.zeros((40, 3))),
        ('translation', [[0.0, np.nan, 0.0]]),
        ('inertial', [['x'] * 10]),
        ('motor', np.ones((2, 2))),
        ('gravity', [0.0, 9.81]),
    ],
)
def test_bad_inline_parameters_are_refused_by_name(field, value):
    good = {'rotation': [np.eye(3)], 'translation': [[0, 0, 0]], 'inertial': np.ones((1, 10))}
    with pytest.raises(ConfigError, match=field):
        make_chain(**{**good, field: value})


@pytest.mark.parametrize('axis', [(0, 0, 1), (0, 0, -1), (1, 0, 0), (1e-9, 1e-9, 1), (3, -4, 5)])
def test_frame_of_an_axis_is_a_rotation(axis):
    frame = axis_frame(np.array(axis, dtype=float))
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-12)
    assert np.linalg.det(frame) > 0.0
