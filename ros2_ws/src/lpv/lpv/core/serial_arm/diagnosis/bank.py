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
from collections import defaultdict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import RATE_BIAS, SerialArm
from lpv.core.serial_arm.diagnosis.balance import (
    DRIFT,
    EPOCH,
    GAIN,
    OFFSET,
    RATE,
    SCALE,
    TORQUE,
    Balance,
)
from lpv.core.serial_arm.diagnosis.contact import (
    Contact,
    force_levers,
    joint_levers,
    new_contact,
    onset_gains,
    rough_contact,
    smooth_contact,
    weigh_residuals,
)
from lpv.core.serial_arm.diagnosis.estimator import (
    ONSET,
    HorizonPlan,
    OffsetEstimator,
    Posterior,
    set_residuals,
)
from lpv.core.serial_arm.diagnosis.information import (
    COUNT,
    NEXT,
    ROBUST,
    Window,
    factorise,
    recent,
    slot,
    whiten,
)
from lpv.core.serial_arm.diagnosis.linear_bank import (
    COLUMNS,
    JUMP,
    Evidence,
    Kinds,
    Rows,
    gather,
    new_evidence,
    new_rows,
)
from lpv.core.serial_arm.diagnosis.onset import sudden_drifts
from lpv.core.serial_arm.diagnosis.priors import (
    CONTACT,
    FAULT_AT_START,
    LOAD,
    OCCURRENCE,
    POSE_TIME,
    SIZE,
    WRONG_STAMPS,
)
from lpv.core.serial_arm.diagnosis.published_rates import rate_noise
from lpv.core.serial_arm.diagnosis.sampler import DELAY, LATE, NOISE_MEMORY, Sampler, smallest_jump
from lpv.core.serial_arm.diagnosis.stuck import Course, Frozen, course_of_frozen, free_course
from lpv.core.serial_arm.dynamics.momentum import mass_matrix
from lpv.core.serial_arm.sensor_map import map_vector
from lpv.core.support.jit import njit_in_place
from lpv.core.support.records import memory, new_record, plain, record_type

BoolArray = npt.NDArray[np.bool_]
STARTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 1.8, 2.5)
"""Times ago at which a cause may have begun [s]: every one that comes passes each of them."""
DRIFT_STARTS = (3.5, 5.0, 7.0)
"""The same of drifts, which go on growing, and of torques, which may look like them."""
STUCK_FOR = (0.2, 0.4, 1.0)
"""Times for which a joint may have moved while its reading rests [s]."""
ENCODER_KINDS = ('drift', 'scale', 'slip', 'stuck')
"""Faults of a position sensor (with the rate that is derived from it)."""
NEGLIGIBLE = 5e-4
"""Errors of readings, and of rates in a quarter of a second, that are no faults, however little
noise the file states [rad], times `SerialJoint.scale`."""
LOUD = 0.5
"""Share of the evidence that an alarm needs, from which on hypotheses that take more time are
compared, too."""
QUIET = 0.5 * LOUD
"""The same below which the bank has found nothing."""
QUIET_EVERY = 4
"""Balances after which the bank is asked while it has found nothing, and readings agree."""
NOT_EXCLUDED = 0.5
"""Share of the evidence for free torques that a fault of free course has to have: one encoder's
explained up to 0.2 of pushes, and mostly 0.6 and more where it was wrong."""
FREE_FOR = 1.0
"""Longest time over which faults of free course are looked for [s]: one unknown a balance."""
_BEFORE = 1e-12
"""Least variance of a row [rad2]: those of readings without any noise are not divided by zero."""


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

    @property
    def is_encoder(self) -> bool:
        """Whether a position sensor is to blame."""
        return self.kind in ENCODER_KINDS

    @property
    def cause(self) -> tuple[str, int]:
        """What is to blame: kinds of one sensor's faults are one cause."""
        return ('encoder' if self.is_encoder else self.kind, self.joint)


