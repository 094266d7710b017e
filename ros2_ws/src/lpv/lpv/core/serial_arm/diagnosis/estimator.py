"""Moving-horizon estimate of all sensor offsets and of what is not known of the arm.

Unknown are the offset f_i of each position sensor and, for the arm, torque offsets, viscous and
Coulomb friction, and the inertial parameters along their likely directions.  The balances of the
last seconds determine all of them together by least squares around the last estimate of f; where
that has moved, the horizon is linearised again.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import COULOMB as DRY
from lpv.core.serial_arm.chain import VISCOUS as WET
from lpv.core.serial_arm.chain import Chain, FloatArray, IntArray, compile_chain
from lpv.core.serial_arm.description import SIGMAS, UNSTATED_FRICTION, SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import (
    DELAY_PART,
    DRIFT,
    OFFSET,
    READINGS_AT_EDGES,
    Balance,
    fill_balances,
    move_epoch,
    new_balance,
    rests,
    scratch_of,
)
from lpv.core.serial_arm.diagnosis.information import (
    COUNT,
    NEXT,
    ROBUST,
    Posterior,
    Window,
    add_balances,
    add_products,
    factorise,
    join,
    move_drifts,
    new_window,
    recent,
    slot,
    solve_factorised,
    whiten,
)
from lpv.core.serial_arm.diagnosis.parameter_error import (
    LOAD_ROWS,
    balance_noise,
    change_noise,
    model_error,
    parameter_directions,
    parameter_factor,
    typical_torque,
    usual_load,
)
from lpv.core.serial_arm.diagnosis.row_noise import (
    FEW,
    LAGS,
    NOISE_SAMPLES,
    UNMEASURED,
    RowNoise,
    decorrelate,
    is_due,
    learn_covariance,
    learn_noise,
    new_row_noise,
    usual_size,
)
from lpv.core.support.jit import Entries, njit_in_place
from lpv.core.support.limits import SMALL

INTERVAL = 0.05
"""Between decisions, about [s]."""
STRAIGHT = 0.3
"""Change of an angle in which balances are linear: sin(0.3) = 0.3 less 1.5 % [rad]."""
HORIZON = 10.0
"""Over which an arm's unknowns are estimated [s]."""
NOISE_KNOWN_AFTER = 3.0
"""Before, noise is learned in any case; what acts from outside is not told from it [s]."""
PAST_WEIGHT = 0.998
"""Factor of what was learned, each balance."""
ONSET = 2
"""Balances at the start of a window in which a cause may come in any way: they are explained by
free torques, for encoders as for contacts.  A jump is in the two balances that hold it."""
DISTRUST = 1e-4
"""Factor of the weights of balances while something acts from outside, which may be a hundred times
what the model misses."""


@dataclass(frozen=True)
class HorizonPlan:
    """How samples become balances, and how many are kept."""

    per_block: int  # samples whose mean enters the dynamics
    blocks: int  # of an interval; two neighbouring intervals make a balance
    interval: float  # [s]
    capacity: int  # balances of the horizon

    @staticmethod
    def of(sample_time: float) -> 'HorizonPlan':
        """Plan for a sample time: blocks of about 10 ms, intervals of at least two samples."""
        per_block = max(1, round(0.01 / sample_time))
        blocks = max(2, round(INTERVAL / (per_block * sample_time)))
        length = per_block * blocks * sample_time
        return HorizonPlan(per_block, blocks, length, max(NOISE_SAMPLES, round(HORIZON / length)))

    @property
    def per_interval(self) -> int:
        """Samples of an interval."""
        return self.per_block * self.blocks


class Horizon(NamedTuple):
    """The balances of the horizon and what is estimated from them."""

    balance: Balance  # that is being filled
    window: Window
    null: Posterior
    level: Posterior  # the same for levels; its sums have no columns of faults
    since: IntArray  # (1,) balances since all were linearised
    noise: RowNoise


