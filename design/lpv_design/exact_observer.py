"""Method ``exact``: gains of the observer in momentum coordinates, one small LMI a link.

The error of link i is e' = -kappa m, m' = Gamma e - mu m + q, with one uncertain slope Gamma in
[G cos_min, G] (see :mod:`lpv_core.momentum_uio`): an observer problem for A = [[0, 0], [Gamma, 0]],
C = [0, 1] and the injection L = -[kappa; mu].  The inequalities are linear in P and Y = P L:
a disc for the poles of every slope (decay rate and fastest pole), and the H2 inequality whose
P^-1 bounds the covariance of the error; its trace is minimised.
"""

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from lpv_core.error_system import LinkError, link_errors
from lpv_core.lmi import covariance, disc
from lpv_design.solve import solve, symmetric_below

_RESERVE = 0.02
"""Relative tightening of the pole region in the solver, against the certificate's."""


@dataclass(frozen=True)
class ExactRequirement:
    """What the observer must fulfil.

    Attributes
    ----------
    decay : float
        Slowest allowed pole [1/s].
    fastest : float
        Fastest allowed pole [1/s]; with the sample time it fixes the margin of the recursion.
    acceleration_noise : tuple of float
        Intensity of white acceleration on both absolute axes [rad/s2/sqrt(Hz)]: disturbance and
        the part of the model error that varies fast.
    rate_noise : float
        Intensity of white noise on theta' (integration of imperfect rates) [rad/s/sqrt(Hz)].
    velocity_weight : float
        Weight of the rate error against the angle error in the H2 criterion [s].
    """

    decay: float = 0.25
    fastest: float = 60.0
    acceleration_noise: tuple = (0.15, 0.15)
    rate_noise: float = 1e-3
    velocity_weight: float = 0.02


def solve_link(link: LinkError, requirement):
    """Gains of one link.

    Parameters
    ----------
    link : LinkError
        The link's error system.
    requirement : ExactRequirement
        Decay, pole and noise requirements.

    Returns
    -------
    tuple
        ``(kappa, mu, p, status)``; kappa is None where no point was found.
    """
    p = cp.Variable((2, 2), symmetric=True)
    y = cp.Variable((2, 1))
    w = cp.Variable((2, 2), symmetric=True)
    # An optimum lies on the border of what is asked; ask for more than is to be certified.
    slowest, fastest = (1.0 + _RESERVE) * requirement.decay, (1.0 - _RESERVE) * requirement.fastest
    q, r = 0.5 * (fastest + slowest), 0.5 * (fastest - slowest)
    constraints = []
    for slope in link.slopes:
        pn = p @ link.drift(slope) + y @ link.output
        constraints.append(symmetric_below(disc(p, pn, q, r, cp.bmat), 1e-7))
        for noise in link.noises(requirement.acceleration_noise, requirement.rate_noise):
            pb = p @ noise.direct + y @ noise.measured
            constraints.append(symmetric_below(
                covariance(pn, pb / link.unit, cp.bmat), 1e-7))
    weight = np.diag([1.0, requirement.velocity_weight])
    constraints.append(cp.bmat([[w, weight], [weight, p]]) >> 0)
    status = solve(cp.trace(w), constraints)
    if p.value is None:
        return None, None, None, status
    gain = -np.linalg.solve(p.value, y.value)[:, 0]
    # The second state is m/Xi_ii.
    return float(gain[0] / link.inertia), float(gain[1]), p.value, status


def solve_exact(arm, requirement):
    """Gains of both links.

    Parameters
    ----------
    arm : ArmParameters
        The arm and its region.
    requirement : ExactRequirement
        Decay, pole and noise requirements.

    Returns
    -------
    tuple
        ``(kappa, mu, p, statuses)``: arrays of shape (2,), (2,), (2, 2, 2), or None where no
        point was found, and the solver's words.
    """
    found = [solve_link(link, requirement) for link in link_errors(arm)]
    statuses = tuple(f[3] for f in found)
    if any(f[0] is None for f in found):
        return None, None, None, statuses
    kappa, mu, p = (np.array(column) for column in list(zip(*found))[:3])
    return kappa, mu, p, statuses
