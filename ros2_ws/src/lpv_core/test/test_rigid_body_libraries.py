"""The arm's dynamics against Pinocchio, and against MuJoCo on the generated MJCF."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from lpv_core.export.mjcf import mjcf
from lpv_core.model.arm import ArmParameters, Link
from lpv_core.model.dynamics import acceleration, inverse_dynamics, rk4_step
from lpv_core.model.joints import JointMap
from lpv_core.simulation.mujoco_plant import MujocoPlant
from lpv_core.support.errors import ConfigError, LpvError

ARMS = 40
STATES = 10


def random_arm(rng, motors=True):
    """A rigid two-link arm of any size, inertia about either point, with or without motors."""
    links = []
    for _ in range(2):
        mass, length = rng.uniform(0.1, 20.0), rng.uniform(0.1, 2.0)
        center = length * rng.uniform(0.05, 1.2)
        links.append(Link(mass, length, center, mass * length**2 * rng.uniform(0.0, 0.3)))
    reference = rng.choice(['center_of_mass', 'joint'])
    if reference == 'joint':
        links = [
            replace(link, inertia=link.inertia + link.mass * link.center_of_mass**2)
            for link in links
        ]
    arm = ArmParameters(
        'random',
        tuple(links),
        inertia_reference=str(reference),
        gravity=rng.uniform(1.0, 20.0),
        zero_angle=rng.uniform(-math.pi, math.pi),
        arrangement=str(rng.choice(['absolute', 'relative'])),
    )
    if motors:
        arm = replace(
            arm,
            rotor_inertia=rng.uniform(0.0, 0.01),
            gear_ratio=rng.uniform(1.0, 50.0),
            viscous=tuple(rng.uniform(0.0, 1.0, 2)),
            coulomb=tuple(rng.uniform(0.0, 1.0, 2)),
        )
    return arm


def random_states(rng):
    """Joint positions, rates, accelerations, each of shape (STATES, 2)."""
    return rng.uniform(-7.0, 7.0, (3, STATES, 2))


def joint_dynamics(arm, q, v, a):
    """Joint torques of lpv_core for a motion in joint coordinates."""
    joints = JointMap(arm)
    absolute = inverse_dynamics(
        *joints.absolute_position(q),
        *joints.absolute_velocity(v),
        *joints.absolute_velocity(a),
        arm.constants(),
    )
    return joints.joint_torque(np.array(absolute))


def joint_inertia(arm, q):
    still = np.zeros(2)
    rest = joint_dynamics(arm, q, still, still)
    return np.column_stack([joint_dynamics(arm, q, still, unit) - rest for unit in np.eye(2)])


def close(found, expected):
    scale = max(1.0, np.abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale)


# ------------------------------------------------------------------ Pinocchio


@pytest.fixture(scope='module')
def pin():
    return pytest.importorskip('pinocchio', reason='Pinocchio (pin) is not installed')


def pinocchio_arm(pin, arm):
    """The arm's links by Pinocchio's own means; rotors and friction are none of its business."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -arm.gravity])
    axis = np.array([0.0, -1.0, 0.0])
    turned = pin.AngleAxis(arm.zero_angle + 0.5 * math.pi, axis).toRotationMatrix()
    places = (
        pin.SE3(turned, np.zeros(3)),
        pin.SE3(np.eye(3), np.array([arm.links[0].length, 0.0, 0.0])),
    )
    parent = 0
    for link, place in zip(arm.links, places):
        inertia = link.inertia
        if arm.inertia_reference == 'joint':
            inertia -= link.mass * link.center_of_mass**2
        parent = model.addJoint(
            parent, pin.JointModelRevoluteUnaligned(axis), place, f'joint{parent + 1}'
        )
        body = pin.Inertia(
            link.mass, np.array([link.center_of_mass, 0.0, 0.0]), np.diag([inertia] * 3)
        )
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    return model


def test_given_random_arms_when_compared_with_pinocchio_then_dynamics_agree_to_1e_9(pin):
    rng = np.random.default_rng(1)
    for _ in range(ARMS):
        arm = random_arm(rng, motors=False)
        model = pinocchio_arm(pin, arm)
        data = model.createData()
        for q, v, a in zip(*random_states(rng)):
            close(joint_inertia(arm, q), pin.crba(model, data, q))
            close(joint_dynamics(arm, q, v, np.zeros(2)), pin.nonLinearEffects(model, data, q, v))
            close(joint_dynamics(arm, q, v, a), pin.rnea(model, data, q, v, a))
            close(
                joint_dynamics(arm, q, np.zeros(2), np.zeros(2)),
                pin.computeGeneralizedGravity(model, data, q),
            )


def test_given_random_arms_when_torques_act_then_pinocchio_finds_the_same_accelerations(pin):
    rng = np.random.default_rng(2)
    for _ in range(ARMS):
        arm = random_arm(rng, motors=False)
        model, joints = pinocchio_arm(pin, arm), JointMap(arm)
        data = model.createData()
        for q, v, tau in zip(*random_states(rng)):
            absolute = acceleration(
                *joints.absolute_position(q),
                *joints.absolute_velocity(v),
                *joints.absolute_torque(tau),
                arm.constants(),
            )
            close(joints.joint_velocity(np.array(absolute)), pin.aba(model, data, q, v, tau))


