"""Noise, quantization, source of rates, delays, tolerance, second encoders."""

import numpy as np
import pytest
from bags import write_measurements
from places import RECORDINGS as DATA

from lpv.core.support.errors import ConfigError, LpvError
from lpv.identify.estimation.delays import rate_delays
from lpv.identify.estimation.torque_error import torque_tolerance
from lpv.identify.recordings.motion import Segment, find_bandwidths
from lpv.identify.recordings.recording import Recording
from lpv.identify.sensors.second_encoder import describe, find_second_encoders, with_second_encoders
from lpv.identify.sensors.sensing import noise_deviation, quantization_step, sense

STEP = 0.004


def segment(noise=1e-5, delay=0.0):
    time = STEP * np.arange(5000)
    rng = np.random.default_rng(0)
    position = np.sin(time)[:, None] + noise * rng.normal(size=(len(time), 1))
    velocity = np.cos(time - delay)[:, None] + 1e-3 * rng.normal(size=(len(time), 1))
    return Segment(STEP, time, position, velocity, 0.0 * position)


def found(position, velocity):
    """What is found of sensors whose samples are given."""
    time = STEP * np.arange(len(position))
    one = Segment(STEP, time, position, velocity, np.round(position, 2))
    recording = Recording('r', time, position, velocity, one.effort)
    return sense([recording], [one], np.zeros(1), np.zeros(1))


def test_given_white_noise_when_measured_then_its_deviation_is_found():
    assert noise_deviation([segment(noise=2e-4).position]) == pytest.approx([2e-4], rel=0.05)


@pytest.mark.parametrize('step', [2 * np.pi / 4096, 1e-4, 1e-3])
@pytest.mark.parametrize('part', [slice(None), slice(0, 1500)])
def test_given_rounded_readings_with_rests_when_their_step_is_looked_for_then_it_is_found(
    step, part
):
    position = segment().position[part].copy()
    position[: len(position) // 3] = position[len(position) // 3]
    coarse = step * np.round(position / step)
    assert quantization_step([coarse]) == pytest.approx([step], rel=1e-3)
    assert quantization_step([position]) == [0.0]


@pytest.mark.slow
def test_given_rounded_signals_when_sensed_then_each_has_its_step_and_its_noise_without_it():
    one = segment(noise=3e-4)
    sensed = found(1e-4 * np.round(one.position / 1e-4), 5e-3 * np.round(one.velocity / 5e-3))
    assert sensed.quantization == pytest.approx([1e-4], rel=1e-3)
    rates = 5e-3 * np.round(one.velocity / 5e-3)
    assert quantization_step([rates]) == pytest.approx([5e-3], rel=1e-3)
    assert sensed.position_noise == pytest.approx([3e-4], rel=0.05)
    assert found(np.round(one.position, 1), one.velocity).position_noise > 0.0


@pytest.mark.slow
def test_given_rates_of_which_nothing_is_proved_when_sensed_then_they_are_called_derived():
    time = STEP * np.arange(5000)[:, None]
    assert found(np.sin(time), np.cos(time)).rates == ['derived']


def test_given_late_rates_when_compared_then_the_delay_is_found():
    late = segment(delay=0.03)
    assert rate_delays([late], find_bandwidths([late])) == pytest.approx([0.03], abs=1e-3)


def test_given_residuals_that_grow_near_rest_when_enveloped_then_the_tolerance_does():
    rng = np.random.default_rng(1)
    speed = rng.uniform(0, 2, 5000)
    tolerance = torque_tolerance(speed, np.exp(-4 * speed) + 0.1 * rng.uniform(-1, 1, 5000))
    near, fast = np.interp([0.01, 1.5], tolerance.speed, tolerance.torque)
    assert near > 0.9 and fast < 0.15


# ------------------------------------------------------------------ second encoders


@pytest.fixture
def bag(recording, arm, tmp_path):
    """A recording in which joint two has a second encoder with an offset and more noise."""
    rng = np.random.default_rng(3)
    other = 0.1 - recording.position[:, 1:2] + 5e-4 * rng.normal(size=(len(recording.time), 1))
    names, still = (*arm.joint_names, 'two_link'), np.zeros_like(other)
    samples = (recording.position, other), (recording.velocity, still), (recording.effort, still)
    return write_measurements(tmp_path / 'bag', names, recording.time, *map(np.hstack, samples))


def test_given_a_second_encoder_when_compared_then_noise_scale_and_offset_are_found(bag, arm):
    (found,) = find_second_encoders(bag, {'two': 'two_link'})
    assert found.encoder.position_noise == pytest.approx(5e-4, rel=0.1)
    assert (found.scale, found.offset) == pytest.approx((-1.0, 0.1), abs=1e-3)
    assert found.difference == pytest.approx(5e-4, rel=0.1)
    assert 'two_link' in describe(found)
    sensors = with_second_encoders(arm, [found]).joints[1].sensors
    assert sensors.second_encoder == found.encoder


def test_given_what_is_no_second_encoder_when_compared_then_the_reason_is_said(bag, arm):
    for other, reason in (
        ('three', 'no second encoder of this joint'),
        ('nothing', 'no message has all joints'),
    ):
        with pytest.raises(LpvError, match=reason):
            find_second_encoders(bag, {'two': other})
    found = find_second_encoders(bag, {'two_link': 'two_link'})
    with pytest.raises(ConfigError, match='two_link'):
        with_second_encoders(arm, found)


@pytest.mark.skipif(not DATA.is_dir(), reason='the recordings are not part of the repository')
def test_given_a_kr300_when_link_side_encoders_are_compared_then_they_agree_within_a_milliradian():
    pairs = {f'{i}': f'link_position{i}' for i in (1, 2, 3)}
    found = find_second_encoders(DATA / 'kr300' / 'A.csv', pairs)
    for reading in found:
        assert abs(abs(reading.scale) - 1.0) < 0.01
        assert reading.difference < 2e-3
