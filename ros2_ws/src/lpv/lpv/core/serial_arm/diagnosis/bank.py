"""Bank of hypotheses: how much better each explains the last balances than a healthy arm does.

A hypothesis (a cause that began l balances ago) adds columns A with sizes of prior covariance S to
the rows of the balances, whose residuals r under the null hypothesis (estimate x, information
U^T U) are known.  Its Bayes factor, sizes and arm integrated out, is

    log L = z^T (I + S^-1)^-1 z / 2 - log det(I S + 1) / 2,
    z = -A^T W r,    I = A^T W A - B^T B,  B = U^-T J^T W A.

All columns of one sensor are sums of seven: drift, scale, rate, gain, offset, torque, and a jump
of the rate.  Where a
rate has a sensor of its own, the kinematic row D = y(t) - y(t - lT) - int v dt adds to z and I.

The statistic of detection is M = sum_h w_h sum_l d_l L_h,l over all hypotheses and starts, with
weights that sum to one; a start of the grid stands for the d_l starts up to the next one.  On a
healthy arm its mean is at most the number of decisions (a Shiryaev-Roberts e-detector: Shin,
Ramdas, Rinaldo 2022), so that an alarm at M >= A has a mean time between false alarms of at least
A decisions.  A cause is named by its share of the same sum, weighted by `OCCURRENCE`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import BoolArray, FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis import priors
from lpv.core.serial_arm.diagnosis.balance import DRIFT, GAIN, OFFSET, RATE, SCALE, TORQUE
from lpv.core.serial_arm.diagnosis.contact import (
    force_levers,
    joint_levers,
    new_contact,
    onset_gains,
    rough_contacts,
    smooth_contacts,
    tip_jacobians,
    weigh_residuals,
)
from lpv.core.serial_arm.diagnosis.estimator import ONSET, Horizon, OffsetEstimator, set_residuals
from lpv.core.serial_arm.diagnosis.information import COUNT, NEXT, Posterior, recent
from lpv.core.serial_arm.diagnosis.kinematic_rows import (
    KinematicRows,
    Kinematics,
    learn_rows,
    loudest_window,
    sum_rows,
    take_row,
)
from lpv.core.serial_arm.diagnosis.linear_bank import (
    COLUMNS,
    DRIFT_STARTS,
    JUMP,
    STARTS,
    Evidence,
    Kinds,
    explain,
    gather,
    new_evidence,
    new_rows,
)
from lpv.core.serial_arm.diagnosis.onset import OF_ONE, onsets_beside_rates, sudden_drifts
from lpv.core.serial_arm.diagnosis.published_rates import rate_noise
from lpv.core.serial_arm.diagnosis.sampler import Sampler, block_end, rounding_step, smallest_jump
from lpv.core.serial_arm.diagnosis.stuck import (
    LINEAR,
    Course,
    Frozen,
    at_rest,
    blocks_along,
    course_of_frozen,
    free_course,
)
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import memory, new_record, plain, record_type

_RELATIVE = ('scale', 'torque_gain')
"""Kinds whose sizes are ratios."""
STUCK_FOR = (0.2, 0.4, 1.0)
"""Times for which a joint may have moved while its reading rests [s]."""
ENCODER_KINDS = ('drift', 'scale', 'slip', 'stuck')
"""Faults of a position sensor (with the rate that is derived from it)."""
_KINDS = tuple(priors.OCCURRENCE)
_RATES = np.array([*priors.OCCURRENCE.values()])
_OF_ENCODERS = np.isin(_KINDS, ENCODER_KINDS)
QUIET = 0.25
"""Share of the evidence that an alarm needs, below which the bank has found nothing; from it on
hypotheses that take more time are compared, too."""
QUIET_EVERY = 4
"""Balances after which the bank is asked while it has found nothing, and readings agree."""
NOT_EXCLUDED = 0.5
"""Share of the evidence for free torques that a fault of free course has to have: one encoder's
explained up to 0.2 of pushes, and mostly 0.6 and more where it was wrong."""
CONTACT_TIME = 1.0
"""For which torques from outside must be the cause before they are reported [s]: a fault that
begins shows as free torques first, until its time profile is seen.  Until then faults of free
course are looked for, too.  As long around a contact nothing is learned."""


BANK_STATE = record_type(
    ('statistic', 'f8'),  # logarithm of M of the last decision
    ('waited', 'i8'),  # balances since hypotheses were compared
    ('age', 'i8'),  # balances over which causes may have begun
    ('unchanged', 'i8'),  # balances since an alarm was raised or cleared
    ('windows', 'i8'),  # of the evidence, that the horizon holds
)


class Hypothesis(NamedTuple):
    """One cause with one start, and how well it explains the balances."""

    kind: str
    joint: int  # -1 where no joint is named
    gain: float  # logarithm of the Bayes factor
    size: float  # of the fault: [rad/s], [rad], [-], [N m]
    sigma: float  # standard deviation of size
    begin: float  # [s]
    starts: float = 1.0  # that it stands for
    seen: bool = False  # whether the reading shows it by itself: it froze
    course: Course | None = None  # of a joint whose reading froze
    change: FloatArray | None = None  # of the load, along the payload's rows
    doubt: FloatArray | None = None  # variances of the last balances by stamps [N2 m2 s2]

    @property
    def is_encoder(self) -> bool:
        """Whether a position sensor is to blame."""
        return self.kind in ENCODER_KINDS


_COLUMNS = np.dtype([
    ('kind', 'i8'),  # place in `_KINDS`
    ('single', 'i8'),  # place among those that know more than columns do, or -1
    # As in `Hypothesis`:
    ('joint', 'i8'), ('gain', 'f8'), ('size', 'f8'), ('sigma', 'f8'), ('begin', 'f8'),
    ('starts', 'f8'),
    ('odds', 'f8'),  # logarithm of the odds that it is true, with its prior
])  # fmt: skip


class Compared(NamedTuple):
    """N hypotheses in columns: of a thousand a few are looked at one by one."""

    rows: np.ndarray  # (N,) of `_COLUMNS`
    single: list[Hypothesis]

    @property
    def is_encoder(self) -> BoolArray:
        """Which of them blame a position sensor, shape (N,)."""
        return _OF_ENCODERS[self.rows['kind']]

    def of_kind(self, kind: str) -> BoolArray:
        """Which of them are of a kind, shape (N,)."""
        return np.asarray(self.rows['kind'] == _KINDS.index(kind))

    @property
    def odds(self) -> float:
        """Logarithm of the odds that one of them is true."""
        return float(np.logaddexp.reduce(self.rows['odds']))

    def where(self, chosen: BoolArray) -> 'Compared':
        """Those of them that are chosen."""
        return Compared(self.rows[chosen], self.single)

    def one(self, k: int) -> Hypothesis:
        """The hypothesis of a row."""
        kind, single, *values, _ = self.rows[k].item()
        return self.single[single] if single >= 0 else Hypothesis(_KINDS[kind], *values)


def in_columns(single: list[Hypothesis]) -> np.ndarray:
    """Rows of hypotheses that were compared one by one."""
    return np.array([(_KINDS.index(one.kind), k, *one[1:7], 0.0) for k, one in enumerate(single)],
                    _COLUMNS)  # fmt: skip


def _rows(count: int, **columns: npt.ArrayLike) -> np.ndarray:
    """Rows of hypotheses of which columns know all."""
    rows = np.zeros(count, _COLUMNS)
    rows['single'] = -1
    for name, values in columns.items():
        rows[name] = values
    return rows


class Bank:
    """Bank of one arm; the estimator's posterior is the null hypothesis."""

    def __init__(self, arm: SerialArm, estimator: OffsetEstimator) -> None:
        self.estimator, plan = estimator, estimator.plan
        self._push = push = priors.PUSH * estimator.typical
        starts = np.array([*STARTS, *DRIFT_STARTS])
        lengths = sorted({max(1, round(one)) for one in (starts / plan.interval).tolist()})
        self._recent = round(STARTS[-1] / plan.interval)  # balances
        self._lengths = np.array(lengths)
        # A start of the grid stands for those up to the next longer one.
        self._starts = np.diff([*lengths, 2 * lengths[-1] - lengths[-2]]).astype(float)
        self._outside = new_contact(max(lengths[-1], ONSET + 1), push, plan.interval, plan.capacity)
        self._derived = estimator.balance.derived == 1.0
        self.kinematics = KinematicRows(arm, plan)
        self._evidence = new_evidence(
            self._hypotheses(), self._outside, (self._lengths, self._starts), plan.interval,
            arm.joints_to_sensors(), len(estimator.prior))  # fmt: skip
        state = new_record(BANK_STATE, statistic=-np.inf)
        self._state = plain(state)
        self.parts = BankParts(
            self._evidence, self.kinematics.parts, memory(state), self._log_weight, self._recent,
        )  # fmt: skip

    def _hypotheses(self) -> Kinds:
        """Kinds with their columns as sums of the seven, priors, and the sensors they apply to.

        Columns of drifts and scale errors are zero where these begin, which `gather` adds: by what
        a reading jumped is taken out already.
        """
        n, derived = self.estimator.joints, self._derived
        everywhere = np.ones(n, bool)
        every: list[tuple[str, dict[int, float], np.ndarray]] = [
            ('drift', {DRIFT: 1.0}, everywhere),
            ('scale', {SCALE: 1.0}, everywhere),
            ('slip', {OFFSET: 1.0}, everywhere),
            ('torque_gain', {GAIN: 1.0}, everywhere),
            ('torque_offset', {TORQUE: 1.0}, everywhere),
            ('rate_bias', {RATE: 1.0, JUMP: 1.0}, ~derived),
            # That a rate is independent is a statement of the file, which may be wrong.
            ('drift', {DRIFT: 1.0, RATE: 1.0}, ~derived),
            ('drift', {DRIFT: 1.0, JUMP: 1.0}, derived),
            # It may be older than its window.
            ('drift', {DRIFT: 1.0}, derived),
        ]
        names = [kind for kind, *_ in every]
        self._places = np.array([_KINDS.index(kind) for kind in names])
        applies = np.array([where for *_, where in every], float)
        basis = np.zeros((len(every), COLUMNS))
        for row, (_, parts, _) in zip(basis, every):
            row[list(parts)] = list(parts.values())
        # Of all times in the horizon before the window, the middle.
        older, plan = np.zeros((len(every), len(self._lengths))), self.estimator.plan
        older[-1] = 0.5 * plan.interval * (plan.capacity - self._lengths)
        scale = self.estimator.balance.scale
        prior = np.array([
            self._push if kind == 'torque_offset'
            else priors.SIZE[kind] * (np.ones(n) if kind in _RELATIVE else scale)
            for kind in names
        ])  # fmt: skip
        growing = 'drift', 'rate_bias', 'torque_gain', 'torque_offset'
        recent = self._lengths <= self._recent
        windows = np.array([
            len(recent) if kind in growing else np.count_nonzero(recent) for kind in names
        ])  # fmt: skip
        loads = len(self.estimator.window.loads) > 0
        # Onsets beside rates are those of windows, told more exactly.
        self._log_weight = float(-np.log(3 + applies.sum() + n + derived.sum() + loads))
        return Kinds(basis, prior, applies, windows, older)

    @property
    def statistic(self) -> float:
        """Logarithm of M of the last decision."""
        return float(self._state['statistic'])

    def restart_statistic(self) -> None:
        """Let causes begin from now on only, as after an alarm."""
        self._state['age'] = 0

    def note_change(self) -> None:
        """An alarm was raised or cleared: readings are not corrected as they were before."""
        self._state['unchanged'] = 0

    def compare(
        self, blocks: Callable[[int], FloatArray], stuck: list[Hypothesis], wrong: set[int]
    ) -> Compared:
        """Compare all hypotheses, after `ask_bank`; `statistic` is written.

        ``blocks`` gives the blocks of so many last intervals, oldest first; ``stuck`` comes from
        the method of that name; sensors ``wrong`` had faults in these intervals.
        """
        count, evidence = int(self._state['windows']), self._evidence
        held = self._held(blocks, count)
        single = stuck + self._load_changes(count) + self._stops(held, wrong)
        single += self._wrong_stamps(held)
        if self._derived.any():
            single += self._sudden(blocks, count)
        if self.kinematics.trusted.any():
            single += self._beside_rates(blocks, count)
        pushes = _rows(
            count, kind=_KINDS.index(priors.CONTACT), joint=-1, gain=evidence.contact[:count],
            begin=evidence.begin[:count], starts=self._starts[:count])  # fmt: skip
        rows = np.concatenate([in_columns(single), self._linear(count), pushes])
        # Rows that are near zero throughout, as of a constant reading, say nothing.
        rows = rows[np.isfinite(rows['gain'])]
        total = np.logaddexp.reduce(rows['gain'] + np.log(rows['starts']), initial=-np.inf)
        self._state['statistic'] = total + self._log_weight
        rows['odds'] = rows['gain'] + np.log(rows['starts'] * _RATES[rows['kind']])
        rows['odds'][rows['joint'] >= 0] -= math.log(self.estimator.joints)
        return Compared(rows, single)

    def shares(self, found: Compared) -> list[tuple[Hypothesis, float]]:
        """Of each cause the best hypothesis and the probability, given that there is one cause.

        The most probable one comes first.
        """
        rows, n = found.rows, self.estimator.joints
        # A number for each cause: kinds of one sensor's faults are one.
        causes = np.where(found.is_encoder, -1, rows['kind']) * (n + 1) + rows['joint']
        order = np.argsort(-rows['gain'], kind='stable')
        _, first, places = np.unique(causes[order], return_index=True, return_inverse=True)
        total = np.full(len(first), -np.inf)
        np.logaddexp.at(total, places, rows['odds'][order])
        shares = np.exp(total - np.logaddexp.reduce(total))
        ranks = np.lexsort((first, -shares)).tolist()
        return [(found.one(order[first[k]]), float(shares[k])) for k in ranks]

    def _linear(self, count: int) -> np.ndarray:
        """Rows of faults that are linear in their size, of the evidence."""
        one = self._evidence
        k, i, w = at = np.nonzero(one.gain[..., :count] > -np.inf)
        rows = _rows(
            len(k), kind=self._places[k], joint=i, gain=one.gain[at], size=one.size[at],
            sigma=one.sigma[at], begin=one.begin[w] - one.kinds.older[k, w],
            starts=self._starts[w])  # fmt: skip
        # Rows are linear in small errors alone.
        end, scale = float(self.estimator.times(1)[0]), self.estimator.balance.scale
        small = np.abs(rows['size']) * (end - rows['begin']) < LINEAR * scale[i]
        return np.asarray(rows[small | (rows['kind'] != _KINDS.index('drift'))])

    def _load_changes(self, count: int) -> list[Hypothesis]:
        """Changes of the load, for every balance of the windows from which on it is another one.

        The balances of the change itself are explained by free torques, as those of contacts.
        """
        estimator = self.estimator
        window, null, longest = estimator.window, estimator.posterior, int(self._lengths[count - 1])
        if len(window.loads) == 0 or longest <= ONSET:
            return []
        at = recent(window, longest)
        columns = window.rows[at][:, :, -len(null.mean) :] @ window.loads.T
        estimator.call(set_residuals, window, null, longest + 1)
        gain, change = onset_gains(window, null, columns)
        begins = (window.times[at] - estimator.plan.interval)[ONSET:].tolist()
        evidence = (gain[: len(begins)] + self._free_onsets(longest)[ONSET + 1 :]).tolist()
        return [
            Hypothesis(priors.LOAD, -1, one, 0.0, 0.0, begin, change=moved)
            for one, begin, moved in zip(evidence, begins, change)
        ]

    def _stops(self, held: FloatArray, wrong: set[int]) -> list[Hypothesis]:
        """An arm that came to rest was stopped by torques that no effort tells, as by its brakes.

        What they take from the momentum is what that changes by in the balances of the stop.  The
        joints of all sensors but the ``wrong`` ones rest then: a fault shows in one.  How fast
        the others were is not known.  ``held`` is as of `_held`.
        """
        estimator, plan, n = self.estimator, self.estimator.plan, self.estimator.joints
        last, rates = len(held) // plan.blocks - 1, self._mean_rates(held)
        if last < 1:
            return []
        sensors = [i for i in range(n) if i not in wrong]
        rests = at_rest(rates, estimator.balance.scale, sensors)
        # Joints that stopped in the newest interval rest at its end.
        rests[0] |= at_rest(held[-1, n : 2 * n], estimator.balance.scale, sensors)
        stops = np.flatnonzero(rests[:-1] & ~rests[1:]).tolist()
        if not stops:
            return []
        at = recent(estimator.window, last)
        mass, faulty = estimator.window.momenta[at], sorted(wrong)
        change = np.einsum('bij,bj->bi', mass, rates[:-1] - rates[1:])[:, :, None]
        unknown = mass[:, :, faulty] * priors.USUAL_RATE * estimator.balance.scale[faulty]
        change = np.concatenate([change, unknown], axis=2)
        estimator.call(set_residuals, estimator.window, estimator.posterior, last)
        found, slowly = [], round(priors.STEADY_FOR / plan.interval) + 1
        for stop in stops:
            for count in (ONSET, slowly):  # dead, or within a time
                stopped = np.arange(stop, min(stop + count, last))  # each with a size of its own
                columns = np.zeros((stopped[-1] + 1, n, len(stopped), change.shape[2]))
                columns[stopped, :, np.arange(len(stopped))] = change[stopped]
                found.append(self._impact(priors.CONTACT, columns))
        return found

    def _wrong_stamps(self, held: FloatArray) -> list[Hypothesis]:
        """Readings of all sensors came late, or early, and were smoothed by who resampled them.

        The rates of all joints are off by the same share, for up to three intervals: momenta seem
        to change with it, and to change back.  ``held`` is as of `_held`.
        """
        estimator, n = self.estimator, self.estimator.joints
        window, null = estimator.window, estimator.posterior
        last = len(held) // estimator.plan.blocks - 1
        if last < 1:
            return []
        at = recent(window, last)
        momentum = np.einsum('bij,bj->bi', window.momenta[at], self._mean_rates(held)[:-1])
        estimator.call(set_residuals, window, null, last)
        weights = null.weights[at]
        score = np.diff(weights * null.residual[:last], axis=0, prepend=0.0)
        power = weights + np.pad(weights, ((1, 0), (0, 0)))[:-1]
        gains = (momentum * score).sum(1) ** 2 / (1.0 + (momentum**2 * power).sum(1))
        middle = int(gains.argmax())
        shared = range(max(middle - 1, 0), min(middle + 2, last))
        columns = np.zeros((shared[-1] + 1, n, len(shared)))  # each with a size of its own
        for place, k in enumerate(shared):
            columns[k, :, place] += momentum[k]
            columns[max(k - 1, 0), :, place] -= momentum[k] * (k > 0)
        return [self._impact(priors.STAMPS, columns)._replace(doubt=(columns**2).sum(2))]

    def _impact(self, kind: str, columns: FloatArray) -> Hypothesis:
        """What acts in some balances alone, by columns of unit sizes, shape (last, n, ...)."""
        estimator, last = self.estimator, len(columns)
        columns = columns.reshape(last, estimator.joints, -1)
        gain = onset_gains(estimator.window, estimator.posterior, columns)[0][-1]
        begin = float(estimator.times(last)[0]) - estimator.plan.interval
        return Hypothesis(kind, -1, float(gain), 0.0, 0.0, begin, 0.5)

    def _held(self, blocks: Callable[[int], FloatArray], windows: int) -> FloatArray:
        """Blocks of the balances in which causes of all kinds may have begun, and of one before."""
        last = min(int(self._lengths[windows - 1]), self._recent, len(self.estimator) - 1)
        held, wanted = blocks(last + 1), (last + 1) * self.estimator.plan.blocks
        return held if len(held) == wanted else held[:0]

    def _mean_rates(self, held: FloatArray) -> FloatArray:
        """Of the intervals of these blocks, newest first."""
        n, blocks = self.estimator.joints, self.estimator.plan.blocks
        return np.asarray(held[:, n : 2 * n].reshape(-1, blocks, n).mean(1)[::-1])

    def stuck(
        self, frozen: dict[int, Frozen], blocks: Callable[[int], FloatArray]
    ) -> list[Hypothesis]:
        """Readings that rest while their joints move.

        ``frozen`` holds, by sensor, those that have not changed at all for a conspicuous time;
        ``blocks`` is as in `compare`.
        """
        found, interval = [], self.estimator.plan.interval
        held = blocks(len(self.estimator) + 1)
        for i, one in frozen.items():
            since = held[-1, 3 * self.estimator.joints] - one.time
            # What froze in the same sample goes on, too: gains add up to that of all.
            others = [j for j in frozen if j < i and frozen[j].time == one.time]
            along = held
            for j in others:
                along = blocks_along(self.estimator, j, along, one.time, frozen[j])
            lengths = [round(time / interval) for time in STUCK_FOR if time < since]
            for count in (0, *lengths):
                course = course_of_frozen(self.estimator, i, one, count, along, bool(others))
                if course is None:
                    continue
                rows = count or int(np.ceil(since / interval))
                gain = course.gain + self.kinematics.explained(i, rows)
                way, sigma = float(course.mean[0]), float(course.covariance[0, 0]) ** 0.5
                begin = course.begin
                found.append(Hypothesis('stuck', i, gain, way, sigma, begin, 1.0, one.seen, course))
        return found

    def free_courses(self, found: Compared, sigmas: float) -> dict[int, tuple[float, float]]:
        """Encoders whose faults, of any course, are not excluded by torques from outside.

        Torques of any course explain whatever such faults do: n of them have n times the freedom.
        A fault that explains `NOT_EXCLUDED` as much is as good an explanation.  Of each sensor the
        logarithm of its Bayes factor, and the largest fault within so many ``sigmas`` [rad].
        """
        end, interval = float(self.estimator.times(1)[0]), self.estimator.plan.interval
        since = end - interval - CONTACT_TIME
        pushes = found.where(found.of_kind(priors.CONTACT) & (found.rows['begin'] > since))
        if not pushes.rows['gain'].max(initial=0.0) > 0.0:
            return {}
        contact = pushes.one(int(pushes.rows['gain'].argmax()))
        last = round((end - contact.begin) / interval)
        faults = dict[int, tuple[float, float]]()
        for i, trusted in enumerate(self.kinematics.trusted.tolist()):
            # A rate of its own would have shown that the fault changes.
            gain, size, sigma = free_course(self.estimator, i, last, not trusted)
            if gain > NOT_EXCLUDED * contact.gain:
                faults[i] = gain, abs(size) + sigmas * sigma
        return faults

    def _sudden(self, blocks: Callable[[int], FloatArray], windows: int) -> list[Hypothesis]:
        """Drifts of encoders with derived rates whose onset itself is evidence."""
        estimator = self.estimator
        last = min(int(self._lengths[windows - 1]), len(estimator) - 1) + 1
        held = blocks(last + 1)
        joints = np.flatnonzero(self._derived)
        onsets = sudden_drifts(estimator, joints, last, held)
        return [
            Hypothesis('drift', i, one.gain, one.size, one.sigma, one.begin)
            for i, one in zip(joints.tolist(), onsets)
        ]

    def _beside_rates(self, blocks: Callable[[int], FloatArray], windows: int) -> list[Hypothesis]:
        """Drifts of encoders, and biases of rates beside them, by the moment when they began.

        The momentum seems to jump with a rate, and does not with a reading that begins to drift:
        windows of the bank begin at other moments, and know friction to first order.
        """
        estimator, own = self.estimator, self.kinematics
        last = min(int(self._lengths[windows - 1]), len(estimator) - 1) + 1
        rows = new_rows(last, estimator.joints)
        lengths, interval = np.arange(1, last + 1), estimator.plan.interval
        estimator.call(sum_rows, own.parts, interval, lengths, rows)
        # Less evidence than a hypothesis needs to count at all is none.
        contradict = 0.5 * (rows.weight * rows.found**2).max(axis=0) > -self._log_weight
        joints, hypotheses = np.flatnonzero(contradict), list[Hypothesis]()
        ways = rows.found[:, joints], rows.weight[:, joints]
        for fault in OF_ONE if joints.size else ():
            every = onsets_beside_rates(estimator, joints, fault, ways, blocks(last + 1))
            hypotheses += [
                Hypothesis(fault.kind, i, one.gain, one.size, one.sigma, one.begin, starts)
                for i, (one, starts) in zip(joints.tolist(), every)
            ]
        return hypotheses

    def excludes_contact(self, fault: Hypothesis, margin: float) -> bool:
        """Whether a fault explains more than smooth torques from outside do, in any window.

        Rough torques are a part of the bank; smooth ones cost most, and are evaluated for a fault
        that would be named.  It must explain more by ``margin``.
        """
        estimator, null = self.estimator, self.estimator.posterior
        # Torques that began long before the fault would have to have done nothing until then.
        is_recent = fault.begin >= estimator.times(min(self._recent, len(estimator)))[0]
        longest = min(self._recent if is_recent else np.inf, len(estimator) - 1)
        lengths = self._lengths[(self._lengths <= longest) & (self._lengths > ONSET)]
        begins = np.array([estimator.times(int(one))[0] for one in lengths])
        most = int(lengths.max(initial=0))
        estimator.call(set_residuals, estimator.window, null, most + 1)
        free = self._free_onsets(most)
        for length in lengths[np.argsort(np.abs(begins - fault.begin))].tolist():
            last = length - ONSET
            for levers in (*self._levers(last), self._friction_at_rest(last)):
                every = smooth_contacts(self._outside.smooth, levers, estimator.window, null)
                if any(free[length] + gain > fault.gain - margin for gain in every):
                    return False
        return True

    def _free_onsets(self, longest: int) -> FloatArray:
        """Evidence for free torques in the balances of an onset, by how long ago that began.

        Shape (longest + 1,); from `ONSET` balances on, before the last one.  The posterior must
        hold the residuals, which are weighed.
        """
        estimator, gains = self.estimator, np.zeros(longest + 1)
        null = estimator.posterior
        estimator.call(weigh_residuals, estimator.window, null, longest + 1)
        estimator.call(rough_contacts, self._outside, null, ONSET + 1, gains)
        return gains

    def _friction_at_rest(self, last: int) -> FloatArray:
        """Torques by usual friction of each joint while it rests; levers as of `joint_levers`."""
        one, null = self.estimator, self.estimator.posterior
        levers = joint_levers(null.dry / one.plan.interval, last)
        return self._in_rows(levers * one.window.rest[recent(one.window, last)][:, :, None])

    def friction_gain(self) -> float:
        """What friction that changes as joints come to rest explains, at best; as of a load."""
        one, longest = self.estimator, min(int(self._lengths[-1]), len(self.estimator) - 1)
        columns = one.plan.interval * self._friction_at_rest(longest).swapaxes(1, 2)
        one.call(set_residuals, one.window, one.posterior, longest + 1)
        return float(onset_gains(one.window, one.posterior, columns)[0].max())

    def _levers(self, last: int) -> tuple[FloatArray, FloatArray]:
        """Of torques on single joints, and of a force on the tip."""
        one = self.estimator
        tips = one.call(tip_jacobians, one.balance.chain, one.window, last)
        alone, at_tip = joint_levers(self._push, last), force_levers(tips, self._push)
        return self._in_rows(alone), self._in_rows(at_tip)

    def _in_rows(self, levers: FloatArray) -> FloatArray:
        """Levers, shape (last, G, n), as the rows of the last balances show them."""
        window = self.estimator.window
        mixing = window.mixing[recent(window, len(levers))]
        return np.asarray(levers @ mixing.swapaxes(1, 2))

    def warm_up(self, blocks: FloatArray) -> None:
        """Compile what is called for suspected faults only; ``blocks`` are those of the horizon."""
        estimator = self.estimator
        last = min(self._recent + 1, len(estimator))
        joints = np.arange(estimator.joints)
        found = sudden_drifts(estimator, joints, last, blocks)
        self.excludes_contact(Hypothesis('drift', 0, 0.0, 0.0, 1.0, found[0].begin), 0.0)
        self._beside_rates(lambda _: blocks, 1)
        begin = block_end(blocks[-1]) - 2.0 * estimator.plan.interval
        course_of_frozen(estimator, 0, Frozen(begin, 1.0, 1.0, True), 0, blocks)

    def offset_against_contact(self, joint: int) -> float:
        """Log odds of an offset of one encoder, were it certain, to torques over the horizon.

        Offsets of other encoders are free.  Torques change throughout, as likely beforehand as an
        offset at the first sample, or begin at some time and stay.
        """
        estimator, changing = self.estimator, self._outside.horizon[0]
        null, window, last = estimator.posterior, estimator.window, len(estimator)
        upper = np.triu(null.factor)
        column = np.linalg.solve(upper.T @ upper, np.eye(len(null.mean))[joint])
        variance, offset = column[joint], null.mean[joint]
        held = upper.T @ upper
        held[joint, joint] += 1e6 / variance  # as good as known
        without = null._replace(
            mean=null.mean - column * offset / variance,
            factor=np.ascontiguousarray(np.linalg.cholesky(held).T),
        )
        gain = 0.5 * (offset**2 / variance - np.log(estimator.prior[joint] ** 2 / variance))
        best = -math.inf
        estimator.call(set_residuals, window, without, last)
        throughout = changing, last, math.log(priors.FAULT_AT_START)
        for levers in self._levers(last):
            begun, prior = self._begun(levers, without)
            begins = [(courses, begun, prior) for courses in self._outside.horizon]
            for courses, count, likely in (throughout, *begins):
                (one,) = smooth_contacts((courses,), levers[:count], window, without)
                best = max(best, one + likely)
        return float(gain) - best

    def _begun(self, levers: FloatArray, null: Posterior) -> tuple[int, float]:
        """Balances since torques that stay most likely began, and the log probability beforehand.

        They may have begun at every balance, or in as long a time before the horizon, but not
        before the first sample.  ``null`` must hold the residuals.
        """
        one, last = self.estimator, len(levers)
        columns = one.plan.interval * levers.swapaxes(1, 2)
        balances = np.ones(last)
        balances[-1] += last * (one.window.counters[NEXT] > last)
        each = np.log(priors.OCCURRENCE[priors.CONTACT] / 3600.0 * one.plan.interval * balances)
        likely = onset_gains(one.window, null, columns)[0] + each
        begun = int(likely.argmax())
        # Neighbouring balances that explain as much are as many chances.
        return 1 + begun, float(np.logaddexp.reduce(likely) - likely[begun] + each[begun])


