"""Readings that a late driver repeated are moved to where their joints were."""

from lpv.core.serial_arm.diagnosis.information import ROBUST
from lpv.core.serial_arm.diagnosis.sampler import (
    DELAY,
    HISTORY,
    Sampler,
    learn_scale,
    smallest_jump,
)
from lpv.core.support.jit import njit_in_place


@njit_in_place
def fill_repeated(sampler: Sampler) -> None:
    """Move readings that were repeated to where the joints were: their driver was late.

    They went evenly to their new readings, if their rates before explain these, else on at those;
    evenly to the next ones, too, where these have caught up.
    Where all go on from where they were for more than a sample, time stood still: they stay.
    """
    now, n, evenly, resumed = HISTORY - 1, sampler.scale.shape[0], True, True
    for i in range(n):
        held, reading = sampler.held[i], sampler.samples[:, 0, i]
        if held == 0 and sampler.filled[i] == 2 and _was_late_again(sampler, i):
            since = sampler.time[now] - sampler.time[now - 3]
            _go_on(sampler, i, now - 3, (reading[now] - reading[now - 3]) / since)
        if held > 0 and not _is_late(sampler, i):  # it rested
            if sampler.derived[i] == 1.0 and sampler.state[0].count > 0:
                time = (held + 1) * (sampler.time[now] - sampler.time[now - 1])
                sampler.samples[now, 1, i] = (reading[now] - reading[now - 1]) / time
        elif held > 0:
            time, way, rate = _since_change(sampler, i)
            # It slowed down, as far as its rounding tells.
            less = abs(way) < ROBUST * sampler.grain[i] and way * (rate * time - way) >= 0.0
            evenly = evenly and (less or abs(way - rate * time) <= smallest_jump(sampler, i))
            on = rate * (sampler.time[now] - sampler.time[now - 1])  # it may go twice as far
            within = abs(way - on) <= abs(on) + smallest_jump(sampler, i)
            resumed = resumed and held > 1 and within
            # Its e is that of all samples in which it was repeated: these are filled in evenly.
            rounded = _is_rounded(sampler, i, way)
            learn_scale(sampler, i, way if rounded else way - rate * time, held + 1.0)
    for i in range(n):
        if sampler.held[i] == 0 or not _is_late(sampler, i) or (resumed and not evenly):
            continue
        old = now - 1 - sampler.held[i]
        time, way, rate = _since_change(sampler, i)
        rate = way / time if evenly else rate
        _go_on(sampler, i, old, rate)
        sampler.filled[i] = 3  # e of the last sample but one holds three readings


@njit_in_place
def _go_on(sampler: Sampler, i: int, old: int, rate: float) -> None:
    """Let a reading go on from a sample until the last one at a rate."""
    for k in range(old + 1, HISTORY - 1):
        since = sampler.time[k] - sampler.time[old]
        sampler.samples[k, 0, i] = sampler.samples[old, 0, i] + rate * since
    if sampler.derived[i] == 1.0:
        sampler.samples[old + 1 :, 1, i] = rate


@njit_in_place
def _was_late_again(sampler: Sampler, i: int) -> bool:
    """Whether a reading that went half its way after it was repeated has caught up now.

    That sample was late, too.
    """
    now, old, reading, time = HISTORY - 1, HISTORY - 4, sampler.samples[:, 0, i], sampler.time
    rate, until = sampler.samples[old, 1, i], time[now - 1] - time[old]
    short = reading[now - 1] - reading[old] - rate * until
    left = reading[now] - reading[old] - rate * (time[now] - time[old])
    return bool(abs(short + 0.5 * rate * until) < abs(short) and abs(left) < 0.5 * abs(short))


@njit_in_place
def _is_late(sampler: Sampler, i: int) -> bool:
    """Whether the samples in which a reading was repeated are still to enter the balance."""
    return bool(sampler.held[i] <= min(DELAY, sampler.state[0].count - 2))


@njit_in_place
def _since_change(sampler: Sampler, i: int) -> tuple[float, float, float]:
    """Time since the change before the last one, way since then, and rate that it should have had.

    Rates of readings that go back and forth by their rounding are none.
    """
    now, old, rate = HISTORY - 1, HISTORY - 2 - sampler.held[i], sampler.samples[:, 1, i]
    way = sampler.samples[now, 0, i] - sampler.samples[old, 0, i]
    time = sampler.time[now] - sampler.time[old]
    if _is_rounded(sampler, i, way):
        return time, way, way / time
    return time, way, rate[old] if sampler.derived[i] == 1.0 else 0.5 * (rate[old] + rate[now])


@njit_in_place
def _is_rounded(sampler: Sampler, i: int, way: float) -> bool:
    """Whether a change of a reading that was repeated may be that of its rounding.

    One that has gone on at every sample shows no small changes, whatever it is rounded to.
    """
    old, reading = HISTORY - 2 - sampler.held[i], sampler.samples[:, 0, i]
    steady = old > 1 and (reading[old] - reading[old - 1]) * way > 0.0
    steady = steady and (reading[old - 1] - reading[old - 2]) * way > 0.0
    return bool(abs(way) < ROBUST * sampler.grain[i] and not steady)