@njit_in_place
def set_residuals(window: Window, null: Posterior, last: int) -> None:
    """Write what the estimate leaves of the last balances, newest first."""
    m = null.mean.shape[0]
    for back in range(last):
        rows = window.rows[slot(window, back)]
        first = rows.shape[1] - m
        for i in range(rows.shape[0]):
            # Four sums: a single one would wait for each addition.
            a, b, c, d = rows[i, 0], 0.0, 0.0, 0.0
            row = rows[i, first:]
            for k in range(0, m - 3, 4):
                a += row[k] * null.mean[k]
                b += row[k + 1] * null.mean[k + 1]
                c += row[k + 2] * null.mean[k + 2]
                d += row[k + 3] * null.mean[k + 3]
            for k in range(m - m % 4, m):
                a += row[k] * null.mean[k]
            null.residual[back, i] = (a + b) + (c + d)


@njit_in_place
def weigh(window: Window, null: Posterior, last: int) -> None:
    """Sum up the last balances again, outliers with less weight (soft L1)."""
    set_residuals(window, null, last)
    for back in range(last - 1, -1, -1):
        at = slot(window, back)
        for i in range(null.noise.shape[0]):
            size = usual_size(window, null, back, i)
            moving = null.noise[i] * window.relative[at, i]
            ratio = null.residual[back, i] / (ROBUST * size)
            lasting = max(null.inflation[i], null.lasting[at, i])
            variance = moving * moving * null.inflation[i]
            variance += (size * size - moving * moving) * lasting
            variance += window.extra[at, i] + window.late[at, i]
            weight = 1.0 / (variance * np.sqrt(1.0 + ratio * ratio))
            null.weights[at, i] = weight * window.trust[at]
        add_products(window, null, back)


@njit_in_place
def recall(null: Posterior) -> None:
    """What is remembered of the arm: offsets may have been others then, and are eliminated.

    A slow drift of an encoder would be learned, else, as an offset that has always been there.
    """
    m, n, known, past = null.mean.shape[0], null.sigma.shape[0], null.recalled, null.past
    first = past.shape[1] - m
    for a in range(1 + m):
        for b in range(m):
            known[a, b] = past[a, first + b]
    for k in range(n):
        row = known[1 + k]
        pivot = row[k] + null.least[k]
        for a in range(m + 1):
            share = known[a, k] / pivot
            if a == 1 + k or share == 0.0:
                continue
            for b in range(k + 1, m):
                known[a, b] -= share * row[b]
    known[1 : 1 + n] = 0.0
    known[:, :n] = 0.0


@njit_in_place
def solve(window: Window, null: Posterior) -> None:
    """Least squares over horizon, past and prior."""
    m, n = null.mean.shape[0], null.sigma.shape[0]
    recall(null)
    for a in range(1 + m):
        for b in range(m):
            null.total[a, b] = null.recalled[a, b]
    add_balances(window, null, null.total)
    for a in range(m):
        for b in range(a, m):
            null.factor[a, b] = null.total[1 + a, b]
        null.factor[a, a] += null.least[a]
        null.mean[a] = -null.total[0, a]
    factorise(null.factor, null.least)
    solve_factorised(null.factor, null.mean)
    null.inverse[:] = 0.0
    for i in range(n):
        null.inverse[i, i] = 1.0
    whiten(null.factor, null.inverse)
    for i in range(n):
        total = 0.0
        for k in range(m):
            total += null.inverse[k, i] * null.inverse[k, i]
        null.sigma[i] = np.sqrt(total)


@njit_in_place
def take_balances(horizon: Horizon, time: float, measured: FloatArray, learn: bool) -> None:
    """Let the balance that is complete join the horizon, without estimating.

    The constant part of its rows belongs to f = 0 afterwards.  The residual and the weight of the
    last balance are written.  ``measured``, shape (n,), says whose efforts are known.  What leaves
    the horizon is remembered if ``learn``.
    """
    balance, window, null, level = horizon.balance, horizon.window, horizon.null, horizon.level
    n, past = balance.reference.shape[0], PAST_WEIGHT if learn else -PAST_WEIGHT
    if window.counters[NEXT] % window.times.shape[0] == 0:  # drifts stay small over days
        shift = time - balance.epoch[0]
        move_drifts(window, null, 1 + DRIFT * n, 1 + OFFSET * n, n, shift)
        move_epoch(balance, time)
    make_absolute(balance.hat.rows, balance.reference)
    join(window, (null, level), time, balance.hat.rows, past)
    at = slot(window, 0)
    for i in range(n):
        window.poses[at, i] = balance.poses[0, i]
        window.rest[at, i] = rests(balance, i)
        window.rested[i] = window.rested[i] + 1 if window.rest[at, i] == 1.0 else 0
        window.extra[at, i] = 0.0 if measured[i] == 1.0 else UNMEASURED
    decorrelate(horizon.noise, window, balance, null.dry, at)
    weigh(window, null, _lengthen_rests(window, null, 1))
    weigh(window, level, _lengthen_rests(window, level, window.times.shape[0]))


