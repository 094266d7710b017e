"""How far the estimate of a healthy arm may be off: guaranteed thresholds of the offsets.

Offsets estimated from the horizon alone are a linear map of its balances.  A healthy arm's balances
are sum_k z_k E_k + noise + slack (`healthy_balance`), abs(z_k) <= 1 and z_k constant.  So

    abs(f^_i) <= sum_k abs(sum_b l_ib E_bk) + sum_b abs(l_ib) slack_b
                 + abs(mean(noise)) + sigmas sd(noise) + rest

with l_i the weights of least squares whose errors last as long as the horizon: what it tells of the
arm, z_k do not disturb any more.  What is remembered of times before is left out: its slack would
be most of the threshold.
The noise is that of the heaviest arm: unlike E_bk, it is none of what was measured.
Its mean is not zero, as that of rates is in the weights, too (errors in variables).
The rest is known: where the estimator linearised elsewhere than at the readings.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import FloatArray, IntArray, compile_chain
from lpv.core.serial_arm.description import SIGMAS, SerialArm
from lpv.core.serial_arm.diagnosis.balance import noise_products
from lpv.core.serial_arm.diagnosis.estimator import STRAIGHT, Horizon, OffsetEstimator
from lpv.core.serial_arm.diagnosis.hat import drop_hat
from lpv.core.serial_arm.diagnosis.healthy_balance import (
    HealthyBalance,
    add_healthy_interval,
    generator_count,
    new_healthy_balance,
)
from lpv.core.serial_arm.diagnosis.information import COUNT, NEXT, recent, slot
from lpv.core.serial_arm.diagnosis.learning import payload_share
from lpv.core.serial_arm.diagnosis.parameter_set import parameter_set, payload_generator
from lpv.core.serial_arm.diagnosis.stuck import LINEAR
from lpv.core.serial_arm.diagnosis.turned_balance import (
    TurnedBalance,
    add_turned_interval,
    new_turned_balance,
)
from lpv.core.serial_arm.sensor_map import map_rows
from lpv.core.support.inequalities import SAME
from lpv.core.support.jit import njit_in_place

LEAST_RESPONSE = 0.05
"""An estimate that shows less of an offset is no evidence of one."""


def offsets_beside(arm: SerialArm) -> FloatArray:
    """Largest sum of other sensors' offsets beside which thresholds hold, shape (n,) [rad].

    What is quadratic in it, f, f^2/2 of a torque, is a tenth of what the model may miss.
    """
    error = arm.uncertainty.model_error or 0.0
    return np.asarray(min(STRAIGHT, float(np.sqrt(0.2 * error))) * arm.scales())


@dataclass(frozen=True)
class Guarantee:
    """What a healthy arm inside its file can show at most; arrays of shape (n,)."""

    estimate: FloatArray  # estimated offsets [rad]
    threshold: FloatArray  # largest estimate of a healthy arm [rad]
    response: FloatArray  # part of an offset that the estimate shows [-]
    effects: FloatArray  # (n, k) effect of each generator of the set on the estimate [rad]
    # (n, b, n) of the estimate by each joint of each balance in the horizon, oldest first
    weights: FloatArray
    slack: FloatArray  # of the threshold: blocks, tolerated torques, other offsets [rad]
    noise: FloatArray  # of the threshold: noise [rad]
    rest: FloatArray  # of the threshold: where the estimator linearised, late efforts [rad]
    payload: tuple[float, float]  # least and largest of a healthy arm, as learned [kg]

    @property
    def exceeded(self) -> np.ndarray:
        """Whether no healthy arm inside its file shows the estimate."""
        shown = self.response > LEAST_RESPONSE
        return np.asarray(shown & (np.abs(self.estimate) > self.threshold))

    @property
    def smallest_found(self) -> FloatArray:
        """Smallest lasting offset that exceeds the threshold whatever else there is [rad]."""
        shown = np.maximum(self.response, LEAST_RESPONSE)
        return np.where(self.response > LEAST_RESPONSE, 2.0 * self.threshold / shown, np.inf)


class HealthyRing(NamedTuple):
    """Balances of a healthy arm, beside those of a horizon."""

    balance: HealthyBalance
    turned: TurnedBalance
    changes: FloatArray  # (capacity, n, 10 n^2) as of `add_turned_interval`
    effects: FloatArray  # (capacity, n, 1 + k) residual, then the effect of each generator
    doubts: FloatArray  # (capacity, 3, n) as of `add_healthy_interval`
    momenta: FloatArray  # (capacity, n, n) those of the heaviest arm, by unit rates of readings
    unseen: int  # balances whose torques late efforts may still be about to show
    # (capacity, n, m) mean that noise of rates gives to the unknowns' columns times the residual
    products: FloatArray
    mean_noise: FloatArray  # (n,) standard deviation of mean rates of an interval [rad/s]


@njit_in_place
def take_healthy(ring: HealthyRing, horizon: Horizon, blocks: tuple[FloatArray, ...]) -> None:
    """Take the balance that the horizon is about to take.

    ``blocks``, shape (2 B, 3 n + 4), are those of its two intervals of B blocks, with what lost
    samples hide of them, shape (2 B, n).
    """
    rows, last = horizon.balance.hat.rows, blocks[0].shape[0] // 2
    if ring.balance.hat.length[0] == 0.0:
        _add(ring, rows, blocks[0][:last], blocks[1][:last], 0)
    at = horizon.window.counters[NEXT] % ring.effects.shape[0]
    _add(ring, rows, blocks[0][last:], blocks[1][last:], at)


@njit_in_place
def take_noise(ring: HealthyRing, horizon: Horizon, edges: float) -> None:
    """Write what noise does in the balance that the horizon has taken."""
    balance, window, n = horizon.balance, horizon.window, ring.mean_noise.shape[0]
    at = slot(window, 0)
    # Poses change little within n balances: one sensor in each stands for all.
    sensor = (window.counters[NEXT] - 1) % n
    means = edges if balance.derived[sensor] > 0.0 else 2.0
    variance = n * means * ring.mean_noise[sensor] ** 2
    noise_products(balance, sensor, variance, window.mixing[at], ring.products[at])
    heavier = 1.0
    for i in range(n):
        heavier = max(heavier, ring.balance.heavier[i])
        for a in range(ring.products.shape[2]):
            ring.products[at, i, a] *= heavier
        for j in range(n):
            ring.momenta[at, i, j] = 0.0
            for k in range(n):
                ring.momenta[at, i, j] += ring.balance.heavy[i, k] * ring.balance.to_joints[k, j]


@njit_in_place
def _add(
    ring: HealthyRing, rows: FloatArray, blocks: FloatArray, lost: FloatArray, at: int
) -> None:
    """Take one interval; what its balance may leave goes into a place of the rings."""
    add_healthy_interval(ring.balance, blocks, lost, rows, ring.effects[at], ring.doubts[at])
    add_turned_interval(ring.turned, blocks, ring.changes[at])
    # Bends that late efforts show now may have been those of torques of the balances before.
    for back in range(1, ring.unseen + 1):
        before = (at - back) % ring.doubts.shape[0]
        for i in range(rows.shape[0]):
            ring.doubts[before, 2, i] = max(ring.doubts[before, 2, i], ring.doubts[at, 2, i])


class HealthySet:
    """The set of a healthy arm's balances, beside an estimator whose estimates are bounded.

    The arm's file states ``uncertainty.model_error``.
    """

    def __init__(self, arm: SerialArm, estimator: OffsetEstimator) -> None:
        self._estimator = estimator
        chain, plan, n = compile_chain(arm), estimator.plan, estimator.joints
        sizes = parameter_set(arm, chain)
        self._largest_payload = arm.uncertainty.largest_payload
        self._at_tip = payload_generator(sizes, self._largest_payload)
        self._load = np.zeros(len(estimator.prior))  # the payload's mass by the unknowns
        if self._at_tip >= 0:
            self._load[4 * n :] = payload_share(estimator)
        m, columns = len(estimator.prior), 1 + generator_count(sizes)
        sensors = arm.sensors()
        self._derived = estimator.balance.derived > 0.0
        noise, rate = sensors.position_noise, sensors.velocity_noise / np.sqrt(plan.per_block)
        reading = np.hypot(noise, sizes.rounding)  # at the edge of two steps
        difference = np.sqrt(2.0) * reading / (plan.per_block * arm.sample_time)
        by_sensor, to_joints = np.where(self._derived, difference, rate), arm.sensors_to_joints()
        self._balance = new_healthy_balance(
            chain, sizes, to_joints, arm.scales(), np.sqrt(map_rows(to_joints**2, by_sensor**2)),
            noise / np.sqrt(plan.per_interval))  # fmt: skip
        turned = new_turned_balance(chain, to_joints, offsets_beside(arm))
        self._inertial = np.zeros((1 + len(sizes.inertial), n, 10))
        self._inertial[0] = chain.inertial
        self._inertial[1 + np.arange(len(sizes.body)), sizes.body] = sizes.inertial
        self.ring = HealthyRing(
            self._balance, turned, np.zeros((plan.capacity, n, 10 * n * n)),
            np.zeros((plan.capacity, n, columns)), np.zeros((plan.capacity, 3, n)),
            np.zeros((plan.capacity, n, n)),
            int(np.ceil((sizes.delay[0].max() - 0.5 * arm.sample_time) / plan.interval - SAME)),
            np.zeros((plan.capacity, n, m)),
            np.where(self._derived, reading / plan.interval, rate / np.sqrt(plan.blocks)),
        )  # fmt: skip

    def restart(self) -> None:
        """Begin anew after a gap."""
        # Intervals that are not complete are forgotten.
        drop_hat(self._balance.hat)
        drop_hat(self.ring.turned.hat)
        self._balance.last[:] = np.inf

    def evaluate(self) -> Guarantee:
        """Bounds at the last balance."""
        window, level, n = self._estimator.window, self._estimator.level, self._estimator.joints
        m, last = len(level.mean), int(window.counters[COUNT])
        places = recent(window, last)[::-1]
        rows = window.rows[places].reshape(last * n, -1)
        constant, columns = rows[:, 0], rows[:, -m:]
        # Errors of the model last as long as the horizon.
        weights = level.weights[places] * np.minimum(level.inflation / max(last, 1), 1.0)
        weighted = weights.reshape(-1, 1) * columns
        wanted = np.vstack([np.eye(m)[:n], self._load])
        gain = wanted @ np.linalg.inv(weighted.T @ columns + np.diag(level.least))
        map_ = -gain @ weighted.T
        estimate = map_ @ constant
        map_ = np.einsum('kbi,bij->kbj', map_.reshape(n + 1, last, n), window.mixing[places])
        # What late efforts do not show yet may be anything: these balances count as they are.
        seen = places[: max(last - self.ring.unseen, 0)]
        map_[:, len(seen) :] = 0.0
        response = map_.reshape(n + 1, -1) @ self.ring.effects[places].reshape(last * n, -1)
        products = weights[: len(seen)].ravel() @ self.ring.products[seen].reshape(-1, m)
        doubts = self.ring.doubts[places]
        slack = np.abs(map_).reshape(n + 1, -1) @ (doubts[:, 0] + doubts[:, 2]).ravel()
        share = gain[:, :n] * level.least[:n]
        # Offsets of the other sensors, as far as the map is linear.
        scale = self._estimator.balance.scale
        own = np.append(np.abs(np.diag(share)) * scale, 0.0)
        slack += LINEAR * (np.abs(share) @ scale - own)
        slack += self._beside(map_, places)
        # Of less noise than the file states the mean is less, too.
        noise = np.abs(gain @ products) + SIGMAS * np.sqrt(self._noise(map_, places))
        effects, rest = response[:, 1:], np.abs(estimate - response[:, 0])
        doubt = slack + noise + rest
        return Guarantee(
            estimate[:n], (np.abs(effects).sum(1) + doubt)[:n], 1.0 - np.diag(share), effects[:n],
            map_[:n], slack[:n], noise[:n], rest[:n],
            self._payload_interval(float(estimate[n]), effects[n], float(doubt[n])),
        )  # fmt: skip

    def _beside(self, map_: FloatArray, places: IntArray) -> FloatArray:
        """Slack of the estimates by offsets of other sensors, beyond what is linear in them."""
        rows, last, n = map_.shape
        changes = self.ring.changes[places].reshape(last * n, -1)
        turned = (map_.reshape(rows, -1) @ changes).reshape(rows * n, 10 * n)
        effects = turned @ self._inertial.reshape(-1, 10 * n).T
        slack = np.abs(effects).sum(1).reshape(rows, n)
        slack[np.arange(n), np.arange(n)] = 0.0
        return np.asarray(slack.max(1))

    def _payload_interval(
        self, estimate: float, effects: FloatArray, doubt: float
    ) -> tuple[float, float]:
        """Payloads that the estimate of a healthy arm does not exclude [kg]."""
        if self._at_tip < 0:
            return 0.0, 0.0
        error = effects.copy()
        error[self._at_tip] -= self._largest_payload
        bound = float(np.abs(error).sum()) + doubt
        low, high = (np.clip(estimate + d, 0.0, self._largest_payload) for d in (-bound, bound))
        return float(low), float(high)

    def _noise(self, map_: FloatArray, places: IntArray) -> FloatArray:
        """Variance of the estimates by noise of readings and rates in the horizon."""
        rows, last, n = map_.shape
        total = (map_**2).reshape(rows, -1) @ self.ring.doubts[places, 1].ravel()
        moved, variance = np.zeros((rows, last + 4, n)), self.ring.mean_noise**2
        for i in range(n):
            moved[:, 2:-2] += map_[:, :, i, None] * self.ring.momenta[places, i]
        once = moved[:, 1:] - moved[:, :-1]
        twice = once[:, 1:] - once[:, :-1]
        total += (once**2).sum(1) @ (variance * ~self._derived)
        return np.asarray(total + (twice**2).sum(1) @ (variance * self._derived))
