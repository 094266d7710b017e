"""Alarms: bounds, dwell, hysteresis, what is and what is not diagnosable."""

import math
from dataclasses import replace

import numpy as np
import pytest
from parts import ErrorBound, make_estimate
from stepwise import Diagnoser, UnknownInputObserver

from lpv_core.decision.diagnosis import AlarmEvent, DiagnosisParameters, SensorState
from lpv_core.model.dynamics import coupling, inverse_dynamics, rk4_step
from lpv_core.model.joints import JointMap
from lpv_core.observer.sampled_observer import Mode
from lpv_core.residual.change_detection import sigmas_for
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.support.timestamps import NANOSECONDS

TS = 2_000_000
PARAMETERS = DiagnosisParameters(dwell=0.01, clear_dwell=0.1, hysteresis=0.5)


def estimate_at(
    k,
    fault=(0.0, 0.0),
    theta=(0.0, 0.0),
    held=(False, False),
    missing=(False, False),
    mode=Mode.OBSERVING,
    interval=0.002,
    rate=(0.0, 0.0),
):
    return make_estimate(
        stamp=k * TS,
        fault=fault,
        absolute_position=theta,
        held=held,
        sensor_position=np.add(theta, fault),
        missing=missing,
        mode=mode,
        interval=interval,
        absolute_velocity=rate,
    )


@pytest.fixture(scope='module')
def settled(paper_arm, paper_gains):
    """Bound of an arm that has been upright for long."""
    bound = ErrorBound(paper_arm, paper_gains, PARAMETERS.sigmas, PARAMETERS.friction_uncertainty)
    for k in range(15000):
        bound.update(estimate_at(k))
    return bound


@pytest.fixture
def diagnoser(paper_arm, paper_gains, settled):
    made = Diagnoser(paper_arm, paper_gains, PARAMETERS)
    made.state.bound = settled.state
    return made


def feed(diagnoser, first, last, **fields):
    """Feed the same estimate at samples first..last; the last diagnosis, alarms and their ends."""
    events, diagnosis = [], None
    for k in range(first, last + 1):
        diagnosis = diagnoser.update(estimate_at(k, **fields))
        events += [e for e in diagnosis.events if e.event != AlarmEvent.UPDATED]
    return diagnosis, events


@pytest.fixture
def threshold(paper_arm, paper_gains, settled):
    """Threshold of sensor 1 upright."""
    fresh = Diagnoser(paper_arm, paper_gains, PARAMETERS)
    fresh.state.bound = settled.state
    return fresh.update(estimate_at(0)).threshold[0]


# ------------------------------------------------------------------ decision


def test_given_an_excursion_when_shorter_than_the_dwell_then_there_is_no_alarm(
    diagnoser, threshold
):
    for start in (0, 20, 40):
        _, events = feed(diagnoser, start, start + 4, fault=(1.01 * threshold, 0.0))
        assert events == []  # 4 intervals of 2 ms: 8 ms of 10
        _, events = feed(diagnoser, start + 5, start + 5, fault=(0.99 * threshold, 0.0))
        assert events == []


def test_given_an_excursion_when_the_dwell_is_over_then_the_right_sensor_is_named_once(
    diagnoser, paper_arm, threshold
):
    feed(diagnoser, 0, 99)
    _, events = feed(diagnoser, 100, 104, fault=(-1.1 * threshold, 0.0))
    assert events == []
    diagnosis, events = feed(diagnoser, 105, 300, fault=(-1.1 * threshold, 0.0))
    assert [e.event for e in events] == [AlarmEvent.RAISED]
    alarm = events[0]
    assert (alarm.sensor_index, alarm.sensor) == (0, paper_arm.sensor_names[0])
    assert (alarm.onset, alarm.detected) == (100 * TS, 105 * TS)
    assert alarm.size == pytest.approx(-1.1 * threshold)
    # A step is known better than a level.
    z = sigmas_for(PARAMETERS.false_alarm_hours, paper_arm.sample_time)
    noise = np.hypot(
        math.sqrt(2) * paper_arm.position_noise, paper_arm.velocity_noise * math.sqrt(0.002 * 0.01)
    )
    assert alarm.bound == pytest.approx(z * noise, rel=0.2)
    assert alarm.bound < 0.5 * diagnosis.bound[0]
    assert diagnosis.state == [SensorState.ERROR, SensorState.OK]
    assert diagnosis.alarm.tolist() == [True, False]
    np.testing.assert_allclose(diagnosis.confirmed_fault, [-1.1 * threshold, 0.0])


