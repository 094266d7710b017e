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

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import FloatArray, IntArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.balance import DRIFT, EPOCH, GAIN, OFFSET, RATE, SCALE, TORQUE
from lpv.core.serial_arm.diagnosis.contact import (
    force_levers,
    joint_levers,
    new_contact,
    rough_contact,
    smooth_contact,
    weigh_residuals,
)
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan, OffsetEstimator, set_residuals
from lpv.core.serial_arm.diagnosis.information import ROBUST, slot
from lpv.core.serial_arm.diagnosis.linear_bank import (
    COLUMNS,
    JUMP,
    ONSET,
    Kinds,
    Rows,
    gather,
    new_evidence,
)
from lpv.core.serial_arm.diagnosis.onset import explained_at_onsets, sudden_drift_of
from lpv.core.serial_arm.diagnosis.sampling import LATE
from lpv.core.serial_arm.diagnosis.stuck import stuck_bayes_factor
from lpv.core.serial_arm.dynamics.momentum import mass_matrix
from lpv.core.serial_arm.sensor_map import map_rows, mixing
from lpv.core.support.jit import njit_in_place

BoolArray = npt.NDArray[np.bool_]
CONTACT = 'contact'
"""Unknown torques on all joints: something pushes or holds the arm, or its load has changed."""
STARTS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 1.8, 2.5)
"""Times ago at which a cause may have begun [s]: every one that comes passes each of them."""
STUCK_FOR = (0.2, 0.4, 1.0)
"""Times for which a joint may have moved while its reading rests [s]."""
OCCURRENCE = {
    CONTACT: 1.0,
    **dict.fromkeys(
        ('drift', 'scale', 'slip', 'stuck', 'rate_bias', 'torque_gain', 'torque_offset'), 0.01
    ),
}
"""How often causes come, per hour of motion: a push every hour, one fault of a kind in 100 h.  Only
ratios count.  Torque sensors fail as often as encoders do."""
ENCODER_KINDS = ('drift', 'scale', 'slip', 'stuck')
"""Faults of a position sensor (with the rate that is derived from it)."""
SIZE = {'drift': 0.3, 'slip': 0.2, 'scale': 0.2, 'rate_bias': 0.3, 'torque_gain': 0.5}
"""Standard deviations of faults' sizes [rad/s], [rad], [-], [rad/s], [-]."""
RATE_BIAS = 0.1
"""Bias of a healthy rate sensor, over its noise a sample."""
NEGLIGIBLE = 5e-4
"""Errors of readings, and of rates in a quarter of a second, that are no faults, however little
noise the file states [rad], times `SerialJoint.scale`."""
WRONG_STAMPS = 0.01
"""Share of stamps that are wrong, before any were seen."""
LARGEST_SCALE = 0.5
"""Largest scale error that is looked for in jumps [-]."""
QUIET, LOUD = 0.25, 0.5
"""Shares of the evidence that an alarm needs: below the first one the bank has found nothing, from
the second one on hypotheses that take more time are compared, too."""
QUIET_EVERY = 4
"""Balances after which the bank is asked while it has found nothing, and readings agree."""
_BEFORE = 1e-12


@dataclass(frozen=True)
class Hypothesis:
    """One cause with one start, and how well it explains the balances."""

    kind: str
    joint: int  # -1 where no joint is named
    gain: float  # logarithm of the Bayes factor
    size: float  # of the fault: [rad/s], [rad], [-], [N m]
    sigma: float  # standard deviation of size
    begin: float  # [s]
    starts: float = 1.0  # that it stands for

    @property
    def is_encoder(self) -> bool:
        """Whether a position sensor is to blame."""
        return self.kind in ENCODER_KINDS

    @property
    def cause(self) -> tuple[str, int]:
        """What is to blame: kinds of one sensor's faults are one cause."""
        return ('encoder' if self.is_encoder else self.kind, self.joint)