class Bank:
    """Bank of one arm; the estimator's posterior is the null hypothesis.

    ``push``, shape (n,), has standard deviations of torques that may act from outside [N m].
    """

    def __init__(self, arm: SerialArm, estimator: OffsetEstimator, push: FloatArray) -> None:
        self.estimator, plan, n = estimator, estimator.plan, estimator.joints
        self._push = push
        starts = np.array([*STARTS, *DRIFT_STARTS])
        lengths = sorted({max(1, round(one)) for one in (starts / plan.interval).tolist()})
        self._recent = round(STARTS[-1] / plan.interval)  # balances
        self._lengths = np.array(lengths)
        # A start of the grid stands for those up to the next longer one.
        self._starts = np.diff([*lengths, 2 * lengths[-1] - lengths[-2]]).astype(float)
        self._outside = new_contact([*lengths, ONSET + 1], push, plan.interval, plan.capacity)
        self._derived = estimator.balance.derived == 1.0
        self.kinematics = KinematicRows(arm, plan)
        self._mass = np.zeros((plan.capacity, n, n))
        self._hypotheses()
        self._evidence = new_evidence(
            self._lengths, self._starts, self._kinds, len(estimator.prior)
        )
        state = new_record(BANK_STATE, statistic=-np.inf)
        self._state = plain(state)
        self.parts = BankParts(
            self._kinds, self._evidence, self._outside, self.kinematics.parts,
            new_rows(len(lengths), n), self._mass, np.zeros((n, n)),
            arm.sensors_to_joints().T.copy(), arm.joints_to_sensors(), np.zeros(n), np.zeros(n),
            memory(state),
            plan.interval, self._log_weight, self._recent)  # fmt: skip

    def _hypotheses(self) -> None:
        """Kinds with their columns as sums of the seven, priors, and the sensors they apply to.

        Columns of drifts and scale errors are zero at the start of their windows, which `gather`
        adds: by what a reading jumped is taken out already.
        """
        n, derived, everywhere = (
            self.estimator.joints,
            self._derived,
            np.ones(self._push.shape, bool),
        )
        single: list[tuple[str, dict[int, float], np.ndarray]] = [
            ('drift', {DRIFT: 1.0}, everywhere),
            ('scale', {SCALE: 1.0}, everywhere),
            ('slip', {OFFSET: 1.0}, everywhere),
            ('torque_gain', {GAIN: 1.0}, everywhere),
            ('torque_offset', {TORQUE: 1.0}, everywhere),
            ('rate_bias', {RATE: 1.0, JUMP: 1.0}, ~derived),
            # That a rate is independent is a statement of the file, which may be wrong.
            ('drift', {DRIFT: 1.0, RATE: 1.0}, ~derived),
            ('drift', {DRIFT: 1.0, JUMP: 1.0}, derived),
        ]
        # It may be older than its window.
        double = [('drift', {DRIFT: 1.0}, derived)]
        self._names = tuple(kind for kind, *_ in (*single, *double))
        applies = np.array([where for *_, where in (*single, *double)], float)
        basis = np.zeros((len(self._names), COLUMNS))
        for row, (_, parts, _) in zip(basis, (*single, *double)):
            row[list(parts)] = list(parts.values())
        prior = np.array([
            self._push if kind == 'torque_offset' else np.full(n, SIZE[kind])
            for kind in self._names
        ])  # fmt: skip
        growing, recent = ('drift', 'torque_gain', 'torque_offset'), self._lengths <= self._recent
        windows = np.array([
            len(recent) if kind in growing else np.count_nonzero(recent) for kind in self._names
        ])  # fmt: skip
        self._kinds = Kinds(basis, prior, applies, windows, len(single), SIZE['slip'])
        loads = len(self.estimator.window.loads) > 0
        self._log_weight = float(-np.log(1 + applies.sum() + n + derived.sum() + loads))

    @property
    def statistic(self) -> float:
        """Logarithm of M of the last decision."""
        return float(self._state['statistic'])

    def momenta_of(self, joint: int) -> FloatArray:
        """Momenta by a unit rate of one reading, of M S^-1, in the ring of the horizon."""
        momenta: FloatArray = self._mass[:, :, joint]
        return momenta

    def restart_statistic(self) -> None:
        """Let causes begin from now on only, as after an alarm."""
        self._state['age'] = 0

    def note_change(self) -> None:
        """An alarm was raised or cleared: readings are not corrected as they were before."""
        self._state['unchanged'] = 0

    def compare(
        self, blocks: Callable[[int], FloatArray], stuck: list[Hypothesis]
    ) -> list[Hypothesis]:
        """Compare all hypotheses one by one, after `ask_bank`; `statistic` is written.

        The best comes first.  ``blocks`` gives the blocks of so many last intervals, oldest first;
        ``stuck`` comes from the method of that name.
        """
        count = int(self._state['windows'])
        found = stuck + self._named(count) + self._load_changes(count)
        if self._derived.any():
            found += self._sudden(blocks, count)
        # Rows that are near zero throughout, as of a constant reading, say nothing.
        found = [one for one in found if math.isfinite(one.gain)]
        self._state['statistic'] = self._sum(found)
        return sorted(found, key=lambda one: -one.gain)

    def _sum(self, found: list[Hypothesis]) -> float:
        """Logarithm of the statistic."""
        gains = np.array([one.gain + math.log(one.starts) for one in found])
        return float(np.logaddexp.reduce(gains) + self._log_weight) if len(gains) else -np.inf

    def shares(self, found: list[Hypothesis]) -> dict[tuple[str, int], float]:
        """Probability of each cause, given that there is one; the most probable one first."""
        logarithms = defaultdict[tuple[str, int], list[float]](list)
        for one in found:
            rate = OCCURRENCE[one.kind] / (1.0 if one.joint < 0 else self.estimator.joints)
            logarithms[one.cause].append(one.gain + math.log(one.starts * rate))
        values = np.array([np.logaddexp.reduce(every) for every in logarithms.values()])
        shares = np.exp(values - np.logaddexp.reduce(values)).tolist()
        return dict(sorted(zip(logarithms, shares), key=lambda item: -item[1]))

    def _named(self, count: int) -> list[Hypothesis]:
        """Hypotheses of the evidence, and contact, one by one."""
        one = self._evidence
        begin, starts = one.begin[:count].tolist(), self._starts[:count].tolist()
        at = np.nonzero(one.gain[..., :count] > -np.inf)
        values = (part[at].tolist() for part in (one.gain, one.size, one.sigma))
        found = [
            Hypothesis(self._names[k], i, gain, size, sigma, begin[w], starts[w])
            for k, i, w, gain, size, sigma in zip(*(part.tolist() for part in at), *values)
        ]
        contact = zip(one.contact[:count].tolist(), begin, starts)
        return found + [Hypothesis(CONTACT, -1, gain, 0.0, 0.0, *rest) for gain, *rest in contact]

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
        estimator.call(weigh_residuals, window, null, longest + 1)
        begins, onset = window.times[at] - estimator.plan.interval, len(self._lengths)
        found = []
        for last in range(1, longest - ONSET + 1):
            free = estimator.call(rough_contact, self._outside, null, onset, last + ONSET)
            evidence, begin = float(gain[last - 1]) + free, float(begins[last + ONSET - 1])
            found.append(Hypothesis(LOAD, -1, evidence, 0.0, 0.0, begin, change=change[last - 1]))
        return found

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
            lengths = [round(time / interval) for time in STUCK_FOR if time < since]
            for count in (0, *lengths):
                course = self.course(i, one, count, held)
                if course is None:
                    continue
                rows = count or int(np.ceil(since / interval))
                gain = course.gain + self.kinematics.explained(i, rows)
                way, sigma = float(course.mean[0]), float(course.covariance[0, 0]) ** 0.5
                begin = course.begin
                found.append(Hypothesis('stuck', i, gain, way, sigma, begin, 1.0, one.seen, course))
        return found

    def course(
        self, joint: int, frozen: Frozen, balances: int, blocks: FloatArray
    ) -> Course | None:
        """As of `course_of_frozen`."""
        about = self.momenta_of(joint), self._push
        return course_of_frozen(self.estimator, joint, frozen, balances, blocks, about)

    def free_courses(
        self, found: list[Hypothesis], sigmas: float
    ) -> dict[int, tuple[float, float]]:
        """Encoders whose faults, of any course, are not excluded by torques from outside.

        Torques of any course explain whatever such faults do: n of them have n times the freedom.
        A fault that explains `NOT_EXCLUDED` as much is as good an explanation.  Of each sensor the
        logarithm of its Bayes factor, and the largest fault within so many ``sigmas`` [rad].
        """
        end, interval = float(self.estimator.times(1)[0]), self.estimator.plan.interval
        contact = max(
            (one for one in found if one.kind == CONTACT and one.begin > end - FREE_FOR - interval),
            key=lambda one: one.gain,
            default=None,
        )
        if contact is None or contact.gain <= 0.0:
            return {}
        last = round((end - contact.begin) / interval)
        faults = dict[int, tuple[float, float]]()
        for i, trusted in enumerate(self.kinematics.trusted.tolist()):
            # A rate of its own would have shown that the fault changes.
            momenta = self.momenta_of(i)
            gain, size, sigma = free_course(self.estimator, i, last, momenta, not trusted)
            if gain > NOT_EXCLUDED * contact.gain:
                faults[i] = gain, abs(size) + sigmas * sigma
        return faults

    def _sudden(self, blocks: Callable[[int], FloatArray], windows: int) -> list[Hypothesis]:
        """Drifts of encoders with derived rates whose onset itself is evidence."""
        estimator = self.estimator
        last = min(int(self._lengths[windows - 1]), self._recent, len(estimator) - 1) + 1
        held = blocks(last + 1)
        joints = np.flatnonzero(self._derived)
        onsets = sudden_drifts(estimator, joints, SIZE['drift'], last, held, self._mass)
        return [
            Hypothesis('drift', i, one.gain, one.size, one.sigma, one.begin)
            for i, one in zip(joints.tolist(), onsets)
        ]

    def excludes_contact(self, fault: Hypothesis, margin: float) -> bool:
        """Whether a fault explains more than smooth torques from outside do, in any window.

        Rough torques are a part of the bank; smooth ones cost most, and are evaluated for a fault
        that would be named.  It must explain more by ``margin``.
        """
        estimator = self.estimator
        # Torques that began long before the fault would have to have done nothing until then.
        is_recent = fault.begin >= estimator.times(min(self._recent, len(estimator)))[0]
        longest = min(self._recent if is_recent else np.inf, len(estimator) - 1)
        lengths = self._lengths[(self._lengths <= longest) & (self._lengths > ONSET)]
        begins = np.array([estimator.times(int(one))[0] for one in lengths])
        onset = len(self._lengths)
        for w in np.argsort(np.abs(begins - fault.begin)):
            length = int(lengths[w])
            for function in (set_residuals, weigh_residuals):
                estimator.call(function, estimator.window, estimator.posterior, length + 1)
            null = estimator.posterior
            free = estimator.call(rough_contact, self._outside, null, onset, length)
            smooth, last = self._outside.smooth, length - ONSET
            for levers in (*self._levers(last), self._friction_at_rest(last)):
                for courses in smooth:
                    gain = free + smooth_contact(courses, levers, estimator.window, null, last)
                    if gain > fault.gain - margin:
                        return False
        return True

    def _friction_at_rest(self, last: int) -> FloatArray:
        """Torques by usual friction of each joint while it rests; levers as of `joint_levers`."""
        one, null = self.estimator, self.estimator.posterior
        levers = joint_levers(null.dry / one.plan.interval, last)
        return levers * one.window.rest[recent(one.window, last)][:, :, None]

    def _levers(self, last: int) -> tuple[FloatArray, FloatArray]:
        """Of torques on single joints, and of a force on the tip."""
        one = self.estimator
        about = one.balance.chain, self._push, one.window, last
        return joint_levers(self._push, last), one.call(force_levers, *about)

    def warm_up(self, blocks: FloatArray) -> None:
        """Compile what is called for suspected faults only; ``blocks`` are those of the horizon."""
        estimator = self.estimator
        last = min(self._recent + 1, len(estimator))
        joints = np.arange(estimator.joints)
        found = sudden_drifts(estimator, joints, SIZE['drift'], last, blocks, self._mass)
        self.excludes_contact(Hypothesis('drift', 0, 0.0, 0.0, 1.0, found[0].begin), 0.0)

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
        for levers in self._levers(last):
            begun, prior = self._begun(levers, without)
            begins = [(courses, begun, prior) for courses in self._outside.horizon]
            for courses, count, likely in ((changing, last, math.log(FAULT_AT_START)), *begins):
                one = smooth_contact(courses, levers[:count], window, without, count)
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
        each = np.log(OCCURRENCE[CONTACT] / 3600.0 * one.plan.interval * balances)
        likely = onset_gains(one.window, null, columns)[0] + each
        begun = int(likely.argmax())
        # Neighbouring balances that explain as much are as many chances.
        return 1 + begun, float(np.logaddexp.reduce(likely) - likely[begun] + each[begun])


