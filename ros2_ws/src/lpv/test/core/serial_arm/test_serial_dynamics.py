import math
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from fault_injection import with_joints
from hypothesis import given
from hypothesis import strategies as st
from places import BRINGUP
from planar_formulas import inverse_dynamics as two_link_inverse_dynamics
from serial_arms import middle, mixed_arm, scara, shoulder_arm, ur10_on_rail
from serial_speed import model_of

from lpv import ConfigError, LpvError, SampleError, load_arm
from lpv.core.export import urdf
from lpv.core.serial_arm import arm_file, description, urdf_chain
from lpv.core.serial_arm.certificate.model_bounds import chain_numbers
from lpv.core.serial_arm.chain import VISCOUS, compile_chain, moved_body, workspace
from lpv.core.serial_arm.dynamics import kinematics, payload
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics, momentum_balance
from lpv.core.serial_arm.dynamics.regressor import regressor
from lpv.core.serial_arm.simulation import integration_step, plant_scratch, plant_step
from lpv.core.serial_arm.two_links import Link, two_link_arm
from lpv.core.simulation.mujoco_chain import MujocoChain, chain_model
from lpv.core.uio.model.joints import JointMap

CASES = given(st.integers(0, 2**31), st.integers(2, 9))
PANDA = load_arm('panda')
LIMITS = np.array([(joint.limits.lower, joint.limits.upper) for joint in PANDA.joints]).T
ENDLESS = {'lower': -math.inf, 'upper': math.inf}
PRISMATIC = {
    'scara': scara, 'mixed': mixed_arm,
    'endless rail': lambda: with_joints(ur10_on_rail(), 0, limits=ENDLESS),
}  # fmt: skip


def random_chain(seed, joints):
    """Joints of any type and direction without friction, a base and a tip in any orientation."""
    rng = np.random.default_rng(seed)
    turn, down = (description.rotation_from_rpy(one) for one in rng.uniform(-3.0, 3.0, (2, 3)))
    return compile_chain(mixed_arm(seed, joints))._replace(
        motor=np.diag(rng.uniform(0.0, 0.5, joints)), friction=np.zeros((joints, 5)),
        gravity=9.81 * down[2], tip_rotation=turn, prismatic=rng.integers(0, 2, joints) > 0,
    )  # fmt: skip


def random_motion(seed, joints):
    """Positions, rates and accelerations, shape (3, n)."""
    scale = np.array([[3.0], [2.0], [5.0]])
    return scale * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, joints))


def written(function, chain, motion, *shapes):
    arrays = [np.empty(shape) for shape in shapes]
    function(chain, *motion, workspace(chain), *arrays)
    return arrays


def close(found, expected, within=1e-10):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=within * scale)


