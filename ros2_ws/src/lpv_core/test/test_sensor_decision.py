"""The decision about one sensor, on synthetic samples: changes, levels, kinds, ends."""

import math
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest
from parts import ChangeTest, History, SensorDecision, classify

from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.decision.fault_classification import is_stuck
from lpv_core.decision.fault_magnitude import removable
from lpv_core.decision.sensor_state import SENSOR_LIMITS
from lpv_core.residual.change_detection import WINDOWS, sigmas_for
from lpv_core.residual.noise_estimation import noise_level
from lpv_core.residual.sample_buffer import READING, RESIDUAL, SampleBuffer
from lpv_core.support.records import new_record

TS = 2_000_000
SIGMA = 0.001
THRESHOLD = 0.1
PARAMETERS = DiagnosisParameters(dwell=0.01, clear_dwell=0.1, hysteresis=0.5)


@pytest.fixture
def changes(paper_arm):
    return ChangeTest(paper_arm, 1000.0, 0.02)


@pytest.fixture
def sensor(paper_arm, paper_gains):
    return SensorDecision(paper_arm, paper_gains, PARAMETERS)


def sample_at(k, fault=0.0, **fields):
    """Fields of sample k of a sensor that is expected to read 0.5 rad, without any error of the
    estimate or of the rates."""
    given = {
        'stamp': k * TS,
        'fault': fault,
        'residual': fault,
        'reading': 0.5 + fault,
        'threshold': THRESHOLD,
        'allowance': 0.0,
        'innovation': 0.0,
        'missing': False,
        'lost': False,
        'inconsistent': False,
    }
    return {**given, **fields}


def feed(sensor, first, faults, **fields):
    """Feed fault estimates from sample ``first`` on; ``(sample, decision, kind)`` of each news."""
    news = []
    for k, fault in enumerate(faults, first):
        decided = sensor.update(**sample_at(k, fault, **fields))
        if decided is not None:
            news.append((k, decided, sensor.kind))
    return news


def noise(n, sigma=0.5 * SIGMA, seed=0):
    return sigma * np.random.default_rng(seed).standard_normal(n)


def raised(news):
    return [n for n in news if n[1] == 'raised']


# ------------------------------------------------------------------ what is removed


def removed(sensor):
    return removable(sensor.state)


def test_given_a_step_when_its_height_is_known_then_the_estimates_own_error_is_not_removed(sensor):
    """The healthy error of the estimate drifts by 40 mrad, that of the rates by 2; the fault does
    not."""
    steps = np.repeat([0.0, 0.3], [300, 700]) + noise(1000, SIGMA)
    for k, (step, level) in enumerate(zip(steps, np.linspace(0.0, 0.04, 1000))):
        sensor.update(**sample_at(k, step + level, residual=step + 0.05 * level))
    assert sensor.kind == 'bias'
    assert removed(sensor) == pytest.approx(0.3, abs=0.0007)
    assert sensor.amount == pytest.approx(0.3014, abs=0.004)


def test_given_a_step_that_changes_later_when_seen_then_the_estimate_is_removed_at_once(sensor):
    feed(sensor, 0, noise(300))
    feed(sensor, 300, 0.3 + noise(300, seed=1))
    feed(sensor, 600, [0.1])
    assert removed(sensor) == sensor.amount == pytest.approx(0.1, abs=0.003)


def test_given_a_scale_error_when_the_arm_has_moved_then_what_is_removed_follows_the_reading(
    sensor,
):
    feed(sensor, 0, noise(300))
    for k in range(300, 1100):
        true = 0.5 + 0.2 * math.sin(0.004 * (k - 300))
        sensor.update(**sample_at(k, 0.4 * true, reading=1.4 * true))
    assert sensor.kind == 'scale'
    sensor.update(**sample_at(1100, 0.4 * true + 0.02, residual=0.4 * true, reading=1.4 * true))
    assert removed(sensor) == pytest.approx(0.4 * true, abs=0.002)


def test_given_noise_when_removed_then_its_mean_stays(sensor):
    feed(sensor, 0, noise(300))
    course = 0.02 * np.random.default_rng(3).standard_normal(3000)
    feed(sensor, 300, course)
    assert sensor.kind == 'noise'
    kept = sensor.amount - removed(sensor) + sensor.baseline
    assert abs(kept) < 0.004 < np.abs(course).max()


