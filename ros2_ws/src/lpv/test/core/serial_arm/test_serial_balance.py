"""Momentum balances and their derivatives; windows of least squares."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm
from simulated_runs import simulated_run

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import ParameterCovariance, Uncertainty
from lpv.core.serial_arm.diagnosis import balance as balances
from lpv.core.serial_arm.diagnosis import information as info
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan, OffsetEstimator, learn_noise
from lpv.core.serial_arm.diagnosis.parameter_error import parameter_directions, parameter_factor

CHAIN, PER_BLOCK, PER_INTERVAL = compile_chain(shoulder_arm()), 5, 5


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


def rows_of(chain, blocks, directions=None, reference=(0.0, 0.0, 0.0), drives=None):
    directions = np.zeros((0, 3, 10)) if directions is None else directions
    balance = balances.new_balance(chain, directions, np.ones(3), drives)
    balance.reference[:] = reference
    rows = np.empty((len(blocks) // PER_INTERVAL - 1, *balance.rows.shape))
    balances.fill_balances(balance, blocks, PER_INTERVAL, rows)
    return rows


def column(rows, group, joint):
    return rows[:, :, 1 + 3 * group + joint]


def test_balance_of_the_true_arm_is_zero_and_columns_of_offsets_are_its_derivatives(blocks):
    rows = rows_of(CHAIN, blocks)
    assert np.abs(rows[:, :, 0]).max() < 2e-3 * np.abs(blocks[:, 6:9]).max() * 0.05
    for joint in range(3):
        step = 1e-4 * np.eye(3)[joint]
        ahead, behind = (rows_of(CHAIN, blocks, reference=sign * step) for sign in (1, -1))
        expected = (ahead[:, :, 0] - behind[:, :, 0]) / 2e-4
        np.testing.assert_allclose(column(rows, balances.OFFSET, joint), expected, atol=1e-3)


@pytest.mark.parametrize(
    ('group', 'field'),
    [(balances.VISCOUS, 0), (balances.COULOMB, 1), (balances.TORQUE, 3), (balances.GAIN, None)],
)
def test_columns_of_friction_and_of_torque_gains_are_exact(blocks, group, field):
    friction, louder = CHAIN.friction.copy(), blocks.copy()
    if group == balances.GAIN:
        louder[:, 7] *= 1.2
    else:
        friction[1, field] += 0.2
    rows = rows_of(CHAIN, blocks)
    change = rows_of(CHAIN._replace(friction=friction), louder) - rows
    np.testing.assert_allclose(change[:, :, 0], 0.2 * column(rows, group, 1), atol=1e-12)


def test_columns_of_parameter_directions_are_exact(blocks):
    factor = np.random.default_rng(0).normal(size=(5, 45))
    factor[:, 36:39] = 0.0  # friction by load would multiply gains
    directions, drives = parameter_directions(CHAIN, factor, np.full(3, 2.0))
    rows = rows_of(CHAIN, blocks, directions, drives=drives)
    friction, louder = CHAIN.friction.copy(), blocks.copy()
    friction[:, :4] += 0.5 * drives[0, :, :4]
    louder[:, 6:9] *= 1.0 + 0.5 * drives[0, :, 4]
    moved = CHAIN._replace(inertial=CHAIN.inertial + 0.5 * directions[0], friction=friction)
    change = rows_of(moved, louder)[:, :, 0] - rows[:, :, 0]
    np.testing.assert_allclose(change, 0.5 * rows[:, :, 1 + 3 * len(balances.GROUPS)], atol=1e-10)


def test_given_masses_and_friction_identified_together_then_they_are_wrong_together():
    row = np.zeros((1, 45))
    row[0, 21], row[0, 44] = 0.1, -2.0  # first moment of the last link, offset of its torque
    covariance = ParameterCovariance(tuple(map(tuple, row)), 1)
    arm = replace(shoulder_arm(), covariance=covariance, uncertainty=Uncertainty())
    chain = compile_chain(arm)
    factor = parameter_factor(arm, chain)
    directions, drives = parameter_directions(chain, factor, np.full(3, 2.0))
    assert len(directions) == 1
    assert drives[0, 2, 3] / directions[0, 2, 1] == pytest.approx(-20.0)


def window_of(rows, weights, capacity, past=0.5):
    window = info.new_window(rows.shape[1], 1, rows.shape[2] - 2, capacity)
    for k, row in enumerate(rows):
        info.join(window, float(k), row, past)
        info.add_products(window, 0, weights[k])
    return window


def test_window_sums_equal_direct_sums_and_what_leaves_it_is_remembered_as_told():
    rng = np.random.default_rng(0)
    rows, weights = rng.normal(size=(30, 2, 4)), rng.uniform(1.0, 2.0, (30, 2))
    window = window_of(rows, weights, 10)
    for last in (1, 5, 10):
        direct = np.einsum('kia,ki,kib->ab', rows[-last:], weights[-last:], rows[-last:])
        np.testing.assert_allclose(info.products(window, last), direct[[0, 2, 3]], atol=1e-10)
    window = window_of(np.ones((5, 1, 3)), np.ones((5, 1)), 3)
    np.testing.assert_allclose(window.past, 1.5 * np.ones((2, 3)))
    info.join(window, 5.0, np.ones((1, 3)), -0.5)
    np.testing.assert_allclose(window.past, 0.75 * np.ones((2, 3)))


def test_drifts_that_count_from_a_later_moment_are_the_same_drifts():
    rng = np.random.default_rng(1)
    rows, weights = rng.normal(size=(8, 1, 3)), np.ones((8, 1))
    later = rows.copy()
    later[:, :, 1] -= 2.0 * rows[:, :, 2]
    one, other = window_of(rows, weights, 5), window_of(later, weights, 5)
    info.move_drifts(one, 1, 2, 1, 2.0)
    np.testing.assert_allclose(info.products(one, 3), info.products(other, 3), atol=1e-12)
    squares = [
        w.squares[info.sum_slot(w, 0)] - w.squares[info.sum_slot(w, 4)] for w in (one, other)
    ]
    np.testing.assert_allclose(*squares, atol=1e-12)


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


def test_residuals_alone_are_those_of_the_whole_balance_and_reversals_are_told(blocks):
    balance = balances.new_balance(CHAIN, np.zeros((0, 3, 10)), np.ones(3))
    alone = balances.residuals(balance, blocks, PER_INTERVAL, CHAIN.friction)
    np.testing.assert_array_equal(alone, rows_of(CHAIN, blocks)[:, :, 0])
    own, rows = blocks[: 2 * PER_INTERVAL].copy(), np.empty((1, *balance.rows.shape))
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
        info.join(window, 0.05 * k, rows, -1.0)
        window.rest[info.slot(window, 0)] = rest
    learn_noise(window, null)
    np.testing.assert_allclose(null.rest, 4.0, rtol=0.3)
    np.testing.assert_allclose(null.noise, null.expected, rtol=0.3)


@pytest.mark.parametrize(('unit', 'known'), [('N m', 0.0), ('A', 0.04)])
def test_given_currents_then_gains_of_drives_may_be_wrong_as_masses_may(unit, known):
    arm = replace(shoulder_arm(), effort_unit=unit, uncertainty=Uncertainty(0.0, 0.0, 0.04))
    gains = parameter_factor(arm, compile_chain(arm))[:, 42:]
    assert np.abs(gains).max(0) == pytest.approx(np.full(3, known))
