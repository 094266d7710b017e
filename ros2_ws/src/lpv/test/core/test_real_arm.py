"""Diagnosis on recordings of a real arm with joint encoders."""

import math

import numpy as np
import pytest
from fault_injection import csv_stream
from places import DATA

from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import AlarmEvent


@pytest.fixture(scope='module')
def recording():
    """An excerpt; whole recordings are in the matrix of faults."""
    return csv_stream(DATA / 'real_arm' / 'excerpt.csv')


def alarms(arm, gains, recording, encoder=0, size=0.0):
    """Along a recording; from 3 s on an encoder reads too much."""
    samples = recording.samples.copy()
    samples[recording.index(3.0) :, 0, encoder] += size
    monitor = SerialSensorMonitor('uio', arm, gains=gains)
    return [a for _, a in monitor.take_many(recording.stamps, *np.moveaxis(samples, 1, 0)).events]


def test_given_a_healthy_recording_when_diagnosed_then_there_is_no_alarm(
    real_arm, real_gains, real_model, recording
):
    assert recording.duration > 4.9
    assert alarms(real_arm, real_gains, recording) == []
    # Most of it is inside the region of the gains.
    absolute = math.pi + np.cumsum(recording.samples[:, 0], axis=1)
    assert np.all(np.cos(absolute) < -np.array(real_model.cos_min), axis=1).mean() > 0.5


@pytest.mark.parametrize('encoder', [0, 1])
def test_given_a_step_on_an_encoder_when_diagnosed_then_its_own_alarm_is_raised_and_no_other(
    real_arm, real_gains, recording, encoder
):
    found = alarms(real_arm, real_gains, recording, encoder, 0.3)
    events = [a.event for a in found if a.event != AlarmEvent.UPDATED]
    assert events == [AlarmEvent.RAISED]
    assert {a.sensor for a in found} == {real_arm.sensor_names[encoder]}
    onset, detected = ((t - recording.stamps[0]) / 1e9 for t in (found[0].onset, found[0].detected))
    assert 2.99 < onset <= detected < 3.03
    assert found[0].size == pytest.approx(0.3, abs=0.1)