# ------------------------------------------------------------------ history


def filled(size, count):
    history = History(size)
    for k in range(count):
        history.add(10 * k, *(100.0 * column + k for column in range(4)))
    return history


@pytest.mark.parametrize('count', [3, 8, 9, 16, 17, 100])
def test_given_any_number_of_samples_when_read_then_the_newest_size_of_them_are_there(count):
    history = filled(8, count)
    stamps, values = history.since(0)
    expected = np.arange(max(0, count - 8), count)
    np.testing.assert_array_equal(stamps, 10 * expected)
    np.testing.assert_array_equal(values[:, :4], expected[:, None] + [0.0, 100.0, 200.0, 300.0])


@pytest.mark.parametrize('count', [8, 17, 100])
def test_given_a_wrapped_history_when_asked_at_a_stamp_then_the_latest_not_after_it_answers(count):
    history, last = filled(8, count), count - 1
    assert history.at(10 * last) == (10 * last, last)
    assert history.at(10 * last + 5) == (10 * last, last)
    assert history.at(10 * last - 1) == (10 * (last - 1), last - 1)
    assert history.at(10 * (last - 7)) == (10 * (last - 7), last - 7)  # the oldest that is kept
    assert history.at(10 * (last - 7) - 1) is None


def test_given_an_empty_history_when_asked_then_it_has_nothing():
    history = filled(8, 20)
    history.clear()
    assert history.at(10_000) is None
    assert len(history.since(0)[0]) == 0


def test_given_one_outlier_when_the_median_is_taken_then_it_does_not_show():
    history = History(8)
    for k, fault in enumerate([1.0, 2.0, 3.0, 4.0, 99.0, 5.0]):
        history.add(10 * k, fault, 0.0)
    assert history.at(40)[1] == 99.0
    assert history.median_at(40) == 3.0  # of 1, 2, 3, 4, 99
    assert history.median_at(45) == 3.0
    assert history.median_at(20) == 2.0  # fewer than five


def test_given_samples_when_asked_since_a_stamp_then_its_end_is_inclusive():
    history = filled(8, 20)
    assert history.since(150)[0].tolist() == [150, 160, 170, 180, 190]
    assert history.since(151)[0].tolist() == [160, 170, 180, 190]
    assert history.since(175)[1][:, READING].tolist() == [118.0, 119.0]
    assert filled(8, 3).since(-50)[0].tolist() == [0, 10, 20]


# ------------------------------------------------------------------ limits of changes


def test_given_hours_between_false_alarms_when_more_are_asked_then_the_quantile_rises():
    values = [sigmas_for(hours, 0.002) for hours in (0.1, 1.0, 10.0, 1e3, 1e6)]
    assert values == sorted(set(values))


def test_given_hours_when_the_quantile_is_taken_then_it_is_two_sided_over_all_tests():
    z = sigmas_for(1000.0, 0.002)
    tests = 10 * 1000 * 3600 * 500  # 2 sensors, 5 windows, 500 samples a second
    assert 2 * NormalDist().cdf(-z) * tests == pytest.approx(1.0, rel=1e-6)
    assert z == pytest.approx(6.56, abs=0.01)


def test_given_an_arm_when_limits_are_asked_then_noise_and_allowance_add_up(paper_arm):
    changes, z = ChangeTest(paper_arm, 1000.0), sigmas_for(1000.0, 0.002)
    for index, window in enumerate(WINDOWS):
        sigma = math.sqrt(2 * 0.001**2 + 0.01**2 * 0.002 * window)
        assert changes.limit(index, 0.0) == pytest.approx(z * sigma)
        assert changes.limit(index, 0.3) == pytest.approx(z * sigma + 0.3)


def test_given_a_smallest_change_when_noise_is_less_then_it_rules(paper_arm):
    changes = ChangeTest(paper_arm, 1000.0, 0.05)
    assert changes.limit(0, 0.0) == 0.05
    assert changes.limit(3, 0.1) > 0.1


def history_of(faults):
    history = History(750)
    for k, fault in enumerate(faults):
        history.add(k * TS, fault, 0.0)
    return history


def test_given_a_step_above_the_limit_when_searched_then_the_shortest_window_has_the_value_before(
    changes,
):
    history = history_of(np.full(600, 0.013))
    found = changes.find(history, 600 * TS, 0.013 + 0.03)
    assert found == (0, 0.013)
    assert changes.find(history, 600 * TS, 0.013 + 0.019) is None
    assert changes.find(history, 600 * TS, 0.013 - 0.03) == (0, 0.013)


