"""Noise, quantization, source of rates, delays, tolerance."""

import numpy as np
import pytest

from lpv_identify.estimation.delays import rate_delays
from lpv_identify.estimation.tolerance import torque_tolerance
from lpv_identify.recordings.motion import Segment, find_bandwidths
from lpv_identify.sensors.noise import noise_deviation, quantization_step
from lpv_identify.sensors.rates import rate_sources

STEP = 0.004


def segment(rates=None, noise=1e-5, delay=0.0, seed=0):
    time = STEP * np.arange(5000)
    rng = np.random.default_rng(seed)
    position = np.sin(time)[:, None] + noise * rng.normal(size=(len(time), 1))
    if rates == 'derived':
        velocity = np.diff(position, axis=0, prepend=position[:1]) / STEP
    else:
        velocity = np.cos(time - delay)[:, None] + 1e-3 * rng.normal(size=(len(time), 1))
    return Segment(STEP, time, position, velocity, 0.0 * position)


def test_given_white_noise_when_measured_then_its_deviation_is_found():
    assert noise_deviation([segment(noise=2e-4).position]) == pytest.approx([2e-4], rel=0.05)


def test_given_an_encoder_when_its_step_is_looked_for_then_it_is_found():
    step = 2 * np.pi / 4096
    coarse = step * np.round(segment().position / step)
    assert quantization_step([coarse]) == pytest.approx([step], rel=1e-3)
    assert quantization_step([segment().position]) == [0.0]


@pytest.mark.parametrize('source', ['derived', 'independent'])
def test_given_rates_when_compared_with_positions_then_their_source_is_found(source):
    assert rate_sources([segment(source)])[0] == [source]


def test_given_smoothed_differences_when_compared_then_they_are_derived():
    one = segment('derived')
    rates = 0.5 * (one.velocity + np.roll(one.velocity, 1, axis=0))
    assert rate_sources([Segment(STEP, one.time, one.position, rates, one.effort)])[0] == [
        'derived'
    ]


def test_given_late_rates_when_compared_then_the_delay_is_found():
    late = segment('independent', delay=0.03)
    assert rate_delays([late], find_bandwidths([late])) == pytest.approx([0.03], abs=1e-3)


def test_given_residuals_that_grow_near_rest_when_enveloped_then_the_tolerance_does():
    rng = np.random.default_rng(1)
    speed = rng.uniform(0, 2, 5000)
    tolerance = torque_tolerance(speed, np.exp(-4 * speed) + 0.1 * rng.uniform(-1, 1, 5000))
    assert tolerance.at(0.01) > 0.9
    assert tolerance.at(1.5) < 0.15