class Bank:
    """Bank of one arm.

    Parameters
    ----------
    arm : SerialArm
        Its sensors.
    estimator : OffsetEstimator
        Of the arm; its posterior is the null hypothesis.
    push : ndarray, shape (n,)
        Standard deviation of torques that may act from outside [N m].

    Attributes
    ----------
    statistic : float
        Logarithm of M of the last decision.
    """

    def __init__(self, arm: SerialArm, estimator: OffsetEstimator, push: FloatArray) -> None:
        self.estimator, plan, n = estimator, estimator.plan, estimator.joints
        self._push, self.statistic = push, -np.inf
        self._to_sensors = arm.joints_to_sensors()
        self._mixing = mixing(arm.sensors_to_joints().T)
        lengths = sorted({max(1, round(one / plan.interval)) for one in STARTS})
        self._lengths = np.array(lengths)
        # A start of the grid stands for those up to the next longer one.
        self._starts = np.diff([*lengths, 2 * lengths[-1] - lengths[-2]]).astype(float)
        self._outside = new_contact([*lengths, ONSET + 1], push, plan.interval, plan.capacity)
        self._derived = estimator.balance.derived == 1.0
        self._kinematics = KinematicRows(arm, plan)
        self._waited, self._age = 0, 0
        self._jumped: list[tuple[float, float, float] | None] = [None] * n
        self._mass = np.zeros((plan.capacity, n, n))
        self._hypotheses()
        self._evidence = new_evidence(
            self._lengths, self._starts, self._kinds, len(estimator.prior)
        )

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
        self._kinds = Kinds(basis, prior, applies, len(single), SIZE['slip'])
        self._log_weight = -np.log(1 + applies.sum() + n)

    def take(self, blocks: FloatArray) -> None:
        """Take the blocks of the last two intervals, rows as of `Sampler.blocks`."""
        self._age += 1
        self._kinematics.take(blocks)
        window, balance = self.estimator.window, self.estimator.balance
        at = slot(window, 0)
        mass_matrix(balance.chain, window.poses[at], balance.work, self._mass[at])
        if self._mixing is not None:
            self._mass[at] = map_rows(self._mixing, self._mass[at])

    def momenta(self, back: int) -> FloatArray:
        """Momenta by unit rates of the readings, M S^-1, at one of the last balances."""
        return np.asarray(self._mass[slot(self.estimator.window, back)])

    def restart(self) -> None:
        """Begin again after a gap."""
        self._kinematics.restart()

    def restart_statistic(self) -> None:
        """Let causes begin from now on only, as after an alarm."""
        self._age = 0

    def leave_out_rate(self, joint: int, out: bool) -> None:
        """Do without the kinematic rows of a joint one of whose sensors has failed, or not."""
        self._kinematics.leave_out(joint, out)

    def rate_row(self, joint: int) -> tuple[float, float] | None:
        """Last kinematic row of a joint and its variance [rad], [rad2]; None without one."""
        return self._kinematics.last(joint)

    def way(self, joint: int, count: int) -> tuple[float, float] | None:
        """How far the rate sensor of a joint says that it went while its reading rested.

        Way in the last ``count`` intervals and its standard deviation [rad]; None without a rate
        of its own.
        """
        return self._kinematics.way(joint, count)

    def note_jump(self, joint: int, time: float, size: tuple[float, float], reading: float) -> None:
        """A reading jumped, and the jump was taken out: it may have been a scale error's.

        Parameters
        ----------
        joint : int
            Of the sensor.
        time : float
            Of the jump [s].
        size : tuple of float
            Of the jump, with its standard deviation [rad].
        reading : float
            Without the jump [rad].
        """
        self._kinematics.note_jump(joint, size[1] ** 2)
        jumped = abs(size[0]) < LARGEST_SCALE * abs(reading)
        found = time, size[0] / reading, size[1] / abs(reading)
        self._jumped[joint] = found if jumped else None

    def _scales_that_jumped(self, count: int) -> list[Hypothesis]:
        """Scale errors of the sizes that jumps of the readings had."""
        found, windows = [], self._evidence
        for i, jump in enumerate(self._jumped):
            if jump is None:
                continue
            time, share, sigma = jump
            # It goes on as it began: a change in proportion to the way, by a share that is known.
            since = time - 2.0 * self.estimator.plan.interval
            for w in np.nonzero(windows.begin[:count] >= since)[0]:
                column = np.zeros(COLUMNS)
                column[SCALE], column[OFFSET] = 1.0, -windows.pose[w, i]
                power = float(column @ windows.information[w, i] @ column) + sigma**-2
                pull = column @ windows.score[w, i] + share / sigma**2
                gain = pull**2 / power - (share / sigma) ** 2 - np.log(power * sigma**2)
                found.append(Hypothesis(
                    'scale', i, 0.5 * float(gain), float(pull / power), power**-0.5,
                    float(windows.begin[w]), float(self._starts[w])))  # fmt: skip
        return found

    def rate_agrees(self, joint: int, taken_out: float) -> bool:
        """Whether rate and encoder of a joint have agreed of late, but for what is taken out."""
        return self._kinematics.agrees(joint, taken_out)

    def evaluate(
        self,
        blocks: Callable[[int], FloatArray],
        rest: tuple[FloatArray, FloatArray],
        unseen: FloatArray,
        threshold: float,
    ) -> list[Hypothesis]:
        """Compare all hypotheses; `statistic` is written.

        Parameters
        ----------
        blocks : callable
            Blocks of so many last intervals, oldest first.
        rest : tuple of ndarray, shape (n,)
            For how long each reading has not changed at all [s], 0 where it is not conspicuous;
            and its speed before [rad/s].
        unseen : ndarray, shape (n,)
            Largest jump of each reading that may not have been seen [rad].
        threshold : float
            Of the statistic: hypotheses that take more time are left out well below.

        Returns
        -------
        list of Hypothesis
            The best first.
        """
        stuck = self._stuck(*rest)
        self._waited += 1
        if (
            self._waited < QUIET_EVERY
            and not stuck
            and not self._kinematics.speaks(QUIET * threshold)
        ):
            return []
        count = self._held()
        if count == 0:
            self.statistic = -np.inf
            return []
        every, pushed = self._gather(count, blocks(1)[-1], unseen)
        self.statistic = float(np.logaddexp(every, pushed) + self._log_weight)
        self._kinematics.learn(self.statistic < QUIET * threshold)
        self._waited = 0 if self.statistic < QUIET * threshold else QUIET_EVERY
        if self.statistic < LOUD * threshold and not stuck:
            return []
        found = stuck + self._named(count) + self._scales_that_jumped(count)
        if self._derived.any():
            found += self._sudden(blocks, count)
        # Rows that are near zero throughout, as of a constant reading, say nothing.
        found = [one for one in found if np.isfinite(one.gain)]
        self.statistic = self._sum(found)
        return sorted(found, key=lambda one: -one.gain)

    def _sum(self, found: list[Hypothesis]) -> float:
        """Logarithm of the statistic."""
        gains = np.array([one.gain + np.log(one.starts) for one in found])
        return float(np.logaddexp.reduce(gains) + self._log_weight) if len(gains) else -np.inf

    def shares(self, found: list[Hypothesis]) -> dict[tuple[str, int], float]:
        """Probability of each cause, if one of them there is; the most probable one first.

        Parameters
        ----------
        found : list of Hypothesis
            Of `evaluate`.
        """
        joints = self.estimator.joints
        logarithms: dict[tuple[str, int], float] = {}
        for one in found:
            rate = OCCURRENCE[one.kind] / (1.0 if one.kind == CONTACT else joints)
            value = one.gain + np.log(one.starts * rate)
            logarithms[one.cause] = np.logaddexp(logarithms.get(one.cause, -np.inf), value)
        total = np.logaddexp.reduce(np.array(list(logarithms.values())))
        shares = {cause: float(np.exp(value - total)) for cause, value in logarithms.items()}
        return dict(sorted(shares.items(), key=lambda item: -item[1]))

    def _held(self) -> int:
        """Windows that the horizon holds."""
        held = min(len(self.estimator), self._age + 1)
        return int((self._lengths < held).sum())

    def _gather(self, count: int, block: FloatArray, unseen: FloatArray) -> tuple[float, float]:
        """Write the evidence of so many windows; the last block holds the readings."""
        estimator = self.estimator
        balance = estimator.balance
        frame = self._to_sensors, balance.reference
        times = float(balance.clock[EPOCH]), estimator.plan.interval
        rows = self._kinematics.sums(self._lengths[:count], block)
        return gather(
            self._evidence, self._kinds, estimator.window, estimator.posterior, self._outside,
            rows, self._mass, frame, times, unseen, count)  # fmt: skip

    def _named(self, count: int) -> list[Hypothesis]:
        """Hypotheses of the evidence, and contact, one by one."""
        one, starts = self._evidence, self._starts
        gains = one.gain[..., :count]
        found = [
            Hypothesis(self._names[k], int(i), float(gains[k, i, w]), float(one.size[k, i, w]),
                       float(one.sigma[k, i, w]), float(one.begin[w]), float(starts[w]))
            for k, i, w in zip(*np.nonzero(gains > -np.inf))
        ]  # fmt: skip
        found += [
            Hypothesis(CONTACT, -1, float(gain), 0.0, 0.0, float(one.begin[w]), float(starts[w]))
            for w, gain in enumerate(one.contact[:count])
        ]
        return found

    def _stuck(self, resting: FloatArray, speed: FloatArray) -> list[Hypothesis]:
        """Readings that rest while their joints move."""
        found, interval = [], self.estimator.plan.interval
        for i in np.nonzero(resting)[0]:
            longest = min(int(np.ceil(resting[i] / interval)) + 1, len(self.estimator))
            for count in sorted({min(round(one / interval), longest) for one in STUCK_FOR}):
                if count < 2:
                    continue
                before = 0.1 if count < longest else float(speed[i])
                gain, *rest = stuck_bayes_factor(self.estimator, int(i), count, before)
                gain += self._kinematics.explained(int(i), count)
                found.append(Hypothesis('stuck', int(i), gain, *rest))
        return found

    def _sudden(self, blocks: Callable[[int], FloatArray], windows: int) -> list[Hypothesis]:
        """Drifts of encoders with derived rates whose onset itself is evidence."""
        estimator = self.estimator
        last = min(int(self._lengths[windows - 1]) + 1, len(estimator))
        free = explained_at_onsets(self._outside, estimator, len(self._lengths), last)
        held = blocks(last + 1)
        found = []
        for i in np.nonzero(self._derived)[0]:
            one = sudden_drift_of(estimator, int(i), SIZE['drift'], free, held, self._mass)
            if one.gain > -np.inf:
                found.append(Hypothesis('drift', int(i), one.gain, one.size, one.sigma, one.begin))
        return found

    def excludes_contact(self, fault: Hypothesis, margin: float) -> bool:
        """Whether a fault explains more than smooth torques from outside do, in any window.

        Rough torques are a part of the bank; smooth ones cost most, and are evaluated for a fault
        that would be named.

        Parameters
        ----------
        fault : Hypothesis
            What is to be named.
        margin : float
            By which it must explain more.
        """
        estimator = self.estimator
        lengths = self._lengths[(self._lengths < len(estimator)) & (self._lengths > ONSET)]
        begins = np.array([estimator.times(int(one))[0] for one in lengths])
        onset = len(self._lengths)
        for w in np.argsort(np.abs(begins - fault.begin)):
            length = int(lengths[w])
            set_residuals(estimator.window, estimator.posterior, length + 1)
            weigh_residuals(estimator.window, estimator.posterior, length + 1)
            free = rough_contact(self._outside, estimator.posterior, onset, length)
            for levers in self._levers(length - ONSET):
                for courses in self._outside.smooth:
                    gain = free + smooth_contact(
                        courses, levers, estimator.window, estimator.posterior, length - ONSET
                    )
                    if gain > fault.gain - margin:
                        return False
        return True

    def _levers(self, last: int) -> tuple[FloatArray, FloatArray]:
        """Of torques on single joints, and of a force on the tip."""
        chain = self.estimator.balance.chain
        return (
            joint_levers(self._push, last),
            force_levers(chain, self._push, self.estimator.window, last),
        )

    def warm_up(self, blocks: FloatArray) -> None:
        """Compile what is called for suspected faults only; ``blocks`` are those of the horizon."""
        estimator = self.estimator
        last = min(int(self._lengths[-1]) + 1, len(estimator))
        free = explained_at_onsets(self._outside, estimator, len(self._lengths), last)
        found = sudden_drift_of(estimator, 0, SIZE['drift'], free, blocks, self._mass)
        self.excludes_contact(Hypothesis('drift', 0, 0.0, 0.0, 1.0, found.begin), 0.0)

    def offset_against_contact(self, joint: int) -> float:
        """Log Bayes factor of an offset of one encoder to torques over the whole horizon.

        Parameters
        ----------
        joint : int
            Of the encoder.

        Returns
        -------
        float
            Positive where the offset explains more; offsets of other encoders are free.
        """
        estimator = self.estimator
        null, window = estimator.posterior, estimator.window
        upper = np.triu(null.factor)
        column = np.linalg.solve(upper.T @ upper, np.eye(len(null.mean))[joint])
        variance, offset = column[joint], null.mean[joint]
        held = upper.T @ upper
        held[joint, joint] += 1e6 / variance
        without = null._replace(
            mean=null.mean - column * offset / variance,
            factor=np.ascontiguousarray(np.linalg.cholesky(held).T),
        )
        gain = 0.5 * (offset**2 / variance - np.log(estimator.prior[joint] ** 2 / variance))
        last, courses = len(estimator), self._outside.horizon
        return float(gain) - max(
            smooth_contact(courses, levers, window, without, last) for levers in self._levers(last)
        )


