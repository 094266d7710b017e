"""Dead reckoning beside the observer: what moves a sensor's residual, and whose fault that is."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from parts import History, Swing, make_estimate

from lpv_core.closed_loop import run_closed_loop
from lpv_core.dead_reckoning import (
    RATE_BIAS,
    RECKONING_STATE,
    dead_reckoning,
    reckon,
    reset_reckoning,
)
from lpv_core.diagnosis import AlarmEvent, Diagnoser
from lpv_core.faults import Fault
from lpv_core.monitor import SensorMonitor
from lpv_core.observer import UnknownInputObserver
from lpv_core.rate_fault import GUILTY, INNOCENT, UNKNOWN, rate_test, rate_verdict
from lpv_core.records import new_record

TS = 2_000_000


class Reckoning:
    """Residuals of one arm."""

    def __init__(self, arm):
        self.constants, self.state = dead_reckoning(arm), new_record(RECKONING_STATE)
        reset_reckoning(self.state)

    def update(self, **estimate):
        reckon(self.constants, self.state, make_estimate(**estimate))
        return self.state.residual.copy(), self.state.allowance.copy()


@pytest.fixture
def reckoning(paper_arm):
    return Reckoning(paper_arm)


# ------------------------------------------------------------------ the residual


def test_given_a_wrong_estimate_when_reckoned_then_only_readings_and_rates_count(reckoning):
    residuals = []
    for k in range(500):
        angle, error = 0.3 * math.sin(0.01 * k), 0.1 * math.cos(0.02 * k)
        rate = 0.3 * 0.01 / 0.002 * math.cos(0.01 * k)
        residual, _ = reckoning.update(
            interval=0.002, absolute_position=(angle + error, 0.0), fault=(-error, 0.0),
            absolute_velocity=(rate, 0.0))
        residuals.append(residual)
    np.testing.assert_allclose(residuals, residuals[:1] * 500, atol=1e-5)


def test_given_a_fault_when_it_starts_then_its_own_residual_jumps_by_it(real_arm, real_gains):
    reckoning = Reckoning(real_arm)
    reckoning.update(absolute_position=(math.pi, math.pi))
    residual, _ = reckoning.update(interval=0.002, absolute_position=(math.pi, math.pi),
                                   fault=(0.2, -0.1))
    np.testing.assert_allclose(residual, [0.2, -0.1])


@pytest.mark.parametrize('velocity_error', [0.0, 0.02])
def test_given_time_and_motion_when_reckoned_then_the_allowance_is_what_the_arm_file_states(
        paper_arm, velocity_error):
    reckoning = Reckoning(replace(paper_arm, velocity_error=velocity_error))
    for _ in range(500):
        _, allowance = reckoning.update(interval=0.002, absolute_velocity=(3.0, -1.0))
    bias = RATE_BIAS * paper_arm.velocity_noise
    np.testing.assert_allclose(allowance, bias + velocity_error * np.array([3.0, 1.0]))


def test_given_a_gap_when_it_is_bridged_then_the_residual_stays_what_it_was(reckoning):
    reckoning.update()
    before, _ = reckoning.update(interval=0.002, absolute_velocity=(1.0, 0.0), fault=(0.2, 0.0))
    after, _ = reckoning.update(interval=7.0, bridged=True, absolute_position=(0.9, 0.1),
                                absolute_velocity=(0.5, 0.0), fault=(0.2, 0.0))
    np.testing.assert_allclose(after, before)


# ------------------------------------------------------------------ a rate that went wrong


def past_of(arm, gains, size, sigma=0.0, count=400, at=200):
    """Innovations around a rate that is suddenly wrong by a size."""
    fall = rate_test(arm, gains).fall
    history, noise = History(1000), np.random.default_rng(2).standard_normal(count)
    for k in range(count):
        wrong = -size * fall ** (k - at) if k >= at else 0.0
        history.add(k * TS, 0.0, 0.0, innovation=wrong + sigma * noise[k])
    return history


def verdict(arm, gains, history, speed, first=195, last=205):
    return rate_verdict(rate_test(arm, gains), history.values, history.end, first, last, speed)


@pytest.mark.parametrize('size', [0.1, -0.1, 0.5])
def test_given_a_rate_that_went_wrong_when_judged_then_it_is_guilty_of_its_own_speed_only(
        paper_arm, paper_gains, size):
    history = past_of(paper_arm, paper_gains, size, sigma=paper_arm.velocity_noise)
    # A rate that reads too much makes the residual fall.
    assert verdict(paper_arm, paper_gains, history, -size) == GUILTY
    assert verdict(paper_arm, paper_gains, history, -5.0 * size) == INNOCENT
    assert verdict(paper_arm, paper_gains, history, size) == UNKNOWN


def test_given_rates_with_noise_only_when_judged_then_they_are_innocent_of_what_would_have_shown(
        paper_arm, paper_gains):
    history = past_of(paper_arm, paper_gains, 0.0, sigma=paper_arm.velocity_noise)
    assert verdict(paper_arm, paper_gains, history, 0.1) == INNOCENT
    assert verdict(paper_arm, paper_gains, history, -0.1) == INNOCENT
    assert verdict(paper_arm, paper_gains, history, 0.01) == UNKNOWN   # hidden by noise


def test_given_tolerated_torques_when_they_could_hide_it_then_nothing_is_known(
        real_arm, real_gains):
    history = past_of(real_arm, real_gains, 0.0, sigma=real_arm.velocity_noise)
    hidden = rate_test(real_arm, real_gains).smallest
    assert hidden > 0.1
    assert verdict(real_arm, real_gains, history, 0.99 * hidden) == UNKNOWN
    assert verdict(real_arm, real_gains, history, 2.0 * hidden) == INNOCENT


def test_given_too_few_samples_when_judged_then_nothing_is_known(paper_arm, paper_gains):
    history = past_of(paper_arm, paper_gains, 0.0)
    assert verdict(paper_arm, paper_gains, history, 0.1, first=3) == UNKNOWN
    assert verdict(paper_arm, paper_gains, history, 0.1, last=399) == UNKNOWN


def test_given_method_paper_when_judged_then_nothing_is_known(paper_arm, paper_gains):
    other = SimpleNamespace(observer=SimpleNamespace(method='paper'))
    history = past_of(paper_arm, paper_gains, 0.0)
    assert verdict(paper_arm, other, history, 1.0) == UNKNOWN


# ------------------------------------------------------------------ the whole loop


@pytest.fixture
def simulate(paper_arm, paper_gains, two_faults):
    def run(*faults, duration=6.0, **fields):
        return run_closed_loop(paper_arm, paper_gains,
                               replace(two_faults, faults=faults, duration=duration, **fields))
    return run


def tracking_rms(run, since, until):
    part = (run.time >= since) & (run.time < until)
    return float(np.sqrt(np.mean((run.position - run.reference)[part] ** 2)))


@pytest.mark.parametrize('index', [0, 1])
@pytest.mark.parametrize(('rate', 'delay'), [(0.03, 0.9), (0.05, 0.6), (0.2, 0.2)])
def test_given_a_drift_when_it_starts_then_it_is_seen_by_its_change_and_named(
        simulate, paper_arm, rate, delay, index):
    run = simulate(Fault(paper_arm.sensor_names[index], 'drift', onset=1.5, rate=rate))
    assert {a.sensor_index for a in run.alarms} == {index}
    raised = run.alarms[0]
    assert (raised.event, run.alarms[-1].kind) == (AlarmEvent.RAISED, 'drift')
    assert 1.5e9 < raised.detected <= (1.5 + delay) * 1e9
    assert raised.onset == pytest.approx(1.5e9, abs=0.15e9)
    # The level would have had to pass the threshold.
    assert abs(raised.size) < 0.7 * run.threshold[raised.detected // TS, index]
    # From then on the size is known by dead reckoning.
    removed = (run.measured - run.compensated)[-1]
    true = run.fault[-1]
    np.testing.assert_allclose(removed[0], true[0], atol=0.005)


@pytest.mark.parametrize('size', [0.04, -0.06, 0.1, 0.2])
@pytest.mark.parametrize('index', [0, 1])
def test_given_a_bias_of_a_rate_sensor_when_small_then_the_cause_is_called_unknown(
        simulate, paper_arm, size, index):
    """The residual moves as it would by a drift of the encoder; the innovation tells."""
    run = simulate(Fault(paper_arm.sensor_names[index], 'rate_bias', onset=1.5, size=size),
                   duration=3.0)
    assert run.alarms
    assert {a.kind for a in run.alarms} == {'inconsistent'}
    assert max(a.confidence for a in run.alarms) <= 0.5
    np.testing.assert_array_equal(run.compensated[:1000], run.measured[:1000])


@pytest.mark.parametrize('kind', ['stuck', 'noise', 'dropout'])
@pytest.mark.parametrize('index', [0, 1])
def test_given_a_sensor_of_no_use_and_a_wrong_model_when_confirmed_then_the_arm_keeps_its_path(
        simulate, paper_arm, kind, index):
    wrong = {'mass_factors': (1.04, 0.97), 'inertia_factors': (0.96, 1.03)}
    fault = Fault(paper_arm.sensor_names[index], kind, onset=1.5, duration=4.0,
                  size={'noise': 0.03}.get(kind, 0.0))
    run, healthy = (simulate(*faults, **wrong) for faults in ((fault,), ()))
    since = run.alarms[0].detected / 1e9
    assert tracking_rms(run, since, 5.5) < 4.0 * tracking_rms(healthy, since, 5.5)
    assert run.trustworthy.all()


def test_given_a_long_dropout_when_rates_are_biased_then_gravity_bounds_what_is_followed(
        paper_arm, paper_gains):
    """A rate that is wrong by 5 mrad/s leads away by 0.3 rad in a minute."""
    observer, diagnoser = (UnknownInputObserver(paper_arm, paper_gains),
                           Diagnoser(paper_arm, paper_gains))
    # At rest upright, gravity and torque balance at zero.
    for k in range(30_000):
        position = (0.0, 0.0) if k < 500 else (math.nan, math.nan)
        estimate = observer.update(k * TS, np.add(position, (math.pi / 2, 0.0)), (0.005, 0.0),
                                   (0.0, 0.0))
        decision = diagnoser.update(estimate)
    followed = estimate.sensor_position - decision.confirmed_fault
    assert abs(estimate.sensor_position[0]) > 0.25
    expected = estimate.absolute_position
    assert np.all(np.abs(followed - expected) <= decision.bound + 1e-9)
    assert abs(followed[0]) < 0.15


# ------------------------------------------------------------------ lost samples


def drop(count, probability, burst, seed):
    """Which of some samples arrive, if losses of a length begin with a probability."""
    kept = np.ones(count, bool)
    for k in np.flatnonzero(np.random.default_rng(seed).random(count) < probability):
        kept[k:k + burst] = False
    kept[:20] = True
    return kept


@pytest.mark.parametrize(('probability', 'burst'), [(0.05, 1), (0.3, 1), (0.01, 10), (0.004, 40)])
@pytest.mark.parametrize(('seed', 'rough'), [(0, 0.0), (1, 0.0), (2, 0.1), (3, 0.1), (4, 0.1)])
def test_given_a_quick_healthy_arm_when_samples_are_lost_then_nothing_is_raised(
        real_arm, real_gains, probability, burst, seed, rough):
    """Also if the rates jitter in proportion to speed, as those by difference do."""
    swing = Swing(real_arm, pace=8.0)
    kept = np.flatnonzero(drop(5000, probability, burst, seed))
    samples = [swing.sample(0.002 * k) for k in kept]
    position, velocity, effort = (np.array(part) for part in zip(*samples))
    position += 0.001 * np.random.default_rng(seed).standard_normal(position.shape)
    noise = np.random.default_rng(seed + 9).standard_normal((2, 5001, 2))
    velocity += 0.01 * noise[0, kept] + rough * velocity * np.diff(noise[1], axis=0)[kept]
    answers = SensorMonitor('', real_arm, real_gains).take_many(kept * TS, position, velocity,
                                                                effort)
    assert np.abs(velocity).max() > 4.0           # quick enough to say something
    assert answers.events == []


def test_given_lost_samples_when_a_step_comes_after_them_then_it_is_seen_all_the_same(
        real_arm, real_gains):
    swing = Swing(real_arm)
    kept = np.flatnonzero(drop(3000, 0.05, 1, 3))
    samples = [swing.sample(0.002 * k, fault=(0.0, 0.2 * (k >= 2000))) for k in kept]
    answers = SensorMonitor('', real_arm, real_gains).take_many(
        kept * TS, *(np.array(part) for part in zip(*samples)))
    raised = [alarm for _, alarm in answers.events if alarm.event == AlarmEvent.RAISED]
    assert [a.sensor_index for a in raised] == [1]
    assert raised[0].detected <= 2010 * TS
    assert raised[0].size == pytest.approx(0.2, abs=0.01)