class Kinematics(NamedTuple):
    """Kinematic rows of n sensors; of the first arrays, the last entries hold the rows at hand."""

    rows: FloatArray  # (most, n) D, oldest first [rad]
    variances: FloatArray  # (most, n) of jumps in them [rad2]
    edges: FloatArray  # (most + 1, n) rates where rows begin and end [rad/s]
    held: IntArray  # (1,) rows at hand
    jumps: FloatArray  # (rows, n) variances of jumps in rows to come, the next one first [rad2]
    independent: BoolArray  # (n,) whether the rate has a sensor of its own
    trusted: BoolArray  # (n,) whether it has, and its rows count
    ends: FloatArray  # (n,) variance of a row by the readings at its ends [rad2]
    walk: FloatArray  # (n,) of int v dt, per second [rad2/s]
    bias: FloatArray  # (n,) standard deviation of the rate's bias [rad/s]
    inflation: FloatArray  # (n,) factor of the variance, as seen
    lag: FloatArray  # (n,) of rates behind readings, as differences and filtered ones do [s]
    lag_known: FloatArray  # (n,) its information [1/s2]
    stamps: FloatArray  # (1,) usual variance of a block's time [s2]
    late: FloatArray  # (most + 1,) more of it where stamps are known to be wrong [s2]
    latest: float  # the largest of these that is plausible [s2]
    matrix: FloatArray  # (2, n, n) scratch


