"""Mistakes of a set-up that are named, and the calibration of a given model."""

import re
from dataclasses import replace

import numpy as np
import pytest

from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.identify.estimation.mistakes import find_mistakes
from lpv.identify.estimation.torque_error import calibrate, torque_error
from lpv.identify.recordings.filters import shifted

STEP = 0.01


def swapped(recording):
    parts = (recording.position, recording.velocity, recording.effort)
    position, velocity, effort = (part[:, [0, 2, 1]] for part in parts)
    return replace(recording, position=position, velocity=velocity, effort=effort)


def efforts(factor):
    return lambda recording: replace(recording, effort=recording.effort * factor)


MISTAKES = {
    'tilted base': ('gravity', 'about y by -5', lambda r: r, (0.0, 0.1, 0.0)),
    'mounted on a wall': ('gravity', 'about y by -(89|9[01])', lambda r: r, (0.0, np.pi / 2, 0.0)),
    'other sign': ('sign', 'efforts of two count', efforts([1.0, -1.0, 1.0]), None),
    'other signs': ('sign', 'of all joints', efforts(-1.0), None),
    'swapped names': ('names', 'two and three are swapped', swapped, None),
    'currents': ('unit', 'currents', efforts([1 / 13.0, 1 / 12.0, 1 / 9.0]), None),
    'late efforts': (
        'delay', '50 ms too late',
        lambda r: replace(r, effort=shifted(r.effort, 0.05, STEP)), None,
    ),
}  # fmt: skip


@pytest.mark.parametrize('kind, text, change, base', MISTAKES.values(), ids=MISTAKES)
def test_given_a_mistake_of_the_setup_when_looked_for_then_its_cause_is_named(
    rough_arm, recording, kind, text, change, base
):
    arm = rough_arm if base is None else replace(rough_arm, base_orientation=base)
    found = find_mistakes(arm, [change(recording)])
    assert found[0].kind == kind
    assert re.search(text, found[0].text)


def test_given_a_proper_setup_when_looked_at_then_there_are_no_mistakes(rough_arm, recording):
    assert find_mistakes(rough_arm, [recording]) == []


def test_given_errors_that_grow_with_speed_when_fitted_then_size_growth_and_time_are_found():
    rng, count = np.random.default_rng(2), 40_000
    rate = np.repeat(rng.uniform(-2, 2, count // 50), 50)
    keep = np.exp(-STEP / 0.2)
    error = np.zeros(count)
    for k, drawn in enumerate(rng.normal(size=count) * np.sqrt(1 - keep**2)):
        error[k] = keep * error[k - 1] + drawn
    residual = np.hypot(0.5, 0.8 * rate) * error + 0.1 * rng.normal(size=count)
    found = torque_error([rate[:, None]], [residual[:, None]], STEP)
    assert found.rest == pytest.approx([0.5], rel=0.15)
    assert found.growth == pytest.approx([0.8], rel=0.15)
    assert found.time == pytest.approx(0.2, rel=0.4)


@pytest.mark.slow
def test_given_a_short_healthy_recording_when_calibrated_then_the_model_stays(
    arm, simulated, tmp_path
):
    short = simulated(arm, 5).rows(slice(500, 1500))
    short = replace(short, position=1e-3 * np.round(short.position / 1e-3))
    found = calibrate(arm, [short])
    assert np.array_equal(found.arm.parameter_vector(), arm.parameter_vector())
    assert [j.sensors.quantization for j in found.arm.joints] == pytest.approx([1e-3] * 3, rel=1e-3)
    stated = found.arm.uncertainty
    assert len(stated.torque_error) == len(stated.torque_error_speed) == 3
    heavier = replace(arm, gravity=1.3 * arm.gravity)  # misses what it holds
    worse = calibrate(heavier, [short]).arm.uncertainty.torque_error
    assert worse[1] > 3.0 * stated.torque_error[1]
    save_arm(found.arm, tmp_path / 'arm.yaml')
    assert load_arm(tmp_path / 'arm.yaml') == found.arm


@pytest.mark.slow
def test_given_an_arm_at_rest_when_calibrated_then_it_is_said_that_errors_at_speed_are_not_seen(
    arm, recording
):
    still = np.broadcast_to(recording.position[:1], recording.position.shape)
    rest = replace(
        recording, position=still, velocity=0.0 * still,
        effort=np.broadcast_to(recording.effort[:1], still.shape),
    )  # fmt: skip
    found = calibrate(arm, [rest])
    assert len(found.warnings) == 3
    assert np.isfinite(found.arm.uncertainty.torque_error).all()
    assert {joint.sensors.rates for joint in found.arm.joints} == {'derived'}