@njit_in_place
def dead_reckoning(blocks: FloatArray, row: FloatArray) -> None:
    """Write by what the readings of blocks changed, less the integral of their rates."""
    n, last = row.shape[0], blocks.shape[0] - 1
    for i in range(n):
        row[i] = blocks[last, i] - blocks[0, i]
        for k in range(last):
            interval = blocks[k + 1, 3 * n] - blocks[k, 3 * n]
            row[i] -= 0.5 * (blocks[k, n + i] + blocks[k + 1, n + i]) * interval


@njit_in_place
def loudest_rows(
    rows: FloatArray,
    variances: FloatArray,
    noise: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    interval: float,
    trusted: BoolArray,
) -> float:
    """Largest evidence against healthy sensors of the sums of any number of last rows."""
    inflation, ends, walk, bias = noise
    largest = 0.0
    for i in range(rows.shape[1]):
        if not trusted[i]:
            continue
        total, jumps = 0.0, 0.0
        for k in range(rows.shape[0]):
            at, span = rows.shape[0] - 1 - k, interval * (k + 1)
            total += rows[at, i]
            jumps += variances[at, i]
            variance = inflation[i] * (ends[i] + walk[i] * span) + (bias[i] * span) ** 2 + jumps
            largest = max(largest, 0.5 * total * total / max(variance, _BEFORE))
    return largest


