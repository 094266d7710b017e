"""Samples that come at 30 Hz: five of them, for which each waits, are a sixth of a second."""

import numpy as np
import pytest
from fault_injection import BY_NAME, Injected, derived, inject, motion_range, simulate
from serial_arms import shoulder_arm, watch, with_rates

RATES = pytest.mark.parametrize('rates', ['derived', 'independent'])
END = 6.0
"""Of a first fault, from 4 s on [s]."""


def watched(kind, rates, *faults, until=9.0, seed=1):
    """Monitor and truth after such faults of sensors, each with its begin and end [s]."""
    arm = with_rates(shoulder_arm(), rates, sample_time=1.0 / 30.0)
    healthy = simulate(arm, motion_range(arm, 0.5), seed, duration=until)
    is_derived = rates == 'derived'
    healthy = derived(healthy) if is_derived else healthy
    rng = np.random.default_rng(seed)
    injected = [Injected(*fault) for fault in faults]
    window = inject(healthy, BY_NAME[kind], injected, is_derived, np.eye(3), rng)
    return watch(arm, window.stream), window.truth[-1]


def named(monitor):
    return {(one.sensor, one.kind) for one in monitor.alarms if one.sensor}


@RATES
@pytest.mark.parametrize('seed', [1, 2])
def test_given_slow_samples_when_a_reading_freezes_then_its_joint_is_followed(rates, seed):
    monitor, truth = watched('stuck', rates, (1, 4.0, END), until=5.0, seed=seed)
    assert named(monitor) == {('encoder2', 'stuck')}  # and it is not noise
    fault, sigma = monitor.faults()
    assert np.all(np.abs(fault - truth) < 4.0 * sigma + 1e-3)
    if rates == 'independent':  # its rate says where the joint is
        assert np.abs(fault - truth).max() < 0.1


@RATES
@pytest.mark.parametrize('seed', [1, 2])
def test_given_slow_samples_when_a_frozen_reading_jumps_back_then_it_is_right(rates, seed):
    monitor, _ = watched('stuck', rates, (1, 4.0, END), seed=seed)
    assert named(monitor) == {('encoder2', 'stuck')}
    assert monitor.alarms[-1].event == 'cleared'
    assert np.all(monitor.taken_out() == 0.0)


@RATES
def test_given_a_noisy_reading_when_another_one_becomes_so_then_it_is_named_too(rates):
    monitor, _ = watched('noise 0.02', rates, (0, 4.0, 20.0), (2, 7.0, 20.0), until=7.6)
    assert ('encoder3', 'noise') in named(monitor)
    assert monitor.sampler.noisy.tolist() == [1, 0, 1]