def test_given_a_step_within_the_allowance_of_the_rates_when_searched_then_it_is_none(changes):
    history = history_of(np.zeros(600))
    assert changes.find(history, 600 * TS, 0.03) is not None
    assert changes.find(history, 600 * TS, 0.03, allowance=0.03) is None


@pytest.mark.parametrize(('rate', 'window'), [(0.03, 3), (0.15, 2), (0.6, 1), (3.0, 0)])
def test_given_a_ramp_when_searched_then_only_windows_that_are_long_enough_see_it(
    changes, rate, window
):
    history = history_of(rate * 0.002 * np.arange(600))
    found = changes.find(history, 600 * TS, rate * 1.2)
    assert found[0] == window
    # The median lags by two samples.
    assert found[1] == pytest.approx(rate * (1.2 - WINDOWS[window] - 0.004))


def test_given_a_ramp_below_every_limit_when_searched_then_it_is_none(changes):
    history = history_of(0.015 * 0.002 * np.arange(600))
    assert changes.find(history, 600 * TS, 0.015 * 1.2) is None


def test_given_a_spike_as_reference_when_searched_then_it_makes_no_change(changes):
    faults = np.zeros(600)
    faults[595] = 0.3  # 10 ms before
    assert changes.find(history_of(faults), 600 * TS, 0.0) is None
    faults[591:596] = 0.3  # no spike any more
    assert changes.find(history_of(faults), 600 * TS, 0.0) == (0, 0.3)


def test_given_a_history_shorter_than_a_window_when_searched_then_nothing_is_found(changes):
    assert changes.find(history_of([]), TS, 1.0) is None
    assert changes.find(history_of(np.zeros(5)), 4 * TS, 1.0) is None
    assert changes.find(history_of(np.zeros(5)), 5 * TS, 1.0) == (0, 0.0)


# ------------------------------------------------------------------ steps and levels


def test_given_a_step_below_the_level_when_the_dwell_is_over_then_its_size_and_onset_are_known(
    sensor,
):
    assert feed(sensor, 0, np.full(300, 0.04)) == []
    assert feed(sensor, 300, np.full(5, -0.02)) == []  # 8 ms of 10
    news = feed(sensor, 305, [-0.02])
    assert news == [(305, 'raised', 'unclassified')]
    assert (sensor.onset, sensor.detected) == (300 * TS, 305 * TS)
    assert sensor.amount == pytest.approx(-0.06)
    assert sensor.alarm and sensor.by_change and sensor.compensable


def test_given_a_step_when_its_course_is_known_then_an_update_names_the_bias_once(sensor):
    feed(sensor, 0, noise(300))
    news = feed(sensor, 300, 0.08 + noise(700, seed=1))
    assert [n[1:] for n in news] == [('raised', 'unclassified'), ('updated', 'bias')]
    # A judgement needs 0.1 s.
    assert 0.1 <= (news[1][0] - 300) * 0.002 <= 0.2


def test_given_a_level_without_a_change_when_it_is_crossed_then_the_alarm_rests_on_the_level(
    sensor,
):
    ramp = 0.01 * 0.002 * np.arange(6000)
    news = feed(sensor, 0, ramp, residual=0.0)
    crossing = int(np.argmax(ramp > THRESHOLD))
    assert news[0] == (crossing + 5, 'raised', 'unclassified')
    assert not sensor.by_change
    assert sensor.onset == crossing * TS
    assert sensor.amount == pytest.approx(ramp[-1])  # the whole level


def test_given_a_lost_reference_when_the_level_is_crossed_then_it_is_no_evidence(sensor):
    ramp = 0.01 * 0.002 * np.arange(6000)
    assert feed(sensor, 0, ramp, residual=0.0, lost=True) == []
    assert not sensor.alarm


def test_given_a_lost_reference_when_a_step_comes_then_it_is_seen_all_the_same(sensor):
    feed(sensor, 0, np.zeros(300), lost=True)
    assert raised(feed(sensor, 300, np.full(20, 0.3), lost=True))


