"""A sensor whose fault changes: its course is followed, and its reading corrected by it.

What was known of the arm and of the other sensors before the fault began is kept.  Offset and
drift of the faulty sensor follow from the balances since then, at most those of the last second.
"""

from dataclasses import dataclass, field

import numpy as np

from lpv_core.serial_arm.chain import FloatArray
from lpv_core.serial_arm.diagnosis.balance import DRIFT, EPOCH, OFFSET
from lpv_core.serial_arm.diagnosis.estimator import OffsetEstimator
from lpv_core.serial_arm.diagnosis.information import products, sum_slot
from lpv_core.serial_arm.diagnosis.sampling import BLOCKS, Sampler

MEMORY = 1.0
"""Longest time over which offset and drift are taken for constant [s]."""
STUCK_RATE = 1.0
"""By which the position of a joint becomes uncertain whose reading rests [rad/s]."""
_PRIOR = np.array([0.5, 1.0])
"""Standard deviations of offset and drift since the last correction [rad], [rad/s]."""
_LARGEST = np.array([1.0, 3.0])
"""Largest correction at once, of offset and drift [rad], [rad/s]."""
_CORRECT_BEYOND = 0.03
"""Estimated offset that is taken out of the readings [rad]."""


@dataclass
class MovingFault:
    """Fault of one sensor while it changes."""

    joint: int
    kind: str  # as named in the alarm
    begin: float  # when it began to change [s]
    known: FloatArray  # information from before, shape (m, m), on the estimator's unknowns
    right: FloatArray  # its right side, shape (m,)
    course: FloatArray = field(default_factory=lambda: np.zeros(2))  # offset [rad], drift [rad/s]
    reference: float = 0.0  # moment to which the offset belongs [s]
    sigma: float = 0.0  # of the fault now [rad]
    base: float = 0.0  # offset of the sensor before the change [rad]

    def fault(self, now: float) -> float:
        """Change of the fault that has not been taken out of the readings yet [rad]."""
        return float(self.base + self.course[0] + self.course[1] * (now - self.reference))


def begin_moving_fault(
    estimator: OffsetEstimator, joint: int, kind: str, begin: float
) -> MovingFault:
    """Keep what is known from before a moment.

    Parameters
    ----------
    estimator : OffsetEstimator
        Its horizon holds balances from before and after.
    joint : int
        Of the faulty sensor.
    kind : str
        Of the fault.
    begin : float
        When it began to change [s].

    Returns
    -------
    MovingFault
        Without an estimate of the course yet.
    """
    window, count, m = estimator.window, len(estimator), len(estimator.prior)
    after = int((estimator.times(count) > begin).sum())
    before = products(window, count) - products(window, after) + window.past
    known = before[1:, -m:] + np.diag(estimator.prior**-2)
    right = -before[0, -m:]
    base = float(np.linalg.solve(known, right)[joint])
    return MovingFault(joint, kind, begin, known, right, base=base)


def follow(fault: MovingFault, estimator: OffsetEstimator, sampler: Sampler, now: float) -> None:
    """Estimate offset and drift of the faulty sensor, and correct its readings where they matter.

    Parameters
    ----------
    fault : MovingFault
        Changed.
    estimator : OffsetEstimator
        Has just got a balance.
    sampler : Sampler
        Its corrections and its last blocks may be changed.
    now : float
        Of the last sample [s].
    """
    plan, i = estimator.plan, fault.joint
    if fault.kind == 'stuck':
        # The reading says nothing any more, and the dynamics alone do not tell for long.
        fault.sigma = STUCK_RATE * (now - fault.begin)
        return
    start = max(fault.begin, now - MEMORY)
    last = int((estimator.times(len(estimator)) > start).sum())
    last = max(2, min(last, len(estimator)))
    begin = now - last * plan.interval
    information, right = _since(estimator, i, last, begin)
    m = len(fault.right)
    information[:m, :m] += fault.known
    right[:m] += fault.right
    information[m:, m:] += np.diag(_PRIOR**-2)
    covariance = np.linalg.inv(information)
    fault.course, fault.reference = (covariance @ right)[m:], begin
    direction = np.array([1.0, now - begin])
    fault.sigma = float(np.sqrt(direction @ covariance[m:, m:] @ direction))
    fault.course = np.clip(fault.course, -_LARGEST, _LARGEST)
    if abs(fault.course[0] + fault.course[1] * (now - begin)) > _CORRECT_BEYOND:
        _correct(fault, estimator, sampler, last)


def _since(
    estimator: OffsetEstimator, i: int, last: int, begin: float
) -> tuple[FloatArray, FloatArray]:
    """Information of the last balances on the unknowns, a further offset and a drift of sensor i.

    The drift counts from ``begin``.  Matrix (m + 2, m + 2) and right side.
    """
    n, m, window = estimator.joints, len(estimator.prior), estimator.window
    sums, shift = products(window, last), begin - estimator.balance.clock[EPOCH]
    sum_of = window.squares[sum_slot(window, 0)] - window.squares[sum_slot(window, last)]
    offset, drift = 1 + OFFSET * n + i, 1 + DRIFT * n + i
    sums[:, drift] -= shift * sums[:, offset]
    columns = np.append(np.arange(sums.shape[1] - m, sums.shape[1]), [offset, drift])
    information = np.zeros((m + 2, m + 2))
    information[:m] = sums[1:, columns]
    information[m] = information[i]
    information[m + 1, :m] = information[:m, m + 1]
    information[m + 1, m] = information[m, m + 1]
    whole = sum_of[drift - 1] - shift * (2.0 * sums[1 + i, drift] + shift * sums[1 + i, offset])
    information[m + 1, m + 1] = whole
    return information, -sums[0, columns]


def _correct(fault: MovingFault, estimator: OffsetEstimator, sampler: Sampler, last: int) -> None:
    """Take offset and drift out of the readings of the last balances and of those to come."""
    n, i = estimator.joints, fault.joint
    offset, drift = fault.course
    derived = sampler.derived[i]
    capacity, written = len(sampler.blocks), int(sampler.counters[BLOCKS])
    count = min((last + 1) * estimator.plan.blocks, written, capacity)
    places = np.arange(written - count, written) % capacity
    blocks = sampler.blocks[places]
    blocks[:, i] -= offset + drift * (blocks[:, 3 * n] - fault.reference)
    blocks[:, n + i] -= derived * drift
    sampler.blocks[places] = blocks
    sampler.samples[:, 0, i] -= offset + drift * (sampler.time - fault.reference)
    sampler.samples[:, 1, i] -= derived * drift
    sampler.correction[i] += offset + drift * (sampler.time[-1] - fault.reference)
    sampler.drift[i] += drift
    estimator.replace_last(blocks)
    fault.course = np.zeros(2)
