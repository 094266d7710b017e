"""Second encoders: what a recording says of them, and what it refuses."""

import numpy as np
import pytest
from bags import write_measurements
from places import RECORDINGS as DATA

from lpv.core.support.errors import ConfigError, LpvError
from lpv.identify.sensors.second_encoder import describe, find_second_encoders, with_second_encoders


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
