"""Method ``exact``: gains of the observer in momentum coordinates, one small LMI a link.

The error of link i is e' = -kappa m, m' = Gamma e - mu m + q, with one uncertain slope Gamma in
[G cos_min, G] (see :mod:`lpv.core.uio.observer.exact_observer`): an observer problem for
A = [[0, 0], [Gamma, 0]], C = [0, 1] and the injection L = -[kappa; mu].  The inequalities are
linear in P and Y = P L:
a disc for the poles of every slope (decay rate and fastest pole), and the H2 inequality whose
P^-1 bounds the covariance of the error; its trace is minimised.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, positive
from lpv.core.support.limits import LARGEST
from lpv.core.uio.certificate.error_system import LinkError, exact_fault_sigma, link_errors
from lpv.core.uio.certificate.lmi import covariance, disc
from lpv.core.uio.observer.exact_observer import ExactObserverGains
from lpv_design.solve import RESERVE, InfeasibleError, run, symmetric_below


@dataclass(frozen=True)
class ExactRequirement:
    """What the observer must fulfil."""

    decay: float = positive(LARGEST)  # slowest allowed pole [1/s]
    # fastest allowed pole [1/s]; with the sample time it fixes the margin of the recursion
    fastest: float = positive(LARGEST)
    # intensity of white acceleration on both absolute axes [rad/s2/sqrt(Hz)]: disturbance and the
    # part of the model error that varies fast
    acceleration_noise: tuple = entry('vector', 2, above=0.0, high=LARGEST)
    # intensity of white noise on theta' (integration of imperfect rates) [rad/s/sqrt(Hz)]
    rate_noise: float = positive(LARGEST)
    # weight of the rate error against the angle error in the H2 criterion [s]
    velocity_weight: float = entry('number', default=0.02, above=0.0, high=LARGEST)
    # largest H-infinity norm from an unknown torque to the angle error [rad/(N m)]
    torque_gain: float = entry('number', default=LARGEST, above=0.0, high=LARGEST)

    def check(self, section: Section) -> None:
        """ConfigError if no pole is allowed."""
        if not self.fastest > self.decay:
            raise section.error('fastest', 'must be greater than decay')


@lru_cache(maxsize=16)
def _link_problem(
    decay: float, fastest: float, weight: float, gain: tuple[float, float] | None = None
) -> tuple[Any, ...]:
    """The inequalities of one link with a requirement's figures, compiled once.

    Returns the problem, parameters of slopes and of noises, P and Y; with a ``gain`` -L that is
    given, P alone is sought.
    """
    p = cp.Variable((2, 2), symmetric=True)
    y = cp.Variable((2, 1)) if gain is None else -p @ np.array(gain)[:, None]
    w = cp.Variable((2, 2), symmetric=True)
    # An optimum lies on the border of what is asked; ask for more than is to be certified.
    slowest, fastest = (1.0 + RESERVE) * decay, (1.0 - RESERVE) * fastest
    q, r = 0.5 * (fastest + slowest), 0.5 * (fastest - slowest)
    slopes = [cp.Parameter(nonneg=True) for _ in range(2)]
    noises = [cp.Parameter((3, 5)) for _ in range(2)]  # as of `LinkError.noises`
    constraints = []
    for slope in slopes:
        # P A + Y C for A = [[0, 0], [slope, 0]], C = [0, 1].
        pn = cp.hstack([slope * p[:, 1:2], y])
        constraints.append(symmetric_below(disc(p, pn, q, r, cp.bmat), 1e-7))
        for noise in noises:
            pb = cp.hstack([p, y]) @ noise
            constraints.append(symmetric_below(covariance(pn, pb, cp.bmat), 1e-7))
    weights = np.diag([1.0, weight])
    constraints.append(cp.bmat([[w, weights], [weights, p]]) >> 0)
    return cp.Problem(cp.Minimize(cp.trace(w)), constraints), slopes, noises, p, y


def solve_link(link: LinkError, wanted: ExactRequirement) -> tuple[Any, ...]:
    """Gains of one link, found in units of time, 1/rate, and angle with numbers around one."""
    rate = math.sqrt(link.slopes[1] / link.inertia)
    noises = np.array(link.noises(wanted.acceleration_noise, wanted.rate_noise))
    noises = noises / np.array([[1.0], [rate], [1.0]]) / math.sqrt(rate)
    size = float(np.linalg.norm(noises, axis=2).max())
    slopes = [slope / link.inertia / rate**2 for slope in link.slopes]
    figures = wanted.decay / rate, wanted.fastest / rate, wanted.velocity_weight * rate
    p, gain, status = _run_link(figures, slopes, noises / size)
    if p is not None and 4.0 * gain[0] * slopes[1] >= gain[1] ** 2:
        # Poles of steep slopes may be complex, which no inequality in P and Y forbids: as much of
        # the injection as leaves them real.
        real = (1.0 - RESERVE) * gain[1] ** 2 / (4.0 * slopes[1]), gain[1]
        p, gain, status = _run_link(figures, slopes, noises / size, real)
    if p is None:
        return None, None, None, status
    scale = np.diag([1.0, 1.0 / rate]) * link.unit / size
    # The second state is m/Xi_ii.
    return float(gain[0] / link.inertia), float(gain[1] * rate), scale @ p @ scale, status


def _run_link(
    figures: tuple[float, ...],
    slopes: list[float],
    noises: np.ndarray,
    given: tuple[float, float] | None = None,
) -> tuple[Any, ...]:
    """P, the gain -L, found or given, and the solver's word; no P where it found none."""
    problem, *parameters, p, y = _link_problem(*figures, given)
    for parameter, value in zip([*parameters[0], *parameters[1]], [*slopes, *noises]):
        parameter.value = value
    status = run(problem)
    if p.value is None or y.value is None:
        return None, None, status
    return p.value, tuple((-np.linalg.solve(p.value, y.value)[:, 0]).tolist()), status