def test_given_an_unconfirmed_excursion_when_asked_then_the_state_warns_and_nothing_is_confirmed(
    diagnoser, threshold
):
    diagnosis, _ = feed(diagnoser, 0, 2, fault=(2 * threshold, 0.0))
    assert diagnosis.state == [SensorState.WARN, SensorState.OK]
    np.testing.assert_array_equal(diagnosis.confirmed_fault, 0.0)


def test_given_an_alarm_when_the_fault_shrinks_into_the_hysteresis_then_it_stays(
    diagnoser, threshold
):
    feed(diagnoser, 0, 20, fault=(2 * threshold, 0.0))
    diagnosis, events = feed(diagnoser, 21, 500, fault=(0.51 * threshold, 0.0))
    assert events == []
    assert diagnosis.state[0] == SensorState.ERROR
    np.testing.assert_allclose(diagnosis.confirmed_fault, [0.51 * threshold, 0.0])


def test_given_an_alarm_when_the_fault_is_gone_for_the_dwell_then_it_clears_once(
    diagnoser, threshold
):
    feed(diagnoser, 0, 20, fault=(2 * threshold, 0.0))
    _, events = feed(diagnoser, 21, 70, fault=(0.2 * threshold, 0.0))
    assert events == []  # 98 ms of 100
    _, events = feed(diagnoser, 71, 200, fault=(0.2 * threshold, 0.0))
    assert [(e.event, e.sensor_index) for e in events] == [(AlarmEvent.CLEARED, 0)]
    diagnosis, events = feed(diagnoser, 201, 210)
    assert events == []
    assert diagnosis.state == [SensorState.OK, SensorState.OK]
    _, events = feed(diagnoser, 211, 230, fault=(2 * threshold, 0.0))
    assert [(e.event, e.onset) for e in events] == [(AlarmEvent.RAISED, 211 * TS)]


def test_given_an_alarm_when_the_fault_comes_back_within_the_clear_dwell_then_it_starts_over(
    diagnoser, threshold
):
    feed(diagnoser, 0, 20, fault=(2 * threshold, 0.0))
    for start in range(21, 321, 50):
        _, events = feed(diagnoser, start, start + 48)
        assert events == []
        _, events = feed(diagnoser, start + 49, start + 49, fault=(2 * threshold, 0.0))
        assert events == []


def test_given_faults_of_both_sensors_when_they_overlap_then_both_are_named(diagnoser, threshold):
    _, events = feed(diagnoser, 0, 50, fault=(2 * threshold, 0.0))
    _, more = feed(diagnoser, 51, 100, fault=(2 * threshold, -9 * threshold))
    assert [e.sensor_index for e in events + more] == [0, 1]


def test_given_larger_faults_when_alarmed_then_confidence_is_higher_and_a_probability(
    paper_arm, paper_gains
):
    values = []
    for size in (0.08, 0.1, 0.2, 1e6):
        _, events = feed(Diagnoser(paper_arm, paper_gains), 0, 10, fault=(size, 0.0))
        values.append(events[0].confidence)
    assert values == sorted(values)
    assert values[0] > 0.9999  # four standard deviations
    assert values[-1] <= 1.0


def test_given_a_minimum_threshold_when_the_bound_is_smaller_then_it_rules(paper_arm, paper_gains):
    parameters = replace(PARAMETERS, minimum_threshold=0.5)
    diagnosis, events = feed(
        Diagnoser(paper_arm, paper_gains, parameters), 0, 50, fault=(0.49, 0.49)
    )
    assert events == []
    np.testing.assert_array_equal(diagnosis.threshold, 0.5)
    assert diagnosis.bound.max() < 0.5


