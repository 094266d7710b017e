"""The observer as nodes use it: degraded modes, counters, and input of any kind."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from parts import Swing
from stepwise import UnknownInputObserver

from lpv_core.model.joints import JointMap
from lpv_core.observer.sampled_observer import Counters, Mode
from lpv_core.support.errors import ConfigError, SampleError
from lpv_core.support.timestamps import NANOSECONDS

TS = 2_000_000
"""Sample time of both arms [ns]."""

VECTORS = (
    'position',
    'velocity',
    'measured_position',
    'measured_velocity',
    'fault',
    'absolute_position',
    'sensor_position',
)


@pytest.fixture
def swing(arm):
    return Swing(arm)


@pytest.fixture
def observer(arm, gains_of):
    return UnknownInputObserver(arm, gains_of[arm.name])


def follow(observer, swing, first, last, fault=(0.0, 0.0), every=1):
    """Feed samples first..last and return the last estimate."""
    estimate = None
    for k in range(first, last + 1, every):
        estimate = observer.update(k * TS, *swing.sample(k * 0.002, every * 0.002, fault))
    return estimate


# ------------------------------------------------------------------ normal operation


def test_given_the_first_sample_when_taken_then_it_is_believed_and_called_initialising(
    observer, swing
):
    estimate = observer.update(5 * TS, *swing.sample(0.01))
    assert estimate.mode == Mode.INITIALISING
    assert estimate.stamp == observer.stamp == 5 * TS
    assert estimate.interval == 0.0
    np.testing.assert_allclose(estimate.position, swing.position(0.01), atol=1e-14)
    np.testing.assert_array_equal(estimate.fault, 0.0)
    assert observer.update(6 * TS, *swing.sample(0.012)).mode == Mode.OBSERVING


def test_given_healthy_sensors_when_the_arm_swings_then_states_follow_and_faults_stay_zero(
    observer, swing
):
    for k in range(1500):
        estimate = observer.update(k * TS, *swing.sample(k * 0.002))
        assert np.abs(estimate.fault).max() < 3e-4  # Heun rule, Coulomb friction turning round
    np.testing.assert_allclose(estimate.position, swing.position(k * 0.002), atol=3e-4)
    np.testing.assert_allclose(estimate.velocity, swing.sample(k * 0.002)[1], atol=3e-3)
    assert observer.counters == Counters()


@pytest.mark.parametrize('sensor', [0, 1])
def test_given_a_step_fault_when_it_starts_then_its_own_sensor_shows_it_in_the_same_sample(
    observer, swing, sensor
):
    follow(observer, swing, 0, 500)
    fault = 0.3 * np.eye(2)[sensor]
    estimate = observer.update(501 * TS, *swing.sample(1.002, fault=fault))
    np.testing.assert_allclose(estimate.fault, fault, atol=5e-4)
    np.testing.assert_allclose(estimate.position, swing.position(1.002), atol=5e-4)


@pytest.mark.parametrize('samples', [1, 3])
def test_given_a_number_of_initial_samples_when_started_then_that_many_initialise(
    paper_arm, paper_gains, samples
):
    observer, swing = UnknownInputObserver(paper_arm, paper_gains, samples), Swing(paper_arm)
    modes = [follow(observer, swing, k, k).mode for k in range(6)]
    assert modes == [Mode.INITIALISING] * samples + [Mode.OBSERVING] * (6 - samples)


def test_given_noise_at_rest_when_started_on_many_samples_then_the_start_value_is_their_mean(
    paper_arm, paper_gains
):
    rng = np.random.default_rng(4)
    observer = UnknownInputObserver(paper_arm, paper_gains, initial_samples=100)
    upright = np.array([math.pi / 2, 0.0])
    noise = rng.normal(scale=0.02, size=(100, 2))
    noise[0] = 0.06  # a bad first sample must not decide alone
    for k in range(100):
        estimate = observer.update(k * TS, upright + noise[k], (0.0, 0.0), (0.0, 0.0))
    np.testing.assert_allclose(estimate.absolute_position, np.cumsum(noise.mean(axis=0)), atol=5e-3)


def test_given_a_link_outside_the_region_when_observed_then_the_mode_is_holding(
    paper_arm, paper_gains
):
    observer = UnknownInputObserver(paper_arm, paper_gains)
    q = JointMap(paper_arm).joint_position([1.4, 0.0])
    observer.update(0, q, (0, 0), (0, 0))
    estimate = observer.update(TS, q, (0, 0), (0, 0))
    assert estimate.mode == Mode.HOLDING
    assert estimate.held.tolist() == [True, False]


def test_given_an_estimate_when_its_arrays_are_overwritten_then_the_observer_is_untouched(
    observer, swing, gains_of
):
    twin = UnknownInputObserver(observer.arm, gains_of[observer.arm.name])
    for k in range(50):
        one, two = (o.update(k * TS, *swing.sample(k * 0.002)) for o in (observer, twin))
        for name in VECTORS:
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
            getattr(one, name)[:] = 99.0
        one.held[:] = one.missing[:] = True


def test_given_an_estimate_when_more_samples_come_then_it_keeps_what_it_said(observer, swing):
    theta = np.full(2, swing.rest) + [1.5, 0.0]  # link 1 held
    q = observer.joints.joint_position(theta)
    observer.update(0, q, (0, 0), (0, 0))
    kept = observer.update(TS, q, (0, 0), (0, 0))
    said = {name: np.copy(getattr(kept, name)) for name in (*VECTORS, 'held', 'missing')}
    observer.reset()
    follow(observer, swing, 2, 20)
    assert said['held'][0]
    for name, value in said.items():
        np.testing.assert_array_equal(getattr(kept, name), value)


# ------------------------------------------------------------------ values that are missing


@pytest.mark.parametrize('sensor', [0, 1])
def test_given_a_moving_arm_when_one_encoder_drops_out_then_its_fault_estimate_is_held(
    real_arm, real_gains, sensor
):
    observer, swing = UnknownInputObserver(real_arm, real_gains), Swing(real_arm)
    fault = np.array([0.2, -0.1])
    follow(observer, swing, 0, 100)
    before = follow(observer, swing, 101, 200, fault)
    for k in range(201, 701):
        position, velocity, effort = swing.sample(k * 0.002, fault=fault)
        position[sensor] = math.nan
        estimate = observer.update(k * TS, position, velocity, effort)
        np.testing.assert_allclose(estimate.fault, before.fault, atol=1e-3)


def test_given_a_missing_encoder_when_the_arm_moves_then_the_measured_position_moves_with_it(
    observer, swing
):
    # It is what a controller without compensation closes on.
    follow(observer, swing, 0, 200)
    for k in range(201, 401):
        _, velocity, effort = swing.sample(k * 0.002)
        estimate = observer.update(k * TS, (math.nan, math.nan), velocity, effort)
    np.testing.assert_allclose(estimate.measured_position, swing.position(0.8), atol=1e-3)


def test_given_a_dropout_when_it_ends_then_the_fault_is_known_at_once(real_arm, real_gains):
    observer, swing = UnknownInputObserver(real_arm, real_gains), Swing(real_arm)
    fault = np.array([0.2, -0.1])
    follow(observer, swing, 0, 100)
    follow(observer, swing, 101, 200, fault)
    for k in range(201, 401):
        position, velocity, effort = swing.sample(k * 0.002, fault=fault)
        position[1] = math.nan
        estimate = observer.update(k * TS, position, velocity, effort)
        assert estimate.missing.tolist() == [False, True]
        np.testing.assert_allclose(estimate.position, swing.position(k * 0.002), atol=1e-3)
    assert observer.counters.not_finite == 200
    after = follow(observer, swing, 401, 401, fault)
    assert after.missing.tolist() == [False, False]
    np.testing.assert_allclose(after.fault, fault, atol=1e-3)


def test_given_a_moving_arm_when_one_encoder_drops_out_then_the_other_is_still_observed(
    real_arm, real_gains
):
    observer, swing = UnknownInputObserver(real_arm, real_gains), Swing(real_arm)
    follow(observer, swing, 0, 200)
    for k in range(201, 301):
        position, velocity, effort = swing.sample(k * 0.002, fault=(0.3, 0.0))
        position[1] = math.nan
        estimate = observer.update(k * TS, position, velocity, effort)
        assert estimate.fault[0] == pytest.approx(0.3, abs=1e-3)
        assert estimate.missing.tolist() == [False, True]


def test_given_both_encoders_out_when_the_arm_moves_then_the_state_estimate_goes_on(
    observer, swing
):
    follow(observer, swing, 0, 200)
    for k in range(201, 401):
        _, velocity, effort = swing.sample(k * 0.002)
        estimate = observer.update(k * TS, (math.nan, math.inf), velocity, effort)
        assert estimate.missing.tolist() == [True, True]
    np.testing.assert_allclose(estimate.position, swing.position(0.8), atol=1e-3)


def test_given_no_start_value_when_an_encoder_is_silent_then_nothing_is_made_up(observer, swing):
    position, velocity, effort = swing.sample(0.0)
    assert observer.update(0, (position[0], math.nan), velocity, effort) is None
    assert observer.stamp is None
    assert observer.update(TS, position, velocity, effort).mode == Mode.INITIALISING
    assert observer.counters.not_finite == 1


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize('field', ['velocity', 'effort'])
def test_given_a_rate_or_torque_that_is_no_number_when_taken_then_the_sample_is_dropped(
    observer, swing, field, bad
):
    follow(observer, swing, 0, 100)
    position, velocity, effort = swing.sample(0.202)
    (velocity if field == 'velocity' else effort)[1] = bad
    assert observer.update(101 * TS, position, velocity, effort) is None
    assert observer.counters == Counters(not_finite=1)
    assert observer.stamp == 100 * TS
    # The lost interval is bridged by the next sample.
    estimate = observer.update(102 * TS, *swing.sample(0.204, 0.004))
    assert estimate.interval == pytest.approx(0.004)
    np.testing.assert_allclose(estimate.position, swing.position(0.204), atol=1e-3)


# ------------------------------------------------------------------ stamps


def test_given_a_duplicate_or_older_stamp_when_taken_then_it_is_dropped_and_counted(
    observer, swing, gains_of
):
    before = follow(observer, swing, 0, 300)
    assert observer.update(300 * TS, *swing.sample(0.6)) is None
    assert observer.update(299 * TS, *swing.sample(0.598)) is None
    assert observer.update(300 * TS - NANOSECONDS // 2, *swing.sample(0.1)) is None
    assert observer.counters == Counters(duplicates=1, out_of_order=2)
    assert observer.stamp == before.stamp
    # As if nothing had been said in between.
    twin = UnknownInputObserver(observer.arm, gains_of[observer.arm.name])
    follow(twin, swing, 0, 300)
    after, expected = (follow(o, swing, 301, 301) for o in (observer, twin))
    for name in VECTORS:
        np.testing.assert_array_equal(getattr(after, name), getattr(expected, name))


def test_given_time_restarts_when_a_sample_arrives_then_the_observer_starts_anew(observer, swing):
    follow(observer, swing, 1000, 1100)
    follow(observer, swing, 1101, 1150, fault=(0.2, 0.0))
    estimate = observer.update(0, *swing.sample(0.0))
    assert estimate.mode == Mode.INITIALISING
    np.testing.assert_array_equal(estimate.fault, 0.0)
    assert observer.counters == Counters(restarts=1)
    np.testing.assert_allclose(follow(observer, swing, 1, 100).fault, 0.0, atol=5e-4)


def test_given_one_second_back_exactly_when_taken_then_it_is_late_and_no_restart(observer, swing):
    follow(observer, swing, 1000, 1001)
    assert observer.update(1001 * TS - NANOSECONDS, *swing.sample(1.0)) is None
    assert observer.counters == Counters(out_of_order=1)
    assert observer.update(1001 * TS - NANOSECONDS - 1, *swing.sample(1.0)) is not None
    assert observer.counters == Counters(out_of_order=1, restarts=1)


@pytest.mark.parametrize('every', [2, 5, 20])
def test_given_lost_samples_when_the_next_one_comes_then_the_interval_is_integrated_in_steps(
    observer, swing, every
):
    estimate = follow(observer, swing, 0, 400, every=every)
    assert observer.counters == Counters(late_steps=400 // every)
    # Torque held and rates interpolated over up to 40 ms: second order in the interval.
    np.testing.assert_allclose(estimate.position, swing.position(0.8), atol=5e-3)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=5e-3)


def test_given_jitter_below_half_a_sample_when_taken_then_nothing_is_counted(observer, swing):
    stamps = np.arange(500) * TS
    stamps[1:] += np.random.default_rng(8).integers(-400_000, 400_000, 499)
    for before, stamp in zip(np.concatenate([[0], stamps[:-1]]), stamps):
        t = stamp / NANOSECONDS
        estimate = observer.update(int(stamp), *swing.sample(t, (stamp - before) / NANOSECONDS))
    assert observer.counters == Counters()
    np.testing.assert_allclose(estimate.position, swing.position(t), atol=5e-4)


@pytest.mark.parametrize('gap', [0.11, 0.5, 30.0])
def test_given_a_gap_when_it_ends_then_the_encoder_increment_moves_the_state_and_holds_the_fault(
    observer, swing, gap
):
    fault = np.array([0.2, -0.15])
    follow(observer, swing, 0, 250)
    before = follow(observer, swing, 251, 500, fault)
    t = 1.0 + gap
    estimate = observer.update(500 * TS + round(gap * NANOSECONDS), *swing.sample(t, fault=fault))
    assert observer.counters == Counters(gaps=1)
    assert estimate.interval == pytest.approx(gap)
    np.testing.assert_allclose(estimate.fault, before.fault, atol=1e-12)
    np.testing.assert_allclose(estimate.position, swing.position(t), atol=1e-3)
    np.testing.assert_allclose(estimate.velocity, swing.sample(t)[1], atol=1e-12)


def test_given_an_interval_of_max_gap_when_taken_then_it_is_still_integrated(observer, swing):
    follow(observer, swing, 0, 100)
    observer.update(100 * TS + NANOSECONDS // 10, *swing.sample(0.3, 0.1))
    assert observer.counters == Counters(late_steps=1)
    observer.update(150 * TS + NANOSECONDS // 10 + 1, *swing.sample(0.4, 0.1))
    assert observer.counters == Counters(late_steps=1, gaps=1)


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize('field', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('values', [(), (1.0,), (1.0, 2.0, 3.0), 1.0, ((1.0, 2.0),)])
def test_given_a_vector_of_the_wrong_size_when_taken_then_the_error_names_it(
    observer, field, values
):
    sample = {'position': (0.0, 0.0), 'velocity': (0.0, 0.0), 'effort': (0.0, 0.0), field: values}
    with pytest.raises(SampleError, match=f'^{field} must have 2 values'):
        observer.update(0, **sample)
    assert observer.stamp is None


def test_given_gains_of_another_arm_when_constructed_then_they_are_refused(
    paper_arm, real_arm, paper_gains
):
    with pytest.raises(ConfigError, match='gains.arm_sha256.*paper.*real_arm'):
        UnknownInputObserver(real_arm, paper_gains)
    with pytest.raises(ConfigError, match='gains.arm_sha256'):
        UnknownInputObserver(replace(paper_arm, gravity=9.81), paper_gains)


# ------------------------------------------------------------------ absurd input


@pytest.mark.parametrize('field', ['position', 'velocity', 'effort'])
@pytest.mark.parametrize('size', [1e6, 1e100, 1e154, 1e300, -1e308, 1.7e308])
def test_given_an_absurd_but_finite_value_when_taken_then_no_estimate_is_ever_not_finite(
    observer, swing, field, size
):
    for k in range(60):
        sample = dict(zip(('position', 'velocity', 'effort'), swing.sample(k * 0.002)))
        if k in (20, 21, 40):
            sample[field] = np.array([size, -size if k == 21 else 0.0])
        estimate = observer.update(k * TS, **sample)
        assert_finite(estimate)


def test_given_readings_near_the_largest_float_when_one_is_held_then_the_outputs_stay_finite(
    paper_arm, paper_gains
):
    observer = UnknownInputObserver(paper_arm, paper_gains)
    for k, position in enumerate([(0.0, 0.0), (-1e300, 1e308), (-1.7e308, math.nan)]):
        assert_finite(observer.update(k * TS, position, (0.0, 0.0), (0.0, 0.0)))


def test_given_an_absurd_position_when_it_is_over_then_the_estimate_is_as_good_as_before(
    observer, swing
):
    follow(observer, swing, 0, 100)
    for size in (1e3, 1e17, 1e300):
        _, velocity, effort = swing.sample(0.202)
        observer.update(observer.stamp + 1, (size, 0.0), velocity, effort)
    estimate = follow(observer, swing, 102, 200)
    np.testing.assert_allclose(estimate.position, swing.position(0.4), atol=1e-3)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=1e-3)


@pytest.mark.parametrize('size', [1e2, 1e6, 1e300])
def test_given_one_absurd_rate_when_it_is_over_then_a_known_fault_is_still_known(
    paper_arm, paper_gains, size
):
    observer, swing = UnknownInputObserver(paper_arm, paper_gains), Swing(paper_arm)
    follow(observer, swing, 0, 100)
    follow(observer, swing, 101, 200, fault=(0.3, 0.0))
    position, velocity, effort = swing.sample(0.402, fault=(0.3, 0.0))
    observer.update(201 * TS, position, velocity + [size, 0.0], effort)
    estimate = follow(observer, swing, 202, 210, fault=(0.3, 0.0))
    np.testing.assert_allclose(estimate.fault, (0.3, 0.0), atol=0.05)


def assert_finite(estimate):
    if estimate is not None:
        for name in VECTORS:
            assert np.isfinite(getattr(estimate, name)).all(), name
        assert math.isfinite(estimate.interval)


ANY = st.one_of(st.floats(), st.floats(-10, 10), st.sampled_from([1e154, -1e300, 1.7e308]))
PAIR = st.tuples(ANY, ANY)
STEP = st.one_of(st.just(TS), st.integers(-2 * NANOSECONDS, 2 * NANOSECONDS))


@pytest.mark.slow
@settings(max_examples=300)
@given(st.lists(st.tuples(STEP, PAIR, PAIR, PAIR), min_size=1, max_size=25))
def test_given_any_sequence_of_floats_when_observed_then_no_estimate_is_ever_not_finite(
    paper_arm, real_arm, gains_of, samples
):
    for arm in (paper_arm, real_arm):
        observer, stamp = UnknownInputObserver(arm, gains_of[arm.name]), 10 * NANOSECONDS
        for step, position, velocity, effort in samples:
            stamp = max(stamp + step, 0)
            assert_finite(observer.update(stamp, position, velocity, effort))


@settings(max_examples=100)
@given(st.lists(st.tuples(STEP, PAIR, PAIR, PAIR), min_size=1, max_size=25))
def test_given_any_sequence_of_floats_when_it_is_over_then_a_reset_observer_works(
    paper_arm, paper_gains, samples
):
    observer, swing = UnknownInputObserver(paper_arm, paper_gains), Swing(paper_arm)
    stamp = 10 * NANOSECONDS
    for step, position, velocity, effort in samples:
        stamp = max(stamp + step, 0)
        observer.update(stamp, position, velocity, effort)
    observer.reset()
    np.testing.assert_allclose(follow(observer, swing, 0, 30).fault, 0.0, atol=1e-4)


@settings(max_examples=100)
@given(st.lists(st.tuples(STEP, PAIR, PAIR, PAIR), min_size=1, max_size=25))
def test_given_any_sequence_of_floats_when_the_paper_observer_takes_it_then_it_stays_finite(
    paper_arm, literal_gains, samples
):
    observer, stamp = UnknownInputObserver(paper_arm, literal_gains), 10 * NANOSECONDS
    for step, position, velocity, effort in samples:
        stamp = max(stamp + step, 0)
        assert_finite(observer.update(stamp, position, velocity, effort))
