"""Recordings of a driver that repeats a sample now and then, resampled by who recorded them.

What was a repeated sample is then readings of all joints that are late together, for a while.
"""

import numpy as np
import pytest
from fault_injection import BY_NAME, Injected, Stream, derived, inject, motion_range, simulate
from scipy.interpolate import CubicSpline, make_interp_spline
from serial_arms import blamed, shoulder_arm, watch, with_rates

SLOW, FAST = 1.0 / 30.0, 0.005
"""Sample times of the driver, and as resampled [s]."""


def resampled(rates, degree, seed, *faults):
    """Monitor after such a recording; rates are resampled, too, or slopes of the readings'."""
    arm, rng = with_rates(shoulder_arm(), rates, sample_time=SLOW), np.random.default_rng(seed)
    slow = simulate(arm, motion_range(arm, 0.5), seed)
    slow = derived(slow) if rates == 'derived' else slow
    drift, is_derived = BY_NAME['drift 0.3'], rates == 'derived'
    slow = inject(slow, drift, list(faults), is_derived, np.eye(3), rng).stream
    late = 1 + np.flatnonzero(rng.random(len(slow.stamps) - 1) < 0.02)
    samples = slow.samples.copy()
    samples[late] = slow.samples[late - 1]
    time, fine = SLOW * np.arange(len(samples)), np.arange(0.0, 19.9, FAST)
    samples_fine = make_interp_spline(time, samples, degree)(fine)
    if rates == 'derived' and degree > 1:
        samples_fine[:, 1] = CubicSpline(time, samples[:, 0])(fine, 1)
    run = Stream(1 + np.round(1e9 * fine).astype(np.int64), samples_fine)
    run = derived(run) if rates == 'derived' and degree == 1 else run
    return watch(with_rates(arm, rates, sample_time=FAST), run)


WAYS = pytest.mark.parametrize(
    ('rates', 'degree'), [('derived', 3), ('derived', 1), ('independent', 3), ('independent', 1)]
)


@WAYS
@pytest.mark.parametrize('seed', [1, 2])
def test_given_repeated_samples_that_were_smoothed_then_no_sensor_is_blamed(rates, degree, seed):
    assert blamed(resampled(rates, degree, seed)) == []


@pytest.mark.parametrize(('rates', 'degree', 'seed'), [
    *((*way, 1) for way in WAYS.args[1]),
    # The drifting reading, as corrected, shows that all come late, which two others hardly do.
    *(('independent', degree, seed) for degree, seed in ((1, 3), (1, 4), (1, 6), (3, 3))),
])  # fmt: skip
def test_given_repeated_samples_that_were_smoothed_when_a_reading_drifts_then_no_other_drifts(
    rates, degree, seed
):
    monitor = resampled(rates, degree, seed, Injected(1, 10.0, 30.0))
    assert blamed(monitor)[0] == ('encoder2', 'drift') and monitor.alarms[0].detected < 11.5e9
    assert {one for one in blamed(monitor) if one[1] != 'bias'} == {('encoder2', 'drift')}