def test_given_a_threshold_factor_when_doubled_then_the_threshold_doubles(paper_arm, paper_gains):
    one = Diagnoser(paper_arm, paper_gains, replace(PARAMETERS, threshold_factor=1.0))
    two = Diagnoser(paper_arm, paper_gains, replace(PARAMETERS, threshold_factor=2.0))
    np.testing.assert_allclose(
        two.update(estimate_at(0)).threshold, 2.0 * one.update(estimate_at(0)).threshold
    )


# ------------------------------------------------------------------ not diagnosable


def test_given_the_first_sample_when_initialising_then_nothing_is_diagnosable_or_alarmed(diagnoser):
    diagnosis, events = feed(diagnoser, 0, 50, fault=(1.0, 1.0), mode=Mode.INITIALISING)
    assert diagnosis.state == [SensorState.NOT_DIAGNOSABLE] * 2
    assert events == []


def test_given_a_held_link_when_sensors_are_absolute_then_only_its_own_is_not_diagnosable(
    diagnoser,
):
    diagnosis, events = feed(diagnoser, 0, 50, fault=(1.0, 1.0), held=(True, False))
    assert diagnosis.state == [SensorState.NOT_DIAGNOSABLE, SensorState.ERROR]
    assert [e.sensor_index for e in events] == [1]


@pytest.mark.parametrize(
    ('held', 'lost'), [((True, False), [True, True]), ((False, True), [False, True])]
)
def test_given_a_held_link_when_encoders_are_relative_then_those_that_see_it_are_lost(
    real_arm, real_gains, held, lost
):
    diagnosis, events = feed(
        Diagnoser(real_arm, real_gains),
        0,
        50,
        fault=(1.5, 1.5),
        theta=(math.pi, math.pi),
        held=held,
    )
    expected = [SensorState.NOT_DIAGNOSABLE if gone else SensorState.ERROR for gone in lost]
    assert diagnosis.state == expected
    assert [e.sensor_index for e in events] == [i for i in range(2) if not lost[i]]


def test_given_an_alarm_when_the_link_becomes_held_then_it_is_neither_cleared_nor_forgotten(
    diagnoser,
):
    feed(diagnoser, 0, 50, fault=(0.4, 0.0))
    diagnosis, events = feed(diagnoser, 51, 1000, fault=(0.001, 0.0), held=(True, False))
    assert events == []
    assert diagnosis.state[0] == SensorState.ERROR
    assert diagnosis.alarm[0]


def test_given_a_held_link_when_time_passes_then_the_bound_only_grows(diagnoser):
    bounds = [diagnoser.update(estimate_at(k, held=(True, False))).bound[0] for k in range(2000)]
    assert np.all(np.diff(bounds[1:]) > 0.0)


@pytest.mark.slow
def test_given_a_held_link_when_much_time_passes_then_the_bound_never_settles(diagnoser):
    bounds = [diagnoser.update(estimate_at(k, held=(True, False))).bound[0] for k in range(15000)]
    early, late = bounds[5000] - bounds[1], bounds[-1] - bounds[10000]
    assert late > 0.5 * early  # dead reckoning goes on gathering errors


def test_given_a_held_link_when_it_is_observed_again_then_the_bound_falls_back_in_time(
    diagnoser, paper_gains
):
    upright = diagnoser.update(estimate_at(0)).bound
    grown = feed(diagnoser, 1, 3000, held=(True, True))[0].bound
    assert np.all(grown > upright + 0.01)
    slowest = 1.0 / paper_gains.observer.decay
    later = feed(diagnoser, 3001, 3001 + int(2.0 * slowest * 500))[0].bound
    assert np.all(later - upright < 0.25 * (grown - upright))
    assert np.all(later > upright - 1e-4)


