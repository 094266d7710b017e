from dataclasses import replace

import numpy as np
import pytest

from lpv.core.control import watchdog
from lpv.core.control.estimate_check import (
    IMPOSSIBLE,
    NOT_FINITE,
    ROWS,
    check_values,
    limit_correction,
)
from lpv.core.control.tracking import loop_latency
from lpv.core.control.watchdog import BrakeReason, StopReason
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.simulation import precompile
from lpv.core.simulation.transport import PARTS, Stall, Transport
from lpv.core.support.jit import Entries

pytestmark = pytest.mark.slow
MS = 1_000_000
STEP = 2 * MS
STILL = np.zeros(2)
OBSERVING, STALE = int(Mode.OBSERVING), int(Mode.STALE)


@pytest.fixture
def tracker(paper_arm):
    return watchdog.TrackerWatchdog(paper_arm, watchdog.TrackerLimits())


@pytest.fixture
def drives(paper_arm):
    return watchdog.DriveWatchdog(paper_arm)


def estimates(tracker, steps, latency=0, mode=OBSERVING, trustworthy=True, velocity=STILL):
    """What the tracker says to estimates that are all alike, at so many steps."""
    what = latency, mode, trustworthy, velocity, STILL
    return [tracker.check_estimate(k * STEP, *what) for k in steps]


def commands(drives, steps, latency, velocity=STILL):
    """What drives say at so many steps; the latency may depend on them."""
    late = latency if callable(latency) else lambda _: latency
    return [drives.check(k * STEP, late(k), False, velocity) for k in steps]


def motion(tracker, step, reference, fed_back, position):
    return tracker.check_motion(step * STEP, reference, fed_back, position)


def test_given_measurements_when_unusable_for_long_then_the_arm_stops_in_the_stated_time(tracker):
    assert set(estimates(tracker, range(100))) == {StopReason.NONE}
    reasons = estimates(tracker, range(100, 150), mode=STALE)
    assert reasons.index(StopReason.UNUSABLE) * 0.002 == pytest.approx(0.05, abs=0.003)


@pytest.mark.parametrize(('latency', 'trustworthy', 'expected'), [
    (70 * MS, True, 'LATENCY'), (0, False, 'NOT_TRUSTWORTHY'), (50 * MS, True, 'NONE'),
])  # fmt: skip
def test_given_a_bad_estimate_then_the_arm_stops_at_once(tracker, latency, trustworthy, expected):
    assert estimates(tracker, [1], latency, trustworthy=trustworthy) == [StopReason[expected]]


def test_given_a_joint_without_end_when_it_has_turned_far_then_its_estimate_can_be_one():
    values = np.full((len(ROWS), 2), 6000.0)
    assert check_values(values) == 0
    values[1, 1] = 1e7
    assert check_values(values) == IMPOSSIBLE
    values[3, 0] = np.nan
    assert check_values(values) == NOT_FINITE


def test_given_what_a_tracker_checks_in_estimates_when_compiled_ahead_then_it_is(
    paper_arm, paper_gains, monkeypatch
):
    call, called = Entries.__call__, list[object]()

    def noted(self, function, *arguments):
        called.append(function)
        return call(self, function, *arguments)

    monkeypatch.setattr(Entries, '__call__', noted)
    monkeypatch.setattr(precompile, 'check_values', lambda values: called.append(values.shape))
    precompile._run_loop(paper_arm, 'two_faults', paper_gains)
    assert limit_correction in called and (len(ROWS), 2) in called


def test_given_stamps_ahead_of_the_clock_when_that_is_set_then_a_late_mean_is_seen_as_soon(tracker):
    assert set(estimates(tracker, range(50), -5000 * MS)) == {StopReason.NONE}
    reasons = estimates(tracker, range(50, 150), 50 * MS)
    assert reasons.index(StopReason.LATENCY) * 0.002 < 0.05


@pytest.mark.parametrize('fast', [np.array([0.0, 20.1]), np.array([np.nan, 0.0])])
def test_given_a_fast_joint_when_it_lasts_then_both_sides_stop_until_reset(tracker, drives, fast):
    estimates(tracker, [0]), commands(drives, [0], 0)
    stops = estimates(tracker, range(1, 20), velocity=fast)
    brakes = commands(drives, range(1, 20), 0, fast)
    assert stops.index(StopReason.OVERSPEED) == brakes.index(BrakeReason.OVERSPEED) == 10
    assert estimates(tracker, [30]) == [StopReason.OVERSPEED]
    assert commands(drives, [30], 0) == [BrakeReason.OVERSPEED]
    tracker.latched = drives.latched = 0
    assert estimates(tracker, [31]) == [StopReason.NONE]
    assert commands(drives, [31], 0) == [BrakeReason.NONE]


def test_given_an_arm_off_its_reference_when_it_stays_there_then_it_stops_until_reset(tracker):
    reference, position = np.array([0.6, 0.0]), np.zeros(2)
    motion(tracker, 0, position, position, position)
    reasons = []
    for k in range(1, 40):
        position = position + np.array([0.0, 0.02])  # it moves, but not as it should
        reasons.append(motion(tracker, k, reference, position, position))
    assert reasons.index(StopReason.TRACKING_ERROR) * 0.002 == pytest.approx(0.05, abs=0.003)
    assert estimates(tracker, [1]) == [StopReason.TRACKING_ERROR]