@njit_in_place
def _lengthen_rests(window: Window, null: Posterior, longest: int) -> int:
    """Let friction last as long as a rest, in all of its balances; how many are to be weighed anew.

    That of a joint that rests does not average out, whatever the others do; in rests of a few
    balances it only reverses.  Lengths are powers of two, so that a balance is weighed a few times,
    and ``longest`` at most.
    """
    rested = window.rested
    last, at = 1, slot(window, 0)
    for i in range(rested.shape[0]):
        if rested[i] <= LAGS:
            continue
        lasting = LAGS
        while lasting < rested[i]:
            lasting *= 2
        null.lasting[at, i] = min(lasting, longest)
        if 2 * (rested[i] - 1) == lasting and null.lasting[slot(window, 1), i] < longest:
            held = min(rested[i], window.counters[COUNT])
            for back in range(held):
                null.lasting[slot(window, back), i] = min(lasting, longest)
            last = max(last, held)
    return last


@njit_in_place
def weigh_all(horizon: Horizon, last: int) -> None:
    """As `weigh`, for the estimate of levels as well."""
    weigh(horizon.window, horizon.null, last)
    weigh(horizon.window, horizon.level, last)


@njit_in_place
def solve_all(horizon: Horizon) -> None:
    """As `solve`, for the estimate of levels as well."""
    solve(horizon.window, horizon.null)
    solve(horizon.window, horizon.level)


@njit_in_place
def estimate_all(horizon: Horizon, interval: float, learn: bool) -> None:
    """Estimate anew, after `take_balances`; balances are an ``interval`` apart [s]."""
    horizon.since[0] += 1
    taken = horizon.window.counters[NEXT]
    if (learn or not taken * interval > NOISE_KNOWN_AFTER) and taken % FEW == 0:
        _learn_all(horizon, priors.POSE_TIME / interval)
    solve_all(horizon)


@njit_in_place
def _learn_all(horizon: Horizon, lasting: float) -> None:
    """Learn the noise; that of levels from all that the arm's unknowns leave.

    What the likeliest fault explains is no noise of the null hypothesis: a fault that grows slowly
    would raise the noise that it is compared with.  ``lasting`` is as of `_copy_noise`.
    """
    window, null, count = horizon.window, horizon.null, horizon.window.counters[COUNT]
    anew = is_due(window)
    if anew:
        set_residuals(window, null, count)
        _explain(window, null)
        learn_covariance(horizon.noise, window, null)
    set_residuals(window, null, count)
    learn_noise(horizon.noise, window, null)
    _copy_noise(window, null, horizon.level, lasting)
    if _explain(window, null):
        learn_noise(horizon.noise, window, null)
    if anew:
        weigh_all(horizon, count)


@njit_in_place
def _explain(window: Window, null: Posterior) -> bool:
    """Take what the likeliest fault explains out of the residuals; whether there is any."""
    some = False
    for back in range(window.counters[COUNT]):
        for i in range(null.noise.shape[0]):
            explained = window.explained[slot(window, back), i]
            null.residual[back, i] += explained
            some = some or explained != 0.0
    return some


@njit_in_place
def _copy_noise(window: Window, source: Posterior, level: Posterior, lasting: float) -> None:
    """Take over what was learned of the noise, all of which lasts as long as a pose.

    ``lasting`` is that time in balances.  What an identified arm is known to miss remains.
    """
    for i in range(source.noise.shape[0]):
        level.noise[i], level.rest[i] = source.noise[i], source.rest[i]
        missed, mixing = 0.0, window.mixing[slot(window, 0), i]
        for j in range(i + 1):
            missed += mixing[j] * mixing[j] * level.systematic[j]
        least = max(missed / (level.noise[i] * level.noise[i]), lasting)
        level.inflation[i] = max(source.inflation[i], least)