def test_given_a_silent_sensor_when_asked_then_it_is_stale_and_its_alarm_is_kept(diagnoser):
    feed(diagnoser, 0, 50, fault=(0.4, 0.0))
    diagnosis, events = feed(diagnoser, 51, 500, fault=(0.0, 0.0), missing=(True, False))
    assert events == []
    assert diagnosis.state == [SensorState.STALE, SensorState.OK]
    assert diagnosis.alarm[0]


@pytest.mark.parametrize('lost', [{'held': (True, True)}, {'missing': (True, True)}])
def test_given_an_excursion_broken_by_a_blind_spell_when_it_shows_again_then_the_dwell_starts_anew(
    diagnoser, lost
):
    feed(diagnoser, 0, 0, fault=(0.5, 0.0))
    feed(diagnoser, 1, 1000, fault=(0.0, 0.0), **lost)
    _, events = feed(diagnoser, 1001, 1002, fault=(0.5, 0.0))
    assert events == []


def test_given_time_restarts_when_the_fault_is_gone_then_the_alarm_clears_in_its_dwell(diagnoser):
    feed(diagnoser, 50_000, 50_050, fault=(0.5, 0.0))
    feed(diagnoser, 50_051, 50_060)
    events = diagnoser.update(estimate_at(0, mode=Mode.INITIALISING, interval=0.0)).events
    events += feed(diagnoser, 1, 500)[1]
    assert not any(s.alarm.active for s in diagnoser.state.sensors)


def test_given_history_when_reset_then_alarms_and_bounds_are_as_new(paper_arm, paper_gains):
    used, fresh = (Diagnoser(paper_arm, paper_gains, PARAMETERS) for _ in range(2))
    feed(used, 0, 500, fault=(0.4, -0.4), held=(True, False), theta=(1.4, 0.0))
    used.reset()
    one, two = used.update(estimate_at(0)), fresh.update(estimate_at(0))
    np.testing.assert_array_equal(one.bound, two.bound)
    assert one.state == two.state == [SensorState.OK] * 2


def test_given_an_alarm_when_retuned_then_it_and_the_bounds_history_stay(diagnoser, threshold):
    feed(diagnoser, 0, 500, fault=(0.0, 0.0), held=(True, False))
    before = feed(diagnoser, 501, 520, fault=(0.8, 0.0))[0]
    diagnoser.retune(replace(PARAMETERS, threshold_factor=3.0))
    after = diagnoser.update(estimate_at(521, fault=(0.8, 0.0)))
    assert after.alarm.tolist() == [True, False]
    assert after.events == []
    # One sample later; a reduction of the set may take some back.
    assert after.bound[0] == pytest.approx(before.bound[0], rel=5e-3)
    assert after.bound[0] > threshold + 0.002  # grown while held, not forgotten
    np.testing.assert_allclose(after.threshold, 3.0 * after.bound)


# ------------------------------------------------------------------ bound


def test_given_rest_when_bounded_then_unknown_torques_over_gravity_slope_are_it(
    paper_arm, paper_gains
):
    bound = ErrorBound(paper_arm, paper_gains, 4.0, 0.3)
    th_1, th_2 = 0.5, -0.8
    # Disturbance through Bd: Xi [0.7*0.2, 0]; 5 % of the gravity torque; no friction.
    off = 2.5 * math.cos(th_1 - th_2)
    observer, noise = paper_gains.observer, 4.0 * paper_gains.observer.fault_sigma
    # A bias of the rates, a tenth of their noise, is held up by a momentum and a torque.
    bias = 0.1 * 0.01 * observer.mu / observer.kappa
    torque = [
        1.05 * 8.33 * 0.14 + 0.05 * 98.0 * math.sin(0.5) + bias[0],
        1.05 * abs(off) * 0.14 + 0.05 * 24.5 * math.sin(0.8) + bias[1],
    ]
    found = bound.static(np.array([th_1, th_2])) - noise
    # The slope is that of the secant over the bound itself.
    half = 0.5 * (found + noise)
    slope = np.array([98.0, 24.5]) * np.cos([0.5, 0.8] + half) * np.sin(half) / half
    np.testing.assert_allclose(found, [torque[0] / slope[0], torque[1] / slope[1]], rtol=1e-6)