@pytest.mark.parametrize('size', [0.0095, -0.0095])
def test_given_a_step_below_the_smallest_size_when_it_stays_then_there_is_no_alarm(sensor, size):
    feed(sensor, 0, np.zeros(300))
    assert feed(sensor, 300, np.full(1000, size)) == []


@pytest.mark.parametrize('size', [0.0105, -0.0105])
def test_given_a_step_above_the_smallest_size_when_it_stays_then_there_is_an_alarm(sensor, size):
    feed(sensor, 0, np.zeros(300))
    assert raised(feed(sensor, 300, np.full(1000, size)))


def test_given_an_inconsistency_when_a_level_is_crossed_then_the_alarm_is_not_compensated(sensor):
    ramp = 0.01 * 0.002 * np.arange(6000)
    news = feed(sensor, 0, ramp, residual=0.0, inconsistent=True)
    assert {kind for _, _, kind in news} == {'inconsistent'}
    assert not sensor.compensable


def test_given_an_inconsistency_when_a_step_comes_then_it_is_a_fault_of_the_sensor(sensor):
    feed(sensor, 0, noise(300), inconsistent=True)
    feed(sensor, 300, 0.3 + noise(200), inconsistent=True)
    assert (sensor.kind, sensor.compensable) == ('bias', True)


def test_given_a_fault_nobody_noticed_when_it_ends_then_nothing_is_raised(sensor):
    feed(sensor, 0, np.full(300, 0.09))
    assert feed(sensor, 300, np.zeros(1000)) == []
    assert not sensor.alarm
    assert raised(feed(sensor, 1300, np.full(20, 0.05)))  # and the next one is seen


# ------------------------------------------------------------------ spikes, noise, stuck


@pytest.mark.parametrize('length', [1, 2, 4])
def test_given_an_excursion_when_shorter_than_the_dwell_then_there_is_no_alarm(sensor, length):
    feed(sensor, 0, np.zeros(300))
    assert feed(sensor, 300, np.full(length, 0.3)) == []
    assert feed(sensor, 300 + length, np.zeros(1000)) == []


@pytest.mark.parametrize('length', [1, 2, 4])
def test_given_three_excursions_when_within_a_second_then_they_are_spikes(sensor, length):
    feed(sensor, 0, np.zeros(300))
    news = []
    for i in range(3):
        news += feed(sensor, 300 + 100 * i, np.full(length, 0.3))
        assert news == []
        news += feed(sensor, 300 + 100 * i + length, np.zeros(100 - length))
    assert [n[1:] for n in news][:1] == [('raised', 'spike')]
    assert raised(news)[0][0] == 500 + length
    # It is over when there has been none for a second.
    news = feed(sensor, 600, np.zeros(800))
    assert [n[1] for n in news] == ['cleared']
    assert (news[0][0] - 500) * 0.002 > 1.0
    assert not sensor.compensable


def test_given_three_excursions_when_over_more_than_a_second_then_there_is_no_alarm(sensor):
    feed(sensor, 0, np.zeros(300))
    for i in range(5):
        assert feed(sensor, 300 + 300 * i, [0.3] + [0.0] * 299) == []


def test_given_spikes_when_they_end_then_the_alarm_clears(sensor):
    feed(sensor, 0, noise(300))
    for i in range(3):
        feed(sensor, 300 + 20 * i, [0.3] + [0.0] * 19)
    assert sensor.alarm
    assert [n[1:] for n in feed(sensor, 360, noise(900))] == [('cleared', 'spike')]


def test_given_more_noise_than_healthy_when_below_every_limit_then_the_kind_is_noise(sensor):
    feed(sensor, 0, noise(300, SIGMA))
    assert not sensor.alarm
    news = feed(sensor, 300, noise(200, 4.0 * SIGMA, seed=1))
    assert raised(news)[0][1:] == ('raised', 'noise')
    assert [n[1:] for n in feed(sensor, 500, noise(500, SIGMA, seed=2))] == [('cleared', 'noise')]


@pytest.mark.parametrize('factor', [3.2, 3.6])
def test_given_noise_near_the_limit_when_it_goes_on_then_it_is_not_called_a_bias(sensor, factor):
    feed(sensor, 0, noise(300, SIGMA))
    news = feed(sensor, 300, noise(3000, factor * SIGMA, seed=6))
    assert raised(news)
    assert {kind for _, _, kind in news} == {'noise'}


def test_given_healthy_noise_when_it_goes_on_for_a_minute_then_there_is_no_alarm(sensor):
    assert feed(sensor, 0, noise(30_000, SIGMA)) == []


