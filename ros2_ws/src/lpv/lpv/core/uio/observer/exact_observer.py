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

import math
from dataclasses import dataclass

import numpy as np

from lpv.core.support.entries import array, entry, positive
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import new_record, record_type
from lpv.core.uio.model.arm import ArmParameters
from lpv.core.uio.model.dynamics import Pair, acceleration, coupling, solve_inertia


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


EXACT_CONSTANTS = record_type(
    ('sign', 'f8'),  # s: +1 upright, -1 hanging
    ('kappa', 'f8', (2,)),  # s kappa_i [1/(kg m2)]
    ('mu', 'f8', (2,)),  # [1/s]
    ('cos_min', 'f8', (2,)),  # smallest s cos(theta_i) of the certified region
)


def exact_constants(arm: ArmParameters, gains: ExactObserverGains) -> np.record:
    """Constants of `exact_step`, of type `EXACT_CONSTANTS`."""
    kappa = arm.sign * np.asarray(gains.kappa)
    return new_record(EXACT_CONSTANTS, sign=arm.sign, kappa=kappa, mu=gains.mu, cos_min=arm.cos_min)


@njit
def injection(
    theta: Pair, v: Pair, r: Pair, mu: np.ndarray, arm: np.record
) -> tuple[float, float, float, float]:
    """Xi(theta^) r and Xi^-1 (mu Xi + Xi'(v)) r."""
    off = coupling(theta, arm)
    turning = -arm.coupling * math.sin(theta[0] - theta[1]) * (v[0] - v[1])  # Xi12'
    p_1, p_2 = arm.inertia[0] * r[0] + off * r[1], off * r[0] + arm.inertia[1] * r[1]
    c_1, c_2 = mu[0] * p_1 + turning * r[1], mu[1] * p_2 + turning * r[0]
    k_1, k_2 = solve_inertia(off, c_1, c_2, arm)
    return p_1, p_2, k_1, k_2


@njit
def _rates(
    params: np.record,
    arm: np.record,
    x: tuple[float, float, float, float],
    v: np.ndarray,
    torque: np.ndarray,
    kappa: tuple[float, float],
) -> tuple[float, float, float, float, float, float]:
    """d theta^/dt and d theta^'/dt as in the module's docstring, and theta''."""
    p_1, p_2, k_1, k_2 = injection(x, v, (x[2] - v[0], x[3] - v[1]), params.mu, arm)
    # Measured rates feed friction and Coriolis terms: no fault in them.
    a_1, a_2 = acceleration(x, v, torque, arm)
    return v[0] - kappa[0] * p_1, v[1] - kappa[1] * p_2, a_1 - k_1, a_2 - k_2, a_1, a_2


@njit
def exact_step(
    params: np.record, arm: np.record, state: np.record, torque: np.ndarray, dt: float
) -> None:
    """Advance the observer over one sample interval by the Heun rule.

    Where the estimate leaves the region of certified gravity slopes, the correction of that
    link's angle is suspended (``held``): the configuration carries no information there.

    Of ``state``, theta^ and theta^' in ``x`` are advanced with the measured rates ``v_old`` and
    ``v_new`` of both ends of the interval [s]; ``held`` receives which links are held,
    and ``bend`` at least how much theta'' has changed.  The generalised torques Q are held over it
    [N m].
    """
    x = state.x
    for link in range(2):
        state.held[link] = params.sign * math.cos(x[link]) < params.cos_min[link]
    kappa = (0.0 if state.held[0] else params.kappa[0], 0.0 if state.held[1] else params.kappa[1])
    a = _rates(params, arm, (x[0], x[1], x[2], x[3]), state.v_old, torque, kappa)
    end = (x[0] + dt * a[0], x[1] + dt * a[1], x[2] + dt * a[2], x[3] + dt * a[3])
    b = _rates(params, arm, end, state.v_new, torque, kappa)
    for i in range(4):
        x[i] += 0.5 * dt * (a[i] + b[i])
    for i in range(2):
        state.bend[i] = max(state.bend[i], abs(b[4 + i] - a[4 + i]))
