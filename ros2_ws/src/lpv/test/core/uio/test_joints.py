"""The conversion between ROS joints, absolute angles and physical sensors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lpv.core.uio.model.joints import JointMap

PAIR = st.tuples(st.floats(-10, 10), st.floats(-10, 10)).map(np.array)


def conversions(joints):
    """Each conversion, and the one back."""
    pairs = ((f'absolute_{of}', f'joint_{of}') for of in ('position', 'velocity', 'torque'))
    return [(getattr(joints, there), getattr(joints, back)) for there, back in pairs]


@given(PAIR, PAIR)
def test_given_any_pair_when_converted_then_it_comes_back_and_power_and_rates_are_the_same(
    paper_model, real_model, pair, rate
):
    for arm in (paper_model, real_model):
        joints, h = JointMap(arm), 1e-6
        for there, back in conversions(joints):
            np.testing.assert_allclose(back(there(pair)), pair, atol=1e-13)
            np.testing.assert_allclose(there(back(pair)), pair, atol=1e-13)
        absolute = joints.absolute_torque(pair) @ joints.absolute_velocity(rate)
        assert absolute == pytest.approx(pair @ rate, abs=1e-12)
        moved = (joints.absolute_position(pair + h * rate) - joints.absolute_position(pair)) / h
        np.testing.assert_allclose(moved, joints.absolute_velocity(rate), atol=1e-7)


def test_given_both_arms_when_upright_or_hanging_then_zeros_and_torques_are_those_of_their_files(
    paper_model, real_model
):
    upright, hanging = JointMap(paper_model), JointMap(real_model)
    np.testing.assert_array_equal(upright.absolute_torque([5.0, 2.0]), [3.0, 2.0])
    np.testing.assert_allclose(upright.absolute_position([math.pi / 2, 0.0]), 0.0, atol=1e-15)
    np.testing.assert_allclose(upright.absolute_position([0.0, 0.0]), -math.pi / 2)
    expected = [math.pi + 0.2, math.pi + 0.5]
    np.testing.assert_allclose(hanging.absolute_position([0.2, 0.3]), expected)


def test_given_a_batch_when_converted_then_every_row_is_converted_alone(arm):
    batch = np.random.default_rng(1).normal(size=(4, 3, 2))
    for pair in conversions(JointMap(arm)):
        for method in pair:
            rows = np.array([[method(pair) for pair in row] for row in batch])
            np.testing.assert_allclose(method(batch), rows, rtol=1e-15, atol=1e-15)
