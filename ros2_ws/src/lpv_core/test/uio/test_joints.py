"""The conversion between ROS joints, absolute angles and physical sensors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv_core.uio.model.joints import JointMap

PAIR = st.tuples(st.floats(-10, 10), st.floats(-10, 10)).map(np.array)


@given(PAIR)
def test_given_any_pair_when_converted_forth_and_back_then_it_is_unchanged(
    paper_model, real_model, pair
):
    for arm in (paper_model, real_model):
        joints = JointMap(arm)
        for there, back in (
            (joints.absolute_position, joints.joint_position),
            (joints.absolute_velocity, joints.joint_velocity),
            (joints.absolute_torque, joints.joint_torque),
            (joints.sensor_position, joints.joint_from_sensor),
        ):
            np.testing.assert_allclose(back(there(pair)), pair, atol=1e-13)
            np.testing.assert_allclose(there(back(pair)), pair, atol=1e-13)


@given(PAIR, PAIR)
def test_given_torques_and_rates_when_converted_then_the_power_is_the_same(
    paper_model, torque, rate
):
    joints = JointMap(paper_model)
    absolute = joints.absolute_torque(torque) @ joints.absolute_velocity(rate)
    assert absolute == pytest.approx(torque @ rate, abs=1e-12)


def test_given_joint_torques_when_converted_then_q1_is_their_difference(paper_model):
    np.testing.assert_array_equal(JointMap(paper_model).absolute_torque([5.0, 2.0]), [3.0, 2.0])


def test_given_rates_when_positions_move_by_them_then_both_conversions_agree(arm):
    joints, h = JointMap(arm), 1e-6
    q, rate = np.array([0.3, -0.4]), np.array([1.1, 0.7])
    moved = joints.absolute_position(q + h * rate) - joints.absolute_position(q)
    np.testing.assert_allclose(moved / h, joints.absolute_velocity(rate), atol=1e-8)
    moved = joints.sensor_position(q + h * rate) - joints.sensor_position(q)
    rates = joints.sensor_matrix @ joints.absolute_velocity(rate)
    np.testing.assert_allclose(moved / h, rates, atol=1e-8)


def test_given_the_paper_arm_when_upright_then_q1_points_up_the_y_axis(paper_model):
    joints = JointMap(paper_model)
    np.testing.assert_allclose(joints.absolute_position([math.pi / 2, 0.0]), 0.0, atol=1e-15)
    np.testing.assert_allclose(joints.absolute_position([0.0, 0.0]), -math.pi / 2)


def test_given_the_real_arm_when_all_joints_are_zero_then_it_hangs_down(real_model):
    np.testing.assert_allclose(JointMap(real_model).absolute_position([0.0, 0.0]), math.pi)
    np.testing.assert_allclose(
        JointMap(real_model).absolute_position([0.2, 0.3]), [math.pi + 0.2, math.pi + 0.5]
    )


def test_given_relative_encoders_when_encoder_1_is_wrong_then_both_absolute_angles_shift(
    real_model,
):
    joints = JointMap(real_model)
    reading = joints.sensor_position([0.4, -0.2])
    wrong = joints.joint_from_sensor(reading + [0.3, 0.0])
    shift = joints.absolute_position(wrong) - joints.absolute_position([0.4, -0.2])
    np.testing.assert_allclose(shift, [0.3, 0.3], atol=1e-15)
    wrong = joints.joint_from_sensor(reading + [0.0, 0.3])
    shift = joints.absolute_position(wrong) - joints.absolute_position([0.4, -0.2])
    np.testing.assert_allclose(shift, [0.0, 0.3], atol=1e-15)


def test_given_relative_encoders_when_they_read_then_a_fault_stays_in_its_own_joint(real_model):
    joints = JointMap(real_model)
    wrong = joints.joint_from_sensor(joints.sensor_position([0.4, -0.2]) + [0.3, 0.0])
    np.testing.assert_allclose(wrong, [0.7, -0.2], atol=1e-15)


def test_given_absolute_sensors_when_sensor_1_is_wrong_then_only_its_own_angle_shifts(paper_model):
    joints = JointMap(paper_model)
    reading = joints.sensor_position([1.4, -0.2])
    np.testing.assert_allclose(reading, joints.absolute_position([1.4, -0.2]), atol=1e-15)
    wrong = joints.joint_from_sensor(reading + [0.3, 0.0])
    np.testing.assert_allclose(wrong, [1.7, -0.5], atol=1e-15)


def test_given_a_batch_when_converted_then_every_row_is_converted_alone(arm):
    joints = JointMap(arm)
    batch = np.random.default_rng(1).normal(size=(4, 3, 2))
    for method in (
        joints.absolute_position,
        joints.joint_position,
        joints.absolute_torque,
        joints.joint_torque,
        joints.sensor_position,
        joints.joint_from_sensor,
        joints.absolute_velocity,
        joints.joint_velocity,
    ):
        rows = np.array([[method(pair) for pair in row] for row in batch])
        np.testing.assert_allclose(method(batch), rows, rtol=1e-15, atol=1e-15)
