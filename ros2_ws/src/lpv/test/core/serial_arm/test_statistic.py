"""Healthy data: the statistic of detection rarely is large, and stamps may scatter."""

from dataclasses import replace
from functools import cache

import fault_injection
import numpy as np
import pytest
from fault_injection import derived, motion_range, read_at, simulate
from serial_arms import shoulder_arm, simulated, watch
from simulated_runs import Run

from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv.core.serial_arm.diagnosis.sampling import JITTER

DURATION = 12.0


def largest_statistic(rates, spoil):
    """Largest statistic of detection of a healthy arm, and the number of decisions."""
    arm = shoulder_arm(rates)
    run = simulated(arm, seed=3, duration=DURATION)
    stamps, samples = spoil(run.stamps, run.samples, np.random.default_rng(3))
    monitor, largest, decisions = SerialMonitor(arm), -np.inf, 0
    for part in range(0, len(stamps), 25):
        monitor.update_many(stamps[part : part + 25], samples[part : part + 25])
        largest, decisions = max(largest, monitor.statistic), decisions + 1
    return largest, decisions


def as_it_is(stamps, samples, rng):
    return stamps, samples


def with_gaps(stamps, samples, rng):
    kept = np.ones(len(stamps), bool)
    for row in np.flatnonzero(rng.random(len(stamps)) < 0.004):
        kept[row : row + int(rng.integers(1, 5))] = False
    return stamps[kept], samples[kept]


def with_wrong_stamps(stamps, samples, rng):
    off = (rng.random(len(stamps)) < 0.02) * rng.uniform(-0.9, 0.9, len(stamps))
    moved = stamps + np.round(off * 2e6).astype(np.int64)
    rows = np.concatenate([[True], np.diff(moved) > 0])
    return moved[rows], samples[rows]


@pytest.mark.slow
@pytest.mark.parametrize('rates', ['derived', 'independent'])
@pytest.mark.parametrize('spoil', [as_it_is, with_gaps, with_wrong_stamps])
def test_statistic_of_a_healthy_arm_stays_below_what_its_mean_allows(rates, spoil):
    # E[M] is at most the number of decisions: P(M >= 1000 t) <= 1/1000 at the last one.
    largest, decisions = largest_statistic(rates, spoil)
    assert largest < np.log(1000.0 * decisions)


# ------------------------------------------------------------------ stamps that scatter

PERIOD = 0.02  # [s]


@cache
def monitored(seed, jitter):
    """The monitor of an arm at 50 Hz that pauses, after 20 s with readings off their stamps."""
    arm = replace(fault_injection.shoulder_arm(quantization=1e-4), sample_time=PERIOD)
    healthy = simulate(arm, motion_range(arm, 0.5), seed, pauses=True)
    time, rng = healthy.stamps * 1e-9, np.random.default_rng(seed)
    taken = time + jitter * PERIOD * rng.normal(size=len(time))
    stream = derived(replace(healthy, samples=read_at(healthy, taken)))
    return watch(arm, Run(1 + stream.stamps, stream.samples, None))


@pytest.mark.parametrize('jitter', [0.0, 0.2])
def test_given_stamps_that_scatter_when_the_arm_moves_then_their_error_is_learned(jitter):
    learned = [np.sqrt(monitored(k, jitter).sampler.clock[JITTER]) / PERIOD for k in range(4)]
    assert np.median(learned) == pytest.approx(jitter, abs=0.05)


@pytest.mark.parametrize('seed', range(10))
def test_given_stamps_that_scatter_when_encoders_are_healthy_then_none_is_blamed(seed):
    assert [(a.sensor, a.kind) for a in monitored(seed, 0.2).alarms if a.sensor] == []
