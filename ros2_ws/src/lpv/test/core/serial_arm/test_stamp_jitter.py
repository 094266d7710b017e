"""Stamps that scatter move all readings by their rates: learned, and no fault of an encoder."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fault_injection import derived, motion_range, read_at, shoulder_arm, simulate

from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv.core.serial_arm.diagnosis.sampling import JITTER

PERIOD = 0.02  # [s]


@cache
def monitored(seed, jitter):
    """The monitor of an arm at 50 Hz that pauses, after 20 s with readings off their stamps."""
    arm = replace(shoulder_arm(quantization=1e-4), sample_time=PERIOD)
    healthy = simulate(arm, motion_range(arm, 0.5), seed, pauses=True)
    time, rng = healthy.stamps * 1e-9, np.random.default_rng(seed)
    taken = time + jitter * PERIOD * rng.normal(size=len(time))
    stream = derived(replace(healthy, samples=read_at(healthy, taken)))
    monitor = SerialMonitor(arm)
    monitor.update_many(1 + stream.stamps, stream.samples)
    return monitor


@pytest.mark.parametrize('jitter', [0.0, 0.2])
def test_given_stamps_that_scatter_when_the_arm_moves_then_their_error_is_learned(jitter):
    learned = [np.sqrt(monitored(k, jitter).sampler.clock[JITTER]) / PERIOD for k in range(4)]
    assert np.median(learned) == pytest.approx(jitter, abs=0.05)


@pytest.mark.parametrize('seed', range(10))
def test_given_stamps_that_scatter_when_encoders_are_healthy_then_none_is_blamed(seed):
    assert [(a.sensor, a.kind) for a in monitored(seed, 0.2).alarms if a.sensor] == []