class BankParts(NamedTuple):
    """Memory of the bank."""

    kinds: Kinds
    evidence: Evidence
    outside: Contact
    kinematics: Kinematics
    rows: Rows
    mass: FloatArray  # (capacity, n, n) M S^-1 of each balance
    matrix: FloatArray  # (n, n) scratch
    mixing: FloatArray  # (n, n) S^-T
    to_sensors: FloatArray  # (n, n) S
    unseen: FloatArray  # (n,) largest jump of each reading that may not have been seen [rad]
    noise: FloatArray  # (n,) variance of a balance's change of a derived rate, by noise [rad2/s2]
    state: np.ndarray  # memory of a record of `BANK_STATE`
    interval: float  # [s]
    log_weight: float  # of a hypothesis
    recent: int  # balances in which causes of all kinds may have begun


@njit_in_place
def take_rows(bank: BankParts, balance: Balance, window: Window, blocks: FloatArray) -> None:
    """Take the balance that has joined the window; ``blocks`` are those of its two intervals."""
    at, n, independent = slot(window, 0), bank.matrix.shape[0], False
    bank.state[0].age += 1
    bank.state[0].unchanged += 1
    for i in range(n):
        independent = independent or bank.kinematics.independent[i]
    if independent:
        take_row(bank.kinematics, blocks, bank.interval)
    mass_matrix(balance.chain, window.poses[at], balance.work, bank.matrix)
    for i in range(n):
        map_vector(bank.mixing, bank.matrix[i], bank.mass[at, i])


