"""Method ``exact``: the unknown-input observer in momentum coordinates, as a sampled recursion.

In the paper's form (38) it is T2 = [0; I 0], f^ = y_p - S theta^, and an output injection K that
is scheduled with the estimated configuration.  With v the measured absolute rates,
r = theta^' - v and s = +1 (upright) or -1 (hanging),

    d theta^ /dt  = v - s kappa Xi(theta^) r
    d theta^'/dt  = theta''(theta^, v, Q) - Xi(theta^)^-1 (mu Xi(theta^) + Xi'(theta^, v)) r

with diagonal kappa and mu.  Written in the angle error e and the momentum error m = Xi(theta^) e',
the error obeys, without linearisation, one second-order system for each link,

    e_i' = -s kappa_i m_i,    m_i' = s Gamma_i e_i - mu_i m_i + q_i,

where Gamma_i = G_i abs(cos xi_i) is the slope of gravity by the mean-value theorem and q_i is what
the model does not know: torque errors, and the coupling b (v^2 + theta'') (e_1 - e_2) of inertia
and Coriolis terms.  The links are decoupled because Xi and its rate cancel; gains, certificate and
error bound are therefore those of two small systems with one uncertain slope each.

The position measurement enters only f^, undelayed, so that no fault of a position sensor, whatever
its shape, reaches the state estimate.
"""

from dataclasses import dataclass

import numpy as np

from lpv.core.support.entries import array, entry, positive
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.uio.model.dynamics import (
    COSINE,
    SINE,
    Pair,
    acceleration,
    coupling,
    set_pose,
    solve_inertia,
)
from lpv.core.uio.model.joints import row_dot


@dataclass(frozen=True)
class ExactObserverGains:
    """Observer of method ``exact``: one second-order error system for each link."""

    method: str = entry('text', choices=('exact',))
    kappa: np.ndarray = array(2, above=0.0)  # kappa of both links [1/(kg m2)]
    mu: np.ndarray = array(2, above=0.0)  # mu of both links [1/s]
    lyapunov: np.ndarray = array(2, 2, 2)  # P of each link for (e_i, m_i / Xi_ii), row by row
    decay: float = positive()  # certified slowest pole of the error [1/s]
    fastest: float = positive()  # certified fastest pole of the error [1/s]
    # standard deviations of the fault estimates [rad]
    fault_sigma: np.ndarray = array(2, low=0.0)


@njit
def injection(
    pose: np.ndarray, v: Pair, r: Pair, mu: np.ndarray, arm: np.record
) -> tuple[float, float, float, float]:
    """Xi(theta^) r and Xi^-1 (mu Xi + Xi'(v)) r."""
    off = coupling(pose, arm)
    turning = -arm.coupling * pose[SINE, 2] * (v[0] - v[1])  # Xi12'
    p_1, p_2 = arm.inertia[0] * r[0] + off * r[1], off * r[0] + arm.inertia[1] * r[1]
    c_1, c_2 = mu[0] * p_1 + turning * r[1], mu[1] * p_2 + turning * r[0]
    k_1, k_2 = solve_inertia(off, c_1, c_2, arm)
    return p_1, p_2, k_1, k_2


@njit
def exact_rate(params: np.record, state: np.record, y: np.ndarray, end: int) -> None:
    """d theta^/dt and d theta^'/dt as in the module's docstring, and theta'', at one end of a step.

    f^ follows from the angles once these are known.  The correction of a link's angle is suspended
    (``held``) where its estimate leaves the region of certified gravity slopes at the first end:
    the configuration carries no information there.
    """
    x, rate, model, angle = state.x, state.rate[end], state.model[end], params.joints.angle
    pose = state.pose
    set_pose(pose, x)
    if end == 0:
        for link in range(2):
            state.held[link] = params.sign * pose[COSINE, link] < params.cos_min[link]
    v = row_dot(angle, 0, y[2], y[3]), row_dot(angle, 1, y[2], y[3])
    p_1, p_2, k_1, k_2 = injection(pose, v, (x[2] - v[0], x[3] - v[1]), params.mu, params.arm)
    # Measured rates feed friction and Coriolis terms: no fault in them.
    model[0], model[1] = acceleration(pose, v, state.torque, params.arm)
    rate[0] = v[0] - (0.0 if state.held[0] else params.kappa[0]) * p_1
    rate[1] = v[1] - (0.0 if state.held[1] else params.kappa[1]) * p_2
    rate[2], rate[3] = model[0] - k_1, model[1] - k_2
