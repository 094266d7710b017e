from dataclasses import replace

import numpy as np
import pytest
from fault_injection import BY_NAME, Cell, cells, draw, run
from serial_arms import shoulder_arm
from simulated_runs import simulated_run
from ur10e_twin import twin
from watched import Watched

from lpv.core.serial_arm.diagnosis import balance, bank, contact, drift_trial, onset
from lpv.core.serial_arm.diagnosis.estimator import set_residuals
from lpv.core.serial_arm.diagnosis.fault_filter import begin_filter
from lpv.core.serial_arm.diagnosis.information import recent
from lpv.core.serial_arm.diagnosis.priors import AMPLITUDES, STEADY_FOR
from lpv.core.serial_arm.diagnosis.sampler import block_end
from lpv.core.serial_arm.diagnosis.stuck import Frozen
from lpv.core.simulation.faults import Fault

JOINT, BEGIN, RATE, PRIOR, LAST = 1, 3.022, 0.2, 0.3, 14


@pytest.fixture(scope='module')
def monitor():
    """Of an arm that is its model, at a decision half a second after a drift began; no names."""
    arm = shoulder_arm()
    fault = Fault(arm.sensor_names[JOINT], 'drift', BEGIN, rate=RATE)
    run = simulated_run(arm, 3.5, fault, noise=False)
    return watch_to_decision(arm, run, int(np.searchsorted(run.stamps, 3_450_000_000)))


def watch_to_decision(arm, run, first):
    monitor = Watched(arm, hours_between_false_alarms=np.inf)
    monitor.take(run.stamps[:first], run.samples[:first])
    for stamp, sample in zip(run.stamps[first:], run.samples[first:]):
        monitor.take([stamp], sample[None])
        if monitor.estimator.window.times.max() == pytest.approx(monitor.readings.last()):
            return monitor


def dense_onsets(monitor, end):
    """All onsets, with the joint information of the drift and of the arm's unknowns."""
    estimator, interval = monitor.estimator, monitor.plan.interval
    window, null, n = estimator.window, estimator.posterior, estimator.joints
    m, rows = len(null.mean), window.rows[recent(window, LAST)]
    weights, unknowns = null.weights[recent(window, LAST)].ravel(), rows[:, :, -m:]
    residual = (rows[:, :, 0] + unknowns @ null.mean).ravel()
    weighted = weights[:, None] * unknowns.reshape(-1, m)
    upper = np.triu(null.factor)
    for back in range(onset.ONSET, LAST - 1):
        momentum = window.momenta[estimator.place(back), :, JOINT]
        for place in onset.PLACES:
            begin = end - (back + 1 - place) * interval
            since = begin - estimator.balance.epoch[0]
            effect = np.zeros((LAST, n))
            effect[:back] = rows[:back, :, 1 + balance.DRIFT * n + JOINT]
            effect[:back] -= since * rows[:back, :, 1 + balance.OFFSET * n + JOINT]
            effect[back - 1] -= place * momentum
            effect[back] -= (1.0 - place) * momentum
            column = effect.ravel()
            cross = column @ weighted
            power = column @ (weights * column) + PRIOR**-2
            information = np.block([[upper.T @ upper, cross[:, None]], [cross[None], power]])
            sigma = np.linalg.inv(information)[-1, -1] ** 0.5
            score = -column @ (weights * residual)
            gain = 0.5 * (score * sigma) ** 2 + np.log(sigma / PRIOR)
            yield onset.Onset(gain, score * sigma**2, sigma, begin, back)


def dense_contact(outside, null, residual):
    """Evidence of rough torques in these residuals, shape (L, n), newest first."""
    place, evidence = outside.interval * np.arange(len(residual)), 0.0
    correlation = np.exp(-np.abs(place - place[:, None]) / STEADY_FOR)
    for left, variance, torque in zip(residual.T, null.noise**2 * null.inflation, outside.torque):
        signals = (np.array(AMPLITUDES) * torque * outside.interval) ** 2 / variance
        ratios = [0.0]
        for matrix in np.eye(len(left)) + signals[:, None, None] * correlation:
            explained = left @ left - left @ np.linalg.solve(matrix, left)
            ratios.append(0.5 * (explained / variance - np.linalg.slogdet(matrix)[1]))
        evidence += max(0.0, max(ratios) - contact.ROUGH_PENALTY)
    return evidence