@njit_in_place
def ask_bank(
    bank: BankParts,
    window: Window,
    null: Posterior,
    balance: Balance,
    sampler: Sampler,
    block: FloatArray,
    threshold: float,
    rests: bool,
) -> bool:
    """Evaluate the statistic, every few balances or where there is reason to.

    True if hypotheses have to be compared one by one.  The residuals of ``null`` are written.
    ``block``, shape (3 n + 4,), is the last one; ``rests`` says that a reading is conspicuous
    because it rests.
    """
    state, lengths, n = bank.state[0], bank.evidence.lengths, bank.matrix.shape[0]
    own, rows, quiet = bank.kinematics, bank.rows, QUIET * threshold
    state.waited += 1
    if state.waited < QUIET_EVERY and not rests and not loudest_window(own, bank.interval) > quiet:
        return False
    # What is left of a fault that was corrected would pass for a drift that began before.
    longest = min(state.age, max(bank.recent, state.unchanged), window.counters[COUNT] - 1)
    state.windows = 0
    for length in lengths:
        state.windows += length <= longest
    if state.windows == 0:
        state.statistic = -np.inf
        return False
    rows.span[:], rows.weight[:], rows.found[:] = 0.0, 0.0, 0.0
    for i in range(n):
        rows.reading[i] = block[i] - balance.reference[i]
        bank.unseen[i] = smallest_jump(sampler, i)
        bank.noise[i] = rate_noise(sampler, i, bank.interval)
    sum_rows(own, bank.interval, lengths[: state.windows], rows)
    every, pushed = gather(
        bank.evidence, bank.kinds, window, null, bank.outside, rows, bank.mass,
        bank.to_sensors, (balance.clock[EPOCH], bank.interval), bank.unseen, bank.noise,
        state.windows)  # fmt: skip
    state.statistic = np.logaddexp(every, pushed) + bank.log_weight
    if state.statistic < quiet and own.held[0] > 1:
        learn_rows(own, bank.interval)
    state.waited = 0 if state.statistic < quiet else QUIET_EVERY
    return rests or not state.statistic < LOUD * threshold


