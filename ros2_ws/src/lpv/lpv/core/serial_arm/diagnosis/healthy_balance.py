"""What a momentum balance of a healthy arm may leave, compiled: once a balance, not once a sample.

The same hat function as in `balance`, at the readings themselves: a healthy arm's positions are
what its encoders read.  A balance gives

    r = sum_k z_k E_k + (noise) + (what blocks of some samples do not show),    abs(z_k) <= 1,

with the residual r of the nominal parameters and the effect E_k of every generator.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import (
    COULOMB,
    LOAD,
    OFFSET,
    SLOPE,
    VISCOUS,
    Chain,
    FloatArray,
    workspace,
)
from lpv.core.serial_arm.description import SIGMAS
from lpv.core.serial_arm.diagnosis.balance import OFFSET as _READING
from lpv.core.serial_arm.diagnosis.balance import RATE
from lpv.core.serial_arm.diagnosis.hat import Hat, close_hat, new_hat, put
from lpv.core.serial_arm.diagnosis.parameter_set import ParameterSet, heaviest
from lpv.core.serial_arm.dynamics.friction import acting_share, smooth_sign
from lpv.core.serial_arm.dynamics.momentum import mass_matrix
from lpv.core.serial_arm.dynamics.regressor import momentum_regressor
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.inequalities import SAME
from lpv.core.support.jit import njit_in_place as njit

RESIDUAL, SPEED, VISCOSITY, DRY, LOADED, ONE, TORQUE, SLACK, VARIANCE = range(9)
"""Columns of the parts that concern one joint each; the last two, what blocks hide [N m s] and the
variance of the noise in friction [N2 m2 s2], with the sign of a force."""
_PARTS = VARIANCE + 1
_STEP = 1e-4
"""Of differences by a reading [rad]."""
_HELD = 0.9
"""Share of the largest bend of a torque that counts an interval later: half after seven."""


class HealthyBalance(NamedTuple):
    """Balances of a healthy arm."""

    chain: Chain  # the nominal arm
    heaviest: Chain  # of the set: noise is at most as that of its momenta
    sizes: ParameterSet  # what may differ
    hat: Hat  # of 10 n + 9 columns: the regressor, then parts of one joint
    last: FloatArray  # (3, n) means q, v and net force of the block before
    # (2, n) last change of the mean torques from one interval to the next, and its own, as held
    bent: FloatArray
    first: FloatArray  # (n, 10 n) scratch: regressor
    second: FloatArray  # (n, 10 n) scratch: regressor
    work: FloatArray  # scratch: workspace
    matrix: FloatArray  # (n, n) scratch: M
    heavy: FloatArray  # (n, n) M of the heaviest arm
    heavier: FloatArray  # (n,) its diagonal over that of the nominal arm
    turned: FloatArray  # (n, n) change of its momenta by that of a reading
    to_joints: FloatArray  # (n, n) S^-1 of y = S q + f
    scale: FloatArray  # (n,) of joints, what counts as 1 rad
    rate_noise: FloatArray  # (n,) standard deviation of mean joint rates of a block [rad/s]
    reading: FloatArray  # (n,) of mean readings of an interval [rad]
    motion: FloatArray  # (2, n) scratch: joint positions and rates


def new_healthy_balance(
    chain: Chain, sizes: ParameterSet, to_joints: FloatArray, scale: FloatArray,
    rate_noise: FloatArray, reading: FloatArray,
) -> HealthyBalance:  # fmt: skip
    """Balances without samples."""
    n = len(chain.translation)
    return HealthyBalance(
        chain, heaviest(chain, sizes), sizes, new_hat(n, 10 * n + _PARTS), np.full((3, n), np.inf),
        np.zeros((2, n)), np.zeros((n, 10 * n)), np.zeros((n, 10 * n)), workspace(chain),
        np.zeros((n, n)), np.zeros((n, n)), np.ones(n), np.zeros((n, n)), to_joints, scale,
        rate_noise, reading, np.zeros((2, n)))  # fmt: skip


def generator_count(sizes: ParameterSet) -> int:
    """Columns of the effects: inertial, rotor, viscous, Coulomb, load, offset, delay, rate bias."""
    return len(sizes.inertial) + 7 * len(sizes.rotor)


@njit
def add_healthy_interval(
    balance: HealthyBalance, blocks: FloatArray, lost: FloatArray, rows: FloatArray,
    effects: FloatArray, doubts: FloatArray,
) -> None:  # fmt: skip
    """Add the blocks of an interval; with one before it, write what its balance may leave.

    ``blocks`` and ``lost`` are as those of `Sampler`, ``rows`` those of the same `Balance`.

    Written are ``effects``, shape (n, 1 + k): the residual, then the effect of each generator, see
    `generator_count`; and ``doubts``, shape (3, n): slack [N m s], the variance of noise except
    that of the mean rates [N2 m2 s2], and the slack of how late torques bend.
    """
    n, row, span = effects.shape[0], balance.hat.rows, 10 * effects.shape[0]
    length, reading = 0.0, balance.reading
    for k in range(blocks.shape[0]):
        length += blocks[k, 3 * n + 1]
    for k in range(blocks.shape[0]):
        _add_block(balance, blocks[k], lost[k], blocks[k, 3 * n + 1] / length)
    _weigh_heaviest(balance)
    if close_hat(balance.hat, length):
        sizes, count = balance.sizes, balance.sizes.inertial.shape[0]
        effects[:, 1 + count :] = 0.0
        for i in range(n):
            effects[i, 0] = row[i, span + RESIDUAL]
            for k in range(count):
                total, first = 0.0, 10 * sizes.body[k]
                for c in range(10):
                    total += row[i, first + c] * sizes.inertial[k, c]
                effects[i, 1 + k] = -total
            at = 1 + count + i
            for j in range(max(i - 1, 0), min(i + 2, n)):  # a rotor with its coupling
                effects[i, 1 + count + max(i, j)] -= sizes.rotor[i, j] * row[j, span + SPEED]
            effects[i, at + n] = sizes.viscous[i] * row[i, span + VISCOSITY]
            effects[i, at + 2 * n] = sizes.coulomb[i] * row[i, span + DRY]
            effects[i, at + 3 * n] = sizes.load[i] * row[i, span + LOADED]
            effects[i, at + 4 * n] = sizes.offset[i] * row[i, span + ONE]
            change = row[i, span + TORQUE]
            effects[i, at + 5 * n] = sizes.delay[0, i] * change
            balance.bent[1, i] = max(abs(change - balance.bent[0, i]), _HELD * balance.bent[1, i])
            balance.bent[0, i] = change
            doubts[0, i], doubts[1, i] = -row[i, span + SLACK], -row[i, span + VARIANCE]
            doubts[2, i] = sizes.delay[1, i] / length * balance.bent[1, i]
            for j in range(n):
                bias = sizes.rate_bias[j] * rows[i, 1 + RATE * n + j]
                effects[i, 1 + count + 6 * n + j] = -bias
                effect = balance.heavier[i] * abs(rows[i, 1 + _READING * n + j])
                doubts[0, i] += sizes.rounding[j] * effect
                # Noise of one of the two mean momenta is not that of the other.
                both = effect * effect + 2.0 * balance.turned[i, j] * balance.turned[i, j]
                doubts[1, i] += reading[j] * reading[j] * both


@njit
def _add_block(balance: HealthyBalance, block: FloatArray, lost: FloatArray, part: float) -> None:
    """Add the means of some samples, which are that part of the current interval."""
    rate_noise = balance.rate_noise
    n = rate_noise.shape[0]
    chain, q, v, hat = balance.chain, balance.motion[0], balance.motion[1], balance.hat
    map_vector(balance.to_joints, block[:n], q)
    map_vector(balance.to_joints, block[n : 2 * n], v)
    torque, length, place = block[2 * n : 3 * n], block[3 * n + 1], block[3 * n + 2]
    weight = length, place
    momentum_regressor(chain, q, v, balance.work, balance.first, balance.second)
    mass_matrix(chain, q, balance.work, balance.matrix)
    span, began = 10 * n, balance.last[0, 0] != np.inf
    turn = 0.0
    if began:
        for i in range(n):
            turn += abs(q[i] - balance.last[0, i]) / balance.scale[i]
    for i in range(n):
        row = chain.friction[i]
        slope = row[SLOPE]
        sign = smooth_sign(v[i], slope)
        left = torque[i] - row[VISCOUS] * v[i] - row[COULOMB] * sign - row[OFFSET]
        acts = acting_share(row, left, sign)
        load, p, force = abs(acts * left), 0.0, acts * left
        dry = row[COULOMB] + row[LOAD] * load
        for a in range(n):
            p += chain.motor[i, a] * v[a]
            for k in range(10):
                c = 10 * a + k
                momentum, effect = balance.first[i, c], balance.second[i, c]
                p += momentum * chain.inertial[a, k]
                force += effect * chain.inertial[a, k]
                put(hat, c, i, (momentum, effect), weight)
        put(hat, span + RESIDUAL, i, (p, force), weight)
        put(hat, span + SPEED, i, (v[i], 0.0), weight)
        put(hat, span + VISCOSITY, i, (0.0, acts * v[i]), weight)
        put(hat, span + DRY, i, (0.0, acts * sign), weight)
        put(hat, span + LOADED, i, (0.0, acts * load * sign), weight)
        put(hat, span + ONE, i, (0.0, acts), weight)
        put(hat, span + TORQUE, i, (torque[i], 0.0), weight)
        half, even, sizes = 0.0, 0.0, balance.sizes
        if began:
            half = 0.5 * abs(v[i] - balance.last[1, i])
            even = part * length * abs(force - balance.last[2, i]) / 8.0
            for a in range(n):
                change = abs(balance.matrix[i, a] * (v[a] - balance.last[1, a]))
                even += part * turn * change / 12.0
            even *= balance.heavier[i]
        doubt = half + SIGMAS * rate_noise[i]
        slowest, fastest = max(abs(v[i]) - doubt, 0.0), abs(v[i]) + doubt
        missed = tolerated(sizes.tolerance[i], slowest, fastest)
        own = sizes.viscous[i] * abs(v[i]) + sizes.coulomb[i] * abs(sign) + sizes.offset[i]
        product = _loaded_twice(row, sizes.load[i], (left, sign, acts), own + missed)
        uneven = most_dry = dry + sizes.coulomb[i] + sizes.load[i] * load
        if uneven != 0.0:
            uneven *= _within(v[i], half, slope)
        if slowest == 0.0:  # it may rest, friction may be anything
            share = row[LOAD] + sizes.load[i]
            most = row[COULOMB] + sizes.coulomb[i] + share * abs(torque[i])
            uneven = max(uneven, most / max(1.0 - share, SAME) + dry * abs(sign))
        missed = length * (uneven + product + max(acts, 1.0) * missed)
        hides = max(acts, 1.0) * lost[i]  # anywhere in the block
        bend = most_dry * slope * (2.0 / np.pi) / (1.0 + (slope * v[i]) ** 2)
        bend += row[VISCOUS] + sizes.viscous[i]
        noise = (length * bend * rate_noise[i]) ** 2
        slack, rest, rising, falling = span + SLACK, 1.0 - place, hat.rising[1, i], hat.falling[i]
        rising[slack] += place * missed + even + (place + 0.5 * part) * hides
        falling[slack] += rest * missed + even + (rest + 0.5 * part) * hides
        rising[span + VARIANCE] += place * place * noise
        falling[span + VARIANCE] += rest * rest * noise
        balance.last[2, i] = force
    for i in range(n):
        balance.last[0, i], balance.last[1, i] = q[i], v[i]


@njit
def tolerated(points: FloatArray, slowest: float, fastest: float) -> float:
    """Largest torque between two speeds, by points (2, s) between which it is linear [N m]."""
    last = points.shape[1] - 1
    largest = points[1, 0] if slowest <= points[0, 0] else 0.0
    if fastest >= points[0, last]:
        largest = max(largest, points[1, last])
    for k in range(last):
        width = points[0, k + 1] - points[0, k]
        low, high = max(slowest, points[0, k]), min(fastest, points[0, k + 1])
        if low <= high and width > 0.0:
            for speed in (low, high):
                rise = (points[1, k + 1] - points[1, k]) * (speed - points[0, k]) / width
                largest = max(largest, points[1, k] + rise)
    return float(largest)


@njit
def _loaded_twice(
    row: FloatArray, more: float, drive: tuple[float, float, float], other: float
) -> float:
    """What the effects of friction miss, where it grows with the load that it changes [N m].

    A gear carries rho, the drive left = (1 + (L + d) s sgn rho) rho + delta, with the error d of L
    and delta of all else, abs(d) <= ``more``, abs(delta) <= ``other``.  Effects are those of the
    load rho^ = a left of the nominal arm.  ``drive`` has left, s and a.
    """
    left, sign, acts = drive
    size, share = abs(sign), acts * abs(sign) * more
    if row[LOAD] + more == 0.0:
        return 0.0
    # rho^ - rho = a (d s sgn(rho) rho + delta), of which the first part was taken of rho^.
    result = share * acts * (size * more * acts * abs(left) + other) / max(1.0 - share, SAME)
    if abs(left) <= other:  # the gear may carry a load of the other sign
        largest = other / max(1.0 - (row[LOAD] + more) * size, SAME)
        opposed = (2.0 * row[LOAD] + more) * largest + more * acts * other
        result = max(result, acts * size * opposed)
    return float(result)


@njit
def _within(rate: float, half: float, slope: float) -> float:
    """What the mean of the smoothed sign over rates v +- half misses, at most."""
    ends = smooth_sign(rate + half, slope) + smooth_sign(rate - half, slope)
    return abs(0.5 * ends - smooth_sign(rate, slope))


@njit
def _weigh_heaviest(balance: HealthyBalance) -> None:
    """Renew what concerns the heaviest arm, at the pose and rates of the last block."""
    n, (q, v), to_joints = balance.heavier.shape[0], balance.motion, balance.to_joints
    mass_matrix(balance.heaviest, q, balance.work, balance.heavy)
    for i in range(n):
        own = max(balance.matrix[i, i], SAME)
        balance.heavier[i] = max(balance.heavy[i, i] / own, 1.0)
    for j in range(n):
        for k in range(n):
            q[k] += _STEP * to_joints[k, j]
        mass_matrix(balance.heaviest, q, balance.work, balance.matrix)
        for i in range(n):
            q[i] -= _STEP * to_joints[i, j]
            balance.turned[i, j] = 0.0
            for k in range(n):
                change = balance.matrix[i, k] - balance.heavy[i, k]
                balance.turned[i, j] += change * v[k] / _STEP