@CASES
def test_given_any_chain_when_moved_then_dynamics_and_poses_are_those_of_pinocchio(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    model, ours = model_of(chain), SerialModel(chain)
    tip = pin.SE3(chain.tip_rotation, chain.tip_translation)
    frame = model.addFrame(pin.Frame('tip', joints, 0, tip, pin.FrameType.OP_FRAME))
    data, place = model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    close(ours.inverse_dynamics(q, v, a), pin.rnea(model, data, q, v, a))
    mass = np.array(pin.crba(model, data, q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    coriolis = pin.computeCoriolisMatrix(model, data, q, v)
    gravity = pin.computeGeneralizedGravity(model, data, q)
    momentum, force = written(momentum_balance, chain, (q, v), joints, joints)
    close(ours.mass_matrix(q), mass)
    close(momentum, mass @ v)
    close(force, coriolis.T @ v - gravity)
    close(ours.gravity(q), gravity)
    turns = pin.computeFrameJacobian(model, data, q, frame, place)
    np.testing.assert_allclose(kinematics.jacobian(chain, q), turns, atol=1e-11)
    pin.framesForwardKinematics(model, data, q)
    rotation, position = kinematics.forward_kinematics(chain, q)
    np.testing.assert_allclose(rotation, data.oMf[frame].rotation, atol=1e-12)
    np.testing.assert_allclose(position, data.oMf[frame].translation, atol=1e-12)


@CASES
def test_given_any_chain_when_moved_then_regressors_and_inversion_fit_its_torques(seed, joints):
    chain, (q, v, a) = random_chain(seed, joints), random_motion(seed, joints)
    ours, phi = SerialModel(chain), chain.inertial.ravel()
    torque = ours.inverse_dynamics(q, v, a)
    momentum_matrix, force_matrix = ours.momentum_regressor(q, v)
    momentum, force = written(momentum_balance, chain, (q, v), joints, joints)
    (matrix,) = written(regressor, chain, (q, v, a), momentum_matrix.shape)
    close(matrix @ phi + chain.motor @ a, torque)
    close(momentum_matrix @ phi + chain.motor @ v, momentum)
    close(force_matrix @ phi, force)
    loaded = SerialModel(payload.with_payload(chain, 1.5)).inverse_dynamics(q, v, a)
    close(loaded, torque + matrix[:, -10:] @ payload.payload_parameters(chain, 1.5))
    scale = np.linalg.cond(ours.mass_matrix(q)) * max(1.0, np.abs(a).max())
    _, found = written(forward_dynamics, chain, (q, v, torque), (joints, joints), joints)
    assert np.abs(found - a).max() < 1e-12 * scale


@given(st.integers(0, 2**31), st.floats(0.0, 5.0))
def test_given_any_planar_arm_then_its_chain_has_two_link_formulas(paper_model, seed, load):
    rng = np.random.default_rng(seed)
    sizes = rng.uniform([0.1, 0.1, 0.05, 0.1], [20.0, 2.0, 1.0, 2.0], (2, 4))
    inertia, ratio = rng.uniform(0.0, 0.01), rng.uniform(1.0, 50.0)
    # The rotor of motor 2 turns at q1' - r q2'; that of motor 1 at r q1'.
    rotor = inertia * (ratio**2 + 1.0), -inertia * ratio, inertia * ratio**2
    arm = replace(
        paper_model, links=tuple(Link(*map(float, size)) for size in sizes),
        gravity=rng.uniform(1.0, 20.0), rotor=rotor, viscous=(0.3, 0.2), coulomb=(0.5, 0.4),
        offset=(0.1, -0.3), load=(0.1, 0.2), coulomb_slope=(50.0, 20.0),
        zero_angle=rng.uniform(-math.pi, math.pi))  # fmt: skip
    (q, v, a), joints = random_motion(seed, 2), JointMap(arm)
    rates = joints.absolute_velocity(v), joints.absolute_velocity(a)
    constants, chain = arm.with_payload(load).constants(), compile_chain(two_link_arm(arm))
    absolute = two_link_inverse_dynamics(joints.absolute_position(q), *rates, constants)
    found = SerialModel(payload.with_payload(chain, load)).torque(q, v, a)
    close(found, joints.joint_torque(np.array(absolute)))


def test_given_a_wrong_sample_then_what_is_wrong_is_named(paper_arm):
    ours = SerialModel(compile_chain(paper_arm))
    with pytest.raises(SampleError, match='v must have 2 numbers'):
        ours.inverse_dynamics([0.0, 0.0], [0.0], [0.0, 0.0])
    pytest.raises(SampleError, ours.gravity, [0.0, math.nan]).match('q must be finite')


def test_given_many_samples_when_asked_at_once_then_torques_are_those_of_each(real_arm):
    model, rng = SerialModel(compile_chain(real_arm)), np.random.default_rng(2)
    motion = rng.normal(size=(3, 9, 2))
    for ask, rows in ((model.torque, motion), (model.gravity, motion[:1])):
        np.testing.assert_array_equal(ask(*rows), [ask(*one) for one in zip(*rows)])
    for wrong in (motion[2, :8], motion[2, 0]):
        pytest.raises(SampleError, model.torque, *motion[:2], wrong).match('of the same samples')


def test_given_friction_by_load_when_it_holds_an_arm_then_steps_are_short_enough():
    chain, n, period = compile_chain(PANDA), len(PANDA.joints), 0.002
    chain.friction[:] = 0.0, 0.0, 0.3, 0.0, 300.0
    q = middle(PANDA) + 0.1
    step, count = integration_step(chain, period)
    torque, ends = 1.02 * SerialModel(chain).gravity(q) + 0.01, []
    scratch, matrix = plant_scratch(chain), np.empty((n, n))
    for finer in (1, 8):
        state = np.array([q, 0.0 * q])
        assert plant_step(chain, state, torque, step / finer, 50 * finer * count, scratch, matrix)
        ends.append(state)
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-8)


@CASES
def test_given_light_joints_that_move_each_other_when_stopped_then_steps_are_stable(seed, n):
    chain, rng, period = random_chain(seed, n), np.random.default_rng(seed), 0.002
    chain.motor[:], chain.gravity[:], chain.prismatic[:] = 0.0, 0.0, False
    model, postures = SerialModel(chain), rng.uniform(-3.0, 3.0, (300, n))
    least = [np.linalg.eigvalsh(model.mass_matrix(q))[0] for q in postures]
    chain.friction[:, VISCOUS] = 50.0 / period * np.min(least)
    step, count = integration_step(chain, period)
    q, matrix = postures[np.argmin(least)], np.empty((n, n))
    state, scratch = np.array([q, rng.normal(size=n)]), plant_scratch(chain)
    before = state[1] @ model.mass_matrix(q) @ state[1]
    assert plant_step(chain, state, np.zeros(n), step, 5 * count, scratch, matrix)
    assert state[1] @ model.mass_matrix(state[0]) @ state[1] < before


def test_given_viscous_friction_when_a_rotor_is_missing_then_its_joint_is_named():
    chain = compile_chain(load_arm('ur10'))
    chain.friction[5] = 1.0, 0.0, 0.0, 0.0, 0.0
    chain.motor[5, 5], chain.inertial[5, :] = 0.0, 1e-3 * chain.inertial[5]
    with pytest.raises(ConfigError, match=r'joints\[5\]\.rotor_inertia: .* at least') as refused:
        integration_step(chain, 0.002)
    chain.motor[5, 5] = 1.01 * float(refused.value.reason.split('at least ')[1].split()[0])
    integration_step(chain, 0.002)


@given(st.integers(0, 2**31), st.integers(6, 9))
def test_nearby_pose_is_reached(seed, joints):
    chain, rng = random_chain(seed, joints), np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, joints)
    rotation, position = kinematics.forward_kinematics(chain, q)
    start = q + rng.uniform(-0.05, 0.05, joints)
    found = kinematics.inverse_kinematics(chain, position, rotation, start)
    assert found.reached
    assert np.abs(kinematics.forward_kinematics(chain, found.q)[1] - position).max() < 1e-6


@given(st.integers(0, 2**31))
def test_given_joints_at_their_limits_when_a_pose_needs_them_there_then_it_is_reached(seed):
    rng, (low, high) = np.random.default_rng(seed), LIMITS
    q, chain, at_limit = rng.uniform(low, high), compile_chain(PANDA), rng.integers(7)
    q[at_limit] = (low, high)[rng.integers(2)][at_limit]
    rotation, position = kinematics.forward_kinematics(chain, q)
    start = np.clip(q + rng.uniform(-0.05, 0.05, 7), low, high)
    assert kinematics.inverse_kinematics(chain, position, rotation, start, (low, high)).reached


def test_given_a_pose_out_of_reach_a_singularity_or_limits_then_steps_are_finite_and_limits_kept():
    planar_arm = random_chain(0, 2)._replace(  # two links of 1 m in a plane
        rotation=np.array([np.eye(3)] * 2), translation=np.array([np.zeros(3), [1.0, 0.0, 0.0]]),
        tip_rotation=np.eye(3), tip_translation=np.array([1.0, 0.0, 0.0]),
        prismatic=np.zeros(2, bool),
    )  # fmt: skip
    found = kinematics.inverse_kinematics(planar_arm, (3.0, 0.0, 0.0), None, (0.4, -0.7))
    assert not found.reached and found.position_error == pytest.approx(1.0, abs=1e-3)
    assert np.isfinite(found.q).all()
    assert kinematics.inverse_kinematics(planar_arm, (1.2, 0.6, 0.0), None, (0.0, 1e-9)).reached
    limits, point = ((-1.0, -1.0), (1.0, 1.0)), (-1.0, 0.5, 0.0)
    found = kinematics.inverse_kinematics(planar_arm, point, None, (0.1, 0.1), limits)
    assert not found.reached and (np.abs(found.q) <= 1.0).all()


@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-8, 0.1, 3.0, np.pi - 1e-9, np.pi]))
def test_rotation_vector_inverts_the_exponential(seed, angle):
    axis = np.random.default_rng(seed).normal(size=3)
    axis /= np.linalg.norm(axis)
    vector = kinematics.rotation_vector(pin.exp3(angle * axis))
    np.testing.assert_allclose(pin.exp3(vector), pin.exp3(angle * axis), atol=1e-6)