class KinematicRows:
    """D = y(t) - y(t - T) - int v dt of every interval, for sensors with rates of their own.

    Parameters
    ----------
    arm : SerialArm
        Its sensors.
    plan : HorizonPlan
        Lengths of blocks and intervals.
    """

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        sensors = [joint.sensors for joint in arm.joints]
        self._interval = plan.interval
        self._independent = np.array([one.rates == 'independent' for one in sensors])
        reading = np.array([
            one.position_noise**2 + one.quantization**2 / 12.0 for one in sensors
        ])  # fmt: skip
        rate = np.array([one.velocity_noise for one in sensors])
        least = NEGLIGIBLE * arm.scales()
        self._ends = 2.0 * reading / plan.per_block + least**2
        self._walk = rate**2 * arm.sample_time  # variance of int v dt per second
        self._bias = np.maximum(RATE_BIAS * rate, 4.0 * least)
        self._longest = max(STARTS)
        # Rates lag behind readings, as differences and filtered ones do [s].
        self._lag = np.zeros(len(sensors))
        self._lag_known = np.full(len(sensors), 1.0 / arm.sample_time**2)
        self._latest = (LATE * arm.sample_time) ** 2 / plan.per_block
        self._stamps = WRONG_STAMPS * self._latest  # variance of a block's time [s2]
        self._inflation = np.ones(len(sensors))
        self.trusted = np.ones(len(sensors), bool)
        self.restart()

    def restart(self) -> None:
        """Forget the rows so far."""
        self._rows, self._variances = np.zeros((2, 0, len(self._independent)))
        self._edges = np.zeros((0, len(self._independent)))  # rates where rows begin and end
        self._jumps: list[FloatArray] = []

    def note_jump(self, joint: int, variance: float) -> None:
        """A jump was taken out of readings that are still to come, with some error [rad2]."""
        jump = np.zeros(len(self._independent))
        jump[joint] = variance
        # It may belong to the next row or to the one after.
        waiting = [*self._jumps, 0.0 * jump, 0.0 * jump][:2]
        self._jumps = [one + jump for one in waiting]

    def take(self, blocks: FloatArray) -> None:
        """Add the row of the last interval; rows as of `Sampler.blocks`, of two intervals."""
        n, half = len(self._independent), len(blocks) // 2
        if not self._independent.any() or half < 1:
            return
        row = np.zeros(n)
        dead_reckoning(blocks[half - 1 :], row)
        most = round(self._longest / self._interval) + 1
        jumped = self._jumps.pop(0) if self._jumps else 0.0 * row
        if len(self._rows) == 0:
            self._edges = blocks[half - 1 : half, n : 2 * n]
        self._edges = np.concatenate([self._edges, blocks[-1:, n : 2 * n]])[-most - 1 :]
        self._rows = np.concatenate([self._rows, row[None]])[-most:]
        self._variances = np.concatenate([self._variances, jumped[None]])[-most:]
        self._rows[-1] -= self._lag * (self._edges[-1] - self._edges[-2])
        self._learn_lag()

    def leave_out(self, joint: int, out: bool) -> None:
        """Do without the rows of a joint, or with those to come."""
        self.trusted[joint] = not out
        self._rows[:, joint] = 0.0

    def last(self, joint: int) -> tuple[float, float] | None:
        """Last row of a joint and its variance; None where there is none."""
        if not self._independent[joint] or len(self._rows) == 0:
            return None
        return float(self._rows[-1, joint]), self._variance_of_last(joint, 1)

    def way(self, joint: int, count: int) -> tuple[float, float] | None:
        """As of `Bank.way`."""
        rows = self._rows[-max(count, 1) :, joint]
        if not self._independent[joint] or not self.trusted[joint] or len(rows) == 0:
            return None
        return -float(rows.sum()), float(np.sqrt(self._variance_of_last(joint, len(rows))))

    def explained(self, joint: int, count: int) -> float:
        """What a reading that rests explains of the last rows: all of it."""
        rows = self._rows[-count:, joint]
        if not self._independent[joint] or not self.trusted[joint] or len(rows) == 0:
            return 0.0
        return float(0.5 * rows.sum() ** 2 / self._variance_of_last(joint, len(rows)))

    def _variance_of_last(self, joint: int, count: int) -> float:
        """Variance of the sum of so many last rows of a joint [rad2]."""
        return max(float(self._variance_of(np.array([count]))[0, joint]), _BEFORE)

    def _variance_of(self, counts: IntArray) -> FloatArray:
        """Variances of the sums of so many last rows, shape (W, n) [rad2]."""
        span = self._interval * counts[:, None]
        variance = self._inflation * (self._ends + self._walk * span) + (self._bias * span) ** 2
        return np.asarray(variance + np.cumsum(self._variances[::-1], axis=0)[counts - 1])

    def speaks(self, evidence: float) -> bool:
        """Whether the rows of any window contradict healthy sensors by so much evidence."""
        if not (self._independent & self.trusted).any() or len(self._rows) == 0:
            return False
        noise = self._inflation, self._ends, self._walk, self._bias
        loudest = loudest_rows(
            self._rows, self._variances, noise, self._interval, self._independent & self.trusted
        )
        return bool(loudest > evidence)

    def agrees(self, joint: int, taken_out: float) -> bool:
        """Whether there are rows of the last half second, and they are those of healthy sensors.

        What is taken out of the rate [rad/s] is not in the rows.
        """
        rows = self._rows[-round(0.5 / self._interval) :, joint]
        if len(rows) == 0:
            return False
        left = rows.sum() - taken_out * len(rows) * self._interval
        return bool(left**2 < 9.0 * self._variance_of_last(joint, len(rows)))

    def learn(self, healthy: bool) -> None:
        """Learn how much rows scatter; constant errors of rates do not count as scatter."""
        if not healthy or len(self._rows) < 2:
            return
        expected = 2.0 * (2.0 * self._ends + self._walk * self._interval)
        ratio = (self._rows[-1] - self._rows[-2]) ** 2 / np.maximum(expected, _BEFORE)
        bounded = np.minimum(ratio, 9.0 * self._inflation)
        self._inflation = np.maximum(self._inflation + (bounded - self._inflation) / 64.0, 1.0)
        self._learn_stamps(expected)

    def _learn_lag(self) -> None:
        """Learn by how much rates lag behind their readings, and take it out of all rows.

        A lag d moves a row by d times the change of its rate, which no fault does: it is learned
        from all rows, outliers bounded.
        """
        variance = self._ends + self._walk * self._interval
        variance = np.maximum(self._inflation * variance + self._variances[-1], _BEFORE)
        change = self._edges[-1] - self._edges[-2]
        weight = np.where(self._independent & self.trusted, change / variance, 0.0)
        self._lag_known += weight * change
        most = ROBUST * np.sqrt(variance)
        step = weight * np.clip(self._rows[-1], -most, most) / self._lag_known
        self._lag += step
        self._rows -= step * np.diff(self._edges, axis=0)

    def _learn_stamps(self, expected: FloatArray) -> None:
        """Learn how wrong stamps are: an error d moves the rows of all sensors by their rates.

        The difference of two rows holds d of three blocks, once, twice and once.
        """
        rate = np.where(self._independent & self.trusted, self._edges[-2], 0.0)
        weight = rate / np.maximum(expected, _BEFORE)
        power = float(weight @ rate)
        if power * self._latest < 1.0:  # too slow to tell
            return
        late = float(weight @ (self._rows[-1] - self._rows[-2])) / power
        seen = min((late**2 - 1.0 / power) / 6.0, self._latest)
        self._stamps = max(self._stamps + (seen - self._stamps) / 64.0, 0.0)

    def sums(self, lengths: IntArray, block: FloatArray) -> Rows:
        """Sums of the rows of windows.

        Parameters
        ----------
        lengths : ndarray of int, shape (W,)
            Balances of the windows.
        block : ndarray, shape (3 n + 3,)
            The last block.

        Returns
        -------
        Rows
            Of no weight where there are no rows.
        """
        n = len(self._independent)
        reading, trusted = block[:n].copy(), self._independent & self.trusted
        if not trusted.any() or len(self._rows) == 0:
            none = np.zeros((len(lengths), n))
            return Rows(none[:, 0], none, none, reading)
        counts = np.minimum(lengths, len(self._rows))
        variance = np.maximum(self._variance_of(counts), _BEFORE)
        found: FloatArray = np.cumsum(self._rows[::-1], axis=0)[counts - 1]
        turned = self._edges[-1] - self._edges[-1 - counts]
        variance = variance + turned**2 / self._lag_known
        weight = 1.0 / variance
        if self._stamps > 0.0:
            # Wrong stamps of both ends are common to all sensors: their covariance is s v v^T.
            covariance = variance[:, :, None] * np.eye(n)
            for rate in (self._edges[-1] * np.ones_like(found), self._edges[-1 - counts]):
                rate = np.where(trusted, rate, 0.0)
                covariance += self._stamps * rate[:, :, None] * rate[:, None, :]
            inverse: FloatArray = np.linalg.inv(covariance).astype(float)
            weight = inverse[:, np.arange(n), np.arange(n)]
            found = (inverse @ np.where(trusted, found, 0.0)[:, :, None])[:, :, 0] / weight
        return Rows(self._interval * counts, np.where(trusted, weight, 0.0), found, reading)