@pytest.mark.parametrize('beside', [0.0, 0.04])
def test_given_an_arm_that_stands_still_when_left_then_it_is_not_following(tracker, beside):
    path = np.outer(0.001 * np.arange(50) + beside, [1.0, 0.0])
    # The position that is fed back moves, as a correction fades; the arm does not.
    reasons = [motion(tracker, k, there, 0.9 * there, STILL) for k, there in enumerate(path)]
    assert reasons.index(StopReason.NOT_FOLLOWING) == 21
    tracker.note_stop()
    assert motion(tracker, 60, np.array([0.1, 0.0]), STILL, STILL) == StopReason.NONE


@pytest.mark.parametrize(('mode', 'rate'), [(OBSERVING, [1.0, 0.0]), (STALE, [0.0, 0.0])])
def test_given_frozen_or_missing_readings_when_the_arm_goes_on_then_it_follows(tracker, mode, rate):
    reasons, read = [], STILL
    for k, there in enumerate(np.outer(0.002 * np.arange(500), [1.0, 0.0])):
        now = OBSERVING if k % 50 < 30 else mode  # nothing is read for 40 ms
        read = there if now == OBSERVING != mode else read
        estimates(tracker, [k], mode=now, velocity=np.array(rate))
        reasons.append(motion(tracker, k, there, there, read))
    assert set(reasons) == {StopReason.NONE}


def test_given_all_readings_frozen_when_rates_go_on_then_the_arm_is_not_following(tracker):
    reasons = []
    for k, there in enumerate(np.outer(0.002 * np.arange(50), [1.0, 0.0])):
        estimates(tracker, [k], velocity=np.array([1.0, 0.0]))
        reasons.append(motion(tracker, k, there, STILL, STILL))
    assert StopReason.NOT_FOLLOWING in reasons


def test_given_a_correction_beyond_the_reference_when_the_arm_waits_for_it_then_it_follows(tracker):
    reasons, read = [], np.zeros(2)
    for k, reference in enumerate(np.outer(0.001 * np.arange(100), [1.0, 0.0])):
        fault = np.array([0.04, 0.0]) * (k >= 20)  # confirmed when it had grown slowly
        read = np.maximum(read, reference - fault)  # it stands until its reference is there
        reasons.append(motion(tracker, k, reference, read + fault, read))
    assert set(reasons) == {StopReason.NONE}


def test_given_an_arm_that_follows_slowly_when_judged_then_it_follows(tracker):
    for k, reference in enumerate(np.outer(0.001 * np.arange(2000), [1.0, 0.0])):
        position = 0.97 * reference
        assert motion(tracker, k, reference, position, position) == StopReason.NONE


def test_given_what_is_late_on_average_then_both_sides_stop_for_a_while(tracker, drives):
    outage = commands(drives, range(60), lambda k: k * STEP)
    assert outage.index(BrakeReason.LATENCY) * 0.002 < 0.06
    assert outage[31] == BrakeReason.LATE
    back = commands(drives, range(60, 260), STEP)
    assert 0.2 < back.index(BrakeReason.NONE) * 0.002 < 0.45
    assert commands(drives, range(300, 500), 16 * MS)[-1] == BrakeReason.LATENCY
    late = estimates(tracker, range(200), 16 * MS)
    assert 0.05 < late.index(StopReason.LATENCY) * 0.002 < 0.2
    back = estimates(tracker, range(200, 400), MS)
    assert 0.2 <= back.index(StopReason.NONE) * 0.002 < 0.3


def test_given_any_rate_then_limits_are_below_the_latency(arm, gains_of):
    gains = gains_of[arm.name]
    tolerated = loop_latency(arm, gains)
    assert watchdog.UNKNOWN_LOOP.mean < tolerated < 0.1
    assert watchdog.latency_limits(tolerated).mean < tolerated
    for rate in (100, 2000):
        tolerated = loop_latency(replace(arm, sample_time=1.0 / rate), gains)
        limits = watchdog.latency_limits(tolerated)
        assert 0.5 / rate < limits.mean < tolerated
        assert watchdog.mean_limit(limits.single) == pytest.approx(limits.mean)


def test_given_a_tolerated_latency_then_the_arm_follows_and_beyond_it_is_braked(run_paper):
    run, late = (run_paper(duration=3.0, options={'transport': Transport(n)}) for n in (5, 20))
    assert np.abs(run.velocity).max() < 0.5 and not run.braked[10:].any()
    assert np.abs(late.velocity).max() < 1.0
    assert set(late.brake_reason[200:]) & {BrakeReason.LATENCY, BrakeReason.SAFE_STOP}


@pytest.mark.parametrize('seed', range(2))
def test_given_random_stalls_when_run_then_no_joint_is_too_fast(run_paper, seed):
    rng, stalls = np.random.default_rng(seed), []
    delay = int(rng.integers(0, 4))
    for _ in range(10):  # of any part at any time, 0.02 to 1 s long
        part, onset = PARTS[rng.integers(len(PARTS))], rng.uniform(0.1, 19.0)
        stalls.append(Stall(part, onset, 0.02 * 50 ** rng.random()))
    run = run_paper(seed=seed, options={'transport': Transport(delay, stalls=tuple(stalls))})
    assert np.abs(run.velocity).max() < 2.0  # of 20 rad/s
    assert run.place[-1] > 1000, 'the arm goes on'


def test_given_unusable_measurements_when_they_last_then_no_trust_is_left(paper_arm, paper_gains):
    monitor = SerialSensorMonitor('test', paper_arm, gains=paper_gains)
    velocity = np.repeat([[0.0, 0.0], [13000.0, 13000.0]], [10, 50], axis=0)
    held, stamps = np.tile([0.1, 0.2], (60, 1)), 1 + STEP * np.arange(60)
    state = monitor.take_many(stamps, held, velocity, np.zeros((60, 2))).state
    assert state.trustworthy[:35].all() and not state.trustworthy[35:].any()
    assert set(state.mode[10:]) == {STALE}