def test_given_residuals_when_rough_torques_explain_them_then_as_by_dense_matrices(monitor):
    outside, null = monitor.bank.parts.evidence.outside, monitor.estimator.posterior
    contact.watch_noise(outside, null)
    null.residual[:] = 3.0 * null.noise * np.random.default_rng(1).normal(size=null.residual.shape)
    last, newest = len(outside.rough), 2
    found = contact.rough_contact(outside, null, newest, last)
    assert found == outside.rough[-1]
    expected = [dense_contact(outside, null, null.residual[newest:][:k]) for k in (1, 9, last)]
    assert outside.rough[[0, 8, -1]] == pytest.approx(expected, rel=1e-9)
    assert expected[-1] > expected[1] > 0.0


def test_given_an_alarm_when_it_is_raised_then_no_drift_is_sought_long_before_it():
    arm = shoulder_arm()
    run = simulated_run(arm, 7.0, Fault(arm.sensor_names[JOINT], 'bias', 6.0, size=0.2))
    monitor, before = Watched(arm), int(np.searchsorted(run.stamps, 5_900_000_000))
    longest = []
    for part in (slice(before), slice(before, None)):
        monitor.take(run.stamps[part], run.samples[part])
        windows = monitor.bank.parts.state[0].windows
        longest.append(monitor.bank.parts.evidence.lengths[windows - 1] * monitor.plan.interval)
    assert [one.event.name for one in monitor.alarms] == ['RAISED']
    np.testing.assert_allclose(longest, [bank.DRIFT_STARTS[1], bank.STARTS[-1]])


def test_given_a_drift_when_its_onset_is_sought_then_it_is_the_dense_best_and_true(monitor):
    blocks = monitor.readings.blocks(LAST + 1)
    about = monitor.estimator, np.array([0, JOINT]), block_end(blocks[-1])
    best = max(dense_onsets(monitor, about[2]), key=lambda one: one.gain)
    likely = onset.likely_onsets(*about, np.full(2, PRIOR), LAST)
    np.testing.assert_allclose(likely[1][0], best, rtol=1e-6)
    _, found = onset.sudden_drifts(*about[:2], LAST, blocks)
    assert found.begin == pytest.approx(BEGIN, abs=0.05 * monitor.plan.interval)
    assert found.size == pytest.approx(RATE, rel=0.06)
    assert found.sigma < 0.15 * RATE
    short = onset.sudden_drifts(*about[:2], onset.ONSET, blocks)
    assert [one.gain for one in short] == [-np.inf, -np.inf]


@pytest.mark.parametrize('fault', [
    Fault('encoder2', 'drift', BEGIN, rate=RATE), Fault('encoder2', 'rate_bias', BEGIN, size=RATE),
], ids=['drift', 'rate_bias'])  # fmt: skip
def test_given_a_fault_beside_rates_when_its_onset_is_no_start_then_cause_and_size_are_right(fault):
    arm = shoulder_arm('independent')
    run = simulated_run(arm, 3.8, fault, noise=False)
    monitor = watch_to_decision(arm, run, int(np.searchsorted(run.stamps, 3_620_000_000)))
    found = monitor.bank.compare(monitor.readings.blocks, [], set())
    (best, share), *_ = monitor.bank.shares(found)
    assert (best.kind, best.joint) == (fault.kind, JOINT) and share > 0.99
    assert best.begin == pytest.approx(BEGIN, abs=0.3 * monitor.plan.interval)
    assert best.size == pytest.approx(RATE, rel=0.02)


def test_given_a_drift_that_is_tried_then_it_changes_balances_as_blocks_without_it_do(monitor):
    blocks, per = monitor.readings.blocks(LAST + 1), monitor.plan.blocks
    estimator = monitor.estimator
    one, null, n = estimator.balance, estimator.posterior, estimator.joints
    own = drift_trial.balance_of_trials(one, one.chain.friction)
    estimator.call(set_residuals, estimator.window, null, LAST)
    trials = drift_trial.new_trials(estimator.window, null, blocks, per, n)
    onsets = np.array([[onset.Onset(0.0, RATE, 0.1, BEGIN, LAST - 1)]])
    found = drift_trial.new_found(onsets)
    joint, prior, parts = np.array([JOINT]), np.array([[0.0], [PRIOR]]), (1.0, 1.0)
    drift_trial.compare_drifts(own, trials, null.factor, joint, parts, prior, onsets, found)
    size, freed, rows = found[0, -1, drift_trial.SIZE], blocks.copy(), []
    drift_trial.free_of_drift(blocks, JOINT, parts, BEGIN, size, freed)
    for some in (blocks, freed):
        rows.append(np.empty((LAST, *one.hat.rows.shape)))
        balance.fill_balances(balance.scratch_of(one), some, per, rows[-1])
    changes, columns = trials.changes[0], 1 + n * np.array([balance.VISCOUS, balance.COULOMB])
    changed = trials.mixing @ (rows[1] - rows[0])
    np.testing.assert_allclose(changes[:, :, 0], changed[:, :, 0], atol=1e-12)
    np.testing.assert_allclose(changes[:, JOINT, 1:], rows[1][:, JOINT, columns + JOINT])


