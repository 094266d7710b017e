"""Arms with prismatic joints: files, dynamics against other libraries, diagnosis in the loop."""

from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from prismatic_arms import middle, mixed_arm, scara, ur10_on_rail, urdf_of
from serial_chains import random_motion

from lpv_core.export.mjcf import chain_mjcf
from lpv_core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv_core.serial_arm.certificate.model_bounds import chain_numbers
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.dynamics.kinematics import forward_kinematics, inverse_kinematics, jacobian
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.serial_arm.simulation import plant_scratch, plant_step
from lpv_core.serial_arm.urdf_chain import read_urdf_chain
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.mujoco_chain import MujocoChain
from lpv_core.simulation.scenario import Scenario
from lpv_core.support.errors import ConfigError

ARMS = pytest.mark.parametrize('arm', [scara(), ur10_on_rail(), mixed_arm()], ids=lambda a: a.name)


def close(found, expected):
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale)


@ARMS
def test_given_its_urdf_when_read_then_dynamics_and_tip_are_those_of_pinocchio(arm, tmp_path):
    path = tmp_path / 'arm.urdf'
    path.write_text(urdf_of(arm))
    found = read_urdf_chain(path)
    assert [joint.type for joint in found.joints] == [joint.type for joint in arm.joints]
    model = pinocchio.buildModelFromUrdf(str(path))
    data, ours = model.createData(), SerialModel(compile_chain(found))
    for seed in range(20):
        q, v, a = random_motion(seed, len(arm.joints))
        close(ours.inverse_dynamics(q, v, a), pinocchio.rnea(model, data, q, v, a))
        mass = np.triu(pinocchio.crba(model, data, q))
        mass = mass + np.triu(mass, 1).T
        close(ours.mass_matrix(q), mass)
        coriolis = pinocchio.computeCoriolisMatrix(model, data, q, v)
        gravity = pinocchio.computeGeneralizedGravity(model, data, q)
        momentum, force = ours.momentum_balance(q, v)
        close(momentum, mass @ v)
        close(force, coriolis.T @ v - gravity)
        close(
            ours.gravity_gradient(q), pinocchio.computeGeneralizedGravityDerivatives(model, data, q)
        )
        close(
            ours.regressor(q, v, a) @ ours.chain.inertial.ravel(),
            pinocchio.rnea(model, data, q, v, a),
        )
        pinocchio.framesForwardKinematics(model, data, q)
        tool = model.getFrameId('tool')
        close(forward_kinematics(ours.chain, q)[1], data.oMf[tool].translation)
        pinocchio.computeJointJacobians(model, data, q)
        expected = pinocchio.getFrameJacobian(model, data, tool, pinocchio.LOCAL_WORLD_ALIGNED)
        close(jacobian(ours.chain, q), expected)


@ARMS
def test_given_its_mjcf_when_mujoco_reads_it_then_dynamics_and_motions_agree(arm):
    mujoco = pytest.importorskip('mujoco', reason='MuJoCo is not installed')
    chain, n = compile_chain(arm), len(arm.joints)
    model = mujoco.MjModel.from_xml_string(chain_mjcf(chain))
    data, ours, mass = mujoco.MjData(model), SerialModel(chain), np.zeros((n, n))
    for seed in range(20):
        q, v, torque = random_motion(seed, n)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
        mujoco.mj_forward(model, data)
        for row, unit in zip(mass, np.eye(n)):
            mujoco.mj_mulM(model, data, row, unit)
        close(ours.mass_matrix(q), mass)
        close(ours.inverse_dynamics(q, v, data.qacc), torque)
    ours_state = np.array([middle(arm), np.full(n, 0.1)])
    theirs, plant = ours_state.copy(), MujocoChain(chain)
    hold = ours.gravity(middle(arm))
    for _ in range(100):
        plant.advance(theirs, hold, 0.0 * hold, 0.002, 8)
        assert plant_step(
            chain, ours_state, hold, 0.002 / 8, 8, plant_scratch(chain), np.empty((n, n))
        )
    np.testing.assert_allclose(ours_state, theirs, rtol=0.0, atol=1e-8)


