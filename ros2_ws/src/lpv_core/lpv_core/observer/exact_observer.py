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

from lpv_core.model.dynamics import acceleration, coupling
from lpv_core.support.jit import njit


@njit
def _rates(theta_1, theta_2, rate_1, rate_2, v_1, v_2, torque, kappa_1, kappa_2, mu, arm):
    r_1, r_2 = rate_1 - v_1, rate_2 - v_2
    off = coupling(theta_1, theta_2, arm)
    turning = -arm.coupling * math.sin(theta_1 - theta_2) * (v_1 - v_2)  # rate of Xi12
    p_1, p_2 = arm.inertia[0] * r_1 + off * r_2, off * r_1 + arm.inertia[1] * r_2
    c_1, c_2 = mu[0] * p_1 + turning * r_2, mu[1] * p_2 + turning * r_1
    det = arm.inertia[0] * arm.inertia[1] - off * off
    # Measured rates feed friction and Coriolis terms: no fault in them.
    a_1, a_2 = acceleration(theta_1, theta_2, v_1, v_2, torque[0], torque[1], arm)
    return (
        v_1 - kappa_1 * p_1,
        v_2 - kappa_2 * p_2,
        a_1 - (arm.inertia[1] * c_1 - off * c_2) / det,
        a_2 - (arm.inertia[0] * c_2 - off * c_1) / det,
    )


@njit
def exact_step(
    x: np.ndarray,
    v_old: np.ndarray,
    v_new: np.ndarray,
    torque: np.ndarray,
    dt: float,
    kappa: np.ndarray,
    mu: np.ndarray,
    arm: np.ndarray,
    slope_low: np.ndarray,
    slope_high: np.ndarray,
    held: np.ndarray,
) -> None:
    """Advance the observer over one sample interval, in place, by the Heun rule.

    Where the estimate leaves the region of certified gravity slopes, the correction of that
    link's angle is suspended (``held``): the configuration carries no information there.

    Parameters
    ----------
    x : ndarray, shape (4,)
        theta^ [rad] and theta^' [rad/s], absolute; advanced in place.
    v_old, v_new : ndarray, shape (2,)
        Measured absolute rates at both ends of the interval [rad/s].
    torque : ndarray, shape (2,)
        Generalised torques Q held over the interval [N m].
    dt : float
        Length of the interval [s].
    kappa : ndarray, shape (2,)
        s*kappa_i [1/(kg m2)]; the sign of the region is in it.
    mu : ndarray, shape (2,)
        mu_i [1/s].
    arm : numpy.record
        Constants of the arm.
    slope_low, slope_high : ndarray, shape (2,)
        Certified range of cos(theta_i).
    held : ndarray of bool, shape (2,)
        Receives which links are held.
    """
    for link in range(2):
        cosine = math.cos(x[link])
        held[link] = cosine < slope_low[link] or cosine > slope_high[link]
    k_1 = 0.0 if held[0] else kappa[0]
    k_2 = 0.0 if held[1] else kappa[1]
    a_1, a_2, a_3, a_4 = _rates(
        x[0], x[1], x[2], x[3], v_old[0], v_old[1], torque, k_1, k_2, mu, arm
    )
    b_1, b_2, b_3, b_4 = _rates(
        x[0] + dt * a_1,
        x[1] + dt * a_2,
        x[2] + dt * a_3,
        x[3] + dt * a_4,
        v_new[0],
        v_new[1],
        torque,
        k_1,
        k_2,
        mu,
        arm,
    )
    h = 0.5 * dt
    x[0] += h * (a_1 + b_1)
    x[1] += h * (a_2 + b_2)
    x[2] += h * (a_3 + b_3)
    x[3] += h * (a_4 + b_4)


def output_injection(
    theta: np.ndarray,
    rates: np.ndarray,
    kappa: np.ndarray,
    mu: np.ndarray,
    arm: np.ndarray,
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