def test_given_friction_that_turns_over_when_a_drift_is_looked_for_then_its_onset_is_found():
    """To first order friction is what it was before the joint seemed to move."""
    kind, last = replace(BY_NAME['drift 0.3'], lead=20.0), 50
    subject, window, _ = draw(Cell('ur10e', (twin(),), kind, 'derived'), 1000, 31)
    stream, fault = window.stream, window.faults[0]
    begin = fault.onset
    monitor = watch_to_decision(subject.arm, stream, stream.index(begin + 0.5))
    estimator, blocks = monitor.estimator, monitor.readings.blocks(last + 1)
    joint, interval = np.array([fault.sensor]), monitor.plan.interval
    end = block_end(blocks[-1])
    ((first, *_),) = onset.likely_onsets(estimator, joint, end, np.array([PRIOR]), last)
    assert abs(first.begin - begin) > interval
    (found,) = onset.sudden_drifts(estimator, joint, last, blocks)
    assert found.begin == pytest.approx(begin, abs=0.3 * interval)
    assert abs(found.size) == pytest.approx(0.3, rel=0.1)


def test_given_a_reading_that_rests_when_explained_then_it_froze_when_its_rest_began(monitor):
    rested, end = 0.25, monitor.estimator.window.times.max()
    frozen = Frozen(end - rested, 1.0, 0.1, alive=False)
    found = monitor.bank.stuck({JOINT: frozen}, monitor.readings.blocks)
    assert {(one.kind, one.joint) for one in found} == {('stuck', JOINT)}
    assert found[0].begin == frozen.time
    assert all(frozen.time <= one.begin < end for one in found)


def drift(size, sigma, spread=0.0):
    fault = bank.Hypothesis('drift', 0, 0.0, size, sigma, 0.0)
    return begin_filter(fault, 0.2, 0.0, spread)


def test_given_a_filter_when_corrected_then_what_is_beyond_its_bound_or_rests_is_removed():
    for size in (0.33, -0.33):
        wide = drift(size, abs(size) / 2.0)  # 0.066 rad after 0.2 s, bound 0.132 rad
        assert wide.fault(0.0, 0.2)[0] == pytest.approx(0.2 * size)
        assert wide.share(0.0, 0.2, 4.0) == 0.0
    late = drift(0.3, 0.0, 0.1)  # its bound holds the uncertainty of its onset, too
    assert late.fault(0.0, 0.2)[1] == pytest.approx(0.03) and late.share(0.0, 0.2, 4.0) == 0.0
    shares = [drift(0.3, sigma).share(0.0, 0.2, 4.0) for sigma in (0.075, 0.07, 0.03, 1e-3, 0.0)]
    assert shares[0] == pytest.approx(0.0, abs=1e-9) and shares[-1] == 1.0
    assert np.all(np.diff(shares) > 0.0) and shares[-2] > 0.999
    assert replace(drift(0.3, 0.5), kind='stuck').share(0.0, 0.2, 4.0) == 1.0


def test_given_a_biased_rate_that_seems_to_turn_round_then_friction_tells_it_from_a_drift():
    """To first order friction does not change, and both explain the balances alike."""
    (cell,) = cells(['real_arm'], [False], ['independent'], [BY_NAME['rate bias 0.1']])
    verdict = run(cell, 100)
    assert verdict.in_time and verdict.kind == 'rate_bias'


def test_given_a_slow_drift_when_its_onset_is_seconds_ago_then_that_still_counts():
    (cell,) = cells(['coarse'], [False], ['derived'], [BY_NAME['drift 0.1']])
    verdict = run(cell, 103)
    assert verdict.delay is not None and verdict.kind == 'drift'
