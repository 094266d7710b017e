"""Rows that compare readings with integrals of rates that have sensors of their own."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm

from lpv.core.serial_arm.diagnosis.bank import (
    KinematicRows,
    learn_rows,
    loudest_rows,
    loudest_window,
    sum_rows,
    take_row,
)
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.linear_bank import new_rows

ARM = shoulder_arm('independent')
PLAN = HorizonPlan.of(ARM.sample_time)
LENGTH = PLAN.interval / PLAN.blocks
"""Of a block [s]."""


def rows_of(time, position, rate, missing=0.0, learns=False, **noise):
    """Rows of three joints whose readings have such noise, after blocks of such means.

    Blocks are longer by ``missing`` [s], in which there were no samples.
    """
    joints = (replace(j, sensors=replace(j.sensors, **noise)) for j in ARM.joints)
    rows = KinematicRows(replace(ARM, joints=tuple(joints)), PLAN)
    blocks = np.zeros((len(time), 13))
    blocks[:, :3], blocks[:, 3:6], blocks[:, 9], blocks[:, 10] = position, rate, time, LENGTH
    blocks[:, 10] += missing
    for k in range(2 * PLAN.blocks, len(blocks) + 1, PLAN.blocks):
        take_row(rows.parts, blocks[k - 2 * PLAN.blocks : k], PLAN.interval)
        if learns and rows.held > 1:
            learn_rows(rows.parts, PLAN.interval)
    return rows.parts


def sums(noise=1e-3, step=0.0, rate=0.0, jump=0.0):
    """Sums of the rows of half a second at a constant rate, in which a reading may jump."""
    time = LENGTH * np.arange(30 * PLAN.blocks)
    position = rate * np.repeat(time[:, None], 3, 1)
    position[-3 * PLAN.blocks :, 1] += jump
    found = new_rows(1, 3)
    parts = rows_of(time, position, rate, position_noise=noise, quantization=step)
    sum_rows(parts, PLAN.interval, np.array([10]), found)
    return found


def learned(error=0.0, lag=0.0, missing=0.0, seed=1):
    """Rows after a minute of swinging joints, their stamps and rates off, and their learning.

    Stamps are off by a deviation of ``error`` [s], rates late by ``lag`` [s], and every fourth
    interval lacks samples for ``missing`` [s], in which the rate is late by a tenth of a second.
    """
    time, speed = LENGTH * np.arange(round(60.0 / LENGTH)), np.array([1.0, 2.0, 3.0])
    taken = time + error * np.random.default_rng(seed).normal(size=len(time))
    spoiled = np.arange(len(time)) // PLAN.blocks % 4 == 3
    late = np.where(spoiled & (missing > 0.0), max(lag, 0.1), lag)
    rate = speed * np.cos((time - late)[:, None] * speed)
    return rows_of(
        time, np.sin(taken[:, None] * speed), rate, missing * spoiled, learns=True,
        position_noise=1e-5, quantization=0.0, velocity_noise=1e-4)  # fmt: skip


@pytest.mark.parametrize('error', [0.0, 5e-4])
def test_given_stamps_that_are_off_when_rows_are_learned_then_so_is_the_error_of_stamps(error):
    found = [float(learned(error=error, seed=k).stamps[0]) ** 0.5 for k in range(4)]
    assert np.median(found) == pytest.approx(error, rel=0.2)


@pytest.mark.parametrize('missing', [0.0, 0.04])
def test_given_rates_that_lag_when_rows_are_learned_then_rows_that_miss_samples_say_little(missing):
    np.testing.assert_allclose(learned(lag=4e-3, missing=missing).lag, 4e-3, rtol=0.1)


def test_given_a_step_of_rounding_when_weighted_then_it_is_noise_of_a_twelfth_of_its_square():
    fine, rounded = sums(noise=1e-3), sums(noise=0.0, step=1e-3 * 12.0**0.5)
    np.testing.assert_allclose(rounded.weight, fine.weight, rtol=1e-12)
    assert np.all(sums(noise=2e-3).weight < 0.7 * fine.weight)


def test_given_a_fast_motion_when_weighted_then_stamps_that_may_be_wrong_cost_weight():
    assert np.all(sums(noise=1e-5, rate=3.0).weight < 0.9 * sums(noise=1e-5).weight)


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_given_a_reading_that_jumps_when_summed_then_its_own_row_holds_the_jump(rate):
    found = sums(rate=rate, jump=0.05)
    np.testing.assert_allclose(found.found[0], [0.0, 0.05, 0.0], atol=2e-3)
    assert found.span == pytest.approx(0.5)


def test_given_no_rows_when_asked_then_rates_do_not_agree_and_nothing_speaks():
    rows = KinematicRows(ARM, PLAN)
    assert not rows.agrees(1, 0.0) and not loudest_window(rows.parts, 0.05) > 0.0


def test_given_rows_when_their_sums_are_searched_then_the_loudest_window_counts():
    values = np.random.default_rng(1).normal(size=(9, 2))
    noise = tuple(np.random.default_rng(2).uniform(0.5, 1.5, (4, 2)))
    inflation, ends, walk, bias = noise
    spans = 0.05 * np.arange(1, 10)[:, None]
    variance = inflation * (ends + walk * spans) + (bias * spans) ** 2
    expected = (0.5 * np.cumsum(values[::-1], axis=0) ** 2 / variance)[:, 1].max()
    trusted = np.array([False, True])
    found = loudest_rows(values, np.zeros((9, 2)), noise, 0.05, trusted)
    assert found == pytest.approx(expected)
