"""Answers between two decisions of a serial arm: confirmed faults removed, and jumps bridged."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.control.estimate_check import CHANGE_SHARE
from lpv.core.monitoring.carried_motion import (
    CarriedMotion,
    accelerate,
    begin,
    carry,
    correct,
    new_motion,
)
from lpv.core.serial_arm.chain import BoolArray, FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.serial_arm.diagnosis.information import median, median_distance
from lpv.core.serial_arm.diagnosis.monitor import LONGEST_STEP
from lpv.core.serial_arm.diagnosis.sampler import DELAY, JUMP_SCALE
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import record_type
from lpv.core.support.timestamps import NANOSECONDS, NEVER

BRIDGED = DELAY + 1
"""Samples over which a reading that jumps is carried on: by then the jump is known, or has entered
the balance.  For as many more, one that goes on to jump is, which will be noise."""
_COUNTS, _NOISY = 2 * BRIDGED, 2 * BRIDGED + 1
"""In place of their number: the reading counts as it is again; it is noisy."""
RATES = 5
"""Samples of whose rates a reading that begins to be carried on has the median: noise that was too
small for a jump, in the last reading or two, is many times as large in differences."""
_HOLDING = int(Mode.HOLDING)


class Compensation(NamedTuple):
    """What goes on from sample to sample, by sensor; arrays of shape (n,)."""

    applied: FloatArray  # fault that is being removed [rad]
    position: FloatArray  # of the sample before, corrected [rad]
    # of the sample before, corrected, and those before it, newest first, shape (RATES, n) [rad/s]
    velocity: FloatArray
    estimate: FloatArray  # of the sample, less the estimated fault [rad]
    reading: FloatArray  # of the sample before, as it was [rad]
    bridged: IntArray  # samples for which a reading has been carried on
    stamp: IntArray  # of the sample before [ns], shape (1,)
    motion: CarriedMotion
    scale: FloatArray  # what counts as 1 rad in the rate of fading, see `SerialJoint.scale` [rad]
    fastest: FloatArray  # fading, by what joints can follow [rad/s]


class Known(NamedTuple):
    """What holds for all samples until the next decision; arrays of shape (n,)."""

    fault: FloatArray  # at the decision [rad]
    rate: FloatArray  # at which it changes [rad/s]
    confirmed: FloatArray  # part that is beyond doubt, where it is an error [rad]
    growth: FloatArray  # rate at which that part changes [rad/s]
    rate_error: FloatArray  # of a rate sensor; NaN where the reading is differenced [rad/s]
    bound: FloatArray  # of the error of fault [rad]
    threshold: FloatArray  # [rad]
    limit: FloatArray  # change of a reading that may be a jump [rad]
    noise: FloatArray  # variance of a reading that is noisy, else 0 [rad2]
    predicted: FloatArray  # share of an acceleration that torques predict
    missed: FloatArray  # variance of what they do not predict [rad2/s4]
    state: npt.NDArray[np.uint8]
    is_error: BoolArray  # confirmed
    is_derived: BoolArray  # the rate is derived from the reading


def new_known(joints: int) -> Known:
    """No sample has been seen."""
    kinds = {'state': np.uint8, 'is_error': np.bool_, 'is_derived': np.bool_}
    return Known(**{name: np.zeros(joints, kinds.get(name, float)) for name in Known._fields})


FLAGS = record_type(
    ('stamp', 'i8'),  # of the decision [ns]
    ('mode', 'u1'),
    ('trustworthy', '?'),
    ('until', 'i8'),  # trustworthy until a stamp, without another balance [ns]
    ('inconsistent', '?'),
    ('fading', 'f8'),  # rate at which a fault is faded in and out [rad/s]
    ('sample_time', 'f8'),  # [s]
)
"""The same for the arm as a whole."""


class AnswerRows(NamedTuple):
    """Fields of the records of `lpv.core.monitoring.answers.answer_type`, one row a sample."""

    answered: BoolArray
    has_fault: BoolArray
    inconsistent: BoolArray
    position: FloatArray
    velocity: FloatArray
    compensated: FloatArray
    measured: FloatArray
    measured_velocity: FloatArray
    mode: npt.NDArray[np.uint8]
    trustworthy: BoolArray
    estimate: FloatArray
    bound: FloatArray
    threshold: FloatArray
    state: npt.NDArray[np.uint8]
    alarm: npt.NDArray[np.uint8]


def answer_rows(records: npt.NDArray[np.void]) -> AnswerRows:
    """Views of the fields of answers."""
    state, fault = records['state'], records['fault']
    return AnswerRows(
        *(records[name] for name in ('answered', 'has_fault', 'inconsistent')),
        *(state[name] for name in ('position', 'velocity', 'compensated_position')),
        *(state[name] for name in ('measured_position', 'measured_velocity')),
        *(state[name] for name in ('mode', 'trustworthy')),
        *(fault[name] for name in ('estimate', 'bound', 'threshold', 'state', 'alarm')),
    )


def new_compensation(arm: SerialArm) -> Compensation:
    """Nothing is removed yet."""
    n = len(arm.joints)
    applied, position, estimate, reading = np.zeros((4, n))
    with np.errstate(divide='ignore'):  # joints that a sensor does not measure
        joints = (arm.velocity_limit / np.abs(arm.sensors_to_joints().T)).min(1)
    return Compensation(
        applied, position, np.zeros((RATES, n)), estimate, reading, np.zeros(n, np.int64),
        np.array([NEVER]), new_motion(arm), arm.scales(), CHANGE_SHARE * joints,
    )  # fmt: skip


@njit_in_place
def fill_answers(
    work: Compensation,
    rows: AnswerRows,
    first: int,
    part: tuple[int, int],
    stamps: IntArray,
    samples: FloatArray,
    known: Known,
    flags: np.record,
) -> None:
    """Answers to samples in a row: faults by sensor, positions and rates by joint.

    What is removed follows the confirmed fault at a limited rate; jumps were added to
    ``work.applied`` by the caller.

    Answered are samples ``part[0]`` to ``part[1] - 1``; row ``first`` is that of ``samples[0]``.
    Samples, shape (N, 3, n), are readings of the sensors, their rates, efforts, NaN where missing;
    stamps are in [ns].
    """
    for k in range(part[0], part[1]):
        row = first + k
        elapsed = (stamps[k] - flags.stamp) / NANOSECONDS
        interval, follows = 0.0, False  # since the sample before; whether that is near
        if work.stamp[0] != NEVER:
            interval = (stamps[k] - work.stamp[0]) / NANOSECONDS
            follows = interval < LONGEST_STEP * flags.sample_time
        mode = _HOLDING
        for effort in samples[k, 2]:
            mode = flags.mode if np.isfinite(effort) else mode
        if follows:
            work.motion.acceleration[:] = 0.0
            if mode != _HOLDING and work.bridged.any():  # torques hold the weight
                accelerate(work.motion, work.position, work.velocity[0], samples[k, 2], interval)
        for i in range(known.fault.shape[0]):
            fault, confirmed = known.fault[i] + elapsed * known.rate[i], 0.0
            drift, growth = 0.0, 0.0
            if known.is_error[i]:
                growth = known.growth[i]
                confirmed = known.confirmed[i] + elapsed * growth
                drift = growth if known.is_derived[i] else 0.0
            drift += known.rate_error[i]
            measured = samples[k, 0, i], samples[k, 1, i]
            step = interval, follows, flags.fading
            _correct(work, i, measured, (confirmed, drift, growth), known, step)
            work.estimate[i] = work.position[i] + work.applied[i] - fault
            rows.estimate[row, i], rows.bound[row, i] = fault, known.bound[i]
            rows.threshold[row, i], rows.state[row, i] = known.threshold[i], known.state[i]
            rows.alarm[row, i] = known.is_error[i]
        map_vector(work.motion.to_joints, work.position, rows.compensated[row])
        map_vector(work.motion.to_joints, work.velocity[0], rows.velocity[row])
        map_vector(work.motion.to_joints, work.estimate, rows.position[row])
        map_vector(work.motion.to_joints, samples[k, 0], rows.measured[row])
        map_vector(work.motion.to_joints, samples[k, 1], rows.measured_velocity[row])
        rows.answered[row], rows.has_fault[row] = True, True
        rows.inconsistent[row], rows.mode[row] = flags.inconsistent, mode
        rows.trustworthy[row] = flags.trustworthy and stamps[k] <= flags.until
        work.stamp[0] = stamps[k]


@njit_in_place
def _correct(
    work: Compensation,
    i: int,
    measured: tuple[float, float],
    fault: tuple[float, float, float],
    known: Known,
    step: tuple[float, bool, float],
) -> None:
    """Reading and rate of a sensor without the fault; one that jumps or is noisy is carried on.

    ``fault``: of the reading [rad], of the rate, and at which the first one grows [rad/s]; of a
    rate that says nothing NaN.  ``step``: time since the sample before [s], whether that is near,
    rate of fading.
    """
    interval, follows, fading = step
    most = interval * (min(fading * work.scale[i], work.fastest[i]) + abs(fault[2]))
    change = min(max(fault[0] - work.applied[i], -most), most)
    work.applied[i] += change
    before = work.position[i] - change + interval * fault[2]  # as it would be corrected now
    position, velocity = measured[0] - work.applied[i], measured[1] - fault[1]
    if np.isnan(fault[1]):
        velocity = (position - before) / interval if follows else work.velocity[0, i]
    noisy = follows and known.noise[i] > 0.0
    rate = _rate_before(work, i, known) if noisy and _counted(work, i) else work.velocity[0, i]
    carried = before + interval * rate
    if noisy or work.bridged[i] > 0:
        acceleration = _carry(work, i, known, interval)
        carried += 0.5 * interval**2 * acceleration
        rate += interval * acceleration
    rates = work.velocity[:, i]
    change = min(abs(rates[0] - rates[1]), abs(rates[1] - rates[2]))
    largest = known.limit[i] + 2.0 * interval * change
    is_near = abs(position - carried) <= largest
    if follows and not (is_near or noisy) and work.bridged[i] == 0:
        rate = _rate_before(work, i, known)
        carried = before + interval * rate
    goes_on = abs(measured[0] - work.reading[i] - interval * rate) <= largest
    last = BRIDGED if goes_on else _COUNTS
    may_differ = work.bridged[i] > 0 if is_near else follows and work.bridged[i] < last
    if noisy:
        work.bridged[i] = _NOISY
        # Between spikes readings are right.
        noise = min(known.noise[i], largest**2) if is_near else known.noise[i]
        shift, change = correct(work.motion, i, 0, position - carried, noise)
        position, rate = carried + shift, rate + change
        if not (known.is_derived[i] or np.isnan(fault[1])):  # it says what the reading does not
            noise = work.motion.rate_noise[i]
            shift, change = correct(work.motion, i, 1, velocity - rate, noise)
            position, rate = position + shift, rate + change
        velocity = rate
    else:
        # The difference of two readings of which one is carried on, or was, is no rate.
        if may_differ and abs(velocity - rate) * interval > largest:
            velocity = rate
        if is_near or not follows:
            work.bridged[i] = 0
        elif may_differ:
            if work.bridged[i] == 0:
                _carry(work, i, known, interval)
            position = carried
            work.bridged[i] += 1
        else:
            work.bridged[i] = _COUNTS
    work.reading[i] = measured[0]
    work.position[i] = position
    for k in range(RATES - 1, 0, -1):
        rates[k] = rates[k - 1] if follows else velocity
    rates[0] = velocity


@njit_in_place
def _counted(work: Compensation, i: int) -> bool:
    """Whether the last reading counted as it was."""
    return bool(work.bridged[i] == 0 or work.bridged[i] == _COUNTS)


@njit_in_place
def _rate_before(work: Compensation, i: int, known: Known) -> float:
    """Rate at which a reading goes on that is not believed any more [rad/s]."""
    return median(work.velocity[:, i]) if known.is_derived[i] else float(work.velocity[0, i])


@njit_in_place
def _carry(work: Compensation, i: int, known: Known, interval: float) -> float:
    """Carry on a sensor; its acceleration [rad/s2]."""
    if _counted(work, i):
        usual = (known.limit[i] / JUMP_SCALE) ** 2
        error = max(usual, known.noise[i]) if work.bridged[i] == _COUNTS else usual
        rate = work.motion.rate_noise[i]
        if known.is_derived[i]:
            apart = median_distance(work.velocity[:, i], median(work.velocity[:, i]))
            rate = max(2.0 * usual / interval**2, apart * apart)
        begin(work.motion, i, error, rate, known.missed[i])
    return carry(work.motion, i, known.predicted[i], known.missed[i], interval)