@njit_in_place
def take_row(own: Kinematics, blocks: FloatArray, interval: float) -> None:
    """Add the row of the last interval; ``blocks`` are those of two intervals, oldest first."""
    n, last, first = own.lag.shape[0], blocks.shape[0] - 1, blocks.shape[0] // 2 - 1
    usual = interval / (last - first)
    most = own.rows.shape[0]
    if own.held[0] == 0:
        for i in range(n):
            own.edges[most, i] = blocks[first, n + i]
        own.late[most] = blocks[first, 3 * n + 3] ** 2
    own.held[0] = min(own.held[0] + 1, most)
    for k in range(most - own.held[0], most):
        own.late[k] = own.late[k + 1]
        for i in range(n):
            own.edges[k, i] = own.edges[k + 1, i]
            if k + 1 < most:
                own.rows[k, i], own.variances[k, i] = own.rows[k + 1, i], own.variances[k + 1, i]
    own.late[most] = blocks[last, 3 * n + 3] ** 2
    for i in range(n):
        own.edges[most, i] = blocks[last, n + i]
        row, missing = blocks[last, i] - blocks[first, i], 0.0
        for k in range(first, last):
            length = blocks[k + 1, 3 * n] - blocks[k, 3 * n]
            row -= 0.5 * (blocks[k, n + i] + blocks[k + 1, n + i]) * length
            # Where samples are missing, the rate is hardly known.
            gap = max(blocks[k + 1, 3 * n + 1] - usual, 0.0)
            missing += (0.5 * gap * blocks[k + 1, n + i]) ** 2
        change = own.edges[most, i] - own.edges[most - 1, i]
        own.rows[most - 1, i] = row - own.lag[i] * change
        own.variances[most - 1, i] = own.jumps[0, i] + missing
        for k in range(own.jumps.shape[0]):
            own.jumps[k, i] = own.jumps[k + 1, i] if k + 1 < own.jumps.shape[0] else 0.0
        if own.trusted[i]:
            _learn_lag(own, i, interval)


@njit_in_place
def _learn_lag(own: Kinematics, i: int, interval: float) -> None:
    """Learn by how much a rate lags behind its reading, and take it out of all rows.

    A lag d moves a row by d times the change of its rate, which no fault does: it is learned
    from all rows, outliers bounded.
    """
    most = own.rows.shape[0]
    variance = own.inflation[i] * (own.ends[i] + own.walk[i] * interval)
    variance = max(variance + own.variances[most - 1, i], _BEFORE)
    change = own.edges[most, i] - own.edges[most - 1, i]
    bound = ROBUST * np.sqrt(variance + change * change / own.lag_known[i])
    own.lag_known[i] += change * change / variance
    step = min(max(own.rows[most - 1, i], -bound), bound) * change / variance / own.lag_known[i]
    own.lag[i] += step
    for k in range(most - own.held[0], most):
        own.rows[k, i] -= step * (own.edges[k + 1, i] - own.edges[k, i])


@njit_in_place
def loudest_window(own: Kinematics, interval: float) -> float:
    """Largest evidence against healthy sensors of the sums of any number of last rows."""
    most, largest = own.rows.shape[0], 0.0
    for i in range(own.rows.shape[1]):
        if not own.trusted[i]:
            continue
        total, jumps = 0.0, 0.0
        for k in range(own.held[0]):
            at, span = most - 1 - k, interval * (k + 1)
            total += own.rows[at, i]
            jumps += own.variances[at, i]
            variance = own.inflation[i] * (own.ends[i] + own.walk[i] * span)
            variance += (own.bias[i] * span) ** 2 + jumps
            largest = max(largest, 0.5 * total * total / max(variance, _BEFORE))
    return largest


