"""Dead reckoning beside the observer: what moves a sensor's residual, and whose fault that is."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from parts import History, Swing, make_estimate
from stepwise import Diagnoser, UnknownInputObserver

from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.residual.dead_reckoning import (
    RATE_BIAS,
    RECKONING_STATE,
    dead_reckoning,
    reset_reckoning,
    update_dead_reckoning,
)
from lpv_core.residual.rate_sensor_test import (
    IMPLICATED,
    RULED_OUT,
    UNDECIDED,
    Movement,
    rate_test,
    rate_verdict,
)
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.support.records import new_record

pytestmark = pytest.mark.slow

TS = 2_000_000


class Reckoning:
    """Residuals of one arm."""

    def __init__(self, arm):
        self.constants, self.state = dead_reckoning(arm), new_record(RECKONING_STATE)
        reset_reckoning(self.state)

    def update(self, **estimate):
        update_dead_reckoning(self.constants, self.state, make_estimate(**estimate))
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
            interval=0.002,
            absolute_position=(angle + error, 0.0),
            fault=(-error, 0.0),
            absolute_velocity=(rate, 0.0),
        )
        residuals.append(residual)
    np.testing.assert_allclose(residuals, residuals[:1] * 500, atol=1e-5)


def test_given_a_fault_when_it_starts_then_its_own_residual_jumps_by_it(real_arm, real_gains):
    reckoning = Reckoning(real_arm)
    reckoning.update(absolute_position=(math.pi, math.pi))
    residual, _ = reckoning.update(
        interval=0.002, absolute_position=(math.pi, math.pi), fault=(0.2, -0.1)
    )
    np.testing.assert_allclose(residual, [0.2, -0.1])


@pytest.mark.parametrize('velocity_error', [0.0, 0.02])
def test_given_time_and_motion_when_reckoned_then_the_allowance_is_what_the_arm_file_states(
    paper_arm, velocity_error
):
    reckoning = Reckoning(replace(paper_arm, velocity_error=velocity_error))
    for _ in range(500):
        _, allowance = reckoning.update(interval=0.002, absolute_velocity=(3.0, -1.0))
    bias = RATE_BIAS * paper_arm.velocity_noise
    np.testing.assert_allclose(allowance, bias + velocity_error * np.array([3.0, 1.0]))


def test_given_a_gap_when_it_is_bridged_then_the_residual_stays_what_it_was(reckoning):
    reckoning.update()
    before, _ = reckoning.update(interval=0.002, absolute_velocity=(1.0, 0.0), fault=(0.2, 0.0))
    after, _ = reckoning.update(
        interval=7.0,
        bridged=True,
        absolute_position=(0.9, 0.1),
        absolute_velocity=(0.5, 0.0),
        fault=(0.2, 0.0),
    )
    np.testing.assert_allclose(after, before)


# ------------------------------------------------------------------ a rate that went wrong


AT, COUNT = 300, 500


def past_of(arm, gains, speed, guilty, rise=0.0, seed=0, noisy=True):
    """A residual that moves from a sample on, within a time to its speed; through a wrong rate, or
    not."""
    constants, rng = rate_test(arm, gains), np.random.default_rng(seed)
    history, moved, shown, before = History(1000), 0.0, 0.0, 0.0
    for k in range(COUNT):
        now = 0.0 if k < AT else 1.0 if rise == 0.0 else min(1.0, 0.002 * (k - AT) / rise)
        shown, before = constants.fall * shown + speed * (now - before), now
        residual = moved + noisy * arm.position_noise * rng.standard_normal()
        # A rate that reads too much makes the residual fall, and the innovation, too.
        history.add(
            k * TS,
            residual,
            residual,
            innovation=(guilty * shown + noisy * arm.velocity_noise * rng.standard_normal()),
        )
        moved += speed * now * 0.002
    return history


def verdict(arm, gains, history, speed, onset=AT):
    return rate_verdict(rate_test(arm, gains), history.buffer, Movement(0.0, onset * TS, speed))


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('speed', [0.1, -0.2, 1.0])
def test_given_a_residual_that_moves_when_its_rate_went_wrong_then_that_is_guilty_else_innocent(
    paper_arm, paper_gains, speed, seed
):
    guilty = past_of(paper_arm, paper_gains, speed, True, seed=seed)
    assert verdict(paper_arm, paper_gains, guilty, speed) == IMPLICATED
    innocent = past_of(paper_arm, paper_gains, speed, False, seed=seed)
    assert verdict(paper_arm, paper_gains, innocent, speed) == RULED_OUT


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('rise', [0.01, 0.03, 0.05, 0.1, 0.15, 0.3])
@pytest.mark.parametrize('speed', [0.03, -0.05, 0.1, -0.2, 0.5])
def test_given_a_rate_that_went_wrong_gradually_when_judged_then_it_is_never_innocent(
    paper_arm, paper_gains, speed, rise, seed
):
    history = past_of(paper_arm, paper_gains, speed, True, rise, seed)
    late = AT + round(0.5 * rise / 0.002)  # a sudden course would seem to begin there
    assert verdict(paper_arm, paper_gains, history, speed, late) != RULED_OUT


@pytest.mark.parametrize(('speed', 'rise'), [(0.02, 0.0), (-0.04, 0.0), (0.1, 0.4)])
def test_given_a_course_that_a_rate_could_have_hidden_when_judged_then_nothing_is_known(
    paper_arm, paper_gains, speed, rise
):
    history = past_of(paper_arm, paper_gains, speed, False, rise)
    assert verdict(paper_arm, paper_gains, history, speed, AT + round(250 * rise)) == UNDECIDED


def test_given_tolerated_torques_when_they_could_hide_it_then_nothing_is_known(
    real_arm, real_gains
):
    hidden = rate_test(real_arm, real_gains).smallest
    assert hidden > 0.1
    for speed, expected in ((0.99 * hidden, UNDECIDED), (2.0 * hidden, RULED_OUT)):
        history = past_of(real_arm, real_gains, speed, False)
        assert verdict(real_arm, real_gains, history, speed) == expected


def test_given_a_course_that_nothing_explains_when_judged_then_nothing_is_known(
    paper_arm, paper_gains
):
    history = past_of(paper_arm, paper_gains, 0.5, False)
    rows = np.arange(AT, COUNT)
    history.buffer.values[rows, 0] += 0.02 * np.sin(0.2 * (rows - AT))
    assert verdict(paper_arm, paper_gains, history, 0.5) == UNDECIDED


@pytest.mark.parametrize('onset', [0, 20, COUNT - 2, COUNT, COUNT + 50])
def test_given_too_few_samples_when_judged_then_nothing_is_known(paper_arm, paper_gains, onset):
    history = past_of(paper_arm, paper_gains, 0.0, False, noisy=False)
    assert verdict(paper_arm, paper_gains, history, 0.5, onset) == UNDECIDED


def test_given_a_residual_at_rest_when_judged_then_nothing_is_known(paper_arm, paper_gains):
    history = past_of(paper_arm, paper_gains, 0.0, False, noisy=False)
    assert verdict(paper_arm, paper_gains, history, 0.0) == UNDECIDED


def test_given_method_paper_when_judged_then_nothing_is_known(paper_arm, paper_gains):
    other = SimpleNamespace(observer=SimpleNamespace(method='paper'))
    history = past_of(paper_arm, paper_gains, 1.0, False)
    assert verdict(paper_arm, other, history, 1.0) == UNDECIDED


# ------------------------------------------------------------------ the whole loop


@pytest.fixture
def simulate(paper_arm, paper_gains, two_faults):
    def run(*faults, duration=6.0, **fields):
        return run_closed_loop(
            paper_arm, paper_gains, replace(two_faults, faults=faults, duration=duration, **fields)
        )

    return run


def tracking_rms(run, since, until):
    part = (run.time >= since) & (run.time < until)
    return float(np.sqrt(np.mean((run.position - run.reference)[part] ** 2)))


@pytest.mark.parametrize('index', [0, 1])
@pytest.mark.parametrize('rate', [0.02, 0.04])
def test_given_a_drift_as_slow_as_a_rate_may_go_wrong_when_it_starts_then_the_cause_is_unknown(
    simulate, paper_arm, rate, index
):
    run = simulate(Fault(paper_arm.sensor_names[index], 'drift', onset=1.5, rate=rate))
    raised = run.alarms[0]
    assert (raised.event, raised.sensor_index) == (AlarmEvent.RAISED, index)
    assert 1.5e9 < raised.detected <= (1.5 + 0.016 / rate) * 1e9
    assert raised.kind == 'inconsistent'
    # Once gravity contradicts the reading by more than a wrong rate can, it is named after all.
    assert {a.sensor_index for a in run.alarms} == {index}
    assert {a.kind for a in run.alarms} <= {'inconsistent', 'unclassified', 'drift'}


@pytest.mark.parametrize('index', [0, 1])
@pytest.mark.parametrize(('size', 'rise'), [(0.03, 1.5), (-0.05, 0.5), (0.08, 4.0), (-0.15, 4.0)])
def test_given_a_rate_that_goes_wrong_slowly_when_the_arm_stops_for_it_then_nobody_is_blamed(
    simulate, paper_arm, size, rise, index
):
    steps = 12
    faults = [
        Fault(
            paper_arm.sensor_names[index],
            'rate_bias',
            onset=1.0 + rise * k / steps,
            size=size / steps,
        )
        for k in range(steps)
    ]
    run = simulate(*faults, duration=8.0)
    assert {a.kind for a in run.alarms} <= {'inconsistent'}


@pytest.mark.parametrize('index', [0, 1])
@pytest.mark.parametrize(('rate', 'delay'), [(0.1, 0.15), (0.15, 0.1), (0.2, 0.08)])
def test_given_a_drift_when_it_starts_then_it_is_seen_by_its_change_and_named(
    simulate, paper_arm, rate, delay, index
):
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
    simulate, paper_arm, size, index
):
    """The residual moves as it would by a drift of the encoder; the innovation tells."""
    run = simulate(
        Fault(paper_arm.sensor_names[index], 'rate_bias', onset=1.5, size=size), duration=3.0
    )
    assert run.alarms
    assert {a.kind for a in run.alarms} == {'inconsistent'}
    assert max(a.confidence for a in run.alarms) <= 0.5
    np.testing.assert_array_equal(run.compensated[:1000], run.measured[:1000])


@pytest.mark.parametrize('kind', ['stuck', 'noise', 'dropout'])
@pytest.mark.parametrize('index', [0, 1])
def test_given_a_sensor_of_no_use_and_a_wrong_model_when_confirmed_then_the_arm_keeps_its_path(
    simulate, paper_arm, kind, index
):
    wrong = {'mass_factors': (1.04, 0.97), 'inertia_factors': (0.96, 1.03)}
    fault = Fault(
        paper_arm.sensor_names[index],
        kind,
        onset=1.5,
        duration=4.0,
        size={'noise': 0.03}.get(kind, 0.0),
    )
    run, healthy = (simulate(*faults, **wrong) for faults in ((fault,), ()))
    since = run.alarms[0].detected / 1e9
    assert tracking_rms(run, since, 5.5) < 4.0 * tracking_rms(healthy, since, 5.5)
    assert run.trustworthy.all()


def test_given_a_long_dropout_when_rates_are_biased_then_gravity_bounds_what_is_followed(
    paper_arm, paper_gains
):
    """A rate that is wrong by 5 mrad/s leads away by 0.3 rad in a minute."""
    observer, diagnoser = (
        UnknownInputObserver(paper_arm, paper_gains),
        Diagnoser(paper_arm, paper_gains),
    )
    # At rest upright, gravity and torque balance at zero.
    for k in range(30_000):
        position = (0.0, 0.0) if k < 500 else (math.nan, math.nan)
        estimate = observer.update(
            k * TS, np.add(position, (math.pi / 2, 0.0)), (0.005, 0.0), (0.0, 0.0)
        )
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
        kept[k : k + burst] = False
    kept[:20] = True
    return kept


@pytest.mark.parametrize(('probability', 'burst'), [(0.05, 1), (0.3, 1), (0.01, 10), (0.004, 40)])
@pytest.mark.parametrize(('seed', 'rough'), [(0, 0.0), (1, 0.0), (2, 0.1), (3, 0.1), (4, 0.1)])
def test_given_a_quick_healthy_arm_when_samples_are_lost_then_nothing_is_raised(
    real_arm, real_gains, probability, burst, seed, rough
):
    """Also if the rates jitter in proportion to speed, as those by difference do."""
    swing = Swing(real_arm, pace=8.0)
    kept = np.flatnonzero(drop(5000, probability, burst, seed))
    samples = [swing.sample(0.002 * k) for k in kept]
    position, velocity, effort = (np.array(part) for part in zip(*samples))
    position += 0.001 * np.random.default_rng(seed).standard_normal(position.shape)
    noise = np.random.default_rng(seed + 9).standard_normal((2, 5001, 2))
    velocity += 0.01 * noise[0, kept] + rough * velocity * np.diff(noise[1], axis=0)[kept]
    answers = SensorMonitor('', real_arm, real_gains).take_many(
        kept * TS, position, velocity, effort
    )
    assert np.abs(velocity).max() > 4.0  # quick enough to say something
    assert answers.events == []


def test_given_lost_samples_when_a_step_comes_after_them_then_it_is_seen_all_the_same(
    real_arm, real_gains
):
    swing = Swing(real_arm)
    kept = np.flatnonzero(drop(3000, 0.05, 1, 3))
    samples = [swing.sample(0.002 * k, fault=(0.0, 0.2 * (k >= 2000))) for k in kept]
    answers = SensorMonitor('', real_arm, real_gains).take_many(
        kept * TS, *(np.array(part) for part in zip(*samples))
    )
    raised = [alarm for _, alarm in answers.events if alarm.event == AlarmEvent.RAISED]
    assert [a.sensor_index for a in raised] == [1]
    assert raised[0].detected <= 2010 * TS
    assert raised[0].size == pytest.approx(0.2, abs=0.01)