@njit_in_place
def make_absolute(rows: FloatArray, reference: FloatArray) -> None:
    """Let the constant parts belong to f = 0 instead of the point of linearisation."""
    n = reference.shape[0]
    for i in range(rows.shape[0]):
        for j in range(n):
            rows[i, 0] -= rows[i, 1 + OFFSET * n + j] * reference[j]


@njit_in_place
def has_moved(horizon: Horizon) -> bool:
    """Whether an offset has surely left the point of linearisation."""
    balance, level, largest = horizon.balance, horizon.level, 0.0
    for i in range(balance.reference.shape[0]):
        step = abs(level.mean[i] - balance.reference[i])
        if step > ROBUST * level.sigma[i]:
            largest = max(largest, step / balance.scale[i])
    # All balances are evaluated anew: not before a tenth of them are new ones.
    renewed = horizon.since[0] * FEW >= horizon.window.counters[COUNT]
    return renewed and largest > SMALL


class OffsetEstimator:
    """Estimator of one arm; ``balance`` is filled by `sampling.take_samples`.

    ``posterior`` is the null hypothesis, with which faults that begin are compared; ``level`` is
    the estimate of the offsets.  What the model of an identified arm is known to miss lasts as long
    as a pose: it is an error of levels, hardly one of changes, and counts only in ``level``.
    ``call`` calls compiled functions that take parts of the estimator.
    """

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        self.plan, about = plan, _about(arm, plan)
        self.joints = n = len(arm.joints)
        self.typical, self.prior = about.typical, about.prior
        derived = np.where(arm.sensors().independent, 0.0, 1.0)
        balance = new_balance(
            about.chain, about.directions, derived, about.drives, arm.sensors_to_joints(),
            arm.scales())  # fmt: skip
        faults, none = OFFSET * n, 0.0 * about.systematic
        self.horizon = Horizon(
            balance,
            new_window(n, faults, len(self.prior), plan.capacity, about.loads),
            _prior_posterior(about, none, faults, plan.capacity),
            _prior_posterior(about, about.systematic, 0, plan.capacity),
            np.zeros(1, np.int64),
            new_row_noise(about.rates, about.other, about.noise, plan.capacity),
        )
        self.balance, self.window, self.posterior, self.level, self._since, _ = self.horizon
        self.call = Entries()

    def __len__(self) -> int:
        """Balances in the horizon."""
        return int(self.window.counters[COUNT])

    def pretend(self, balances: int) -> None:
        """Let a new horizon have so many balances, of nothing: to compile what uses them."""
        self.window.counters[:] = balances

    def place(self, back: int) -> int:
        """Index in the ring of the balance ``back`` before the last one."""
        return int(self.window.counters[NEXT] - 1 - back) % self.plan.capacity

    def times(self, last: int) -> FloatArray:
        """Ends of the last balances, oldest first [s]."""
        return self.window.times[recent(self.window, last)[::-1]]

    def weigh_again(self, last: int) -> None:
        """Sum up the last balances again, after a change of their variance."""
        self.call(weigh_all, self.horizon, last)

    def _renew(self, last: int) -> None:
        """Estimate anew, after a change of the last balances, or of their variance."""
        self.weigh_again(last)
        self.call(solve_all, self.horizon)

    def misfit(self) -> float:
        """By how many of its standard deviations the arm differs from its file, at most.

        Of unknown parameters, and of what they leave over what is expected.
        """
        if self.window.counters[NEXT] * self.plan.interval < NOISE_KNOWN_AFTER:
            return 0.0
        null, n = self.posterior, self.joints
        unknowns = null.mean[n:] ** 2 * null.least[n:]
        # Of m of them the largest square is about 2 log(m) by chance.
        largest = max(float(unknowns.max()) - 2.0 * math.log(len(unknowns)), 0.0)
        return max(math.sqrt(largest), float((null.noise / null.expected).max()))

    def left_over(self, last: int) -> tuple[FloatArray, FloatArray]:
        """What the estimate leaves of the last balances, newest first, and its usual size."""
        null, at = self.posterior, recent(self.window, last)
        rows = self.window.rows[at]
        return rows[:, :, 0] + rows[:, :, -len(null.mean) :] @ null.mean, self.usual_sizes(at)

    def usual_sizes(self, at: int | IntArray) -> FloatArray:
        """Usual sizes of what is left of balances at places of the ring, as they move or rest.

        Unlike `usual_size`, no more in long rests.
        """
        null = self.posterior
        size = null.noise * self.window.relative[at]
        return np.asarray(size * (1.0 + (null.rest - 1.0) * self.window.rest[at]))

    def contradiction(self, last: int) -> float:
        """Root mean square of what is left of the last balances, over its size; the largest.

        Of balances whose readings are uncertain more is left.
        """
        last = min(last, len(self))
        left, size = self.left_over(last)
        at = recent(self.window, last)
        power = left**2 / (size**2 + self.window.extra[at] + self.window.late[at])
        return float(np.sqrt(power.mean(axis=0).max())) if last else 0.0

    def _step(self) -> FloatArray:
        """Ways to the estimates of those offsets that have surely moved, shape (n,) [rad]."""
        step = self.level.mean[: self.joints] - self.balance.reference
        # The columns of the offsets are those of the nominal arm: what it carries is not in them.
        # Where gravity says little, the search would run away from the truth.
        return np.where(np.abs(step) > ROBUST * self.level.sigma, step, 0.0)

    def linearise(self, blocks: FloatArray, other: FloatArray | None = None) -> None:
        """Evaluate the balances of the horizon again, at the present estimate of the offsets.

        ``blocks``, shape (N, 3 n + 4), are as in `Sampler.blocks`, oldest first; whole intervals.
        ``other``, shape (n,), are offsets from which less may be left [rad].
        """
        largest = STRAIGHT * self.balance.scale
        near = self.balance.reference + np.clip(self._step(), -largest, largest)
        self._linearise_at(near, blocks)
        if other is not None:
            left = self._unexplained()
            self._linearise_at(other, blocks)
            if self._unexplained() > left:
                self._linearise_at(near, blocks)
        self._since[:] = 0

    def _linearise_at(self, offsets: FloatArray, blocks: FloatArray) -> None:
        """Evaluate the balances of the horizon at these offsets, and estimate anew."""
        self.balance.reference[:] = offsets
        self.replace_last(blocks)
        self.call(solve_all, self.horizon)

    def _unexplained(self) -> float:
        """Weighted squares of what the estimate of levels leaves, and of its way from the prior."""
        level, last = self.level, len(self)
        self.call(set_residuals, self.window, level, last)
        weights, left = level.weights[recent(self.window, last)], level.residual[:last]
        return float((weights * left**2).sum() + level.least @ level.mean**2)

    def move_reference(self, joint: int, by: float) -> None:
        """Let an offset grow [rad], as the readings do by what is no longer taken out of them."""
        self.balance.reference[joint] += by
        column = joint - len(self.prior)
        self.window.rows[:, :, 0] -= by * self.window.rows[:, :, column]
        for past in (self.posterior.past, self.level.past):
            past[0] -= by * past[1 + joint]
            past[:, 0] -= by * past[:, column]
        self._renew(len(self))

    def restart(self) -> None:
        """Begin a new horizon after a gap; what the old one said of the arm is kept.

        Offsets may be others from now on, and what is remembered knows of one for each sensor.
        """
        m = len(self.prior)
        for null in (self.posterior, self.level):
            past = null.past
            add_balances(self.window, null, past)
            self.call(recall, null)
            past[:, -m:], past[1:, 0] = null.recalled, null.recalled[0]
        self.window.counters[:] -= len(self)
        self.call(solve_all, self.horizon)

    def replace_last(self, blocks: FloatArray) -> None:
        """Evaluate the last balances again, from their blocks; one interval more than balances."""
        last = min(len(blocks) // self.plan.blocks - 1, len(self))
        if last < 1:
            return
        at = recent(self.window, last)[::-1]
        self.window.rows[at] = self._evaluate(self.balance, blocks, at)
        self.weigh_again(last)

    def rows_of(self, blocks: FloatArray) -> FloatArray:
        """Rows of the last balances, oldest first, if these were their blocks; nothing is kept."""
        at = recent(self.window, len(blocks) // self.plan.blocks - 1)[::-1]
        return self._evaluate(scratch_of(self.balance), blocks, at)

    def _evaluate(self, balance: Balance, blocks: FloatArray, at: IntArray) -> FloatArray:
        """Rows of the balances at places of the ring, of which these are, or end, the blocks."""
        rows = np.empty((len(blocks) // self.plan.blocks - 1, *balance.hat.rows.shape))
        blocks = np.ascontiguousarray(blocks)
        self.call(fill_balances, balance, blocks, self.plan.blocks, rows)
        self.call(make_absolute, rows.reshape(-1, rows.shape[2]), balance.reference)
        rows = self.window.mixing[at] @ rows[len(rows) - len(at) :]
        self._take_out_load(rows, self.window.carried[at])
        return rows

    def _take_out_load(self, rows: FloatArray, change: FloatArray) -> None:
        """Let rows of balances be those of a load that has changed, each or all."""
        if change.any():
            moved = np.atleast_2d(change @ self.window.loads)
            rows[:, :, 0] -= (rows[:, :, -moved.shape[1] :] * moved[:, None]).sum(2)

    def change_load(self, begin: float, change: FloatArray) -> None:
        """The load has changed since a moment [s]: what balances before say of it is forgotten.

        ``change``, shape (L,), is how, as estimated: balances before are as if they had had the
        load of now.  Its error is in the information.  The balances of the change say nothing.
        """
        at = recent(self.window, len(self))
        # Beginnings are ends of balances, but for rounding.
        later = self.window.times[at] > begin + 0.5 * self.plan.interval
        last = int(np.count_nonzero(later)) - ONSET
        old, moved = at[last:], change @ self.window.loads
        self.window.carried[old] += change
        rows = self.window.rows[old]
        self._take_out_load(rows, change)
        self.window.rows[old] = rows
        self.window.changed[at[last - 1]] = 1.0
        self.window.trust[old[:ONSET]] = DISTRUST
        for null in (self.posterior, self.level):
            past = null.past
            past[0] -= moved @ past[1:]
            past[:, 0] -= past[:, -len(moved) :] @ moved
            null.mean[:] += moved
        self._renew(len(self))

    def doubt_readings(self, joint: int, error: float | FloatArray) -> None:
        """Let the balances of the horizon say less: readings of one sensor were wrong in them.

        ``error`` is the standard deviation of its readings in each balance, newest first [rad].  It
        is one error for all of them, which does not average out.
        """
        error = np.broadcast_to(error, len(self))
        at = recent(self.window, len(error))
        offset = self.window.rows[at, :, 1 + OFFSET * self.joints + joint]
        self.window.extra[at] += np.count_nonzero(error) * (error[:, None] * offset) ** 2
        self._renew(len(error))

    def doubt_rates(self, joint: int, noise: float, since: float) -> None:
        """Let balances that ended since a moment [s] say less: readings of one sensor were noisy.

        ``noise`` is their standard deviation [rad]; rates are derived from them.
        """
        count = int(np.count_nonzero(self.times(len(self)) > since))
        at = recent(self.window, count)
        edges = noise * self.window.momenta[at, :, joint] / self.plan.interval
        self.window.extra[at] += self.balance.derived[joint] * READINGS_AT_EDGES * edges**2
        self._renew(count)

    def doubt_balances(self, variances: FloatArray) -> None:
        """Let the last balances say less, by more variance, shape (last, n) [N2 m2 s2]."""
        self.window.extra[recent(self.window, len(variances))] += variances
        self._renew(len(variances))

    def distrust(self, last: int) -> None:
        """Take most of the weight off the last balances, and estimate anew."""
        last = min(last, len(self))
        at = recent(self.window, last)
        self.window.trust[at] = np.minimum(self.window.trust[at], DISTRUST)
        self._renew(last)


class _About(NamedTuple):
    """What depends on the arm alone; not to be changed."""

    chain: Chain
    typical: FloatArray  # torques that move it, shape (n,) [N m]
    directions: FloatArray  # of its parameters, as of `Balance`, and what belongs to them of drives
    drives: FloatArray
    loads: FloatArray  # the payload's unknowns, of `Window`
    prior: FloatArray  # standard deviations of the unknowns, shape (m,)
    noise: FloatArray  # as expected, of `Posterior`, as the next three
    rest: FloatArray
    dry: FloatArray
    systematic: FloatArray
    rates: FloatArray  # V, of `RowNoise`
    other: FloatArray  # D, as expected


@lru_cache(maxsize=4)
def _about(arm: SerialArm, plan: HorizonPlan) -> _About:
    """Kept: a campaign watches one arm again and again."""
    chain, scale = compile_chain(arm), arm.scales()
    speed = np.minimum(arm.velocity_limit, priors.FAST * scale)
    typical = typical_torque(chain, scale)
    missed = model_error(arm) * typical
    directions, drives, rows = parameter_directions(
        chain, parameter_factor(arm, chain), speed, scale
    )
    directions, drives, rows = _with_delay(arm, directions, drives, rows)
    loads = rows[-LOAD_ROWS:] if usual_load(arm) > 0.0 else rows[:0]
    loads = np.hstack([np.zeros((len(loads), 4 * len(arm.joints))), loads])
    prior = np.concatenate([*_priors(arm, chain.friction, missed), np.ones(len(directions))])
    rates = change_noise(arm, plan.interval)
    other, noise = balance_noise(arm, chain, directions, rates, _missed_power(arm, missed, plan))
    # Friction at rest is anything between both signs of Coulomb's: uniformly distributed.
    dry = plan.interval * chain.friction[:, DRY] / np.sqrt(3.0)
    rest = np.hypot(1.0, dry / noise)
    systematic = _systematic_error(arm, priors.LASTING * missed, plan)
    return _About(
        chain, typical, directions, drives, loads, prior, noise, rest, dry, systematic, rates, other
    )


def _with_delay(
    arm: SerialArm, directions: FloatArray, drives: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions with one more: efforts that are commands or means are half a sample off."""
    late = np.zeros((1, *drives.shape[1:]))
    late[:, :, DELAY_PART] = 0.5 * arm.sample_time
    directions = np.concatenate([directions, np.zeros((1, *directions.shape[1:]))])
    return directions, np.concatenate([drives, late]), np.pad(rows, ((0, 0), (0, 1)))


def _prior_posterior(
    about: _About, systematic: FloatArray, faults: int, capacity: int
) -> Posterior:
    """What is known before any balance; sums have so many columns of faults."""
    prior, noise, rest = about.prior, about.noise, about.rest
    n, m = len(noise), len(prior)
    inflation, past = np.maximum(2.0, systematic / noise**2), np.zeros((1 + m, 1 + faults + m))
    residual, weights, lasting = np.zeros((3, capacity, n))
    recalled, total = np.zeros((2, 1 + m, m))
    return Posterior(
        np.zeros(m), np.diag(1.0 / prior), prior[:n].copy(), prior**-2, noise.copy(), noise,
        inflation, rest.copy(), rest, about.dry, systematic, residual, weights, lasting,
        np.zeros((capacity + 1, *past.shape)), past, recalled, total, np.zeros((m, n)),
        np.zeros(capacity))  # fmt: skip


def _priors(arm: SerialArm, friction: FloatArray, missed: FloatArray) -> list[FloatArray]:
    """Standard deviations of offsets, torque offsets, viscous and Coulomb friction."""
    share, absent = max(arm.uncertainty.friction, UNSTATED_FRICTION), priors.STATIC * missed
    scale = arm.scales()
    return [
        priors.OFFSET_PRIOR * scale,
        absent,
        share * np.abs(friction[:, WET]) + absent / (priors.FAST * scale),
        share * friction[:, DRY] + absent,
    ]


def _missed_power(arm: SerialArm, missed: FloatArray, plan: HorizonPlan) -> FloatArray:
    """Variances of a balance by torques that the model misses, shape (n,) [N2 m2 s2]."""
    tolerance = np.array([max(joint.torque_tolerance.torque) for joint in arm.joints])
    return np.asarray((plan.interval * np.maximum(tolerance / SIGMAS, missed)) ** 2)


def _systematic_error(arm: SerialArm, missed: FloatArray, plan: HorizonPlan) -> FloatArray:
    """What the model misses while a pose lasts: as measured, or on data held back, or expected."""
    lasting = arm.uncertainty.torque_error_time or priors.POSE_TIME
    if arm.uncertainty.torque_error is not None:
        missed = np.array(arm.uncertainty.torque_error)
    elif arm.covariance is not None:
        missed = np.array([np.median(joint.torque_tolerance.torque) for joint in arm.joints]) / 3.0
    return (missed * plan.interval) ** 2 * lasting / plan.interval