def freeze(sensor, first, count, rate=0.2):
    """The reading stands while the arm moves on."""
    news = []
    for i in range(count):
        moved = rate * 0.002 * i
        decided = sensor.update(**sample_at(first + i, -moved, reading=0.5))
        news += [(first + i, decided, sensor.kind)] * (decided is not None)
    return news


def test_given_a_frozen_reading_when_the_arm_moves_then_it_is_stuck(sensor):
    for k, error in enumerate(noise(300, SIGMA)):
        sensor.update(**sample_at(k, error, reading=0.5 + error))
    news = freeze(sensor, 300, 200)
    assert news[0][1:] == ('raised', 'stuck')
    assert sensor.onset == 300 * TS
    assert {kind for _, _, kind in news} == {'stuck'}


def test_given_a_frozen_reading_when_the_arm_rests_then_no_one_can_tell(sensor):
    assert freeze(sensor, 0, 500, rate=0.0) == []


def test_given_a_stuck_reading_when_the_arm_rests_then_the_alarm_stays(sensor):
    feed(sensor, 0, noise(300, SIGMA))
    freeze(sensor, 300, 40)
    assert sensor.kind == 'stuck'
    for k in range(340, 1000):  # back in place, but without any noise
        assert sensor.update(**sample_at(k, 0.0)) is None
    assert sensor.alarm
    assert [n[1:] for n in feed(sensor, 1000, noise(300, SIGMA))] == [('cleared', 'stuck')]


# ------------------------------------------------------------------ missing data


def test_given_no_reading_when_the_dwell_is_over_then_a_dropout_is_raised_once(sensor):
    feed(sensor, 0, np.zeros(300))
    assert feed(sensor, 300, np.zeros(5), missing=True) == []
    news = feed(sensor, 305, np.zeros(500), missing=True)
    assert news == [(305, 'raised', 'dropout')]
    assert sensor.onset == 300 * TS
    assert removed(sensor) == 0.0  # the rates carry the reading on


def test_given_noise_when_the_reading_stops_then_its_last_error_is_not_carried_on(sensor):
    feed(sensor, 0, noise(300, SIGMA))
    feed(sensor, 300, np.full(50, 0.003), missing=True)
    assert sensor.kind == 'dropout'
    assert sensor.amount - removed(sensor) == 0.0
    assert removed(sensor) == pytest.approx(0.003, abs=0.0006)


@pytest.mark.parametrize(
    ('back', 'kinds'),
    [(0.004, [('cleared', 'dropout')]), (0.2, [('updated', 'unclassified'), ('updated', 'bias')])],
)
def test_given_a_dropout_when_readings_come_back_wrong_then_the_alarm_goes_on_with_their_error(
    sensor, back, kinds
):
    feed(sensor, 0, noise(300, SIGMA))
    feed(sensor, 300, np.zeros(100), missing=True)
    news = feed(sensor, 400, back + noise(500, SIGMA, seed=1))
    assert [n[1:] for n in news] == kinds
    assert sensor.alarm == (back > 0.1)
    if sensor.alarm:
        assert removed(sensor) == pytest.approx(0.2, abs=0.004)


@pytest.mark.parametrize(
    ('speed', 'kind', 'compensable'), [(0.2, 'drift', True), (0.03, 'inconsistent', False)]
)
def test_given_a_slow_change_when_rates_could_feign_it_unseen_then_the_cause_is_unknown(
    sensor, speed, kind, compensable
):
    feed(sensor, 0, noise(300))
    ramp = speed * 0.002 * np.arange(round(0.048 / speed / 0.002))  # the level says nothing yet
    feed(sensor, 300, ramp + noise(len(ramp), seed=1))
    assert (sensor.kind, sensor.compensable) == (kind, compensable)


def test_given_a_doubtful_change_when_no_rate_draws_the_level_so_far_then_the_sensor_is_blamed(
    sensor,
):
    feed(sensor, 0, noise(300))
    ramp = 0.03 * 0.002 * np.arange(4000)  # passes the threshold of 0.1 rad after 3.3 s
    news = feed(sensor, 300, ramp + noise(4000, seed=1))
    assert [n[2] for n in news][0] == 'inconsistent'
    cleared_up = next(n[0] for n in news if n[2] != 'inconsistent')
    assert cleared_up > 300 + 1650 + 500
    assert (sensor.kind, sensor.compensable) == ('drift', True)
    assert removed(sensor) == pytest.approx(ramp[-1], abs=0.004)