def test_given_a_generated_mjcf_when_pinocchio_reads_it_then_it_is_the_same_arm(pin, arm, tmp_path):
    (tmp_path / 'arm.xml').write_text(mjcf(arm))
    model = pin.buildModelFromMJCF(str(tmp_path / 'arm.xml'))
    model.gravity.linear = np.array([0.0, 0.0, -arm.gravity])  # it does not read this option
    data, rng = model.createData(), np.random.default_rng(3)
    plain = replace(arm, viscous=(0.0, 0.0), coulomb=(0.0, 0.0))
    # Pinocchio does not read tendons: the rotor of motor 2 turns at q1' - r q2'.
    ratios = np.array([1.0, -arm.gear_ratio])
    rotor = arm.rotor_inertia * np.outer(ratios, ratios)
    for q, v, a in zip(*random_states(rng)):
        close(joint_dynamics(plain, q, v, a), pin.rnea(model, data, q, v, a) + rotor @ a)


# ------------------------------------------------------------------ MuJoCo


@pytest.fixture(scope='module')
def mujoco():
    return pytest.importorskip('mujoco', reason='MuJoCo is not installed')


def test_given_random_arms_with_motors_when_compared_with_mujoco_then_dynamics_agree_to_1e_9(
    mujoco,
):
    rng = np.random.default_rng(4)
    for _ in range(ARMS):
        arm = random_arm(rng)
        plain = replace(arm, coulomb=(0.0, 0.0))
        plant = MujocoPlant(plain)
        model, data, column = plant.model, plant.data, np.zeros(2)
        for q, v, tau in zip(*random_states(rng)):
            data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, tau
            mujoco.mj_forward(model, data)
            for index, unit in enumerate(np.eye(2)):
                mujoco.mj_mulM(model, data, column, unit)
                close(joint_inertia(arm, q)[:, index], column)
            close(joint_dynamics(plain, q, v, data.qacc), tau)


def swing(arm, plant, seconds, steps, torque=(0.0, 0.0), push=(0.0, 0.0)):
    """Largest difference of the absolute states between MuJoCo and the built-in simulator."""
    c, worst = arm.constants(), 0.0
    state = (0.4, -0.7, 0.5, -1.0)
    other = np.array(state)
    for k in range(round(seconds / 0.002)):
        q = np.array(torque) * math.sin(0.01 * k)
        other = plant.advance(other, q, push, 0.002, steps)
        for _ in range(steps):
            state = rk4_step(state, tuple(q), tuple(push), 0.002 / steps, c)
        worst = max(worst, np.abs(other - state).max())
    return worst


def test_given_torque_friction_and_disturbance_when_integrated_then_both_plants_agree(mujoco, arm):
    assert swing(arm, MujocoPlant(arm), 2.0, 4, (0.5, 0.2), (0.2, 0.1)) < 1e-9
    rng = np.random.default_rng(5)
    for _ in range(5):
        other = random_arm(rng)
        assert swing(other, MujocoPlant(other), 0.5, 10, (0.5, 0.2), (0.2, 0.1)) < 1e-6


def test_given_no_passive_force_but_viscous_friction_when_integrated_then_both_plants_agree(
    mujoco, paper_arm
):
    arm = replace(paper_arm, viscous=(3.0, 2.0))
    assert swing(arm, MujocoPlant(arm), 2.0, 4, (5.0, 2.0)) < 1e-9


def test_given_a_callback_of_somebody_else_when_the_plant_has_stepped_then_it_is_back(
    mujoco, real_arm
):
    def mine(_model, _data):
        pass

    plant = MujocoPlant(real_arm)
    mujoco.set_mjcb_passive(mine)
    try:
        plant.advance((3.0, 3.0, 0.1, 0.0), (0.0, 0.0), (0.1, 0.0), 0.002, 2)
        assert mujoco.get_mjcb_passive() is mine
    finally:
        mujoco.set_mjcb_passive(None)


def test_given_dry_friction_when_the_load_is_below_it_then_the_arm_sticks_and_smooth_creeps(
    mujoco, real_arm
):
    moved = {}
    for law in ('smooth', 'dry'):
        plant, state = MujocoPlant(real_arm, law), np.array([math.pi, math.pi, 0.0, 0.0])
        for _ in range(500):
            # Half the friction of joint 1, and gravity pulls back: one second.
            state = plant.advance(state, (0.08, 0.0), (0.0, 0.0), 0.002, 2)
        moved[law] = abs(state[0] - math.pi)
    assert moved['dry'] < 1e-3
    assert moved['smooth'] > 5.0 * moved['dry']
    plant, state = MujocoPlant(real_arm, 'dry'), np.array([math.pi, math.pi, 0.0, 0.0])
    for _ in range(500):
        state = plant.advance(state, (0.5, 0.0), (0.0, 0.0), 0.002, 2)
    assert abs(state[0] - math.pi) > 0.02  # and it slides where the load is above it


def test_given_a_link_that_is_no_rigid_body_when_written_then_its_inertia_is_named(paper_arm):
    links = tuple(replace(link, inertia=0.1) for link in paper_arm.links)
    with pytest.raises(ConfigError, match=r'links\[0\].inertia.*negative'):
        mjcf(replace(paper_arm, links=links, inertia_reference='joint'))


def test_given_point_masses_when_simulated_then_mujoco_takes_them(mujoco, paper_arm):
    links = tuple(replace(link, inertia=0.0) for link in paper_arm.links)
    arm = replace(paper_arm, links=links)
    assert swing(arm, MujocoPlant(arm), 0.2, 10) < 1e-6


def test_given_no_mujoco_when_the_plant_is_made_then_the_error_says_what_to_install(
    monkeypatch, paper_arm
):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    with pytest.raises(LpvError, match=r"pip install 'mujoco>=3.3.1,<4'"):
        MujocoPlant(paper_arm)
