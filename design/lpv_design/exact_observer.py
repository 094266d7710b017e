"""Method ``exact``: gains of the observer in momentum coordinates, one small LMI a link.

The error of link i is e' = -kappa m, m' = Gamma e - mu m + q, with one uncertain slope Gamma in
[G cos_min, G] (see :mod:`lpv.core.uio.observer.exact_observer`): an observer problem for
A = [[0, 0], [Gamma, 0]], C = [0, 1] and the injection L = -[kappa; mu].  The inequalities are
linear in P and Y = P L:
a disc for the poles of every slope (decay rate and fastest pole), and the H2 inequality whose
P^-1 bounds the covariance of the error; its trace is minimised.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.support.entries import entry, positive
from lpv.core.support.limits import LARGEST
from lpv.core.uio.certificate.error_system import LinkError, link_errors
from lpv.core.uio.certificate.lmi import covariance, disc
from lpv.core.uio.certificate.noise import stated_acceleration_noise
from lpv.core.uio.model.arm import ArmParameters
from lpv_design.solve import RESERVE, run, symmetric_below


@dataclass(frozen=True)
class ExactRequirement:
    """What the observer must fulfil."""

    decay: float = positive(LARGEST)  # slowest allowed pole [1/s]
    # fastest allowed pole [1/s]; with the sample time it fixes the margin of the recursion
    fastest: float = positive(LARGEST)
    # intensity of white acceleration on both absolute axes [rad/s2/sqrt(Hz)]: disturbance and the
    # part of the model error that varies fast
    acceleration_noise: tuple = entry('pair', above=0.0, high=LARGEST)
    # intensity of white noise on theta' (integration of imperfect rates) [rad/s/sqrt(Hz)]
    rate_noise: float = positive(LARGEST)
    # weight of the rate error against the angle error in the H2 criterion [s]
    velocity_weight: float = entry('number', default=0.02, above=0.0, high=LARGEST)
    # largest H-infinity norm from an unknown torque to the angle error [rad/(N m)]
    torque_gain: float = entry('number', default=LARGEST, above=0.0, high=LARGEST)


class LinkProblem:
    """The inequalities of one link with a requirement's figures and some white inputs, compiled
    once; slopes and noise are parameters."""

    def __init__(self, inputs: int, decay: float, fastest: float, velocity_weight: float) -> None:
        self._p = cp.Variable((2, 2), symmetric=True)
        self._y = cp.Variable((2, 1))
        w = cp.Variable((2, 2), symmetric=True)
        # An optimum lies on the border of what is asked; ask for more than is to be certified.
        slowest, fastest = (1.0 + RESERVE) * decay, (1.0 - RESERVE) * fastest
        q, r = 0.5 * (fastest + slowest), 0.5 * (fastest - slowest)
        self._slopes = [cp.Parameter(nonneg=True) for _ in range(2)]
        self._noises = [(cp.Parameter((2, inputs)), cp.Parameter((1, inputs))) for _ in range(2)]
        constraints = []
        for slope in self._slopes:
            # P A + Y C for A = [[0, 0], [slope, 0]], C = [0, 1].
            pn = cp.hstack([slope * self._p[:, 1:2], self._y])
            constraints.append(symmetric_below(disc(self._p, pn, q, r, cp.bmat), 1e-7))
            for direct, measured in self._noises:
                pb = self._p @ direct + self._y @ measured
                constraints.append(symmetric_below(covariance(pn, pb, cp.bmat), 1e-7))
        weight = np.diag([1.0, velocity_weight])
        constraints.append(cp.bmat([[w, weight], [weight, self._p]]) >> 0)
        self._problem = cp.Problem(cp.Minimize(cp.trace(w)), constraints)

    def solve(
        self, slopes: Sequence[float], noises: Sequence[tuple[np.ndarray, np.ndarray]]
    ) -> tuple[Any, ...]:
        """Injection -L and P, None without a solution, and the solver's word."""
        for parameter, slope in zip(self._slopes, slopes):
            parameter.value = slope
        for (direct, measured), values in zip(self._noises, noises):
            direct.value, measured.value = values
        status = run(self._problem)
        if self._p.value is None or self._y.value is None:
            return None, None, status
        return -np.linalg.solve(self._p.value, self._y.value)[:, 0], self._p.value, status


_compiled = lru_cache(maxsize=16)(LinkProblem)


def solve_link(link: LinkError, requirement: ExactRequirement) -> tuple[Any, ...]:
    """Gains of one link, found in units of time, 1/rate, and angle with numbers around one."""
    rate = math.sqrt(link.slopes[1] / link.inertia)
    root, time = math.sqrt(rate), np.array([[1.0], [rate]])
    noises = link.noises(requirement.acceleration_noise, requirement.rate_noise)
    inputs = [(noise.direct / time / root, noise.measured / root) for noise in noises]
    size = max(float(np.linalg.norm(part, axis=1).max()) for pair in inputs for part in pair)
    problem = _compiled(
        inputs[0][0].shape[1],
        requirement.decay / rate,
        requirement.fastest / rate,
        requirement.velocity_weight * rate,
    )
    gain, p, status = problem.solve(
        [slope / link.inertia / rate**2 for slope in link.slopes],
        [(direct / size, measured / size) for direct, measured in inputs],
    )
    if p is None:
        return None, None, None, status
    scale = np.diag([1.0, 1.0 / rate]) * link.unit / size
    # The second state is m/Xi_ii.
    return float(gain[0] / link.inertia), float(gain[1] * rate), scale @ p @ scale, status


def torque_gains(arm: ArmParameters) -> list[float]:
    """H-infinity norm from an unknown torque to each link's angle error.

    With real poles the error system is positive in suitable coordinates (see
    `lpv.core.uio.bound.error_bound`), so that its norm is the static gain at the smallest slope,
    whatever the gains are: gravity, not the observer, sets it.
    """
    return [1.0 / link.slopes[0] for link in link_errors(arm)]


def solve_exact(arm: ArmParameters, requirement: ExactRequirement) -> tuple[Any, ...]:
    """Gains of both links."""
    # What the arm file states is certified, whatever less the requirement says.
    noise = np.maximum(requirement.acceleration_noise, stated_acceleration_noise(arm))
    requirement = replace(requirement, acceleration_noise=tuple(noise))
    found = [solve_link(link, requirement) for link in link_errors(arm)]
    statuses = tuple(f[3] for f in found)
    if any(f[0] is None for f in found):
        return None, None, None, statuses
    kappa, mu, p = (np.array(column) for column in list(zip(*found))[:3])
    return kappa, mu, p, statuses