def test_given_a_wrong_rate_when_it_draws_the_level_then_nobody_is_blamed(sensor):
    """f^ follows the residual at first, and falls behind as gravity pulls the estimate back."""
    feed(sensor, 0, noise(300))
    errors, decay = noise(6000, seed=1), sensor.constants.decay
    for k in range(6000):
        time = 0.002 * k
        level = 0.06 * (1.0 - math.exp(-decay * time)) / decay
        sensor.update(**sample_at(300 + k, level + errors[k], residual=0.06 * time + errors[k]))
        assert sensor.kind in ('inconsistent', 'unclassified')
    assert (sensor.alarm, sensor.kind, sensor.compensable) == (True, 'inconsistent', False)


def test_given_a_level_that_grows_with_the_residual_when_above_then_the_cause_is_unknown(sensor):
    """Too slow for any window: a rate that is a little wrong, or a drift."""
    news = []
    for k in range(40_000):
        slow = 0.003 * 0.002 * k
        decided = sensor.update(**sample_at(k, slow))
        news += [(decided, sensor.kind)] * (decided is not None)
    assert news[0] == ('raised', 'inconsistent')


def test_given_a_fault_from_the_start_when_the_level_learns_it_then_the_sensor_is_blamed(sensor):
    news = []
    for k, error in enumerate(noise(5000)):
        level = 0.2 * (1.0 - math.exp(-0.002 * k))
        decided = sensor.update(**sample_at(k, level, residual=error))
        news += [(decided, sensor.kind)] * (decided is not None)
    assert news[0][0] == 'raised'
    assert 'inconsistent' not in {kind for _, kind in news}


def test_given_noise_when_it_begins_with_a_lasting_excursion_then_no_rate_is_suspected(sensor):
    feed(sensor, 0, noise(300))
    course = 0.03 * np.random.default_rng(3).standard_normal(500)
    course[:8] = np.abs(course[:8]) + 0.02
    news = feed(sensor, 300, course)
    assert 'inconsistent' not in {n[2] for n in news}
    assert sensor.kind == 'noise'


def test_given_a_doubtful_change_when_the_level_does_not_follow_then_nobody_is_blamed(sensor):
    feed(sensor, 0, noise(300))
    for k, moved in enumerate(0.03 * 0.002 * np.arange(2500), 300):
        sensor.update(**sample_at(k, 0.02, residual=moved, reading=0.5 + moved))
    assert (sensor.kind, sensor.compensable) == ('inconsistent', False)


def test_given_dead_reckoning_when_the_level_contradicts_it_then_the_cause_is_unknown(sensor):
    feed(sensor, 0, noise(300))
    feed(sensor, 300, 0.3 + noise(300, seed=1))
    assert sensor.kind == 'bias'
    sensor.update(**sample_at(600, 0.02, residual=0.3))
    assert sensor.kind == 'inconsistent'


def test_given_a_sensor_that_lied_lately_when_it_changes_slowly_then_it_is_not_doubted(sensor):
    feed(sensor, 0, noise(300))
    feed(sensor, 300, 0.3 + noise(100, seed=1))
    feed(sensor, 400, noise(500, seed=2))
    assert not sensor.alarm
    feed(sensor, 900, 0.03 * 0.002 * np.arange(800) + noise(800, seed=3))
    assert sensor.kind == 'drift'


def test_given_a_scale_error_when_the_angle_passes_zero_then_the_alarm_stays(sensor):
    feed(sensor, 0, noise(300))
    for k, error in enumerate(noise(2000, SIGMA, seed=4), 300):
        true = 0.3 * math.cos(0.003 * (k - 300))
        decided = sensor.update(**sample_at(k, 0.4 * true + error, reading=1.4 * true))
        assert decided != 'cleared'
    assert sensor.kind == 'scale'


def test_given_a_dropout_when_data_return_then_it_clears_after_the_clear_dwell(sensor):
    feed(sensor, 0, np.zeros(300))
    feed(sensor, 300, np.zeros(100), missing=True)
    assert feed(sensor, 400, np.zeros(50)) == []  # 98 ms of 100
    assert feed(sensor, 450, np.zeros(500)) == [(450, 'cleared', 'dropout')]


