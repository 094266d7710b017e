"""Diagnosis on recordings of a real arm with joint encoders."""

import csv
import math
import os
from pathlib import Path

import numpy as np
import pytest
from places import DATA, RECORDINGS
from stepwise import Diagnoser, UnknownInputObserver

from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.observer.sampled_observer import Counters

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


def estimate_faults(arm, gains, recording, shift):
    """Fault estimates along a recording with an artificial sensor fault."""
    observer, diagnoser = UnknownInputObserver(arm, gains), Diagnoser(arm, gains)
    faults, alarms = [], []
    for t, q, v, tau, add in zip(
        recording.time, recording.position, recording.velocity, recording.torque, shift
    ):
        estimate = observer.update(round(t * 1e9), q + add, v, tau)
        alarms += diagnoser.update(estimate).events
        faults.append(estimate.fault)
    assert observer.counters == Counters(late_steps=observer.counters.late_steps)
    return np.array(faults), alarms


@pytest.fixture(scope='module')
def healthy(real_arm, real_gains, recording):
    return estimate_faults(real_arm, real_gains, recording, np.zeros_like(recording.position))


def test_given_a_healthy_recording_when_observed_then_no_fault_of_a_tenth_of_a_radian_is_seen(
    recording, healthy
):
    faults, _ = healthy
    assert recording.time[-1] > 4.9
    assert np.abs(faults[recording.time > 1.0]).max() < 0.1


def test_given_a_healthy_recording_when_diagnosed_then_there_is_no_alarm(healthy):
    _, alarms = healthy
    assert alarms == []


@pytest.mark.parametrize(
    ('encoder', 'onset', 'size'),
    [(0, 2.0, 0.3), (0, 3.0, 0.3), (0, 6.5, -0.3), (1, 1.5, -0.3), (1, 5.0, 0.3), (1, 7.5, 0.3)],
)
def test_given_a_step_on_an_encoder_when_observed_then_it_is_known_after_a_tenth_of_a_second(
    real_arm, real_gains, recording, encoder, onset, size
):
    if onset + 0.4 > recording.time[-1]:
        pytest.skip('the excerpt ends before')
    step = np.zeros_like(recording.position)
    step[recording.time >= onset, encoder] = size
    faults, _ = estimate_faults(real_arm, real_gains, recording, step)
    late = recording.time > onset + 0.1
    assert np.abs(faults - step)[late].max() < 0.1


@pytest.mark.parametrize('encoder', [0, 1])
def test_given_a_step_on_an_encoder_when_diagnosed_then_its_own_alarm_is_raised_and_no_other(
    real_arm, real_gains, recording, encoder
):
    step = np.zeros_like(recording.position)
    step[recording.time >= 3.0, encoder] = 0.3
    _, alarms = estimate_faults(real_arm, real_gains, recording, step)
    assert [(a.event, a.sensor) for a in alarms if a.event != AlarmEvent.UPDATED] == [
        (AlarmEvent.RAISED, real_arm.sensor_names[encoder])
    ]
    assert {a.sensor for a in alarms} == {real_arm.sensor_names[encoder]}
    assert 2.99e9 < alarms[0].onset <= alarms[0].detected < 3.03e9
    assert alarms[0].size == pytest.approx(0.3, abs=0.1)


def test_given_the_recordings_when_compared_with_the_region_then_most_of_each_is_inside(
    real_arm, recording
):
    absolute = math.pi + np.cumsum(recording.position, axis=1)
    inside = np.all(np.cos(absolute) < -np.array(real_arm.cos_min), axis=1)
    assert inside.mean() > 0.5