@pytest.fixture(params=['paper', 'real_arm', 'ur10', 'panda', *PRISMATIC])
def chosen(request):
    if request.param in PRISMATIC:
        return PRISMATIC[request.param]()
    return load_arm(request.param)


@pytest.fixture
def mujoco():
    return pytest.importorskip('mujoco', reason='MuJoCo is not installed')


def states(joints):
    return np.random.default_rng(2).uniform(-3.0, 3.0, (10, 3, joints))


def pinocchio_arm(arm, inertial):
    """The arm as Pinocchio reads its URDF; its base stands as the arm's does."""
    model = pin.buildModelFromXML(urdf.arm_urdf(arm, inertial=inertial))
    model.gravity.linear = arm.gravity_vector()
    return model


def position(model, q):
    """Of Pinocchio: a joint without limits is a point on a circle."""
    return pin.integrate(model, pin.neutral(model), q)


def test_given_an_exported_urdf_when_pinocchio_reads_it_then_torques_are_ours(chosen, tmp_path):
    model = pinocchio_arm(chosen, inertial=False)
    data, chain, tool = model.createData(), compile_chain(chosen), model.getFrameId('tip')
    for q, _, _ in states(len(chosen.joints)):
        pin.framesForwardKinematics(model, data, position(model, q))
        rotation, tip = kinematics.forward_kinematics(chain, q)
        close(data.oMf[tool].translation, tip)
        close(data.oMf[tool].rotation, rotation)
    try:
        model = pinocchio_arm(chosen, inertial=True)
    except ValueError as error:
        assert 'a URDF cannot express that' in str(error)  # noqa: PT017 - identified arms
        return
    data, ours = model.createData(), SerialModel(chain)
    (tmp_path / 'arm.urdf').write_text(urdf.arm_urdf(chosen))
    again = urdf_chain.read_urdf_chain(tmp_path / 'arm.urdf')
    for one, joint in zip(again.joints, chosen.joints, strict=True):
        assert one.type == joint.type and one.range == pytest.approx(joint.range)
    read = SerialModel(compile_chain(again)._replace(gravity=ours.chain.gravity))
    for q, v, a in states(len(chosen.joints)):
        place = position(model, q)
        close(pin.computeGeneralizedGravity(model, data, place), ours.gravity(q))
        torque = pin.rnea(model, data, place, v, a)  # a URDF has no rotors
        close(read.inverse_dynamics(q, v, a), torque)
        close(ours.inverse_dynamics(q, v, a) - ours.chain.motor @ a, torque)


