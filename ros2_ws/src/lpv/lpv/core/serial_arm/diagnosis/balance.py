"""Momentum balances over short intervals, with their derivatives by faults and parameters.

With a hat function w over two intervals of length T, the balance p' = tau - F + C^T v - g becomes

    r = mean(p, 2nd interval) - mean(p, 1st interval) - int w (tau - F + C^T v - g) dt,

which needs no acceleration and averages the noise of the rates.  q = y - f, so that r depends on
the faults; it is linear in all parameters.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import SLOPE, Chain, FloatArray, joint_count, workspace
from lpv.core.serial_arm.description import JointFriction
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.hat import Hat, close_hat, drop_hat, new_hat, put
from lpv.core.serial_arm.dynamics.friction import drive_friction, smooth_sign
from lpv.core.serial_arm.dynamics.momentum import carried_momentum, momentum_balance, set_velocities
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place

READINGS_AT_EDGES = 6.0
"""How many times the variance of a reading is in a balance's change of a derived rate, over the
interval squared: readings where its two intervals begin and end count once, twice and once."""
GROUPS = ('drift', 'scale', 'rate', 'gain', 'offset', 'torque', 'viscous', 'coulomb')
"""Groups of n columns each, in this order; those of the inertial directions follow.  The unknowns
of a healthy arm are the columns from `OFFSET` on."""
DRIFT, SCALE, RATE, GAIN, OFFSET, TORQUE, VISCOUS, COULOMB = range(8)
VISCOUS_PART, COULOMB_PART, LOAD_PART, OFFSET_PART, GAIN_PART, DELAY_PART = range(6)
"""Columns of `Balance.drives`: those of `Chain.friction`, the gain, and the efforts' delay."""
_STEEPEST = JointFriction.coulomb_slope
"""Slope of the sign of a rate, at most: files that state none have it [s/rad]."""
_STEP = 1e-5
"""Step of the differences by which columns of angles and rates are found [rad], [rad/s], times
`Balance.scale`: these are wrong by 1e-5 of themselves, and by rounding, 1e-16 / 1e-5, by less."""


class Balance(NamedTuple):
    """State of the balances of one arm.

    Columns are the residual first, then those of `GROUPS` and of the inertial directions.

    Attributes
    ----------
    chain : Chain
        The arm.
    directions : ndarray, shape (k, n, 10)
        Directions in which the inertial parameters may be wrong, each of unit weight.
    reference : ndarray, shape (n,)
        Faults f at which the balance is linearised [rad].
    derived : ndarray, shape (n,)
        1 where a rate comes from its encoder, so that a drift and a scale error enter both.
    hat : Hat
        Its rows are residual and derivatives.
    epoch : ndarray, shape (1,)
        Moment from which drifts count [s].
    poses : ndarray, shape (2, n)
        Joint positions at the ends of the previous and of the current interval [rad].
    rates : ndarray, shape (3, 2, n)
        Lowest and highest joint rates of both intervals of the last hat, and of the current one
        [rad/s].
    rigid : ndarray, shape (n, n)
        Zero: directions of the inertial parameters have no rotors.
    work, vectors : ndarray
        Scratch.
    drives : ndarray, shape (k, n, 6)
        What belongs to ``directions`` of viscous, Coulomb, load-dependent friction, offset,
        relative gain and delay of the efforts.
    to_joints : ndarray, shape (n, n)
        S^-1 of y = S q + f: faults are those of sensors, rows those of joints.
    scale : ndarray, shape (n,)
        What counts as much as 1 rad, see `SerialJoint.scale` [rad].
    """

    chain: Chain
    directions: FloatArray
    reference: FloatArray
    derived: FloatArray
    hat: Hat
    epoch: FloatArray
    poses: FloatArray
    rates: FloatArray
    rigid: FloatArray
    work: FloatArray
    vectors: FloatArray
    drives: FloatArray
    to_joints: FloatArray
    scale: FloatArray


def new_balance(
    chain: Chain,
    directions: FloatArray,
    derived: FloatArray,
    drives: FloatArray,
    to_joints: FloatArray,
    scale: FloatArray,
) -> Balance:
    """Empty balances, linearised at no fault; arguments are as in `Balance`."""
    n = joint_count(chain)
    columns = 1 + len(GROUPS) * n + len(directions)
    return Balance(
        chain, np.ascontiguousarray(directions, dtype=float), np.zeros(n),
        np.ascontiguousarray(derived, dtype=float),
        new_hat(n, columns), np.zeros(1), np.zeros((2, n)),
        np.tile([[np.inf], [-np.inf]], (3, 1, n)),
        np.zeros((n, n)), workspace(chain), np.zeros((10, n)), drives,
        np.ascontiguousarray(to_joints), scale)  # fmt: skip