def test_given_single_missing_samples_when_they_come_often_then_there_is_no_dropout(sensor):
    for start in range(0, 1000, 10):
        assert feed(sensor, start, np.zeros(5), missing=True) == []
        assert feed(sensor, start + 5, np.zeros(5)) == []


# ------------------------------------------------------------------ end of an alarm


def test_given_an_alarm_by_level_when_below_the_hysteresis_then_it_clears_after_its_dwell(sensor):
    feed(sensor, 0, np.full(20, 0.2))  # from the first sample on: no change to see
    assert sensor.alarm and not sensor.by_change
    assert [n for n in feed(sensor, 20, np.full(500, 0.051)) if n[1] == 'cleared'] == []
    assert [n for n in feed(sensor, 520, np.full(50, 0.049)) if n[1] == 'cleared'] == []
    news = feed(sensor, 570, np.full(500, 0.049))
    assert [n[:2] for n in news] == [(570, 'cleared')]
    assert not sensor.alarm


def test_given_an_alarm_when_the_size_comes_back_within_the_clear_dwell_then_it_stays(sensor):
    feed(sensor, 0, np.full(20, 0.2))
    for start in range(20, 1020, 50):
        news = feed(sensor, start, np.zeros(49)) + feed(sensor, start + 49, [0.2])
        assert 'cleared' not in [n[1] for n in news]
    assert sensor.alarm


def test_given_a_bias_seen_as_a_change_when_it_ends_then_the_end_is_no_new_fault(sensor):
    feed(sensor, 0, 0.03 + noise(300))
    feed(sensor, 300, 0.09 + noise(500, seed=1))
    news = feed(sensor, 800, 0.03 + noise(1000, seed=2))
    assert [n[1] for n in news if n[1] != 'updated'] == ['cleared']


def test_given_a_small_bias_seen_as_a_change_when_it_stays_then_the_level_does_not_clear_it(sensor):
    feed(sensor, 0, noise(300))
    news = feed(sensor, 300, 0.03 + noise(2000, seed=1))  # far below the level of 0.1
    assert [n[1] for n in news] == ['raised', 'updated']
    assert sensor.alarm


def test_given_a_latch_when_the_fault_is_over_then_the_alarm_stays_until_the_reset(
    paper_arm, paper_gains
):
    sensor = SensorDecision(paper_arm, paper_gains, replace(PARAMETERS, latch=True))
    feed(sensor, 0, np.zeros(300))
    feed(sensor, 300, np.full(50, 0.3))
    assert 'cleared' not in [n[1] for n in feed(sensor, 350, np.zeros(2000))]
    assert sensor.alarm
    sensor.reset()
    assert not sensor.alarm
    assert feed(sensor, 0, np.zeros(300)) == []


def test_given_a_latch_when_a_dropout_is_over_then_the_alarm_stays(paper_arm, paper_gains):
    sensor = SensorDecision(paper_arm, paper_gains, replace(PARAMETERS, latch=True))
    feed(sensor, 0, np.zeros(50), missing=True)
    assert feed(sensor, 50, np.zeros(500)) == []
    assert sensor.alarm


def test_given_an_alarm_when_its_size_grows_then_updates_come_by_steps_not_by_samples(sensor):
    feed(sensor, 0, np.zeros(300))
    feed(sensor, 300, np.full(600, 0.2))
    news = feed(sensor, 900, np.linspace(0.2, 0.5, 1000))
    assert {n[1] for n in news} == {'updated'}
    assert 2 <= len(news) <= 4
    assert sensor.amount == pytest.approx(0.5)


# ------------------------------------------------------------------ time starts anew


def test_given_an_alarm_when_time_restarts_then_it_stays_and_can_still_clear(sensor):
    feed(sensor, 5000, np.zeros(300))
    feed(sensor, 5300, np.full(100, 0.3))
    sensor.restart()
    assert sensor.alarm and sensor.amount == pytest.approx(0.3)
    assert 'cleared' not in [n[1] for n in feed(sensor, 0, np.full(100, 0.3))]
    assert [n[1] for n in feed(sensor, 100, np.zeros(500))][-1:] == ['cleared']


def test_given_pending_evidence_when_time_restarts_then_the_dwell_starts_anew(sensor):
    feed(sensor, 5000, np.full(4, 0.3))
    sensor.restart()
    assert feed(sensor, 0, np.full(5, 0.3)) == []
    assert raised(feed(sensor, 5, [0.3]))