def test_given_a_mass_point_when_exported_and_read_again_then_it_is_the_same(tmp_path):
    point = moved_body(np.array([0.5, *np.zeros(9)]), np.eye(3), np.array([0.1, 0.7, -0.3]))
    arm = with_joints(shoulder_arm(), 2, link=description.LinkInertia.from_vector(point))
    (tmp_path / 'arm.urdf').write_text(urdf.arm_urdf(arm))
    close(urdf_chain.read_urdf_chain(tmp_path / 'arm.urdf').joints[2].link.to_vector(), point)


def test_given_a_model_when_mujoco_takes_it_then_motions_are_ours(mujoco, chosen):
    chain = compile_chain(chosen)
    if chosen.name == 'panda':  # identified: its inertias are those of no rigid bodies
        pytest.raises(LpvError, MujocoChain, chain).match('MuJoCo does not take the arm: .*inertia')
        return
    model = chain_model(mujoco, chain)
    data, ours, n = mujoco.MjData(model), SerialModel(chain), len(chosen.joints)
    for q, v, torque in states(n):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
        mujoco.mj_forward(model, data)
        column = np.zeros(n)
        for index, unit in enumerate(np.eye(n)):
            mujoco.mj_mulM(model, data, column, unit)
            close(column, ours.mass_matrix(q)[:, index], 1e-9)
        close(np.array(data.qfrc_bias), ours.inverse_dynamics(q, v, np.zeros(n)), 1e-9)
        if chosen.name in PRISMATIC:
            close(ours.inverse_dynamics(q, v, data.qacc), torque, 1e-9)
    if chosen.name in PRISMATIC:  # the shipped ones in loops: `test_simulator`, `test_serial_loop`
        state = np.array([middle(chosen), np.full(n, 0.1)])
        theirs, plant, hold = state.copy(), MujocoChain(chain), ours.gravity(middle(chosen))
        scratch, matrix = plant_scratch(chain), np.empty((n, n))
        for _ in range(100):
            plant.advance(theirs, hold, 0.0 * hold, 0.002, 8)
            assert plant_step(chain, state, hold, 0.002 / 8, 8, scratch, matrix)
        np.testing.assert_allclose(state, theirs, rtol=0.0, atol=1e-8)