@njit_in_place
def add_residual(
    balance: Balance, y: FloatArray, v: FloatArray, torque: FloatArray, weight: tuple[float, float]
) -> None:
    """Add the residual of a block to the current interval, without derivatives."""
    angle, rate = balance.vectors[0], balance.vectors[1]
    p, force, friction = balance.vectors[2], balance.vectors[3], balance.vectors[6]
    for i in range(y.shape[0]):
        friction[i] = y[i] - balance.reference[i]
    map_vector(balance.to_joints, friction, angle)
    map_vector(balance.to_joints, v, rate)
    momentum_balance(balance.chain, angle, rate, balance.work, p, force)
    drive_friction(balance.chain, rate, torque, friction)
    for i in range(y.shape[0]):
        put(balance.hat, 0, i, (p[i], force[i] + torque[i] - friction[i]), weight)


@njit_in_place
def add_block(
    balance: Balance,
    y: FloatArray,
    v: FloatArray,
    torque: FloatArray,
    time: float,
    length: float,
    place: float,
) -> None:
    """Add the means of some samples to the current interval.

    ``y``, ``v`` and ``torque`` are as measured [rad], [rad/s], [N m].  ``time`` [s] and ``place``,
    0 to 1 in the interval, are those of the block's middle; ``length`` is the block's [s].
    """
    chain, n = balance.chain, y.shape[0]
    weight = (length, place)
    angle, rate = balance.vectors[0], balance.vectors[1]
    p_by, force_by = balance.vectors[4], balance.vectors[5]
    add_residual(balance, y, v, torque, weight)
    for i in range(n):
        balance.rates[2, 0, i] = min(balance.rates[2, 0, i], rate[i])
        balance.rates[2, 1, i] = max(balance.rates[2, 1, i], rate[i])
        row = 1 + i
        put(balance.hat, row + TORQUE * n, i, (0.0, -1.0), weight)
        put(balance.hat, row + VISCOUS * n, i, (0.0, -rate[i]), weight)
        put(balance.hat, row + COULOMB * n, i,
             (0.0, -smooth_sign(rate[i], chain.friction[i, SLOPE])), weight)  # fmt: skip
        put(balance.hat, row + GAIN * n, i, (0.0, torque[i]), weight)
    for i in range(n):
        reading = y[i] - balance.reference[i], v[i]
        _add_fault_columns(balance, i, reading, torque, time - balance.epoch[0], weight)
    set_velocities(chain, angle, rate, balance.work)
    for k in range(balance.directions.shape[0]):
        carried_momentum(
            chain, balance.directions[k], balance.rigid, rate, balance.work, p_by, force_by
        )
        for j in range(n):
            column, part = 1 + 8 * n + k, balance.drives[k, j]
            dry = part[COULOMB_PART] + part[LOAD_PART] * abs(torque[j])
            lost = part[VISCOUS_PART] * rate[j] + part[OFFSET_PART]
            lost -= part[GAIN_PART] * torque[j]
            if dry != 0.0:
                lost += dry * smooth_sign(rate[j], chain.friction[j, SLOPE])
            late = part[DELAY_PART] * torque[j]
            put(balance.hat, column, j, (p_by[j] - late, force_by[j] - lost), weight)


@njit_in_place
def _add_fault_columns(
    balance: Balance,
    i: int,
    reading: tuple[float, float],
    torque: FloatArray,
    time: float,
    weight: tuple[float, float],
) -> None:
    """Add the columns of the faults of sensor i, by differences; time since the epoch.

    ``reading`` is that of the sensor without its fault, with its rate.
    """
    chain, n = balance.chain, torque.shape[0]
    angle, rate = balance.vectors[0], balance.vectors[1]
    p, force = balance.vectors[2], balance.vectors[3]
    p_angle, force_angle = balance.vectors[4], balance.vectors[5]
    p_rate, force_rate = balance.vectors[7], balance.vectors[8]
    moved, share, step = balance.vectors[9], balance.to_joints[:, i], _STEP * balance.scale[i]
    for j in range(n):
        moved[j] = angle[j] - step * share[j]
    momentum_balance(chain, moved, rate, balance.work, p_angle, force_angle)
    for j in range(n):
        moved[j] = rate[j] - step * share[j]
    momentum_balance(chain, angle, moved, balance.work, p_rate, force_rate)
    derived = balance.derived[i]
    for j in range(n):
        p_f, force_f = (p_angle[j] - p[j]) / step, (force_angle[j] - force[j]) / step
        p_v, force_v = (p_rate[j] - p[j]) / step, (force_rate[j] - force[j]) / step
        if share[j] != 0.0:
            row = chain.friction[j]
            slip = min(row[SLOPE], _STEEPEST / balance.scale[j])
            bend = dry = row[1] + row[2] * abs(torque[j])
            if dry != 0.0:
                before = smooth_sign(rate[j] - 0.5 / slip, slip)
                bend *= (smooth_sign(rate[j] + 0.5 / slip, slip) - before) * slip
            force_v += share[j] * (row[0] + bend)
        put(balance.hat, 1 + OFFSET * n + i, j, (p_f, force_f), weight)
        put(balance.hat, 1 + RATE * n + i, j, (p_v, force_v), weight)
        drift = (time * p_f + derived * p_v, time * force_f + derived * force_v)
        put(balance.hat, 1 + DRIFT * n + i, j, drift, weight)
        scale = (
            reading[0] * p_f + derived * reading[1] * p_v,
            reading[0] * force_f + derived * reading[1] * force_v,
        )
        put(balance.hat, 1 + SCALE * n + i, j, scale, weight)


