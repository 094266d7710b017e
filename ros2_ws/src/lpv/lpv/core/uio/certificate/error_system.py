"""The error system of method ``exact``, link by link, with its noise: data of LMIs and checks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv.core.support.limits import SMALL
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.joints import JointMap


@dataclass(frozen=True)
class Noise:
    """White inputs of one link's error."""

    # columns of unit-intensity inputs that enter the error as they are, shape (2, n)
    direct: np.ndarray
    measured: np.ndarray  # those that enter through the output injection L, shape (1, n)


@dataclass(frozen=True)
class LinkError:
    """Error of one link in the state (e, m/Xi_ii): angle [rad] and weighted rate [rad/s]."""

    index: int  # 0 or 1
    inertia: float  # Xi_ii [kg m2]
    gravity: float  # G_i [N m/rad]
    slopes: tuple  # smallest and largest slope Gamma_i in the region [N m/rad]
    # row i of Xi at both ends of Xi12, times s = +1 (upright) or -1 (hanging): for a hanging arm
    # the momentum error is counted with the other sign, which makes both cases one, shape (2, 2)
    rows: np.ndarray
    # square root of the covariance of the measured absolute rates, per root of time, shape (2, 2)
    rate_noise: np.ndarray
    unit: float = SMALL  # size of errors [rad], for scaling

    def closed(self, slope: Any, kappa: Any, mu: Any) -> np.ndarray:
        """N of the error e' = -kappa m, m' = Gamma e - mu m, for one slope."""
        return np.array([[0 * mu, -kappa * self.inertia], [slope / self.inertia, -mu]])

    def noises(self, acceleration_noise: Sequence[float], rate_noise: float) -> list[Noise]:
        """Noise at both ends of Xi12; everything between them is a convex combination."""
        own = np.eye(2)[[self.index]] @ self.rate_noise
        found = []
        for row in self.rows:
            push = np.abs(row * np.asarray(acceleration_noise)) / self.inertia
            momentum = row[None] @ self.rate_noise / self.inertia
            # e' takes the rates' noise as it is, and both rows through the injection.
            direct = np.block(
                [[own, np.array([[rate_noise, 0.0, 0.0]])], [np.zeros((1, 3)), push[None]]]
            )
            measured = np.hstack([-momentum, np.zeros((1, 3))])
            found.append(Noise(direct, measured))
        return found


def link_errors(arm: ArmParameters, number: Callable[[Any], Any] = float) -> list[LinkError]:
    """Error systems of both links, in floats, or in exact fractions but for ``rate_noise``."""
    c, sign = arm.numbers(number), number(arm.sign)
    rate_noise = np.linalg.inv(JointMap(arm).sensor_matrix) * arm.velocity_noise
    rate_noise = rate_noise * np.sqrt(arm.sample_time)
    ends = (c.rotor_coupling - c.coupling, c.rotor_coupling + c.coupling)
    links = []
    for i, (inertia, gravity) in enumerate(zip(c.inertia, c.gravity)):
        rows = sign * np.array([[inertia, end] if i == 0 else [end, inertia] for end in ends])
        slopes = (gravity * number(arm.cos_min[i]), gravity)
        links.append(LinkError(i, inertia, gravity, slopes, rows, rate_noise))
    return links
