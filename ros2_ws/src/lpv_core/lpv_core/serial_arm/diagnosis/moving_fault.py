"""A sensor whose fault changes: its course is followed, and its reading corrected by it.

What was known of the arm and of the other sensors before the fault began is kept.  Offset and
drift of the faulty sensor follow from the balances since then, at most those of the last second.
"""

from dataclasses import dataclass, field

import numpy as np

from lpv_core.serial_arm.chain import FloatArray
from lpv_core.serial_arm.diagnosis.balance import DRIFT, OFFSET
from lpv_core.serial_arm.diagnosis.estimator import OffsetEstimator, balances_of
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
    after = sum(time > begin for time in estimator.window.times)
    before = estimator.window.products() - estimator.window.products(after)
    before = before + estimator.window.past
    columns = estimator.columns
    known = before[np.ix_(columns, columns)] + np.diag(estimator.prior**-2)
    right = -before[columns, 0]
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
    n, plan, i = estimator.joints, estimator.plan, fault.joint
    if fault.kind == 'stuck':
        # The reading says nothing any more, and the dynamics alone do not tell for long.
        fault.sigma = STUCK_RATE * (now - fault.begin)
        return
    start = max(fault.begin, now - MEMORY)
    last = max(2, min(sum(time > start for time in estimator.window.times), len(estimator.window)))
    products = estimator.window.products(last)
    columns = np.append(estimator.columns, [1 + OFFSET * n + i, 1 + DRIFT * n + i])
    transform = np.eye(len(columns))
    begin = now - last * plan.interval
    transform[-2, -1] = -begin
    information = transform.T @ products[np.ix_(columns, columns)] @ transform
    right = -transform.T @ products[columns, 0]
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
    rows = balances_of(estimator.balance, blocks, estimator.plan.blocks)
    estimator.replace_last(rows[len(rows) - last :])
    fault.course = np.zeros(2)
