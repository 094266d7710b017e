"""Moving-horizon estimate of all sensor offsets and of what is not known of the arm.

Unknown are the offset f_i of each position sensor and, for the arm, torque offsets, viscous and
Coulomb friction, and the inertial parameters along their likely directions.  The balances of the
last seconds determine all of them together by least squares around the last estimate of f; where
that has moved, the horizon is linearised again.
"""

from dataclasses import dataclass

import numpy as np

from lpv_core.serial_arm.chain import COULOMB as DRY
from lpv_core.serial_arm.chain import VISCOUS as WET
from lpv_core.serial_arm.chain import FloatArray, IntArray, compile_chain
from lpv_core.serial_arm.description import SerialArm
from lpv_core.serial_arm.diagnosis.balance import (
    COULOMB,
    GROUPS,
    OFFSET,
    TORQUE,
    VISCOUS,
    Balance,
    column_count,
    fill_balances,
    new_balance,
)
from lpv_core.serial_arm.diagnosis.information import InformationWindow
from lpv_core.serial_arm.diagnosis.parameter_error import inertial_directions, inertial_factor

OFFSET_PRIOR = 0.5
"""Standard deviation of an offset of which nothing is known [rad]."""
_LINEAR_WITHIN = 0.05
"""Change of an offset after which the horizon is linearised again [rad]."""
_NOISE_SAMPLES = 20
"""Balances that what is expected of the noise counts for."""
_LARGEST_INFLATION = 15.0
DISTRUST = 0.02
"""Factor of the weights of balances while something acts from outside."""


@dataclass(frozen=True)
class HorizonPlan:
    """How samples become balances, and how many are kept."""

    per_block: int  # samples whose mean enters the dynamics
    blocks: int  # of an interval; two neighbouring intervals make a balance
    interval: float  # [s]
    capacity: int  # balances of the horizon

    @staticmethod
    def of(sample_time: float, interval: float = 0.05, horizon: float = 10.0) -> 'HorizonPlan':
        """Plan for a sample time: blocks of about 10 ms, intervals of at least two samples."""
        per_block = max(1, round(0.01 / sample_time))
        blocks = max(2, round(interval / (per_block * sample_time)))
        length = per_block * blocks * sample_time
        return HorizonPlan(per_block, blocks, length, max(20, round(horizon / length)))


@dataclass
class Posterior:
    """Estimate of offsets and parameters from all balances of the horizon."""

    mean: FloatArray  # offsets [rad], then parameters
    covariance: FloatArray
    columns: IntArray  # of the balance's rows, in the order of mean

    def offsets(self, joints: int) -> tuple[FloatArray, FloatArray]:
        """Offsets and their standard deviations [rad]."""
        return self.mean[:joints], np.sqrt(np.diag(self.covariance)[:joints])