@njit_in_place
def noise_products(
    balance: Balance, sensor: int, variance: float, mixing: FloatArray, products: FloatArray
) -> None:
    """Write the mean that noise of a sensor's rate gives to unknowns' columns times the residual.

    Noise changes the momenta in both.  ``variance`` is that of the change of the mean rate between
    the two intervals of the last hat [rad2/s2]; rows are L r with ``mixing`` L, shape (n, n);
    ``products`` have shape (n, m).
    """
    chain, n, q = balance.chain, balance.reference.shape[0], balance.poses[0]
    rate, p, force = balance.vectors[1], balance.vectors[2], balance.vectors[3]
    by, moved = balance.vectors[4], balance.vectors[9]
    for j in range(n):
        rate[j] = balance.to_joints[j, sensor]
    momentum_balance(chain, q, rate, balance.work, p, force)
    map_vector(mixing, p, force)
    for j in range(n):
        p[j] = force[j]
    products[:] = 0.0
    for i in range(n):
        step = _STEP * balance.scale[i]
        for j in range(n):
            moved[j] = q[j] - step * balance.to_joints[j, i]
        momentum_balance(chain, moved, rate, balance.work, by, force)
        map_vector(mixing, by, force)
        for j in range(n):
            products[j, i] = variance * p[j] * (force[j] - p[j]) / step
    set_velocities(chain, q, rate, balance.work)
    first = products.shape[1] - balance.directions.shape[0]
    for k in range(balance.directions.shape[0]):
        carried_momentum(chain, balance.directions[k], balance.rigid, rate, balance.work, by, force)
        map_vector(mixing, by, force)
        for j in range(n):
            products[j, first + k] = variance * p[j] * force[j]


@njit_in_place
def close_interval(balance: Balance, length: float) -> bool:
    """End the current interval, which becomes the previous one; true if a hat is complete.

    Then ``hat.rows`` of the balance hold the residual and its derivatives.  ``length`` is the
    interval's [s].
    """
    for i in range(balance.reference.shape[0]):
        balance.poses[0, i] = balance.poses[1, i]
        balance.poses[1, i] = balance.vectors[0, i]
        for side in range(2):
            balance.rates[0, side, i] = balance.rates[1, side, i]
            balance.rates[1, side, i] = balance.rates[2, side, i]
        balance.rates[2, 0, i], balance.rates[2, 1, i] = np.inf, -np.inf
    return close_hat(balance.hat, length)


@njit_in_place
def rests(balance: Balance, joint: int) -> bool:
    """Whether a joint rests or reverses within the last hat."""
    low = min(balance.rates[0, 0, joint], balance.rates[1, 0, joint])
    high = max(balance.rates[0, 1, joint], balance.rates[1, 1, joint])
    slow = priors.SLOW_RATE * balance.scale[joint]
    return bool(low < slow and high > -slow)


@njit_in_place
def move_epoch(balance: Balance, epoch: float) -> None:
    """Let drifts count from another moment; what has been integrated follows."""
    n, shift, hat = balance.reference.shape[0], epoch - balance.epoch[0], balance.hat
    for part in (hat.momentum[0], hat.momentum[1], hat.rising[0], hat.rising[1], hat.falling):
        for i in range(n):
            for j in range(n):
                part[i, 1 + DRIFT * n + j] -= shift * part[i, 1 + OFFSET * n + j]
    balance.epoch[0] = epoch


@njit_in_place
def drop_interval(balance: Balance) -> None:
    """Forget the intervals so far, after a gap in the samples."""
    drop_hat(balance.hat)
    balance.rates[:, 0] = np.inf
    balance.rates[:, 1] = -np.inf


def scratch_of(balance: Balance) -> Balance:
    """A balance of the same arm at the same point, with intervals and scratch of its own."""
    own = ('epoch', 'poses', 'rates', 'work', 'vectors')
    copies = {name: getattr(balance, name).copy() for name in own}
    return balance._replace(hat=new_hat(*balance.hat.rows.shape), **copies)


@njit_in_place
def fill_balances(
    balance: Balance, blocks: FloatArray, per_interval: int, rows: FloatArray
) -> None:
    """Balances of blocks that were kept; the state of the balance is that after the last block.

    ``blocks``, shape (N, 3 n + 4), hold means y, v, tau with time, length and place of each block,
    for whole intervals.  ``rows``, shape (N / per_interval - 1, n, columns), are written.
    """
    n = balance.reference.shape[0]
    drop_interval(balance)
    length, count = 0.0, 0
    for k in range(blocks.shape[0]):
        block = blocks[k]
        add_block(
            balance, block[:n], block[n : 2 * n], block[2 * n : 3 * n], block[3 * n],
            block[3 * n + 1], block[3 * n + 2])  # fmt: skip
        length += block[3 * n + 1]
        if (k + 1) % per_interval == 0:
            if close_interval(balance, length):
                for i in range(n):
                    for c in range(rows.shape[2]):
                        rows[count, i, c] = balance.hat.rows[i, c]
                count += 1
            length = 0.0