def test_given_a_stuck_alarm_when_time_restarts_then_it_stays(sensor):
    feed(sensor, 5000, noise(300, SIGMA))
    freeze(sensor, 5300, 40)
    assert sensor.kind == 'stuck'
    sensor.restart()
    sensor.update(**sample_at(0, 0.0))
    assert sensor.alarm


# ------------------------------------------------------------------ classification


def course(fault, seconds=0.6, sigma=SIGMA, seed=0):
    """Course of a fault ``fault(t, angle)`` on a moving arm, with noise."""
    stamps = np.arange(round(seconds * 500)) * TS
    t = stamps / 1e9
    angle = 0.5 + 0.4 * np.sin(3.0 * t)
    error = fault(t, angle) + sigma * np.random.default_rng(seed).standard_normal(len(t))
    none = np.zeros_like(t)
    return stamps, np.column_stack([error, angle + error, none, none])


FAULTS = {
    'bias': lambda t, y: 0.1 + 0.0 * t,
    'drift': lambda t, y: 0.2 * t,
    'scale': lambda t, y: 0.3 * y,
}


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('sign', [1.0, -1.0])
@pytest.mark.parametrize('kind', FAULTS)
def test_given_a_course_with_noise_when_classified_then_its_kind_is_named(kind, sign, seed):
    stamps, values = course(lambda t, y: sign * FAULTS[kind](t, y), seed=seed)
    assert classify(stamps, values, 0, 0.0, SIGMA) == kind


@pytest.mark.parametrize('kind', FAULTS)
def test_given_a_value_before_the_onset_when_classified_then_it_is_taken_off(kind):
    stamps, values = course(lambda t, y: 0.05 + FAULTS[kind](t, y))
    assert classify(stamps, values, 0, 0.05, SIGMA) == kind


def test_given_a_ramp_from_an_offset_when_classified_then_it_is_a_drift():
    stamps, values = course(lambda t, y: 0.1 + 0.2 * t)
    assert classify(stamps, values, 0, 0.0, SIGMA) == 'drift'


def test_given_an_arm_at_rest_when_a_scale_error_is_classified_then_it_is_a_bias():
    stamps, values = course(FAULTS['bias'])
    values[:, READING] = 0.5 + values[:, RESIDUAL]
    assert classify(stamps, values, 0, 0.0, SIGMA) == 'bias'


def test_given_too_short_a_course_when_classified_then_it_is_not_judged():
    stamps, values = course(FAULTS['bias'])
    assert classify(stamps[:50], values[:50], 0, 0.0, SIGMA) == 'unclassified'  # 98 ms
    assert classify(stamps[:51], values[:51], 0, 0.0, SIGMA) == 'bias'


def test_given_a_noisy_course_when_classified_then_it_is_noise():
    stamps, values = course(lambda t, y: 0.0 * t, sigma=5.0 * SIGMA)
    assert classify(stamps, values, 0, 0.0, SIGMA) == 'noise'


def test_given_steps_spikes_and_ramps_when_the_noise_level_is_taken_then_they_do_not_count():
    _, values = course(lambda t, y: 0.2 * t + 0.3 * (t > 0.3))
    values[::10, RESIDUAL] += 0.5
    # Three of ten second differences see a spike: the median moves, but not by a spike's size.
    assert 0.7 * SIGMA < noise_level(values, RESIDUAL) < 2.0 * SIGMA


@pytest.mark.parametrize(
    ('jitter', 'rate', 'stuck'), [(0.0, 0.2, True), (0.0, 0.01, False), (SIGMA, 0.2, False)]
)
def test_given_a_reading_when_still_while_the_arm_moves_then_it_is_stuck(jitter, rate, stuck):
    angle = rate * 0.002 * np.arange(40)
    reading = jitter * np.random.default_rng(0).standard_normal(40)
    values = np.column_stack([reading - angle, reading, 0 * reading, 0 * reading])
    stamps = TS * np.arange(40)
    limits = new_record(SENSOR_LIMITS, noise=SIGMA)
    assert is_stuck(limits, SampleBuffer(stamps, values, np.array([40]))) is stuck
    assert not is_stuck(limits, SampleBuffer(stamps, values, np.array([19])))