class OffsetEstimator:
    """Estimator of one arm; ``balance`` is filled by `sampling.take_samples`.

    Parameters
    ----------
    arm : SerialArm
        Arm, sensors, and what may vary.
    plan : HorizonPlan
        Lengths of balances and horizon.
    """

    def __init__(self, arm: SerialArm, plan: HorizonPlan) -> None:
        self.plan = plan
        chain = compile_chain(arm)
        self.joints = len(arm.joints)
        n = self.joints
        speed = np.array([min(joint.limits.velocity, 3.0) for joint in arm.joints])
        directions = inertial_directions(chain, inertial_factor(arm, chain), speed)
        derived = np.array([float(joint.sensors.rates != 'independent') for joint in arm.joints])
        self.balance: Balance = new_balance(chain, directions, derived)
        self.columns = np.concatenate([
            1 + group * n + np.arange(n) for group in (OFFSET, TORQUE, VISCOUS, COULOMB)
        ] + [1 + len(GROUPS) * n + np.arange(len(directions))])  # fmt: skip
        self.prior = np.concatenate([*_priors(arm, chain.friction), np.ones(len(directions))])
        self.noise = _expected_noise(arm, plan)
        self._expected = self.noise.copy()
        self.inflation = np.full(n, 2.0)
        size = column_count(n, len(directions))
        self.window = InformationWindow(size, plan.capacity, 0.998)
        self.posterior = Posterior(
            np.zeros(len(self.columns)), np.diag(self.prior**2), self.columns
        )
        self._since_linearised = 0

    def add(self, time: float, learn: bool) -> None:
        """Take the balance that is complete, and estimate anew.

        Parameters
        ----------
        time : float
            Of the balance [s].
        learn : bool
            Whether what leaves the horizon is remembered.
        """
        self.take(time, learn)
        self._since_linearised += 1
        if len(self.window) % 10 == 0:
            self._learn_noise()
        self.solve()

    def take(self, time: float, learn: bool = False) -> None:
        """Take the balance that is complete without estimating; arguments as of `add`."""
        rows = self._absolute(self.balance.rows)
        self.window.add(time, rows, self.weights(self.residual(rows)), learn)

    def _absolute(self, rows: FloatArray) -> FloatArray:
        """Rows whose constant part belongs to f = 0 instead of the point of linearisation."""
        rows = rows.copy()
        n = self.joints
        rows[..., 0] -= rows[..., 1 + OFFSET * n : 1 + (OFFSET + 1) * n] @ self.balance.reference
        return rows

    def residual(self, rows: FloatArray) -> FloatArray:
        """What the present estimate leaves of the balances [N m s]."""
        return rows[..., 0] + rows[..., self.columns] @ self.posterior.mean

    def weights(self, residual: FloatArray) -> FloatArray:
        """Inverse variances, less for outliers (soft L1)."""
        variance = self.noise**2 * self.inflation
        return 1.0 / (variance * np.sqrt(1.0 + (residual / (3.0 * self.noise)) ** 2))

    def solve(self) -> None:
        """Least squares over horizon, past and prior."""
        products = self.window.products() + self.window.past
        information = products[np.ix_(self.columns, self.columns)]
        information[np.diag_indices_from(information)] += self.prior**-2
        covariance = np.linalg.inv(information)
        mean = -covariance @ products[self.columns, 0]
        self.posterior = Posterior(mean, 0.5 * (covariance + covariance.T), self.columns)

    def must_linearise(self) -> bool:
        """Whether the estimate has left the point of linearisation."""
        moved = np.abs(self.posterior.mean[: self.joints] - self.balance.reference).max()
        return bool(moved > _LINEAR_WITHIN) and self._since_linearised >= max(
            3, len(self.window) // 10)  # fmt: skip

    def linearise(self, blocks: FloatArray, iterations: int = 1) -> None:
        """Evaluate the balances of the horizon again, at the present estimate of the offsets.

        Parameters
        ----------
        blocks : ndarray, shape (N, 3 n + 3)
            Means as kept by `Sampler.blocks`, oldest first; whole intervals.
        iterations : int, optional
            How often.
        """
        n = self.joints
        for _ in range(iterations):
            step = self.posterior.mean[:n] - self.balance.reference
            self.balance.reference[:] += np.clip(step, -0.3, 0.3)
            rows = self._absolute(balances_of(self.balance, blocks, self.plan.blocks))
            rows = rows[len(rows) - len(self.window) :]
            self.window.reset(rows, self.weights(self.residual(rows)))
            self.solve()
        self._since_linearised = 0

    def restart(self) -> None:
        """Begin a new horizon after a gap; what the old one said of arm and offsets is kept."""
        self.window.past += self.window.products()
        self.window.forget(0)

    def replace_last(self, rows: FloatArray) -> None:
        """Put new rows, linearised where the balance is, in the place of the last ones."""
        self._put_last(self._absolute(rows), 1.0)

    def distrust(self, last: int) -> None:
        """Take most of the weight off the last balances, and estimate anew."""
        rows = self.window.last_rows(min(last, len(self.window)))
        self._put_last(rows, DISTRUST)
        self.solve()

    def _put_last(self, rows: FloatArray, trust: float) -> None:
        keep = len(self.window) - len(rows)
        times, factors = list(self.window.times)[keep:], np.minimum(self.window.trust[keep:], trust)
        self.window.forget(keep)
        for time, row, factor in zip(times, rows, factors):
            self.window.add(time, row, self.weights(self.residual(row)), False, factor)

    def _learn_noise(self) -> None:
        """Size and correlation of what the arm's model does not explain, from the horizon."""
        residual = self.residual(self.window.rows)[self.window.trust == 1.0]
        count = len(residual)
        if count < 10:
            return
        size = 1.4826 * np.median(np.abs(residual), axis=0)
        expected, total = self._expected**2 * _NOISE_SAMPLES, _NOISE_SAMPLES + count
        self.noise = np.sqrt((expected + count * size**2) / total)
        self.noise = np.clip(self.noise, 0.1 * self._expected, 10.0 * self._expected)
        clipped = np.clip(residual, -3.0 * self.noise, 3.0 * self.noise)
        power = (clipped**2).mean(0)
        lags = range(1, min(8, count // 2))
        correlation = sum(
            np.maximum((clipped[lag:] * clipped[:-lag]).mean(0) / power, 0.0) for lag in lags
        )
        learned = np.clip(1.0 + 2.0 * np.asarray(correlation), 1.0, _LARGEST_INFLATION)
        self.inflation = (_NOISE_SAMPLES * 2.0 + count * learned) / (_NOISE_SAMPLES + count)


def balances_of(balance: Balance, blocks: FloatArray, per_interval: int) -> FloatArray:
    """Balances of blocks that were kept, shape (L, n, columns); the balance ends as it began."""
    rows = np.empty((max(len(blocks) // per_interval - 1, 0), *balance.rows.shape))
    fill_balances(balance, np.ascontiguousarray(blocks), per_interval, rows)
    return rows


def _priors(arm: SerialArm, friction: FloatArray) -> list[FloatArray]:
    """Standard deviations of offsets, torque offsets, viscous and Coulomb friction."""
    n = len(arm.joints)
    limit = np.array([min(joint.limits.torque, 1e3) for joint in arm.joints])
    share = max(arm.uncertainty.friction, 0.3)
    return [
        np.full(n, OFFSET_PRIOR),
        0.005 * limit,
        share * np.abs(friction[:, WET]) + 5e-4 * limit,
        share * friction[:, DRY] + 3e-3 * limit,
    ]


def _expected_noise(arm: SerialArm, plan: HorizonPlan) -> FloatArray:
    """Standard deviation of a balance that is expected before any was seen [N m s]."""
    limit = np.array([min(joint.limits.torque, 1e3) for joint in arm.joints])
    tolerance = np.array([max(joint.torque_tolerance.torque) for joint in arm.joints])
    return plan.interval * np.maximum(0.25 * tolerance, 0.01 * limit)