def torque_gains(arm: ArmParameters) -> list[float]:
    """H-infinity norm from an unknown torque to each link's angle error.

    With real poles the error system is positive in suitable coordinates (see
    `lpv.core.uio.bound.error_bound`), so that its norm is the static gain at the smallest slope,
    whatever the gains are: gravity, not the observer, sets it.
    """
    return [1.0 / link.slopes[0] for link in link_errors(arm)]


def design_exact(arm: ArmParameters, wanted: ExactRequirement) -> tuple[ExactObserverGains, str]:
    """Observer that fulfils a requirement, and the solver's words; InfeasibleError without one."""
    gain = max(torque_gains(arm))
    if gain > wanted.torque_gain:
        raise InfeasibleError(
            f'observer: the H-infinity norm from an unknown torque to an angle error is {gain:.3g} '
            f'rad/(N m), 1/(G cos_min), not {wanted.torque_gain:g}; no observer changes '
            'that: ask for a smaller region'
        )
    # What the arm file states is certified, whatever less the requirement says.
    links = link_errors(arm)
    noise = np.maximum(wanted.acceleration_noise, np.sqrt(links[0].intensity[2:]))
    wanted = replace(wanted, acceleration_noise=tuple(noise))
    *found, statuses = zip(*(solve_link(link, wanted) for link in links))
    if None in found[0]:
        raise InfeasibleError(
            f'observer: no gains with decay {wanted.decay}/s and poles up to '
            f'{wanted.fastest}/s down to abs(cos theta) = {min(arm.cos_min)} '
            f'(solver: {", ".join(statuses)}); ask for a slower decay, a larger fastest pole or a '
            'smaller region'
        )
    kappa, mu, p = map(np.array, found)
    sigma = exact_fault_sigma(arm, p)
    gains = ExactObserverGains('exact', kappa, mu, p, wanted.decay, wanted.fastest, sigma)
    return gains, ', '.join(statuses)
