"""Readings that were rounded more coarsely than their arm file says, as in exported recordings."""

from dataclasses import replace

import numpy as np
import pytest
from fault_injection import motion_range, simulate
from serial_arms import blamed, delivered, shoulder_arm, watch, with_rates

TWO_DECIMALS = 0.01  # [rad]
DRIVERS = pytest.mark.parametrize(
    ('rates', 'sample_time'), [('derived', 0.002), ('derived', 0.01), ('independent', 0.005)]
)


def rounded(rates, sample_time, seed, step=0.0):
    """Monitor after 5 s of a run with two decimals, in which the second reading steps at 3 s."""
    arm = with_rates(shoulder_arm(), rates, sample_time=sample_time)
    samples = simulate(arm, motion_range(arm, 0.5), seed, duration=5.0).samples
    samples[round(3.0 / sample_time) :, 0, 1] += step
    samples[:, :2] = TWO_DECIMALS * np.round(samples[:, :2] / TWO_DECIMALS)
    return watch(arm, delivered(arm, samples))


@DRIVERS
@pytest.mark.parametrize('seed', [1, 2])
def test_given_readings_of_two_decimals_then_no_sensor_is_blamed(rates, sample_time, seed):
    assert blamed(rounded(rates, sample_time, seed)) == []


@DRIVERS
def test_given_readings_of_two_decimals_when_one_steps_then_it_is_named(rates, sample_time):
    monitor = rounded(rates, sample_time, 1, step=0.1)
    assert blamed(monitor)[0] == ('encoder2', 'bias') and monitor.alarms[0].detected < 3.1e9


def test_given_a_joint_that_makes_no_small_changes_when_it_steps_then_it_is_not_rounded():
    arm = replace(shoulder_arm(), sample_time=0.01)
    samples = 2e-5 * np.random.default_rng(1).normal(size=(200, 3, 3))
    samples[:, 0] += np.arange(-1.0, 1.0, 0.01)[:, None]
    samples[100:, 0, 0] += 0.02
    samples[:, 2] = np.nan
    assert blamed(watch(arm, delivered(arm, samples))) == [('encoder1', 'bias')]
