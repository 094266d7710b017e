"""From samples to momentum balances: means of some samples are blocks, some blocks an interval."""

import numpy as np

from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.diagnosis.balance import Balance, add_block, close_interval, drop_interval
from lpv.core.serial_arm.diagnosis.jumps import find_jumps, set_jumps
from lpv.core.serial_arm.diagnosis.published_rates import (
    balance_lag,
    keep_probe,
    rate_lag,
    watch_contrast,
    watch_lag,
)
from lpv.core.serial_arm.diagnosis.repeated_readings import fill_repeated
from lpv.core.serial_arm.diagnosis.sampler import (
    CONTRARY,
    DELAY,
    HISTORY,
    LATE,
    LEARNED,
    NONE,
    ROUNDING,
    STATE,
    Sampler,
    measure_stop,
    removed,
    watch_change,
)
from lpv.core.serial_arm.diagnosis.stamp_errors import note_wrong_stamp, watch_stamps
from lpv.core.support.jit import njit_in_place


@njit_in_place
def push_sample(
    sampler: Sampler, time: float, y: FloatArray, v: FloatArray, torque: FloatArray
) -> None:
    """Append a sample, with faults that are known removed, and test the one before for jumps.

    ``found`` and ``size`` of the sampler say what has been found at samples before.  A torque that
    is not known is NaN.
    """
    n = y.shape[0]
    period = time - sampler.time[HISTORY - 1]
    if sampler.state[0].probed < sampler.probe.shape[0]:
        keep_probe(sampler, time, y, v)
    for k in range(HISTORY - 1):
        sampler.time[k] = sampler.time[k + 1]
        for i in range(n):
            sampler.jumps[k, i] = sampler.jumps[k + 1, i]
            sampler.doubtful[k, i] = sampler.doubtful[k + 1, i]
            for part in range(3):
                sampler.samples[k, part, i] = sampler.samples[k + 1, part, i]
    sampler.time[HISTORY - 1] = time
    follows = sampler.state[0].count > 0  # else the sample before is on the other side of a gap
    lag, hidden = rate_lag(sampler), rate_lag(sampler, 0.0)
    for i in range(n):
        sampler.found[i] = NONE
        sampler.filled[i] = max(sampler.filled[i] - 1, 0)
        change = sampler.curve[i] * period  # none before the first sample
        sampler.followed[i] += (sampler.drift[i] + 0.5 * change) * period
        sampler.drift[i] += change
        reading, way = y[i] - removed(sampler, i, y[i]), y[i] - sampler.raw[i]
        sampler.held[i] = 0
        if abs(way) > ROUNDING:
            sampler.held[i], sampler.still[i] = sampler.still[i], 0
            if follows:
                watch_change(sampler, i, way)
        else:
            sampler.still[i] += 1
            if sampler.still[i] == 1:
                measure_stop(sampler, i)
        sampler.change[i] = way if follows else 0.0
        watch_lag(sampler, i, way, v[i], period)
        watch_contrast(sampler, i, way / period, v[i], hidden)
        sampler.raw[i] = y[i]
        sampler.samples[HISTORY - 1, 0, i] = reading
        rate = v[i] - sampler.derived[i] * (sampler.drift[i] + sampler.share[i] * v[i])
        rate -= sampler.rate_error[i]
        sampler.samples[HISTORY - 1, 1, i] = rate
        for k in range(0 if follows else HISTORY - 1):  # nothing is known of before
            sampler.samples[k, 1, i] = rate
        is_measured = np.isfinite(torque[i])
        sampler.measured[i] = sampler.measured[i] + 1.0 if is_measured else 0.0
        sampler.samples[HISTORY - 1, 2, i] = torque[i] if is_measured else 0.0
    for i in range(n):
        wrong = sampler.contrast[i].wrong + sampler.contrast[i].replaced > 0.0
        if follows and (wrong or (lag > 0.0 and sampler.derived[i] == 1.0)):
            way = sampler.samples[HISTORY - 1, 0, i] - sampler.samples[HISTORY - 2, 0, i]
            sampler.samples[HISTORY - 1, 1, i] = way / period
    fill_repeated(sampler)
    if sampler.state[0].count > 1 and period > LATE * (
        sampler.time[HISTORY - 2] - sampler.time[HISTORY - 3]
    ):
        note_wrong_stamp(sampler)
    sampler.state[0].count += 1
    watch_stamps(sampler)
    if sampler.state[0].count >= 3:
        set_jumps(sampler)
        find_jumps(sampler)
    for i in range(n):  # a jump goes first; a rate that is wrong is so again
        own = sampler.contrast[i]
        if sampler.found[i] == NONE and own.wrong > own.replaced and own.contrary_at == time:
            sampler.found[i] = CONTRARY


@njit_in_place
def move_to_balance(sampler: Sampler, balance: Balance) -> bool:
    """Let the sample that is ``DELAY`` old enter the balance; true if a balance is complete."""
    k = HISTORY - 1 - DELAY
    if sampler.state[0].count <= DELAY + 1:
        return False
    n, now = sampler.scale.shape[0], sampler.time[k]
    # A sample stands for the time to halfway to its neighbours, where others are missing, too.
    after = sampler.time[k + 1] - now
    length = 0.5 * (after + now - sampler.time[k - 1])
    for part in range(3):
        for i in range(n):
            sampler.sums[part, i] += length * sampler.samples[k, part, i]
    lag = after * balance_lag(sampler)  # a difference is the rate between two samples
    for i in range(n):
        late = lag * (sampler.samples[k + 1, 1, i] - sampler.samples[k, 1, i])
        sampler.sums[1, i] += sampler.derived[i] * late
    for gap in (k - 1, k):  # half of what each hides
        if sampler.time[gap + 1] - sampler.time[gap] > sampler.period:
            for i in range(n):
                sampler.hidden[i] += 0.5 * _hidden(sampler, gap, i)
    sampler.state[0].block_length += length
    sampler.state[0].times += length * now
    if sampler.state[0].late_from < now < sampler.state[0].late_until:
        sampler.state[0].in_doubt = sampler.state[0].latest
    sampler.state[0].in_block += 1
    if sampler.state[0].in_block < sampler.per_block:
        return False
    _close_block(sampler)
    if sampler.state[0].in_interval < sampler.per_interval:
        return False
    return _close_interval(sampler, balance)