def test_given_a_coupled_rotor_without_inertia_when_mujoco_shall_take_it_then_it_is_refused(mujoco):
    arm = with_joints(scara(), 1, rotor_inertia=0.0, rotor_coupling=-0.1)
    with pytest.raises(ConfigError, match=r'motor\[1\]: must have the inertia'):
        chain_model(mujoco, compile_chain(arm))


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
    arm = replace(with_joints(paper_arm, 0, name='x<1> & "y"'), name='a <b> & "c"')
    robot = ElementTree.fromstring(urdf.arm_urdf(arm))
    assert robot.get('name') == arm.name
    assert [j.get('name') for j in robot.findall('joint')][:2] == list(arm.joint_names)
    arm = with_joints(paper_arm, 1, link={'inertia': (1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3)})
    pytest.raises(ConfigError, urdf.arm_urdf, arm).match(r'joints\[1\]\.link\.inertia')
    assert '<inertial>' not in urdf.arm_urdf(arm, inertial=False)


def test_given_the_command_when_run_then_it_prints_the_urdf_of_a_file(paper_arm, call, tmp_path):
    command, out = ['urdf', '--arm', BRINGUP / 'arms' / 'paper.yaml'], tmp_path / 'a.urdf'
    printed, _ = call(*command).out, call(*command, '--out', out)
    assert printed == out.read_text() == urdf.arm_urdf(paper_arm)


@pytest.mark.parametrize('make', PRISMATIC.values(), ids=PRISMATIC)
def test_given_an_arm_file_when_written_and_read_then_it_is_the_same(make, tmp_path):
    arm = make()
    arm_file.save_arm(arm, tmp_path / 'arm.yaml')
    again = load_arm(tmp_path / 'arm.yaml')
    assert again == arm and again.sha256() == arm.sha256()
    data = arm_file.to_mapping(arm)
    data['joints'][0]['type'] = 'helical'
    pytest.raises(ConfigError, arm_file.parse_arm, data).match('revolute, prismatic')
    with pytest.raises(ConfigError, match=r'arm.yaml is not written: joints\[0\].torque_gain'):
        arm_file.save_arm(with_joints(arm, 0, torque_gain=0.0), tmp_path / 'arm.yaml')
    assert load_arm(tmp_path / 'arm.yaml') == arm


@pytest.mark.parametrize(('low', 'high', 'span'), [
    (-math.inf, math.inf, (-math.pi, math.pi)), (-6.3, 6.3, (-math.pi, math.pi)),
    (-3.0, -0.1, (-3.0, -0.1)), (4.0, 6.0, (4.0, 6.0)), (-9.0, -4.0, (-4.0 - math.pi, -4.0)),
])  # fmt: skip
def test_given_limits_anywhere_then_usual_motions_are_within_them(low, high, span):
    assert replace(scara().joints[0], limits=description.JointLimits(low, high)).range == span


def test_given_a_prismatic_joint_then_its_range_counts_as_a_turn_and_it_has_no_certificate():
    scales = dict(zip(scara().joint_names, scara().scales()))
    assert scales['turn_1'] == 1.0 and scales['lift'] == pytest.approx(0.2 / (2 * np.pi))
    rail = ur10_on_rail().joints[0]
    for end, scale, span in ((20.0, 1.0, (-20.0, 20.0)), (np.inf, None, (-0.5, 0.5))):
        joint = replace(rail, limits=replace(rail.limits, lower=-end, upper=end))
        assert joint.range == span and scale in (joint.scale, None)
    pytest.raises(ConfigError, chain_numbers, ur10_on_rail()).match('rail is prismatic')
