from dataclasses import replace

import numpy as np
import pytest
from fault_injection import with_sensors
from serial_arms import shoulder_arm, watch, without
from simulated_runs import simulated_run

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import ParameterCovariance, Uncertainty
from lpv.core.serial_arm.diagnosis import balance as balances
from lpv.core.serial_arm.diagnosis import bank, linear_bank, parameter_error, row_noise
from lpv.core.serial_arm.diagnosis import estimator as estimators
from lpv.core.serial_arm.diagnosis import information as info
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan, OffsetEstimator
from lpv.core.serial_arm.dynamics.model import SerialModel

CHAIN, PER_BLOCK, PER_INTERVAL = compile_chain(shoulder_arm()), 5, 5
ARM = shoulder_arm('independent')
PLAN = HorizonPlan.of(ARM.sample_time)
LENGTH = PLAN.interval / PLAN.blocks  # of a block [s]


@pytest.fixture(scope='module')
def blocks():
    """Means of a simulated run without noise."""
    samples = simulated_run(shoulder_arm('independent'), 1.0, seed=2, noise=False).samples
    samples[:-1, 2] = samples[1:, 2]  # the effort of a sample acted before it
    count = (len(samples) - 1) // PER_BLOCK
    means = samples[: count * PER_BLOCK].reshape(count, PER_BLOCK, 9).mean(1)
    k = np.arange(count)
    places = (k % PER_INTERVAL + 0.5) / PER_INTERVAL
    rows = np.column_stack([means, 0.01 * k, np.full(count, 0.01), places])
    return rows[PER_INTERVAL : PER_INTERVAL * (count // PER_INTERVAL)]


def new_balance(chain, directions=None, drives=None):
    directions = np.zeros((0, 3, 10)) if directions is None else directions
    drives = np.zeros((len(directions), 3, 6)) if drives is None else drives
    return balances.new_balance(chain, directions, np.ones(3), drives, np.eye(3), np.ones(3))


def rows_of(chain, blocks, directions=None, reference=(0.0, 0.0, 0.0), drives=None):
    balance = new_balance(chain, directions, drives)
    balance.reference[:] = reference
    rows = np.empty((len(blocks) // PER_INTERVAL - 1, *balance.hat.rows.shape))
    balances.fill_balances(balance, blocks, PER_INTERVAL, rows)
    return rows


def test_balance_of_the_true_arm_is_zero_and_its_columns_are_derivatives(blocks):
    rows = rows_of(CHAIN, blocks)
    assert np.abs(rows[:, :, 0]).max() < 2e-3 * np.abs(blocks[:, 6:9]).max() * 0.05
    for joint in range(3):
        step = 1e-4 * np.eye(3)[joint]
        ahead, behind = (rows_of(CHAIN, blocks, reference=sign * step) for sign in (1, -1))
        expected = (ahead[:, :, 0] - behind[:, :, 0]) / 2e-4
        found = rows[:, :, 1 + 3 * balances.OFFSET + joint]
        np.testing.assert_allclose(found, expected, atol=1e-3)
    factor = np.random.default_rng(0).normal(size=(5, 45))
    factor[:, 36:39] = 0.0  # friction by load would multiply gains
    usual = np.full(3, 2.0), np.ones(3)
    directions, drives, _ = parameter_error.parameter_directions(CHAIN, factor, *usual)
    rows = rows_of(CHAIN, blocks, directions, drives=drives)
    friction, louder = CHAIN.friction.copy(), blocks.copy()
    friction[:, :4] += 0.5 * drives[0, :, :4]
    louder[:, 6:9] *= 1.0 + 0.5 * drives[0, :, 4]
    moved = CHAIN._replace(inertial=CHAIN.inertial + 0.5 * directions[0], friction=friction)
    change = rows_of(moved, louder)[:, :, 0] - rows[:, :, 0]
    np.testing.assert_allclose(change, 0.5 * rows[:, :, 1 + 3 * len(balances.GROUPS)], atol=1e-10)


@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_samples_that_are_missing_when_the_arm_is_the_true_one_then_little_is_left(rates):
    arm = shoulder_arm(rates)
    run = simulated_run(arm, 4.0, seed=2, noise=False)
    run.samples[:-1, 2] = run.samples[1:, 2]  # the effort of a sample acted before it
    largest = []
    for lost in (0, 4):  # in a row, every 0.2 s, at another place of the interval each time
        rows = [99 * k + np.arange(lost, dtype=int) for k in range(1, 20)]
        window = watch(arm, without(run, np.concatenate(rows))).estimator.window
        largest.append(np.abs(window.rows[10:60, :, 0]).max(0))
    assert (largest[1] < 3.0 * largest[0]).all()


def test_columns_of_friction_and_of_torque_gains_are_exact(blocks):
    rows, fields = rows_of(CHAIN, blocks), {balances.VISCOUS: 0, balances.COULOMB: 1}
    for group, field in {**fields, balances.TORQUE: 3, balances.GAIN: None}.items():
        friction, louder = CHAIN.friction.copy(), blocks.copy()
        if group == balances.GAIN:
            louder[:, 7] *= 1.2
        else:
            friction[1, field] += 0.2
        change = rows_of(CHAIN._replace(friction=friction), louder) - rows
        np.testing.assert_allclose(change[:, :, 0], 0.2 * rows[:, :, 2 + 3 * group], atol=1e-12)


def test_given_masses_and_friction_identified_together_then_they_are_wrong_together():
    row = np.zeros((1, 45))
    row[0, 21], row[0, 44] = 0.1, -2.0  # first moment of the last link, offset of its torque
    covariance = ParameterCovariance(tuple(map(tuple, row)), 1)
    arm = replace(shoulder_arm(), covariance=covariance, uncertainty=Uncertainty(payload=0.0))
    chain = compile_chain(arm)
    factor = parameter_error.parameter_factor(arm, chain)
    usual = np.full(3, 2.0), np.ones(3)
    directions, drives, _ = parameter_error.parameter_directions(chain, factor, *usual)
    assert len(directions) == 1
    assert drives[0, 2, 3] / directions[0, 2, 1] == pytest.approx(-20.0)


def products(window, null, last):
    return null.sums[info.sum_slot(window, 0)] - null.sums[info.sum_slot(window, last)]


def new_window(joints, unknowns, capacity, loads):
    """An empty window with one column of faults, and what is summed up of it."""
    past, rest = np.zeros((1 + unknowns, 2 + unknowns)), np.zeros(0)
    null = info.Posterior(*[rest] * len(info.Posterior._fields))._replace(
        weights=np.ones((capacity, joints)), lasting=np.zeros((capacity, joints)),
        sums=np.zeros((capacity + 1, *past.shape)), past=past)  # fmt: skip
    return info.new_window(joints, 1, unknowns, capacity, loads), null


def window_of(rows, weights, capacity, past=0.5):
    _, joints, columns = rows.shape
    window, null = new_window(joints, columns - 2, capacity, np.zeros((0, columns - 2)))
    for k, row in enumerate(rows):
        info.join(window, (null,), float(k), row, past)
        null.weights[info.slot(window, 0)] = weights[k]
        info.add_products(window, null, 0)
    return window, null


def test_window_sums_equal_direct_sums_and_drifts_may_count_from_a_later_moment():
    rng = np.random.default_rng(0)
    rows, weights = rng.normal(size=(30, 2, 4)), rng.uniform(1.0, 2.0, (30, 2))
    window, null = window_of(rows, weights, 10)
    for last in (1, 5, 10):
        direct = np.einsum('kia,ki,kib->ab', rows[-last:], weights[-last:], rows[-last:])
        np.testing.assert_allclose(products(window, null, last), direct[[0, 2, 3]], atol=1e-10)
    window, null = window_of(np.ones((5, 1, 3)), np.ones((5, 1)), 3)
    np.testing.assert_allclose(null.past, 1.5 * np.ones((2, 3)))
    info.join(window, (null,), 5.0, np.ones((1, 3)), -0.5)
    np.testing.assert_allclose(null.past, 0.75 * np.ones((2, 3)))
    rng = np.random.default_rng(1)
    rows, weights = rng.normal(size=(8, 1, 3)), np.ones((8, 1))
    later = rows.copy()
    later[:, :, 1] -= 2.0 * rows[:, :, 2]
    one, other = window_of(rows, weights, 5), window_of(later, weights, 5)
    info.move_drifts(*one, 1, 2, 1, 2.0)
    np.testing.assert_allclose(products(*one, 3), products(*other, 3), atol=1e-12)


def test_given_the_load_changed_then_balances_before_say_nothing_of_it():
    rows, load = np.random.default_rng(3).normal(size=(6, 1, 4)), np.array([0.5, -2.0])
    window, null = new_window(1, 2, 4, load[None])
    for k, row in enumerate(rows):
        info.join(window, (null,), float(k), row, 1.0)
        info.add_products(window, null, 0)
        window.changed[info.slot(window, 0)] = k in (1, 4)  # one has left the window
    total = null.past.copy()
    info.add_balances(window, null, total)
    changes = np.array([[1.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    free = np.hstack([rows[:, 0, [0, 2, 3]], -(rows[:, 0, 2:] @ load)[:, None] * changes])
    both = free.T @ free + np.diag([0.0, 0.0, 0.0, 1.0, 1.0])
    known = both[:3, 3:] @ np.linalg.solve(both[3:, 3:], both[3:, :3])
    np.testing.assert_allclose(total[1:, 2:], (both[:3, :3] - known)[1:, 1:], atol=1e-10)
    np.testing.assert_allclose(total[0, 2:], (both[:3, :3] - known)[0, 1:], atol=1e-10)


def test_factor_solves_and_whitens():
    rows = np.random.default_rng(2).normal(size=(9, 5))
    matrix, right = rows.T @ rows, rows[0].copy()
    factor, expected = matrix.copy(), np.linalg.solve(matrix, right)
    info.factorise(factor, np.zeros(5))
    columns = right[:, None].copy()
    info.whiten(factor, columns)
    info.solve_factorised(factor, right)
    np.testing.assert_allclose(right, expected, rtol=1e-9)
    assert columns[:, 0] @ columns[:, 0] == pytest.approx(rows[0] @ expected)


@pytest.mark.parametrize('count', [1, 2, 10, 201])
def test_given_values_when_one_is_selected_then_it_is_that_of_the_sorted_ones(count):
    values = np.random.default_rng(count).normal(size=count).round(1)  # some are equal
    assert [info.select(values, k) for k in range(count)] == sorted(values)


def test_reversals_are_told(blocks):
    balance = new_balance(CHAIN)
    own, rows = blocks[: 2 * PER_INTERVAL].copy(), np.empty((1, *balance.hat.rows.shape))
    for rates, expected in ((1.0, False), (np.linspace(-1.0, 1.0, len(own))[:, None], True)):
        own[:, 3:6] = rates
        balances.fill_balances(balance, own, PER_INTERVAL, rows)
        assert balances.rests(balance, 1) is expected


def test_given_residuals_that_are_larger_at_rest_then_noise_in_motion_stays_small():
    arm, rng = shoulder_arm(), np.random.default_rng(0)
    estimator = OffsetEstimator(arm, HorizonPlan.of(arm.sample_time))
    window, null = estimator.window, estimator.posterior
    for k in range(200):
        rows, rest = np.zeros(window.rows.shape[1:]), k % 2
        rows[:, 0] = (4.0 if rest else 1.0) * null.expected * rng.normal(size=3)
        info.join(window, (null,), 0.05 * k, rows, -1.0)
        window.rest[info.slot(window, 0)] = rest
    estimators.set_residuals(window, null, 200)
    row_noise.learn_noise(estimator.horizon.noise, window, null)
    np.testing.assert_allclose(null.rest, 4.0, rtol=0.3)
    np.testing.assert_allclose(null.noise, null.expected, rtol=0.3)


def test_given_noise_of_readings_then_its_size_is_learned_and_rows_do_not_share_it():
    arm, rng = shoulder_arm('derived'), np.random.default_rng(0)
    estimator = OffsetEstimator(arm, HorizonPlan.of(arm.sample_time))
    window, null, noise = estimator.window, estimator.posterior, estimator.horizon.noise
    share, other = 0.5, noise.stated / 100.0
    left = []
    for k in range(2 * estimator.plan.capacity):
        info.join(window, (null,), 0.05 * k, np.zeros(window.rows.shape[1:]), -1.0)
        at = info.slot(window, 0)
        window.poses[at] = rng.uniform(-0.5, 0.5, 3)
        mass = SerialModel(compile_chain(arm)).mass_matrix(window.poses[at])
        left.append(mass @ (np.sqrt(share * noise.rates) * rng.normal(size=3)))
        left[-1] += np.sqrt(other) * rng.normal(size=3)
        window.rows[at, :, 0] = left[-1]
        row_noise.decorrelate(noise, window, estimator.balance, null.dry, at)
        if row_noise.is_due(window):
            estimators.set_residuals(window, null, len(estimator))
            row_noise.learn_covariance(noise, window, null)
    assert noise.share == pytest.approx(share, rel=0.2)
    np.testing.assert_allclose(noise.other[1:], other[1:], rtol=0.5)
    rows = window.rows[info.recent(window, estimator.plan.capacity)][:, :, 0]
    assert np.abs(np.corrcoef(np.array(left).T)[1, 2]) > 0.5
    assert np.abs(np.corrcoef(rows.T) - np.eye(3)).max() < 0.2


@pytest.mark.parametrize(('unit', 'known'), [('N m', 0.0), ('A', 0.04)])
def test_given_currents_then_gains_of_drives_may_be_wrong_as_masses_may(unit, known):
    arm = replace(shoulder_arm(), effort_unit=unit, uncertainty=Uncertainty(0.0, 0.0, 0.04))
    gains = parameter_error.parameter_factor(arm, compile_chain(arm))[:, 42:]
    assert np.abs(gains).max(0) == pytest.approx(np.full(3, known))


def kinematic_rows(time, position, rate, missing=0.0, learns=False, **noise):
    """Rows after blocks of such means, which lack samples for ``missing`` [s], and such noise."""
    rows = bank.KinematicRows(with_sensors(ARM, **noise), PLAN)
    blocks = np.zeros((len(time), 13))
    blocks[:, :3], blocks[:, 3:6], blocks[:, 9], blocks[:, 10] = position, rate, time, LENGTH
    blocks[:, 10] += missing
    for k in range(2 * PLAN.blocks, len(blocks) + 1, PLAN.blocks):
        bank.take_row(rows.parts, blocks[k - 2 * PLAN.blocks : k], PLAN.interval)
        if learns and rows.held > 1:
            bank.learn_rows(rows.parts, PLAN.interval)
    return rows.parts


def sums(noise=1e-3, step=0.0, rate=0.0, jump=0.0):
    """Sums of the rows of half a second at a constant rate, in which a reading may jump."""
    time = LENGTH * np.arange(30 * PLAN.blocks)
    position = rate * np.repeat(time[:, None], 3, 1)
    position[-3 * PLAN.blocks :, 1] += jump
    found = linear_bank.new_rows(1, 3)
    parts = kinematic_rows(time, position, rate, position_noise=noise, quantization=step)
    bank.sum_rows(parts, PLAN.interval, np.array([10]), found)
    return found


def learned(error=0.0, lag=0.0, missing=0.0, seed=1):
    """Rows after a minute of swings, stamps off by ``error``, rates late by ``lag`` [s].

    Every fourth interval lacks samples for ``missing`` [s]; there rates are late by 0.1 s.
    """
    time, speed = LENGTH * np.arange(round(60.0 / LENGTH)), np.array([1.0, 2.0, 3.0])
    taken = time + error * np.random.default_rng(seed).normal(size=len(time))
    spoiled = np.arange(len(time)) // PLAN.blocks % 4 == 3
    late = np.where(spoiled & (missing > 0.0), max(lag, 0.1), lag)
    rate = speed * np.cos((time - late)[:, None] * speed)
    return kinematic_rows(
        time, np.sin(taken[:, None] * speed), rate, missing * spoiled, learns=True,
        position_noise=1e-5, quantization=0.0, velocity_noise=1e-4)  # fmt: skip


@pytest.mark.slow
def test_given_stamps_and_rates_that_are_off_when_rows_are_learned_then_so_is_how_much():
    for error in (0.0, 5e-4):
        found = [float(learned(error=error, seed=k).stamps[0]) ** 0.5 for k in range(4)]
        assert np.median(found) == pytest.approx(error, rel=0.2)
    for missing in (0.0, 0.04):  # rows that miss samples say little of the lag
        np.testing.assert_allclose(learned(lag=4e-3, missing=missing).lag, 4e-3, rtol=0.1)


def test_given_rounding_or_fast_motion_when_weighted_then_it_is_noise_that_costs_weight():
    fine, rounded = sums(noise=1e-3), sums(noise=0.0, step=1e-3 * 12.0**0.5)
    np.testing.assert_allclose(rounded.weight, fine.weight, rtol=1e-12)
    assert np.all(sums(noise=2e-3).weight < 0.7 * fine.weight)
    assert np.all(sums(noise=1e-5, rate=3.0).weight < 0.9 * sums(noise=1e-5).weight)


def test_given_a_rate_that_goes_wrong_when_weighted_then_its_jump_is_no_turn_of_the_joint():
    time, lengths = LENGTH * np.arange(30 * PLAN.blocks), np.array([3, 5, 8])
    parts, found = kinematic_rows(time, 0.0, 0.0), []
    for error in (0.0, 0.1):
        parts.rows[-5:, 1] -= error * PLAN.interval
        parts.edges[-5:, 1] += error
        found.append(linear_bank.new_rows(3, 3))
        bank.sum_rows(parts, PLAN.interval, lengths, found[-1])
    np.testing.assert_allclose(found[1].weight, found[0].weight, rtol=0.01)
    ways = -0.1 * PLAN.interval * np.minimum(lengths, 5)
    np.testing.assert_allclose(found[1].found[:, 1], ways, rtol=0.01)


@pytest.mark.parametrize('rate', [0.0, 1.0])
def test_given_a_reading_that_jumps_when_summed_then_its_own_row_holds_the_jump(rate):
    found = sums(rate=rate, jump=0.05)
    np.testing.assert_allclose(found.found[0], [0.0, 0.05, 0.0], atol=2e-3)
    assert found.span == pytest.approx(0.5)


@pytest.mark.parametrize(('slow', 'error'), [(0.0, 0.0), (0.03, 0.0), (0.03, 0.05)])
def test_given_a_clock_that_is_slow_when_a_way_is_asked_for_then_other_joints_tell(slow, error):
    time, speed = LENGTH * np.arange(30 * PLAN.blocks), np.array([0.5, 1.0, -1.0])
    rate = np.repeat([speed], len(time), 0)
    position = rate * time[:, None] / (1.0 - slow)
    rows = bank.KinematicRows(ARM, PLAN)
    rows.parts = kinematic_rows(time, position + [0.0, error, 0.0] * time[:, None], rate)
    way, sigma = rows.way(1, 20)
    assert way == pytest.approx(-error * 20 * PLAN.interval, abs=2.0 * sigma)
    assert sigma < 0.2 * 0.05 * 20 * PLAN.interval


def test_given_rows_or_none_when_their_sums_are_searched_then_the_loudest_window_counts():
    values = np.random.default_rng(1).normal(size=(9, 3))
    inflation, ends, walk, bias = np.random.default_rng(2).uniform(0.5, 1.5, (4, 3))
    spans = 0.05 * np.arange(1, 10)[:, None]
    variance = inflation * (ends + walk * spans) + (bias * spans) ** 2
    expected = (0.5 * np.cumsum(values[::-1], axis=0) ** 2 / variance)[:, 1].max()
    rows = bank.KinematicRows(ARM, PLAN)
    assert not rows.agrees(1, 0.0) and not bank.loudest_window(rows.parts, 0.05) > 0.0
    noise = {'inflation': inflation, 'ends': ends, 'walk': walk, 'bias': bias}
    parts = rows.parts._replace(**noise, trusted=np.array([False, True, False]))
    parts.rows[-9:], parts.held[0] = values, 9
    assert bank.loudest_window(parts, 0.05) == pytest.approx(expected)


@pytest.mark.parametrize('first', [-np.inf, -800.0, 0.0, 800.0])
def test_given_logarithms_of_any_size_when_added_then_it_is_their_sum(first):
    total, logarithms = (-np.inf, 0.0), [first, 3.0, -np.inf, 3.5, -2.0, -700.0]
    for one in logarithms:
        total = linear_bank.add_logarithm(total, one)
    expected = np.logaddexp.reduce(logarithms)
    assert total[0] + np.log(total[1]) == pytest.approx(expected, rel=1e-14)
