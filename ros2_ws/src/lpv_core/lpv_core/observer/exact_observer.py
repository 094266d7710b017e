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

import numpy as np

from lpv_core.certificate.gains import ExactObserverGains
from lpv_core.model.arm import ARM_CONSTANTS, ArmParameters
from lpv_core.model.dynamics import acceleration, coupling
from lpv_core.model.polytope import slope_range
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

EXACT_CONSTANTS = record_type(
    ('arm', ARM_CONSTANTS),
    ('kappa', 'f8', (2,)),  # s kappa_i: the sign of the region is in it [1/(kg m2)]
    ('mu', 'f8', (2,)),  # [1/s]
    ('low', 'f8', (2,)),  # certified range of cos(theta_i)
    ('high', 'f8', (2,)),
)


def exact_constants(arm: ArmParameters, gains: ExactObserverGains) -> np.record:
    """Constants of `exact_step`, of type `EXACT_CONSTANTS`."""
    low, high = slope_range(arm)
    return new_record(
        EXACT_CONSTANTS,
        arm=arm.constants(),
        kappa=arm.sign * np.asarray(gains.kappa),
        mu=gains.mu,
        # The region ends at |cos| = 1; no rounding of the cosine may leave it.
        low=np.where(low <= -1.0, -1.0 - 1e-9, low),
        high=np.where(high >= 1.0, 1.0 + 1e-9, high),
    )


@njit
def _rates(
    params: np.record,
    x: tuple[float, float, float, float],
    v: np.ndarray,
    torque: np.ndarray,
    kappa: tuple[float, float],
) -> tuple[float, float, float, float]:
    """d theta^/dt and d theta^'/dt as in the module's docstring."""
    arm, mu = params.arm, params.mu
    r_1, r_2 = x[2] - v[0], x[3] - v[1]
    off = coupling(x[0], x[1], arm)
    turning = -arm.coupling * math.sin(x[0] - x[1]) * (v[0] - v[1])  # Xi12'
    p_1, p_2 = arm.inertia[0] * r_1 + off * r_2, off * r_1 + arm.inertia[1] * r_2  # Xi r
    c_1, c_2 = mu[0] * p_1 + turning * r_2, mu[1] * p_2 + turning * r_1  # (mu Xi + Xi') r
    det = arm.inertia[0] * arm.inertia[1] - off * off
    # Measured rates feed friction and Coriolis terms: no fault in them.
    a_1, a_2 = acceleration(x[0], x[1], v[0], v[1], torque[0], torque[1], arm)
    return (
        v[0] - kappa[0] * p_1,
        v[1] - kappa[1] * p_2,
        a_1 - (arm.inertia[1] * c_1 - off * c_2) / det,
        a_2 - (arm.inertia[0] * c_2 - off * c_1) / det,
    )


@njit
def exact_step(params: np.record, state: np.record, torque: np.ndarray, dt: float) -> None:
    """Advance the observer over one sample interval by the Heun rule.

    Where the estimate leaves the region of certified gravity slopes, the correction of that
    link's angle is suspended (``held``): the configuration carries no information there.

    Parameters
    ----------
    params : numpy.record
        Of type `EXACT_CONSTANTS`.
    state : numpy.record
        Of type `lpv_core.observer.observer_step.RECURSION_STATE`: theta^ and theta^' in ``x`` are
        advanced, with the measured rates ``v_old`` and ``v_new`` of both ends of the interval;
        ``held`` receives which links are held.
    torque : ndarray, shape (2,)
        Generalised torques Q held over the interval [N m].
    dt : float
        Length of the interval [s].
    """
    x = state.x
    for link in range(2):
        cosine = math.cos(x[link])
        state.held[link] = cosine < params.low[link] or cosine > params.high[link]
    kappa = (0.0 if state.held[0] else params.kappa[0], 0.0 if state.held[1] else params.kappa[1])
    a = _rates(params, (x[0], x[1], x[2], x[3]), state.v_old, torque, kappa)
    end = (x[0] + dt * a[0], x[1] + dt * a[1], x[2] + dt * a[2], x[3] + dt * a[3])
    b = _rates(params, end, state.v_new, torque, kappa)
    for i in range(4):
        x[i] += 0.5 * dt * (a[i] + b[i])


def output_injection(
    theta: np.ndarray,
    rates: np.ndarray,
    kappa: np.ndarray,
    mu: np.ndarray,
    arm: np.record,
    sensor_matrix: np.ndarray,
) -> np.ndarray:
    """K(rho) of the observer in the paper's form z' = T1 (A~ x^ + B~ u) + K (C~ x^ - y).

    Parameters
    ----------
    theta, rates : ndarray, shape (2,)
        Absolute angles [rad] and measured rates [rad/s].
    kappa : ndarray, shape (2,)
        s*kappa_i.
    mu : ndarray, shape (2,)
        mu_i.
    arm : numpy.record
        Constants of the arm.
    sensor_matrix : ndarray, shape (2, 2)
        S.

    Returns
    -------
    ndarray, shape (6, 4)
        K at this configuration; its rows for f keep S theta^ + z_f at zero.
    """
    off = coupling(theta[0], theta[1], arm)
    xi = np.array([[arm.inertia[0], off], [off, arm.inertia[1]]])
    turning = -arm.coupling * np.sin(theta[0] - theta[1]) * (rates[0] - rates[1])
    xi_rate = np.array([[0.0, turning], [turning, 0.0]])
    s_inverse = np.linalg.inv(sensor_matrix)
    k = np.zeros((6, 4))
    k[:2, 2:] = -(np.eye(2) + np.diag(kappa) @ xi) @ s_inverse
    k[2:4, 2:] = -np.linalg.solve(xi, np.diag(mu) @ xi + xi_rate) @ s_inverse
    k[4:, 2:] = -sensor_matrix @ k[:2, 2:]
    return k
