"""What is computed at every decision, compiled; `monitor` does what only a suspicion needs.

`decide` goes through the stages of a decision, and leaves where Python has to do one of them.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.balance import OFFSET, RATE, READINGS_AT_EDGES
from lpv.core.serial_arm.diagnosis.bank import BankParts, ask_bank, take_rows
from lpv.core.serial_arm.diagnosis.estimator import (
    HORIZON,
    INTERVAL,
    Horizon,
    estimate_all,
    has_moved,
    take_balances,
    weigh_all,
)
from lpv.core.serial_arm.diagnosis.healthy_set import HealthyRing, take_healthy, take_noise
from lpv.core.serial_arm.diagnosis.information import COUNT, NEXT, slot
from lpv.core.serial_arm.diagnosis.published_rates import readings_at_edges
from lpv.core.serial_arm.diagnosis.row_noise import NOISE_SAMPLES, is_due
from lpv.core.serial_arm.diagnosis.sampler import Sampler, readings_in_jump
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import record_type


class Stage(IntEnum):
    """Where in a decision to go on; Python does those that say so, if they are due."""

    TAKE = 0  # the balance joins the horizon
    FOLLOW = 1  # Python: faults that are followed
    ESTIMATE = 2
    LINEARISE = 3  # Python: the estimate has left the point of linearisation
    ENDS = 4  # Python: jumps that may have been ends of faults
    GUARANTEE = 5  # Python: guaranteed thresholds are due
    REST = 6  # Python: readings rest
    ASK = 7
    NAME = 8  # Python: hypotheses are compared, or suspects are none any more
    LEVELS = 9
    RAISE = 10  # Python: offsets are beyond what a healthy arm shows
    END = 11  # Python: faults that may be over
    RATES = 12  # Python: whether rates are derived from readings
    DONE = 13


(
    _TAKE, _FOLLOW, _ESTIMATE, _LINEARISE, _ENDS, _GUARANTEE, _REST, _ASK, _NAME, _LEVELS,
    _RAISE, _END, _RATES, _DONE,
) = map(int, Stage)  # fmt: skip
READINGS_IN_WAY = 2.0
"""How many times the variance of a reading is in the way of an interval."""
STILL_TIME = INTERVAL
"""A reading without any change for longer rests [s]."""
DECISION = record_type(
    ('stage', 'i8'),
    ('now', 'f8'),  # [s]
    # What `monitor` knows:
    ('learns', '?'),  # nothing contradicts a healthy arm
    ('follows', '?'),  # faults are followed
    ('ends', '?'),  # jumps may have been ends of faults
    ('guarantees', '?'),  # the arm's file states what a healthy arm is
    ('disturbed', '?'),  # something is wrong now of which guarantees know nothing
    ('suspects', '?'),  # several causes are suspected
    ('pushed', '?'),  # ... or torques from outside are
    ('active', '?'),  # alarms are up that may end
    ('usual', '?'),  # nothing of all this, and no alarm
    ('threshold', 'f8'),  # of the statistic
    ('widest', 'f8'),  # standard deviation of an offset that says nothing, times scale [rad]
    ('smallest', 'f8'),  # level that is a fault, times scale [rad]
    ('sigmas', 'f8'),  # standard deviations in a bound
    ('at_start', 'f8'),  # log Bayes factor that an offset needs within the first horizon
    ('later', 'f8'),  # and later
    ('sample_time', 'f8'),  # [s]
    ('held', 'i8'),  # samples of the newest balance, and those that wait
    # What was found:
    ('balances', 'i8'),  # used so far
    ('lost', 'i8'),  # balances when something was so last, or -1
    ('exceeds', '?'),  # an estimate exceeds its guaranteed threshold
    ('sound', '?'),  # thresholds are guaranteed: the horizon holds nothing of that
    ('rests', '?'),  # a reading is conspicuous because it rests
    ('asked', '?'),  # hypotheses have to be compared
)


Certified = tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]
"""Offsets by an observer that certifies them, the bounds of a healthy arm, both of shape (n,)
[rad], and whether they hold, shape (1,)."""


class Parts(NamedTuple):
    """What decisions are made of."""

    state: np.ndarray  # memory of a record of `DECISION`
    sampler: Sampler
    horizon: Horizon
    healthy: HealthyRing
    bank: BankParts
    prior: FloatArray  # (m,) standard deviations if nothing is known, the offsets' first [rad]
    known: FloatArray  # (n,) for how long each offset has been diagnosable [s]
    certified: Certified
    # (2, n) log Bayes factors of offsets that are beyond a healthy arm by the horizon; 1 where the
    # other observer excludes one, and the horizon does not contradict; all else is 0
    beyond: FloatArray
    recent: FloatArray  # (2 B, 3 n + 4) the B blocks of each of the last two intervals
    lost: FloatArray  # (2 B, n) what samples lost in these may hide, as of `Sampler.lost`
    measured: FloatArray  # (n,) 1 where the efforts of the last balance are known
    noise: FloatArray  # (3, n) of `_note_noise` [rad2/s2]


@njit_in_place
def reading_noise(sampler: Sampler, i: int) -> float:
    """Variance of a noisy reading [rad2]."""
    return float(sampler.noise[1, i] / readings_in_jump(sampler, i))


@njit_in_place
def _note_noise(parts: Parts) -> None:
    """Write variances of the rates of the last balance: readings noisy, rounded, or off stamps."""
    sampler, (rounded, noisy, late) = parts.sampler, parts.noise
    for j in range(noisy.shape[0]):
        edges = READINGS_AT_EDGES * sampler.derived[j] / parts.bank.evidence.interval**2
        rounded[j] = 0.0
        if np.isfinite(sampler.grain[j]):
            rounded[j] = edges * sampler.grain[j] * sampler.grain[j] / 12.0
        fastest, wrong = 0.0, 0.0
        for block in parts.recent:
            rate = abs(block[noisy.shape[0] + j])
            fastest, wrong = max(fastest, rate), max(wrong, abs(block[-1]) * rate)
        # Readings may be louder in motion than at rest.
        louder = sampler.scale[j] * sampler.scale[j] - sampler.calm[j]
        noisy[j] = max(louder, 0.0) / readings_in_jump(sampler, j)
        noisy[j] += sampler.state[0].jitter * fastest * fastest
        if sampler.noisy[j] == 1:
            noisy[j] += reading_noise(sampler, j)
        noisy[j], late[j] = edges * noisy[j], edges * wrong * wrong
        parts.horizon.noise.more[j] = noisy[j] + late[j]


@njit_in_place
def _add_noise(parts: Parts) -> None:
    """Let the last balance say less than others by the noise that was noted."""
    sampler, window, null = parts.sampler, parts.horizon.window, parts.horizon.null
    interval = parts.bank.evidence.interval
    samples = round(interval / parts.state[0].sample_time)
    n, at, less = null.noise.shape[0], slot(window, 0), False
    for i in range(n):
        rounded, noisy, late = 0.0, 0.0, 0.0
        for j in range(n):
            power = window.momenta[at, i, j] ** 2
            rounded += power * parts.noise[0, j]
            noisy += power * parts.noise[1, j]
            late += power * parts.noise[2, j]
            if sampler.noisy[j] == 1:
                mean = window.rows[at, i, 1 + OFFSET * n + j] ** 2 / samples
                # Torques grow with the squares of rates, of which noise changes the mean.
                turned = window.rows[at, i, 1 + RATE * n + j] / interval
                way = sampler.derived[j] * READINGS_IN_WAY * turned**2
                noisy += reading_noise(sampler, j) * (mean + way)
        # As learned, most of what is left may be rounding.
        usual = null.noise[i] * window.relative[at, i]
        extra = max(rounded - usual * usual, 0.0) + noisy
        window.extra[at, i] += extra
        window.late[at, i] = late
        less = less or extra + late > 0.0
    if less:
        weigh_all(parts.horizon, 1)


@njit_in_place
def _find_levels(parts: Parts) -> bool:
    """Which offsets are beyond what a healthy arm shows, as in ``beyond``; true if there is any.

    ``known`` is updated.
    """
    level, state, known, beyond = parts.horizon.level, parts.state[0], parts.known, parts.beyond
    scales, interval = parts.horizon.balance.scale, parts.bank.evidence.interval
    (faults, bounds, holds), sigmas = parts.certified, state.sigmas
    some = False
    for i in range(known.shape[0]):
        offset, sigma, least = level.mean[i], level.sigma[i], state.smallest * scales[i]
        beyond[0, i], beyond[1, i] = 0.0, 0.0
        if sigma < state.widest * scales[i]:
            known[i] += interval
            ratio = offset / sigma
            gain = 0.5 * ratio * ratio - np.log(parts.prior[i] / sigma)
            # An offset may have been there before the first sample; later ones come at any time,
            # and every horizon is another chance of a false alarm.
            needed = state.at_start if known[i] < HORIZON else state.later
            # Before, the noise is what the file expects.
            needed = needed if known[i] > NOISE_SAMPLES * interval else np.inf
            if gain > needed and abs(offset) > least:
                beyond[0, i], some = gain, True
        fault, bound = faults[i], bounds[i] if holds[0] else np.inf
        if abs(fault) > max(bound, least) and abs(offset - fault) < bound + sigmas * sigma:
            beyond[1, i], some = 1.0, True
    return some


@njit_in_place
def decide(parts: Parts) -> None:
    """Go on with a decision from its stage on, until Python has to do something or it is done."""
    state, horizon, bank = parts.state[0], parts.horizon, parts.bank
    if state.stage == _TAKE:
        _copy_recent(parts.sampler, parts.recent, parts.lost)
        if state.guarantees:
            blocks = parts.recent, parts.lost
            take_healthy(parts.healthy, horizon, blocks)
        _note_noise(parts)
        for i in range(parts.measured.shape[0]):
            parts.measured[i] = parts.sampler.measured[i] >= state.held
        take_balances(horizon, state.now, parts.measured, state.learns)
        if state.guarantees:
            take_noise(parts.healthy, horizon, readings_at_edges(parts.sampler))
        take_rows(bank, parts.recent, parts.sampler)
        state.balances += 1
        if state.disturbed:
            state.lost = state.balances
        held = horizon.window.counters[COUNT]
        state.sound = state.guarantees and state.balances - state.lost > held
        state.stage = _FOLLOW if state.follows else _ESTIMATE
    if state.stage == _ESTIMATE:
        _add_noise(parts)
        estimate_all(horizon, bank.evidence.interval, state.learns)
        state.stage = _LINEARISE if has_moved(horizon) else _ENDS
    if state.stage == _ENDS and not state.ends:
        state.stage = _GUARANTEE
    # Guaranteed thresholds change over the horizon.
    due = state.sound and (
        is_due(horizon.window) or horizon.window.counters[NEXT] % bank.recent == 0
    )
    if state.stage == _GUARANTEE and not due:
        state.stage, state.rests = _REST, False
    if state.stage == _REST:
        longest = 0
        for still in parts.sampler.still:
            longest = max(longest, still)
        if longest * state.sample_time <= STILL_TIME:
            state.stage = _ASK
    if state.stage == _ASK:
        block = parts.recent[parts.recent.shape[0] - 1]
        state.asked = ask_bank(bank, horizon, parts.sampler, block, state.threshold, state.rests)
        quiet = bank.state[0].statistic < state.threshold and not (state.suspects or state.pushed)
        state.stage = _LEVELS if quiet and not state.asked else _NAME
    if state.stage == _LEVELS:
        found = _find_levels(parts)
        state.stage = _RAISE if found or state.exceeds else _END
    if state.stage == _END and not state.active:
        state.stage = _RATES
    probe, probed = parts.sampler.probe.shape[0], parts.sampler.state[0].probed
    if state.stage == _RATES and not (probe > 0 and probed == probe):
        state.stage = _DONE


@njit_in_place
def _copy_recent(sampler: Sampler, recent: FloatArray, lost: FloatArray) -> None:
    """Copy the last blocks, oldest first."""
    count, capacity = recent.shape[0], sampler.blocks.shape[0]
    first = sampler.state[0].blocks - count
    for k in range(count):
        at = (first + k) % capacity
        for c in range(recent.shape[1]):
            recent[k, c] = sampler.blocks[at, c]
        for i in range(lost.shape[1]):
            lost[k, i] = sampler.lost[at, i]