@ARMS
def test_given_an_arm_file_when_written_and_read_then_it_is_the_same(arm, tmp_path):
    save_arm(arm, tmp_path / 'arm.yaml')
    again = load_arm(tmp_path / 'arm.yaml')
    assert again == arm and again.sha256() == arm.sha256()
    data = to_mapping(arm)
    data['joints'][0]['type'] = 'helical'
    with pytest.raises(ConfigError, match='revolute, prismatic'):
        parse_arm(data)


def test_given_a_reachable_pose_when_solved_then_the_slides_take_part():
    arm = ur10_on_rail()
    chain, q = compile_chain(arm), np.array([0.4, 0.3, -1.0, 1.2, -0.5, 0.4, 0.2])
    rotation, position = forward_kinematics(chain, q)
    found = inverse_kinematics(chain, position, rotation, q + 0.2)
    assert found.reached
    np.testing.assert_allclose(forward_kinematics(chain, found.q)[1], position, atol=1e-5)


def test_given_a_prismatic_joint_then_its_whole_range_counts_as_a_turn_and_1_m_at_most():
    scales = dict(zip(scara().joint_names, scara().scales()))
    assert scales['turn_1'] == 1.0 and scales['lift'] == pytest.approx(0.2 / (2 * np.pi))
    rail = ur10_on_rail().joints[0]
    long = replace(rail, limits=replace(rail.limits, lower=-20.0, upper=20.0))
    assert long.scale == 1.0
    open_ended = replace(rail, limits=replace(rail.limits, lower=-np.inf, upper=np.inf))
    assert open_ended.range == (-0.5, 0.5)


def test_given_a_prismatic_joint_when_a_certificate_is_asked_for_then_it_is_refused_by_name():
    with pytest.raises(ConfigError, match='rail is prismatic'):
        chain_numbers(ur10_on_rail())


# ------------------------------------------------------------------ the loop


def scenario(arm, *faults):
    rng = np.random.default_rng(3)
    rows = [middle(arm)]
    for _ in range(4):
        reach = np.array([0.12 * (joint.range[1] - joint.range[0]) for joint in arm.joints])
        rows.append(middle(arm) + reach * rng.uniform(-1.0, 1.0, len(reach)))
    rows = np.array(rows)
    if arm.name == 'ur10_on_rail':
        rows[:, 2] -= 1.0
        rows[:, 3] += 1.0
    return Scenario(
        name='slides', duration=10.0, seed=2, plant='nonlinear', parameter_error=0.03, payload=0.2,
        friction_factor=1.1, noise=True, noise_factor=1.0, times=(0.3, 2.5, 5.0, 7.5, 9.8),
        waypoints=tuple(map(tuple, rows)), faults=faults)  # fmt: skip


@pytest.mark.slow
@ARMS
def test_given_an_arm_with_slides_when_nothing_fails_then_it_follows_and_nothing_is_said(arm):
    run = run_closed_loop(arm, scenario(arm))
    assert run.alarms == [] and not run.stop_reason.any() and not run.brake_reason.any()
    assert np.abs(run.position - run.reference).max() < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(
    'fault',
    [
        Fault('rail_encoder', 'bias', 3.0, size=0.03),
        pytest.param(
            Fault('rail_encoder', 'drift', 3.0, rate=0.05),
            marks=pytest.mark.xfail(reason='moves the estimate of the next joint instead'),
        ),
        Fault('shoulder_lift_encoder', 'bias', 3.0, size=0.1),
    ],
    ids=lambda f: f'{f.sensor}-{f.kind}',
)
def test_given_an_arm_on_a_rail_when_an_encoder_fails_then_its_fault_is_named(fault):
    arm = ur10_on_rail()
    run = run_closed_loop(arm, scenario(arm, fault))
    first = run.alarms[0]
    assert (first.sensor, first.kind) == (fault.sensor, fault.kind)
    assert first.unit == ('m' if 'rail' in fault.sensor else 'rad')
    assert {alarm.sensor for alarm in run.alarms} == {fault.sensor}