@njit_in_place
def sum_rows(own: Kinematics, interval: float, lengths: IntArray, rows: Rows) -> None:
    """Write the sums of the rows of windows; see `KinematicRows.sums`."""
    n, most, held = own.lag.shape[0], own.rows.shape[0], own.held[0]
    for w in range(lengths.shape[0]):
        count = min(lengths[w], held)
        if count == 0:
            continue
        rows.span[w] = interval * count
        for i in range(n):
            if own.trusted[i]:
                jumps = 0.0
                for k in range(most - 1, most - 1 - count, -1):
                    rows.found[w, i] += own.rows[k, i]
                    jumps += own.variances[k, i]
                variance = own.inflation[i] * (own.ends[i] + own.walk[i] * rows.span[w])
                variance = max(variance + (own.bias[i] * rows.span[w]) ** 2 + jumps, _BEFORE)
                turned = own.edges[most, i] - own.edges[most - count, i]
                rows.weight[w, i] = 1.0 / (variance + turned * turned / own.lag_known[i])
        _doubt_stamps(own, count, rows.weight[w], rows.found[w])


@njit_in_place
def _doubt_stamps(own: Kinematics, count: int, weight: FloatArray, found: FloatArray) -> None:
    """Let sums say what they do where stamps of both ends of their window may be wrong.

    These are common to all sensors: their covariance is s v v^T.
    """
    n, most, matrix, inverse = weight.shape[0], own.rows.shape[0], own.matrix[0], own.matrix[1]
    now, then = own.edges[most], own.edges[most - count]
    late, old = own.stamps[0] + own.late[most], own.stamps[0] + own.late[most - count]
    if late + old == 0.0:
        return
    for i in range(n):
        for j in range(n):
            counts = weight[i] > 0.0 and weight[j] > 0.0
            both = late * now[i] * now[j] + old * then[i] * then[j] if counts else 0.0
            matrix[i, j], inverse[i, j] = both, 1.0 if i == j else 0.0
        matrix[i, i] += 1.0 / weight[i] if weight[i] > 0.0 else 1.0
    factorise(matrix, own.ends)  # no pivot is smaller than what readings alone leave
    whiten(matrix, inverse)
    for k in range(n):  # U^-T times the sums, in place of a column of the factor
        matrix[k, 0] = 0.0
        for j in range(k + 1):
            matrix[k, 0] += inverse[k, j] * found[j]
    for i in range(n):
        if weight[i] > 0.0:
            weight[i], total = 0.0, 0.0
            for k in range(i, n):
                weight[i] += inverse[k, i] * inverse[k, i]
                total += inverse[k, i] * matrix[k, 0]
            found[i] = total / weight[i]


@njit_in_place
def learn_rows(own: Kinematics, interval: float) -> None:
    """Learn how much rows scatter; constant errors of rates do not count as scatter."""
    n, most, power, late = own.lag.shape[0], own.rows.shape[0], 0.0, 0.0
    for i in range(n):
        expected = max(3.0 * own.ends[i] + 2.0 * own.walk[i] * interval, _BEFORE)
        change = own.rows[most - 1, i] - own.rows[most - 2, i]
        bounded = min(change * change / expected, ROBUST**2 * own.inflation[i])
        own.inflation[i] = max(own.inflation[i] + (bounded - own.inflation[i]) / NOISE_MEMORY, 1.0)
        if own.trusted[i]:
            rate = own.edges[most - 1, i]
            power += rate * rate / expected
            late += rate / expected * change
    # An error d of a stamp moves the rows of all sensors by their rates.  The difference of two
    # rows holds d of three blocks, once, twice and once.
    # Where the joints are slow it says little of them.
    known = 6.0 * power * WRONG_STAMPS * own.latest
    if known > 0.0:
        seen = min(((late / power) ** 2 - 1.0 / power) / 6.0, own.latest)
        share = (known / (1.0 + known)) ** 2 / NOISE_MEMORY
        own.stamps[0] = max(own.stamps[0] + share * (seen - own.stamps[0]), 0.0)