def test_given_the_horizontal_when_bounded_at_rest_then_gravity_cannot_bound_the_error(
    paper_arm, paper_gains
):
    bound = ErrorBound(paper_arm, paper_gains, 4.0, 0.3)
    assert np.isinf(bound.static(np.array([math.pi / 2, 0.0]))).tolist() == [True, False]


def test_given_rest_when_time_passes_then_the_bound_rises_to_the_static_one_and_stays(
    paper_arm, paper_gains
):
    bound, theta = ErrorBound(paper_arm, paper_gains, 4.0, 0.3), np.array([0.4, -0.5])
    values = [bound.update(estimate_at(k, theta=theta)) for k in range(15000)]
    static = bound.static(theta)
    assert np.all(np.diff(values, axis=0) > -1e-3)  # a reduction of the set may take some back
    # The static bound takes the worst slope, the reachable set adds what that leaves out.
    np.testing.assert_allclose(values[-1], static, rtol=0.2)
    assert np.all(values[0] < 0.6 * static)


def test_given_relative_encoders_when_bounded_then_encoder_2_carries_both_links(
    real_arm, real_gains
):
    bound = ErrorBound(real_arm, real_gains, 4.0, 0.3)
    for k in range(500):
        total = bound.update(estimate_at(k, theta=(math.pi + 0.2, math.pi - 0.3)))
    angles = bound.state.extent[:2]
    np.testing.assert_allclose(
        total - 4.0 * real_gains.observer.fault_sigma,
        [angles[0], angles[0] + angles[1]],
        rtol=1e-12,
    )


