"""Samples that come at 30 to 100 Hz: each waits for five others, up to a sixth of a second.

Rates that are differences are those of half a sample before, and of a joint that rests, noise.
"""

from dataclasses import replace

import fault_injection as made
import numpy as np
import pytest
from fault_injection import derived, motion_range, random_arm, simulate, sines
from serial_arms import blamed, delivered, shoulder_arm, watch, with_rates
from watched import Watched

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.model import SerialModel

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
    injected, kind = [made.Injected(*fault) for fault in faults], made.BY_NAME[kind]
    window = made.inject(healthy, kind, injected, is_derived, np.eye(3), rng)
    return watch(arm, window.stream), window.truth[-1]


@RATES
@pytest.mark.parametrize('seed', [1, 2])
def test_given_slow_samples_when_a_reading_freezes_then_it_is_followed(rates, seed):
    monitor, truth = watched('stuck', rates, (1, 4.0, END), until=5.0, seed=seed)
    assert set(blamed(monitor)) == {('encoder2', 'stuck')}  # and it is not noise
    fault, sigma = monitor.faults()
    assert np.all(np.abs(fault - truth) < 4.0 * sigma + 1e-3)
    if rates == 'independent':  # its rate says where the joint is
        assert np.abs(fault - truth).max() < 0.1
    monitor, _ = watched('stuck', rates, (1, 4.0, END), seed=seed)
    assert set(blamed(monitor)) == {('encoder2', 'stuck')}
    assert monitor.alarms[-1].event.name == 'CLEARED'
    assert np.all(monitor.followed.taken_out() == 0.0)


@RATES
def test_given_a_noisy_reading_when_another_one_becomes_so_then_it_is_named_too(rates):
    monitor, _ = watched('noise 0.02', rates, (0, 4.0, 20.0), (2, 7.0, 20.0), until=7.6)
    assert ('encoder3', 'noise') in blamed(monitor)
    assert monitor.sampler.noisy.tolist() == [1, 0, 1]


@pytest.mark.parametrize('rate', [30.0, 50.0, 100.0])
def test_given_differences_as_rates_when_an_arm_moves_then_balances_hold_its_true_momentum(rate):
    arm = with_rates(shoulder_arm(), 'derived', sample_time=1.0 / rate)
    path = sines(*motion_range(arm, 0.5), np.random.default_rng(1))
    motion = path(np.arange(round(6.0 * rate)) / rate)
    torque = SerialModel(compile_chain(arm)).torque(*motion)
    run = delivered(arm, np.stack([*motion[:2], torque], axis=1))
    estimator = watch(arm, run).estimator
    # Until they are known to be late by half a sample, rates are taken as they come.
    left = estimator.window.rows[3 : len(estimator), :, 0] / estimator.plan.interval
    usual = np.sqrt((run.samples[:, 2] ** 2).mean(0))
    assert (np.sqrt((left**2).mean(0)) < 2e-3 * usual).all()


FAST = with_rates(made.two_links('real_arm')[0], 'derived', sample_time=0.02)
LONG = with_rates(random_arm(8), 'derived', sample_time=0.01)


@pytest.mark.parametrize(('arm', 'motion', 'seed'), [
    *((FAST, [np.zeros(2), np.full(2, 9.0), np.full(2, 25.0)], seed) for seed in (3, 6)),
    # The noise of its rate while a joint rests is no scale error.
    *((LONG, motion_range(LONG, 0.5), seed) for seed in (108, 113)),
], ids=['fast 3', 'fast 6', 'long 108', 'long 113'])  # fmt: skip
def test_given_fast_joints_or_a_long_chain_then_nothing_is_suspected(arm, motion, seed):
    run, monitor = derived(simulate(arm, motion, seed, pauses=True)), Watched(arm)
    threshold = monitor.settings.threshold(monitor.plan.interval)
    for part in range(0, len(run.stamps), 25):
        rows = slice(part, part + 25)
        monitor.take(1 + run.stamps[rows], run.samples[rows])
        assert monitor.statistic < threshold
    assert blamed(monitor) == []


@RATES
@pytest.mark.parametrize('taken', [-1.0, 0.0])
def test_given_efforts_that_are_means_or_commands_then_no_encoder_is_blamed(rates, taken):
    """Efforts are means over a sample that begins so many periods after their stamp."""
    arm, quiet = random_arm(4), {'position_noise': 1e-6, 'velocity_noise': 1e-4, 'rates': rates}
    arm, rng = made.with_sensors(replace(arm, sample_time=0.01), **quiet), np.random.default_rng(1)
    path = sines(*motion_range(arm, 0.5)[:2], np.full(4, 12.0), rng)  # up to 30 rad/s2
    model, time = SerialModel(made.wrong_chain(arm, rng)), arm.sample_time * np.arange(1000)
    moments = arm.sample_time * (taken + np.arange(0.05, 1.0, 0.1))
    effort = np.mean([model.torque(*path(time + moment)) for moment in moments], axis=0)
    samples = np.stack([*path(time)[:2], effort], axis=1)
    samples[:, 0] += 1e-6 * rng.normal(size=effort.shape)
    samples[:, 1] += 1e-4 * rng.normal(size=effort.shape)
    monitor = watch(arm, delivered(arm, samples))
    assert blamed(monitor) == []
    fault, sigma = monitor.faults()
    assert np.all(np.abs(fault) < 4.0 * sigma)
    delay = monitor.estimator.posterior.mean[-1]  # in half samples
    assert delay == pytest.approx(-1.0 - 2.0 * taken, abs=0.1)


@pytest.mark.parametrize(('first', 'shares'), [
    (799, (1.2, 0.8)),  # e of the sample before is 0.75 of the jump
    (798, (0.7, 1.2, 0.9)),  # as if a sample were missing, which the jump's own rate explains
])  # fmt: skip
def test_given_uneven_samples_when_a_reading_jumps_then_no_rate_explains_it(first, shares):
    arm, rng, rows = shoulder_arm(), np.random.default_rng(0), 1000
    periods = np.full(rows, arm.sample_time)
    periods[first : first + len(shares)] *= shares
    samples = np.zeros((rows, 3, 3))
    samples[:, 0] = 1e-4 * rng.normal(size=(rows, 3))
    samples[800:, 0, 1] -= 0.3
    samples[1:, 1] = np.diff(samples[:, 0], axis=0) / periods[1:, None]
    monitor = Watched(arm)
    monitor.take(10**9 + np.round(np.cumsum(periods) * 1e9).astype(int), samples)
    (alarm,) = monitor.alarms
    assert abs(alarm.size + 0.3) < 1e-3
