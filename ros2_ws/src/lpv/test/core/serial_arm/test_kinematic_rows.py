"""Rows that compare readings with integrals of rates that have sensors of their own."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm

from lpv.core.serial_arm.diagnosis import bank
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan
from lpv.core.serial_arm.diagnosis.linear_bank import new_rows

ARM = shoulder_arm('independent')
PLAN = HorizonPlan.of(ARM.sample_time)
LENGTH = PLAN.interval / PLAN.blocks  # of a block [s]


def rows_of(time, position, rate, missing=0.0, learns=False, **noise):
    """Rows after blocks of such means, which lack samples for ``missing`` [s], and such noise."""
    joints = (replace(j, sensors=replace(j.sensors, **noise)) for j in ARM.joints)
    rows = bank.KinematicRows(replace(ARM, joints=tuple(joints)), PLAN)
    blocks = np.zeros((len(time), 13))
    blocks[:, :3], blocks[:, 3:6], blocks[:, 9], blocks[:, 10] = position, rate, time, LENGTH
    blocks[:, 10] += missing
    for k in range(2 * PLAN.blocks, len(blocks) + 1, PLAN.blocks):
        bank.take_row(rows.parts, blocks[k - 2 * PLAN.blocks : k], PLAN.interval)
        if learns and rows.held > 1:
            bank.learn_rows(rows.parts, PLAN.interval)
    return rows.parts


def sums(noise=1e-3, step=0.0, rate=0.0, jump=0.0):
    """Sums of the rows of half a second at a constant rate, in which a reading may jump."""
    time = LENGTH * np.arange(30 * PLAN.blocks)
    position = rate * np.repeat(time[:, None], 3, 1)
    position[-3 * PLAN.blocks :, 1] += jump
    found = new_rows(1, 3)
    parts = rows_of(time, position, rate, position_noise=noise, quantization=step)
    bank.sum_rows(parts, PLAN.interval, np.array([10]), found)
    return found


def learned(error=0.0, lag=0.0, missing=0.0, seed=1):
    """Rows after a minute of swings, stamps off by ``error``, rates late by ``lag`` [s].

    Every fourth interval lacks samples for ``missing`` [s]; there rates are late by 0.1 s.
    """
    time, speed = LENGTH * np.arange(round(60.0 / LENGTH)), np.array([1.0, 2.0, 3.0])
    taken = time + error * np.random.default_rng(seed).normal(size=len(time))
    spoiled = np.arange(len(time)) // PLAN.blocks % 4 == 3
    late = np.where(spoiled & (missing > 0.0), max(lag, 0.1), lag)
    rate = speed * np.cos((time - late)[:, None] * speed)
    return rows_of(
        time, np.sin(taken[:, None] * speed), rate, missing * spoiled, learns=True,
        position_noise=1e-5, quantization=0.0, velocity_noise=1e-4)  # fmt: skip


def test_given_stamps_and_rates_that_are_off_when_rows_are_learned_then_so_is_how_much():
    for error in (0.0, 5e-4):
        found = [float(learned(error=error, seed=k).stamps[0]) ** 0.5 for k in range(4)]
        assert np.median(found) == pytest.approx(error, rel=0.2)
    for missing in (0.0, 0.04):  # rows that miss samples say little of the lag
        np.testing.assert_allclose(learned(lag=4e-3, missing=missing).lag, 4e-3, rtol=0.1)


def test_given_rounding_or_fast_motion_when_weighted_then_it_is_noise_that_costs_weight():
    fine, rounded = sums(noise=1e-3), sums(noise=0.0, step=1e-3 * 12.0**0.5)
    np.testing.assert_allclose(rounded.weight, fine.weight, rtol=1e-12)
    assert np.all(sums(noise=2e-3).weight < 0.7 * fine.weight)
    assert np.all(sums(noise=1e-5, rate=3.0).weight < 0.9 * sums(noise=1e-5).weight)


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_given_a_reading_that_jumps_when_summed_then_its_own_row_holds_the_jump(rate):
    found = sums(rate=rate, jump=0.05)
    np.testing.assert_allclose(found.found[0], [0.0, 0.05, 0.0], atol=2e-3)
    assert found.span == pytest.approx(0.5)


@pytest.mark.parametrize(('slow', 'error'), [(0.0, 0.0), (0.03, 0.0), (0.03, 0.05)])
def test_given_a_clock_that_is_slow_when_a_way_is_asked_for_then_other_joints_tell(slow, error):
    time, speed = LENGTH * np.arange(30 * PLAN.blocks), np.array([0.5, 1.0, -1.0])
    rate = np.repeat([speed], len(time), 0)
    position = rate * time[:, None] / (1.0 - slow)
    rows = bank.KinematicRows(ARM, PLAN)
    rows.parts = rows_of(time, position + [0.0, error, 0.0] * time[:, None], rate)
    way, sigma = rows.way(1, 20)
    assert way == pytest.approx(-error * 20 * PLAN.interval, abs=2.0 * sigma)
    assert sigma < 0.2 * 0.05 * 20 * PLAN.interval


def test_given_no_rows_when_asked_then_rates_do_not_agree_and_nothing_speaks():
    rows = bank.KinematicRows(ARM, PLAN)
    assert not rows.agrees(1, 0.0) and not bank.loudest_window(rows.parts, 0.05) > 0.0


def test_given_rows_when_their_sums_are_searched_then_the_loudest_window_counts():
    values = np.random.default_rng(1).normal(size=(9, 2))
    noise = tuple(np.random.default_rng(2).uniform(0.5, 1.5, (4, 2)))
    inflation, ends, walk, bias = noise
    spans = 0.05 * np.arange(1, 10)[:, None]
    variance = inflation * (ends + walk * spans) + (bias * spans) ** 2
    expected = (0.5 * np.cumsum(values[::-1], axis=0) ** 2 / variance)[:, 1].max()
    found = bank.loudest_rows(values, np.zeros((9, 2)), noise, 0.05, np.array([False, True]))
    assert found == pytest.approx(expected)
