"""The statistic of detection means what it says: on healthy data it rarely is large."""

import numpy as np
import pytest
from serial_arms import shoulder_arm, simulated

from lpv.core.serial_arm.diagnosis.monitor import SerialMonitor

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
