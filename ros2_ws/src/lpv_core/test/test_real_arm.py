"""Diagnosis on recordings of a real arm with joint encoders."""

import csv
import math
import os
from pathlib import Path

import numpy as np
import pytest
from places import DATA, RECORDINGS

from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent

FOLDER = Path(os.environ.get('LPV_REAL_ARM_DATA') or RECORDINGS / 'real_arm')
FILES = {
    'excerpt': DATA / 'real_arm' / 'excerpt.csv',
    'run_143601': FOLDER / 'run_143601.csv',
    'run_144115': FOLDER / 'run_144115.csv',
}
"""An excerpt is part of the repository; the whole recordings are not."""


class Recording:
    """Columns of one file."""

    def __init__(self, path):
        with open(path, newline='') as file:
            rows = list(csv.DictReader(file))

        def columns(*keys):
            return np.array([[float(row[key]) for key in keys] for row in rows])

        self.time = columns('time')[:, 0]
        self.position = columns('pos_meas1', 'pos_meas2')
        self.velocity = columns('vel_meas1', 'vel_meas2')
        self.torque = columns('tau_meas1', 'tau_meas2')


@pytest.fixture(scope='module', params=FILES)
def recording(request):
    path = FILES[request.param]
    if not path.is_file():
        pytest.skip(f'{path.name} is not part of the repository; LPV_REAL_ARM_DATA may point to it')
    return Recording(path)


def observe(arm, gains, recording, shift):
    """Answers along a recording with an artificial sensor fault."""
    monitor = SerialSensorMonitor('uio', arm, gains=gains)
    stamps = np.rint(1e9 * recording.time).astype(np.int64)
    return monitor.take_many(
        stamps, recording.position + shift, recording.velocity, recording.torque
    )


@pytest.fixture(scope='module')
def healthy(real_arm, real_gains, recording):
    return observe(real_arm, real_gains, recording, np.zeros_like(recording.position))


def test_given_a_healthy_recording_when_diagnosed_then_there_is_no_alarm(healthy, recording):
    assert recording.time[-1] > 4.9
    assert healthy.events == []


@pytest.mark.parametrize('encoder', [0, 1])
def test_given_a_step_on_an_encoder_when_diagnosed_then_its_own_alarm_is_raised_and_no_other(
    real_arm, real_gains, recording, encoder
):
    step = np.zeros_like(recording.position)
    step[recording.time >= 3.0, encoder] = 0.3
    alarms = [alarm for _, alarm in observe(real_arm, real_gains, recording, step).events]
    assert [(a.event, a.sensor) for a in alarms if a.event != AlarmEvent.UPDATED] == [
        (AlarmEvent.RAISED, real_arm.sensor_names[encoder])
    ]
    assert {a.sensor for a in alarms} == {real_arm.sensor_names[encoder]}
    assert 2.99e9 < alarms[0].onset <= alarms[0].detected < 3.03e9
    assert alarms[0].size == pytest.approx(0.3, abs=0.1)


def test_given_the_recordings_when_compared_with_the_region_then_most_of_each_is_inside(
    real_model, recording
):
    absolute = math.pi + np.cumsum(recording.position, axis=1)
    inside = np.all(np.cos(absolute) < -np.array(real_model.cos_min), axis=1)
    assert inside.mean() > 0.5