class KinematicRows:
    """D = y(t) - y(t - T) - int v dt of every interval, for sensors with rates of their own."""

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        sensors = [joint.sensors for joint in arm.joints]
        self._interval, n = plan.interval, len(sensors)
        reading = np.array([
            one.position_noise**2 + one.quantization**2 / 12.0 for one in sensors
        ])  # fmt: skip
        rate = np.array([one.velocity_noise for one in sensors])
        least, most = NEGLIGIBLE * arm.scales(), round(DRIFT_STARTS[-1] / plan.interval) + 1
        latest = (LATE * arm.sample_time) ** 2 / plan.per_block
        independent = np.array([one.rates == 'independent' for one in sensors])
        self.parts = Kinematics(
            np.zeros((most, n)), np.zeros((most, n)), np.zeros((most + 1, n)),
            np.zeros(1, np.int64), np.zeros((2 + DELAY // (plan.per_block * plan.blocks), n)),
            independent, independent.copy(),
            2.0 * reading / plan.per_block + least**2, rate**2 * arm.sample_time,
            np.maximum(RATE_BIAS * rate, 4.0 * least), np.ones(n), np.zeros(n),
            np.full(n, 1.0 / arm.sample_time**2), np.array([WRONG_STAMPS * latest]),
            np.zeros(most + 1),
            latest, np.zeros((2, n, n)))  # fmt: skip
        self._independent, self.trusted = self.parts.independent, self.parts.trusted

    @property
    def _rows(self) -> FloatArray:
        """Rows at hand, oldest first."""
        return self.parts.rows[len(self.parts.rows) - self.parts.held[0] :]

    def restart(self) -> None:
        """Forget the rows so far, after a gap."""
        self.parts.held[:] = 0
        self.parts.jumps[:] = 0.0

    def note_jump(self, joint: int, variance: float) -> None:
        """A jump was taken out of readings that are still to come, with some error [rad2]."""
        # It may belong to any row that holds samples which wait.
        self.parts.jumps[:, joint] += variance

    def leave_out(self, joint: int, out: bool) -> None:
        """Do without the rows of a joint one of whose sensors has failed, or with those to come."""
        self.trusted[joint] = self._independent[joint] and not out
        self.forget(joint)

    def forget(self, joint: int) -> None:
        """Do without the rows of a joint so far."""
        self._rows[:, joint] = 0.0

    def last(self, joint: int) -> tuple[float, float] | None:
        """Last row of a joint and its variance [rad], [rad2]; None where there is none."""
        if not self._independent[joint] or len(self._rows) == 0:
            return None
        return self._told(joint, 1)

    @property
    def held(self) -> int:
        """Rows at hand."""
        return len(self._rows)

    def way(self, joint: int, count: int) -> tuple[float, float] | None:
        """How far the rate sensor of a joint says that it went while its reading rested.

        Way in the last ``count`` intervals and its standard deviation [rad]; None without a rate
        of its own.
        """
        count = min(max(count, 1), self.held)
        if not self.trusted[joint] or count == 0:
            return None
        total, variance = self._told(joint, count)
        return -total, variance**0.5

    def explained(self, joint: int, count: int) -> float:
        """What a reading that rests explains of the last rows: all of it."""
        count = min(count, self.held)
        if not self.trusted[joint] or count == 0:
            return 0.0
        total, variance = self._told(joint, count)
        return 0.5 * total**2 / variance

    def _told(self, joint: int, count: int) -> tuple[float, float]:
        """Sum of so many last rows of a joint and its variance [rad], [rad2].

        If intervals were not as long as their stamps say, all rows are off by the rates: what the
        other joints show of it is taken out.
        """
        own, rows = self.parts, self._rows[-count:]
        rates, jumps = 0.5 * (own.edges[1:] + own.edges[:-1])[-count:], own.variances[-count:]
        usual = own.inflation * (own.ends + own.walk * self._interval) + jumps
        weights = self.trusted * rates / np.maximum(usual, _BEFORE)
        weights[:, joint] = 0.0
        known = (weights * rates).sum(1) + 1.0 / own.latest
        late, rate = (weights * rows).sum(1) / known, rates[:, joint]
        span, jumped = self._interval * count, float(jumps[:, joint].sum())
        variance = own.inflation * (own.ends + own.walk * span) + (own.bias * span) ** 2
        by_stamps = float((rate**2 / known).sum())
        total = float((rows[:, joint] - late * rate).sum())
        return total, max(float(variance[joint]) + jumped + by_stamps, _BEFORE)

    def agrees(self, joint: int, taken_out: float) -> float:
        """For how long the rows of late are those of healthy sensors, 0 where they are not [s].

        What is taken out of the rate [rad/s] is not in the rows.  They go back for a pose at
        least, and until they tell a rate that is right again from one that is not.
        """
        count = min(round(POSE_TIME / self._interval), self.held)
        while count > 0:
            total, variance = self._told(joint, count)
            error = taken_out * count * self._interval
            if error**2 > (2.0 * ROBUST) ** 2 * variance or error == 0.0 or count == self.held:
                left = abs(total - error)
                is_right = left < ROBUST * variance**0.5 and left <= abs(total)
                return count * self._interval if is_right else 0.0
            count = min(2 * count, self.held)
        return 0.0
