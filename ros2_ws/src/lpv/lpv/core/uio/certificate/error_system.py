"""The error system of method ``exact``, link by link, and the noise of both methods' estimates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv.core.support.inequalities import NumberType, array_of
from lpv.core.support.limits import SMALL
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_descriptor
from lpv.core.uio.observer.paper_observer import PaperObserverGains


@dataclass(frozen=True)
class LinkError:
    """Error of one link in the state (e, m/Xi_ii): angle [rad] and weighted rate [rad/s]."""

    index: int  # 0 or 1
    inertia: float  # Xi_ii [kg m2]
    slopes: tuple  # smallest and largest slope Gamma_i in the region [N m/rad]
    # row i of Xi at both ends of Xi12, times s = +1 (upright) or -1 (hanging): for a hanging arm
    # the momentum error is counted with the other sign, which makes both cases one, shape (2, 2)
    rows: np.ndarray
    rates: np.ndarray  # S^-1: absolute rates from those of the sensors, shape (2, 2)
    rate_noise: Any  # standard deviation of a rate sensor's white noise [rad/s]
    direction: np.ndarray  # of the stated disturbance, per axis [rad/s2], shape (2,)
    variance: Any  # of independent disturbances of both axes that cover the stated one
    period: Any  # Ts [s]
    unit: float = SMALL  # size of errors [rad], for scaling

    def closed(self, slope: Any, kappa: Any, mu: Any) -> np.ndarray:
        """N of the error e' = -kappa m, m' = Gamma e - mu m, for one slope."""
        return np.array([[0 * mu, -kappa * self.inertia], [slope / self.inertia, -mu]])

    def noises(self, acceleration_noise: Sequence[float], rate_noise: float) -> list[tuple]:
        """Noise at both ends of Xi12, of rate sensors and as given [rad/s2/sqrt(Hz)],
        [rad/s/sqrt(Hz)]; everything between them is a convex combination.

        White inputs of unit intensity: columns that enter the error as they are, shape (2, n), and
        those that enter through the output injection L, shape (1, n).
        """
        rates = self.rates * self.rate_noise * math.sqrt(self.period)
        found = []
        for row in self.rows:
            push = np.abs(row * np.asarray(acceleration_noise)) / self.inertia
            # e' takes the rates' noise as it is, and both rows through the injection.
            direct = np.zeros((2, 5))
            direct[0, :3], direct[1, 3:] = [*rates[self.index], rate_noise], push
            found.append((direct, np.append(-row @ rates / self.inertia, np.zeros(3))[None]))
        return found

    def input_covariance(self, row: np.ndarray, kappa: Any, mu: Any) -> np.ndarray:
        """B B^T of the white inputs that the arm file states, in `unit`, at one end of Xi12."""
        seen = row @ self.rates / self.inertia
        b = np.array([self.rates[self.index] + kappa * self.inertia * seen, mu * seen])
        push = row * self.direction / self.inertia
        total = self.rate_noise**2 * (b @ b.T)
        total[1, 1] += self.variance * (push @ push)
        return total * self.period / type(self.period)(self.unit) ** 2


def link_errors(arm: ArmParameters, number: NumberType = float) -> list[LinkError]:
    """Error systems of both links, in floats or in exact fractions."""
    c, sign, array = arm.numbers(number), number(arm.sign), array_of(number)
    noise = {
        'rates': array(np.linalg.inv(JointMap(arm).sensor_matrix)),
        'rate_noise': number(arm.velocity_noise),
        'direction': array(arm.disturbance_direction),
        # One d drives both axes: (a d_1 + b d_2)^2 <= 2 (a^2 d_1^2 + b^2 d_2^2).
        'variance': int(np.count_nonzero(arm.disturbance_direction))
        * number(arm.disturbance_variance),
        'period': number(arm.sample_time),
    }
    ends = (c.rotor_coupling - c.coupling, c.rotor_coupling + c.coupling)
    links = []
    for i, (inertia, gravity) in enumerate(zip(c.inertia, c.gravity)):
        rows = sign * np.array([[inertia, end] if i == 0 else [end, inertia] for end in ends])
        slopes = (gravity * number(arm.cos_min[i]), gravity)
        links.append(LinkError(i, inertia, slopes, rows, **noise))
    return links


def exact_fault_sigma(arm: ArmParameters, lyapunov: np.ndarray) -> np.ndarray:
    """Bound on the standard deviation of f^ of method ``exact``, per sensor [rad].

    P^-1 bounds the covariance of each link's error; sensors add those of their links.
    """
    with np.errstate(invalid='ignore'):  # of a P that is not positive: NaN fails every check
        angle = LinkError.unit * np.sqrt([np.linalg.inv(p)[0, 0] for p in lyapunov])
    spread = np.abs(JointMap(arm).sensor_matrix) @ angle
    return np.hypot(spread, arm.position_noise)


def paper_fault_sigma(arm: ArmParameters, observer: PaperObserverGains) -> np.ndarray:
    """Largest standard deviation of f^ of method ``paper`` over the vertices, per sensor [rad]."""
    from scipy.linalg import solve_continuous_lyapunov  # as `discretised` does

    d = paper_descriptor(arm, observer.box)
    root = math.sqrt(arm.sample_time)
    noise = np.diag([arm.position_noise] * 2 + [arm.velocity_noise] * 2)
    t1, t2, sigma = observer.t1, observer.t2, np.zeros(2)
    for a_i, k_i in zip(d.a, observer.k):
        n = t1 @ a_i + k_i @ d.c
        disturbance = t1 @ d.bd * math.sqrt(arm.disturbance_variance)
        inputs = root * np.hstack([disturbance, (n @ t2 - k_i) @ noise])
        spread = solve_continuous_lyapunov(n, -inputs @ inputs.T) + t2 @ noise @ noise @ t2.T
        sigma = np.maximum(sigma, np.sqrt(np.diag(spread)[4:]))
    return sigma