def test_given_a_clock_that_jumps_by_years_when_bounded_then_it_takes_no_longer_than_a_minute_of_it(
    paper_arm, paper_gains
):
    bounds = []
    for gap in (60.0, 1e9):
        bound = ErrorBound(paper_arm, paper_gains, 4.0, 0.3)
        bound.update(estimate_at(0, interval=0.0))
        bounds.append(bound.update(estimate_at(1, interval=gap)))
    np.testing.assert_array_equal(bounds[0], bounds[1])
    assert np.all(np.isfinite(bounds[0]))


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(6))
def test_given_a_wrong_arm_within_its_file_when_it_moves_then_errors_stay_in_the_set(
    arm, gains_of, seed
):
    """The bound without its noise part, against arms at corners and a bang-bang disturbance."""
    rng, gains, n, dt = np.random.default_rng(seed), gains_of[arm.name], 2500, arm.sample_time
    error = arm.model_error * rng.choice([-1.0, 1.0], 4)
    true = arm.scaled(1.0 + error[:2], 1.0 + error[2:])
    factor = rng.choice([0.7, 1.3])
    true = replace(
        true,
        viscous=tuple(factor * v for v in arm.viscous),
        coulomb=tuple(factor * v for v in arm.coulomb),
    ).constants()
    bound, joints = ErrorBound(arm, gains, 0.0, 0.3), JointMap(arm)
    observer = UnknownInputObserver(arm, gains)
    phase, rest = rng.uniform(0, 6, 2), 0.0 if arm.sign > 0 else math.pi
    size, speed = rng.uniform(0.3, 0.7, 2), rng.uniform(0.5, 1.5, 2)
    signs = np.repeat(rng.choice([-1.0, 1.0], n // 50 + 1), 50)
    scale = arm.velocity_error * rng.choice([-1.0, 1.0])
    state = (*(rest + size * np.sin(phase)), *(size * speed * np.cos(phase)))
    effort = np.zeros(2)
    for k in range(n):
        angle = speed * k * dt + phase
        estimate = observer.update(
            k * TS,
            joints.joint_position(state[:2]),
            (1.0 + scale) * joints.joint_velocity(state[2:]),
            effort,
        )
        allowed = bound.update(estimate)
        assert np.all(np.abs(estimate.fault) <= allowed + 2e-5), (k, estimate.fault, allowed)
        wanted = rest + size * np.sin(angle) - state[:2]
        pull = 400.0 * wanted + 40.0 * (size * speed * np.cos(angle) - state[2:])
        torque = inverse_dynamics(*state, *(pull - size * speed**2 * np.sin(angle)), true)
        effort = joints.joint_torque(torque)
        push = signs[k] * arm.disturbance_mean * np.asarray(arm.disturbance_direction)
        state = rk4_step(tuple(state), tuple(torque), tuple(push), dt, true)


@pytest.mark.slow
def test_given_rest_near_the_edge_for_minutes_when_back_upright_then_the_bound_comes_back(
    paper_arm, paper_gains
):
    bound = ErrorBound(paper_arm, paper_gains, 4.0, 0.3)
    edge = (math.radians(65.0), 0.0)
    start = bound.update(estimate_at(0, theta=edge, interval=0.0))
    for k in range(1, 60_000):
        estimate = estimate_at(k, theta=edge)
        widest = bound.update(estimate)
    assert np.all(widest < 1.0)  # it was 10 rad, for ever
    fresh = ErrorBound(paper_arm, paper_gains, 4.0, 0.3)
    moved = estimate_at(60_000, theta=edge)
    for k in range(60_001, 60_001 + 5500):
        # Ten seconds and one second of motion: angles go on by the measured rates.
        share = min(1.0, (k - 60_000) / 500)
        rate = (-edge[0] if share < 1.0 else 0.0, 0.0)
        moved = estimate_at(k, theta=((1.0 - share) * edge[0], 0.0), rate=rate)
        after, new = bound.update(moved), fresh.update(moved)
    np.testing.assert_allclose(after, new, rtol=0.1)
    assert np.all(start < 0.05)


# ------------------------------------------------------------------ a bias that no one can see


@pytest.mark.slow
@pytest.mark.parametrize('lean', [0.0, 0.6, -1.0])
def test_given_a_constant_disturbance_at_rest_when_observed_then_it_looks_like_the_floors_bias(
    paper_arm, paper_gains, lean
):
    """A joint-1 torque and a joint-1 encoder bias act alike: delta = 0.7 d/(11.76 cos th1)."""
    c, joints = paper_arm.constants(), JointMap(paper_arm)
    theta = np.array([lean, 0.2])
    d = paper_arm.disturbance_mean
    # At rest the drives carry gravity and the disturbance Xi Bd d; the observer knows the drives.
    off = coupling(*theta, c)
    push = np.array([8.33, off]) * 0.7 * d
    drive = np.array(inverse_dynamics(*theta, 0.0, 0.0, 0.0, 0.0, c)) - push
    observer = UnknownInputObserver(paper_arm, paper_gains)
    q, effort = joints.joint_position(theta), joints.joint_torque(drive)
    for k in range(15000):
        estimate = observer.update(k * TS, q, (0.0, 0.0), effort)
    # Sensors are healthy, and yet:
    floor = 0.7 * d / (11.76 * math.cos(lean))
    assert abs(estimate.fault[0]) == pytest.approx(floor, rel=0.02)  # floor: to first order
    # An undisturbed arm that leans by the floor more needs the same torques: no one can tell.
    elsewhere = np.arcsin(np.sin(theta) + push / np.array([98.0, 24.5]))
    np.testing.assert_allclose(inverse_dynamics(*elsewhere, 0.0, 0.0, 0.0, 0.0, c), drive)
    np.testing.assert_allclose(estimate.fault, theta - elsewhere, atol=1e-5)
    # ... which the bound knows, so that no alarm is raised on it.
    assert Diagnoser(paper_arm, paper_gains).update(estimate).bound[0] > floor


# ------------------------------------------------------------------ in the loop


@pytest.fixture(scope='module')
def healthy(paper_arm, paper_gains, two_faults):
    return run_closed_loop(paper_arm, paper_gains, replace(two_faults, duration=12.0, faults=()))


def test_given_a_healthy_run_with_noise_and_disturbance_when_diagnosed_then_there_is_no_alarm(
    healthy,
):
    assert healthy.alarms == []
    assert np.all(np.abs(healthy.fault_estimate) < healthy.threshold)


def test_given_a_healthy_run_when_compared_with_the_designed_deviation_then_it_is_a_bound(
    healthy, paper_gains
):
    settled = healthy.fault_estimate[2500:]
    assert np.all(settled.std(axis=0) < paper_gains.observer.fault_sigma)
    assert np.all(settled.std(axis=0) > 0.05 * paper_gains.observer.fault_sigma)  # not idle


def decided(run):
    """Alarms and their ends, without news in between."""
    return [a for a in run.alarms if a.event != AlarmEvent.UPDATED]


@pytest.mark.parametrize('index', [0, 1])
@pytest.mark.parametrize('size', [0.3, -0.2])
def test_given_a_step_fault_when_it_starts_then_the_alarm_comes_in_the_dwell_with_its_size(
    paper_arm, paper_gains, two_faults, index, size
):
    fault = Fault(paper_arm.sensor_names[index], 'bias', onset=1.5, size=size)
    run = run_closed_loop(
        paper_arm, paper_gains, replace(two_faults, duration=2.5, faults=(fault,))
    )
    assert [(a.event, a.sensor_index) for a in decided(run)] == [(AlarmEvent.RAISED, index)]
    alarm = run.alarms[0]
    assert alarm.onset == round(1.5 * NANOSECONDS)
    assert alarm.detected <= alarm.onset + 10_000_000 + TS
    assert alarm.size == pytest.approx(size, abs=4.0 * paper_gains.observer.fault_sigma[index])


def test_given_a_fault_that_ends_when_the_clear_dwell_is_over_then_the_alarm_is_cleared(
    paper_arm, paper_gains, two_faults
):
    fault = Fault(paper_arm.sensor_names[0], 'bias', onset=1.0, duration=1.0, size=0.3)
    run = run_closed_loop(
        paper_arm, paper_gains, replace(two_faults, duration=2.5, faults=(fault,))
    )
    assert [(a.event, a.sensor_index) for a in decided(run)] == [
        (AlarmEvent.RAISED, 0),
        (AlarmEvent.CLEARED, 0),
    ]


def test_given_a_link_beyond_the_region_when_it_waits_there_then_the_estimate_is_kept_not_reset(
    paper_arm, paper_gains
):
    joints, c = JointMap(paper_arm), paper_arm.constants()
    observer, diagnoser = (
        UnknownInputObserver(paper_arm, paper_gains),
        Diagnoser(paper_arm, paper_gains),
    )

    def angle(t):  # leans from 0.3 to 1.45 rad (border: 1.27) and stays there
        return 0.3 + 1.15 * (1 - math.cos(math.pi * min(t / 3.0, 1.0))) / 2

    fault, bounds, states, worst = np.array([0.25, 0.0]), [], [], 0.0
    for k in range(4000):
        t, h = k * 0.002, 1e-4
        rate = (angle(t + h) - angle(t - h)) / (2 * h)
        acc = (angle(t + h) - 2 * angle(t) + angle(t - h)) / h**2
        theta = np.array([angle(t), 0.1])
        torque = inverse_dynamics(*theta, rate, 0.0, acc, 0.0, c)
        reading = theta + (fault if t >= 1.0 else 0.0)
        estimate = observer.update(
            k * TS,
            joints.joint_from_sensor(reading),
            joints.joint_velocity(np.array([rate, 0.0])),
            joints.joint_torque(np.array(torque)),
        )
        diagnosis = diagnoser.update(estimate)
        if t > 1.1:
            worst = max(worst, np.abs(estimate.fault - fault).max())
        if estimate.held[0]:
            bounds.append(diagnosis.bound[0])
            states.append(diagnosis.state[0])
            assert not estimate.held[1]
    assert len(bounds) > 2500
    assert worst < 0.01  # kept through motion and hold
    assert bounds[-1] > bounds[100]
    assert set(states) == {SensorState.ERROR}  # raised before, not cleared there
    assert diagnosis.state[1] == SensorState.OK
