"""Samples in a row: taken, decided on and answered in one compiled call.

`advance` leaves where Python has to do something: a report is due, a reading jumped, a decision
needs what only a suspicion does, or there is more to be known than that nothing is wrong.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.monitoring.compensation import AnswerRows, Compensation, Known, fill_answers
from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.diagnosis.alarms import Mode, SensorState
from lpv.core.serial_arm.diagnosis.decision import Parts, Stage, decide
from lpv.core.serial_arm.diagnosis.linear_bank import STARTS
from lpv.core.serial_arm.diagnosis.sampler import NONE, removed, smallest_jump
from lpv.core.serial_arm.diagnosis.sampling import take_samples
from lpv.core.support.jit import njit_in_one_place, njit_in_place
from lpv.core.support.records import record_type
from lpv.core.support.timestamps import NANOSECONDS
from lpv.core.uio.unknown_input_observer import UioParts, uio_answers

UNWATCHED = round(STARTS[-1] * NANOSECONDS)
"""Time without a complete balance after which faults may have begun that are never found [ns]."""
OK, NOT_DIAGNOSABLE = int(SensorState.OK), int(SensorState.NOT_DIAGNOSABLE)
_TAKE, _DONE, _OBSERVING = int(Stage.TAKE), int(Stage.DONE), int(Mode.OBSERVING)
SAMPLE, REPORT, JUMP, DECIDE, KNOW = range(5)
"""Phases of a sample; Python does what is due of all but the first one: a report of samples that
have been answered, what was found at a sample, stages of the decision, what holds from then on."""
PROGRESS = record_type(
    ('phase', 'i8'),
    ('taken', 'i8'),  # samples
    ('answered', 'i8'),  # samples
    ('reported', 'i8'),  # samples
    ('stamp', 'i8'),  # of the last sample [ns]
    ('next_report', 'i8'),  # that is due [ns]
    ('complete', '?'),  # whether a balance is complete at the last sample
    ('jumped', '?'),  # whether something was found at it
    ('touched', '?'),  # whether Python has had a part in the decision
)


class Answering(NamedTuple):
    """What samples are answered with."""

    work: Compensation
    known: Known
    flags: np.ndarray  # memory of a record of `FLAGS`
    progress: np.ndarray  # memory of a record of `PROGRESS`
    uio: UioParts  # of the designed observer, or of none


@njit_in_one_place
def advance(
    parts: Parts,
    one: Answering,
    rows: AnswerRows,
    first: int,
    stamps: IntArray,
    times: FloatArray,
    samples: FloatArray,
) -> bool:
    """Go on with samples until Python has to do something (true), or all are answered.

    What is decided at a sample counts from this sample on; the designed observer has used all
    samples before it then.

    ``first`` is the row of the first sample.  Samples, shape (N, 3, n), are readings, rates,
    torques, with their stamps [ns] and their times since the first sample of all [s].
    """
    progress, state = one.progress[0], parts.state[0]
    while True:
        if progress.phase == SAMPLE:
            taken, complete, jumped = progress.taken, False, False
            if taken < times.shape[0]:
                taken, complete = take_samples(
                    parts.sampler, parts.horizon.balance, times, samples, taken
                )
                for found in parts.sampler.found:
                    jumped = jumped or found != NONE
                state.now, progress.stamp = times[taken - 1], stamps[taken - 1]
            elif progress.answered == taken:
                return False
            answered = taken - 1 if complete or jumped else taken
            part = progress.answered, answered
            fill_answers(one.work, rows, first, part, stamps, samples, one.known, one.flags[0])
            uio_answers(one.uio, rows, first, part, stamps, samples)
            progress.complete, progress.jumped, progress.touched = complete, jumped, False
            progress.taken, progress.answered, progress.phase = taken, answered, REPORT
            state.stage = _TAKE if complete else _DONE
        if progress.phase == REPORT:
            last = progress.answered - 1
            if progress.reported <= last and stamps[last] >= progress.next_report:
                return True
            progress.reported, progress.phase = progress.answered, JUMP
        if progress.phase == JUMP:
            if progress.jumped:
                return True
            progress.phase = DECIDE
        if progress.phase == DECIDE:
            decide(parts)
            if state.stage != _DONE:
                return True
            progress.phase = KNOW
        if progress.complete or progress.jumped:
            if progress.touched or progress.jumped or not state.usual:
                return True
            _know_nothing_wrong(parts, one, progress.stamp)
        progress.phase = SAMPLE


@njit_in_place
def _know_nothing_wrong(parts: Parts, one: Answering, stamp: int) -> None:
    """Write what holds from a sample on, where nothing is suspected and no reading noisy."""
    state, level, known, flags = parts.state[0], parts.horizon.level, one.known, one.flags[0]
    scale = parts.horizon.balance.scale
    sigmas = state.sigmas
    for i in range(known.fault.shape[0]):
        # An offset that is not confirmed may be none.
        sigma = max(level.sigma[i], abs(level.mean[i]) / sigmas)
        known.confirmed[i] = removed(parts.sampler, i, parts.sampler.raw[i])
        known.fault[i] = known.confirmed[i] + level.mean[i]
        known.rate[i] = known.growth[i] = parts.sampler.drift[i]
        known.rate_error[i] = 0.0
        known.bound[i] = sigmas * sigma
        known.threshold[i] = max(sigmas * sigma, state.smallest * scale[i])
        known.limit[i], known.noise[i] = smallest_jump(parts.sampler, i), 0.0
        known.is_error[i] = False
        known.state[i] = NOT_DIAGNOSABLE if sigma > state.widest * scale[i] else OK
    flags.stamp, flags.trustworthy, flags.inconsistent = stamp, True, False
    flags.mode, flags.until = _OBSERVING, stamp + UNWATCHED