class BankParts(NamedTuple):
    """Memory of the bank."""

    evidence: Evidence
    kinematics: Kinematics
    state: np.ndarray  # memory of a record of `BANK_STATE`
    log_weight: float  # of a hypothesis
    recent: int  # balances in which causes of all kinds may have begun


@njit_in_place
def take_rows(bank: BankParts, blocks: FloatArray, sampler: Sampler) -> None:
    """Take the balance that has joined the horizon; ``blocks`` are those of its two intervals."""
    independent = False
    bank.state[0].age += 1
    bank.state[0].unchanged += 1
    for i in range(bank.kinematics.independent.shape[0]):
        independent = independent or bank.kinematics.independent[i]
        rounded = rounding_step(sampler, i) ** 2 / 6.0  # both ends of a row
        bank.kinematics.ends[i] = max(bank.kinematics.stated[i], rounded)
    if independent:
        take_row(bank.kinematics, blocks, bank.evidence.interval)


@njit_in_place
def ask_bank(
    bank: BankParts,
    horizon: Horizon,
    sampler: Sampler,
    block: FloatArray,
    threshold: float,
    rests: bool,
) -> bool:
    """Evaluate the statistic, every few balances or where there is reason to.

    True if hypotheses have to be compared one by one.  Residuals under the null hypothesis are
    written.  ``block``, shape (3 n + 4,), is the last one; ``rests`` says that a reading is
    conspicuous because it rests.
    """
    evidence, own, state = bank.evidence, bank.kinematics, bank.state[0]
    rows, interval, quiet = evidence.rows, evidence.interval, QUIET * threshold
    state.waited += 1
    if state.waited < QUIET_EVERY and not rests and not loudest_window(own, interval) > quiet:
        return False
    # What is left of a fault that was corrected would pass for a drift that began before.
    longest = min(state.age, max(bank.recent, state.unchanged), horizon.window.counters[COUNT] - 1)
    state.windows = 0
    for length in evidence.lengths:
        state.windows += length <= longest
    if state.windows == 0:
        state.statistic = -np.inf
        return False
    rows.span[:], rows.weight[:], rows.found[:] = 0.0, 0.0, 0.0
    for i in range(evidence.noise.shape[0]):
        rows.reading[i] = block[i] - horizon.balance.reference[i]
        evidence.unseen[i] = smallest_jump(sampler, i)
        evidence.noise[i] = rate_noise(sampler, i, interval)
    sum_rows(own, interval, evidence.lengths[: state.windows], rows)
    every, pushed = gather(evidence, horizon, state.windows)
    state.statistic = np.logaddexp(every, pushed) + bank.log_weight
    found = not state.statistic < quiet
    if found:
        explain(evidence, horizon, state.windows)
    else:
        horizon.window.explained[:] = 0.0
        if own.held[0] > 1:
            learn_rows(own, interval)
    state.waited = QUIET_EVERY if found else 0
    return rests or found