@njit_in_place
def _hidden(sampler: Sampler, k: int, i: int) -> float:
    """Largest error of a torque's integral by the trapezoid from sample k to the next one [N m s].

    An effort is the mean of the period before it.  In the rest of a longer gap the torque may have
    been as at either end, or have gone on as it changed before and after.
    """
    torque, time = sampler.samples[:, 2, i], sampler.time
    gap, change = time[k + 1] - time[k], abs(torque[k + 1] - torque[k])
    for j in (k - 1, k + 1):
        if j > 0 or sampler.state[0].count >= HISTORY:  # else it is of before the start
            slope = abs(torque[j + 1] - torque[j]) / (time[j + 1] - time[j])
            change = max(change, gap * slope)
    return 0.5 * (gap - sampler.period) * change


@njit_in_place
def _close_interval(sampler: Sampler, balance: Balance) -> bool:
    """Give the last blocks to the balance; true if one is complete."""
    n, capacity, length = sampler.scale.shape[0], sampler.blocks.shape[0], 0.0
    last, passed = sampler.state[0].blocks, 0.0
    first = last - sampler.per_interval
    for k in range(first, last):
        length += sampler.blocks[k % capacity, 3 * n + 1]
    for k in range(first, last):
        row = sampler.blocks[k % capacity]
        own = row[3 * n + 1]
        row[3 * n + 2] = (passed + 0.5 * own) / length
        passed += own
        add_block(
            balance, row[:n], row[n : 2 * n], row[2 * n : 3 * n], row[3 * n], own,
            row[3 * n + 2])  # fmt: skip
    sampler.state[0].in_interval = 0
    return close_interval(balance, length)


@njit_in_place
def _close_block(sampler: Sampler) -> None:
    """Keep the means of the block."""
    n, count, blocks = sampler.scale.shape[0], sampler.state[0].in_block, sampler.per_interval
    capacity, length = sampler.blocks.shape[0], sampler.state[0].block_length
    at = sampler.state[0].blocks % capacity
    row = sampler.blocks[at]
    for i in range(n):
        for part in range(3):
            row[part * n + i] = sampler.sums[part, i] / length
            sampler.sums[part, i] = 0.0
        sampler.lost[at, i], sampler.hidden[i] = sampler.hidden[i], 0.0
    row[3 * n] = sampler.state[0].times / length
    if sampler.state[0].count > HISTORY + 2 * blocks * count:
        _calm_rates(sampler, row, sampler.blocks[(sampler.state[0].blocks - blocks) % capacity])
    row[3 * n + 1] = length
    row[3 * n + 3] = sampler.state[0].in_doubt
    for i in range(n):  # what is louder than usual shows at once, that it has become usual later
        more = sampler.scale[i] * sampler.scale[i] - sampler.calm[i]
        sampler.calm[i] += more if more < 0.0 else more / capacity
    sampler.state[0].block_length = sampler.state[0].times = sampler.state[0].in_doubt = 0.0
    sampler.state[0].blocks += 1
    sampler.state[0].in_block = 0
    sampler.state[0].in_interval += 1


@njit_in_place
def _calm_rates(sampler: Sampler, block: FloatArray, before: FloatArray) -> None:
    """Let rates that are derived from noisy readings be those since the block an interval before.

    Torques grow with their squares, of which noise changes the mean.
    """
    n = sampler.scale.shape[0]
    for i in range(n):
        if sampler.noisy[i] == 1 and sampler.derived[i] == 1.0:
            block[n + i] = (block[i] - before[i]) / (block[3 * n] - before[3 * n])


def restart(sampler: Sampler, balance: Balance) -> None:
    """Begin again after a gap in the samples; corrections and what was learned stay."""
    for name in STATE.names or ():
        if name not in LEARNED:
            sampler.state[name] = -1 if name == 'pending' else 0
    sampler.still[:] = 0
    sampler.doubtful[:] = 0
    sampler.jumps[:] = 0.0
    sampler.filled[:] = 0
    sampler.sums[:] = 0.0
    sampler.hidden[:] = 0.0
    drop_interval(balance)


@njit_in_place
def take_samples(
    sampler: Sampler, balance: Balance, times: FloatArray, samples: FloatArray, begin: int
) -> tuple[int, bool]:
    """Take samples until something has to be decided: a balance is complete, or a reading jumped.

    ``times``, shape (N,), are stamps [s], ``samples``, shape (N, 3, n), readings, rates and
    torques.  Returns the next sample to take, and whether a balance is complete.
    """
    n = sampler.scale.shape[0]
    for k in range(begin, times.shape[0]):
        push_sample(sampler, times[k], samples[k, 0], samples[k, 1], samples[k, 2])
        complete = move_to_balance(sampler, balance)
        jumped = False
        for i in range(n):
            jumped = jumped or sampler.found[i] != NONE
        if complete or jumped:
            return k + 1, complete
    return times.shape[0], False
