"""Momentum balances and their derivatives; windows of least squares."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm
from simulated_runs import simulated_run

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import ParameterCovariance, Uncertainty
from lpv.core.serial_arm.diagnosis.balance import (
    COULOMB,
    GAIN,
    GROUPS,
    OFFSET,
    TORQUE,
    VISCOUS,
    fill_balances,
    new_balance,
    residuals,
    rests,
)
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan, OffsetEstimator, learn_noise
from lpv.core.serial_arm.diagnosis.information import (
    add_products,
    factorise,
    join,
    move_drifts,
    new_window,
    products,
    slot,
    solve_factorised,
    sum_slot,
    whiten,
)
from lpv.core.serial_arm.diagnosis.parameter_error import parameter_directions, parameter_factor

PER_BLOCK, PER_INTERVAL = 5, 5


@pytest.fixture(scope='module')
def blocks():
    """Means of a simulated run without noise."""
    samples = simulated_run(shoulder_arm('independent'), 1.0, seed=2, noise=False).samples
    rows = []
    for k in range((len(samples) - 1) // PER_BLOCK):
        part = slice(k * PER_BLOCK, (k + 1) * PER_BLOCK)
        mean = [samples[part, i].mean(0) for i in (0, 1)]
        efforts = samples[1:, 2][part].mean(0)  # the effort of a sample acted before it
        place = (k % PER_INTERVAL + 0.5) / PER_INTERVAL
        rows.append([*mean[0], *mean[1], *efforts, 0.01 * k, 0.01, place])
    return np.array(rows)[PER_INTERVAL : PER_INTERVAL * (len(rows) // PER_INTERVAL)]


@pytest.fixture(scope='module')
def chain():
    return compile_chain(shoulder_arm())


def rows_of(chain, blocks, directions=None, reference=(0.0, 0.0, 0.0), drives=None):
    directions = np.zeros((0, 3, 10)) if directions is None else directions
    balance = new_balance(chain, directions, np.ones(3), drives)
    balance.reference[:] = reference
    rows = np.empty((len(blocks) // PER_INTERVAL - 1, *balance.rows.shape))
    fill_balances(balance, blocks, PER_INTERVAL, rows)
    return rows


def column(rows, group, joint):
    return rows[:, :, 1 + 3 * group + joint]


def test_balance_of_the_true_arm_is_zero_and_columns_of_offsets_are_its_derivatives(chain, blocks):
    rows = rows_of(chain, blocks)
    assert np.abs(rows[:, :, 0]).max() < 2e-3 * np.abs(blocks[:, 6:9]).max() * 0.05
    for joint in range(3):
        step = 1e-4 * np.eye(3)[joint]
        ahead, behind = (rows_of(chain, blocks, reference=sign * step) for sign in (1, -1))
        expected = (ahead[:, :, 0] - behind[:, :, 0]) / 2e-4
        np.testing.assert_allclose(column(rows, OFFSET, joint), expected, atol=1e-3)


@pytest.mark.parametrize(
    ('group', 'field'), [(VISCOUS, 0), (COULOMB, 1), (TORQUE, 3), (GAIN, None)]
)
def test_columns_of_friction_and_of_torque_gains_are_exact(chain, blocks, group, field):
    friction, louder = chain.friction.copy(), blocks.copy()
    if group == GAIN:
        louder[:, 7] *= 1.2
    else:
        friction[1, field] += 0.2
    rows = rows_of(chain, blocks)
    change = rows_of(chain._replace(friction=friction), louder) - rows
    np.testing.assert_allclose(change[:, :, 0], 0.2 * column(rows, group, 1), atol=1e-12)


def test_columns_of_parameter_directions_are_exact(chain, blocks):
    factor = np.random.default_rng(0).normal(size=(5, 45))
    factor[:, 36:39] = 0.0  # friction by load would multiply gains
    directions, drives = parameter_directions(chain, factor, np.full(3, 2.0))
    rows = rows_of(chain, blocks, directions, drives=drives)
    friction, louder = chain.friction.copy(), blocks.copy()
    friction[:, :4] += 0.5 * drives[0, :, :4]
    louder[:, 6:9] *= 1.0 + 0.5 * drives[0, :, 4]
    moved = chain._replace(inertial=chain.inertial + 0.5 * directions[0], friction=friction)
    change = rows_of(moved, louder)[:, :, 0] - rows[:, :, 0]
    np.testing.assert_allclose(change, 0.5 * rows[:, :, 1 + 3 * len(GROUPS)], atol=1e-10)


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
    window = new_window(rows.shape[1], 1, rows.shape[2] - 2, capacity)
    for k, row in enumerate(rows):
        join(window, float(k), row, past)
        add_products(window, 0, weights[k])
    return window


def test_window_sums_equal_direct_sums():
    rng = np.random.default_rng(0)
    rows, weights = rng.normal(size=(30, 2, 4)), rng.uniform(1.0, 2.0, (30, 2))
    window = window_of(rows, weights, 10)
    for last in (1, 5, 10):
        direct = np.einsum('kia,ki,kib->ab', rows[-last:], weights[-last:], rows[-last:])
        np.testing.assert_allclose(products(window, last), direct[[0, 2, 3]], atol=1e-10)


def test_window_remembers_what_leaves_it_as_told():
    window = window_of(np.ones((5, 1, 3)), np.ones((5, 1)), 3)
    np.testing.assert_allclose(window.past, 1.5 * np.ones((2, 3)))
    join(window, 5.0, np.ones((1, 3)), -0.5)
    np.testing.assert_allclose(window.past, 0.75 * np.ones((2, 3)))


def test_drifts_that_count_from_a_later_moment_are_the_same_drifts():
    rng = np.random.default_rng(1)
    rows, weights = rng.normal(size=(8, 1, 3)), np.ones((8, 1))
    later = rows.copy()
    later[:, :, 1] -= 2.0 * rows[:, :, 2]
    one, other = window_of(rows, weights, 5), window_of(later, weights, 5)
    move_drifts(one, 1, 2, 1, 2.0)
    np.testing.assert_allclose(products(one, 3), products(other, 3), atol=1e-12)
    squares = [w.squares[sum_slot(w, 0)] - w.squares[sum_slot(w, 4)] for w in (one, other)]
    np.testing.assert_allclose(*squares, atol=1e-12)


def test_factor_solves_and_whitens():
    rows = np.random.default_rng(2).normal(size=(9, 5))
    matrix, right = rows.T @ rows, rows[0].copy()
    factor, expected = matrix.copy(), np.linalg.solve(matrix, right)
    factorise(factor, np.zeros(5))
    columns = right[:, None].copy()
    whiten(factor, columns)
    solve_factorised(factor, right)
    np.testing.assert_allclose(right, expected, rtol=1e-9)
    assert columns[:, 0] @ columns[:, 0] == pytest.approx(rows[0] @ expected)


def test_residuals_alone_are_those_of_the_whole_balance_and_reversals_are_told(chain, blocks):
    balance = new_balance(chain, np.zeros((0, 3, 10)), np.ones(3))
    alone = residuals(balance, blocks, PER_INTERVAL, chain.friction)
    np.testing.assert_array_equal(alone, rows_of(chain, blocks)[:, :, 0])
    own, rows = blocks[: 2 * PER_INTERVAL].copy(), np.empty((1, *balance.rows.shape))
    for rates, expected in ((1.0, False), (np.linspace(-1.0, 1.0, len(own))[:, None], True)):
        own[:, 3:6] = rates
        fill_balances(balance, own, PER_INTERVAL, rows)
        assert rests(balance, 1) is expected


def test_given_residuals_that_are_larger_at_rest_then_noise_in_motion_stays_small():
    arm, rng = shoulder_arm(), np.random.default_rng(0)
    estimator = OffsetEstimator(arm, HorizonPlan.of(arm.sample_time))
    window, null = estimator.window, estimator.posterior
    for k in range(200):
        rows, rest = np.zeros(window.rows.shape[1:]), k % 2
        rows[:, 0] = (4.0 if rest else 1.0) * null.expected * rng.normal(size=3)
        join(window, 0.05 * k, rows, -1.0)
        window.rest[slot(window, 0)] = rest
    learn_noise(window, null)
    np.testing.assert_allclose(null.rest, 4.0, rtol=0.3)
    np.testing.assert_allclose(null.noise, null.expected, rtol=0.3)


@pytest.mark.parametrize(('unit', 'known'), [('N m', 0.0), ('A', 0.04)])
def test_given_currents_then_gains_of_drives_may_be_wrong_as_masses_may(unit, known):
    arm = replace(shoulder_arm(), effort_unit=unit, uncertainty=Uncertainty(0.0, 0.0, 0.04))
    gains = parameter_factor(arm, compile_chain(arm))[:, 42:]
    assert np.abs(gains).max(0) == pytest.approx(np.full(3, known))
