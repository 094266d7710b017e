"""The unknown-input observer, eqs. (38)-(53), as a sampled recursion.

With K_i = N_i T2 - L_i (50), the observer (38) written in its estimate x^ = z + T2 y is

    z' = T1 (A~(rho) x^ + B~(rho) u) + K(rho) (C~ x^ - y),

which method ``paper`` integrates literally.  Method ``exact`` replaces the interpolated model by
the arm's own equation of motion at the estimate, with friction and Coriolis terms computed from
the measured rates, so that the error obeys the mean-value dynamics that its gains are designed
for.  Both use the Heun rule with the torque held and the outputs of both ends of the step.

With T2 = [0; I 0] the position measurement enters only the fault estimate f^ = y_p - S theta^,
undelayed, and no fault of a position sensor, whatever its shape, reaches the state estimate.
"""

import math

import numpy as np

from lpv_core.dynamics import acceleration
from lpv_core.jit import njit
from lpv_core.polytope import exact_weights, paper_scheduling, paper_weights

N_AUGMENTED = 6
N_OUTPUTS = 4


def decoupling(e, c):
    """T1 and T2 from the pseudo-inverse, eqs. (47)-(49).

    Parameters
    ----------
    e : ndarray, shape (6, 6)
        Singular matrix E.
    c : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4), with T1 E + T2 C~ = I, eq. (41).
    """
    delta = np.linalg.pinv(np.vstack([e, c]))
    return delta[:, :N_AUGMENTED], delta[:, N_AUGMENTED:]


def fault_feedthrough(c):
    """T1 and T2 of method ``exact``: T2 = [0; I 0], and T1 = [(I - T2 C~) restricted to x, 0].

    Every solution of T1 E + T2 C~ = I has these first two columns of T2; choosing zeros for the
    rest keeps the whole torque balance in T1, and T1 Bf~ = 0 decouples the fault.

    Parameters
    ----------
    c : ndarray, shape (4, 6)
        C~.

    Returns
    -------
    tuple of ndarray
        T1, shape (6, 6), and T2, shape (6, 4).
    """
    t2 = np.zeros((N_AUGMENTED, N_OUTPUTS))
    t2[4:, :2] = np.eye(2)
    t1 = np.eye(N_AUGMENTED) - t2 @ c
    t1[:, 4:] = 0.0
    return t1, t2


def observer_matrices(a, b, c, t1, t2, k):
    """N_i, L_i and G_i of eqs. (51)-(53).

    Parameters
    ----------
    a, b : ndarray, shapes (h, 6, 6) and (h, 6, 2)
        Augmented vertices A~_i, B~_i.
    c : ndarray, shape (4, 6)
        C~.
    t1, t2 : ndarray
        Decoupling matrices.
    k : ndarray, shape (h, 6, 4)
        K_i.

    Returns
    -------
    tuple of ndarray
        N (h, 6, 6), L (h, 6, 4), G (h, 6, 2).
    """
    n = t1 @ a + k @ c
    return n, n @ t2 - k, t1 @ b


@njit
def _multiply(matrix, vector, out):
    for i in range(matrix.shape[0]):
        total = 0.0
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * vector[j]
        out[i] = total


@njit
def _blend(rho, stack, out):
    """out = sum_i rho_i stack_i, the interpolation of eq. (25)."""
    for r in range(out.shape[0]):
        for q in range(out.shape[1]):
            total = 0.0
            for i in range(rho.shape[0]):
                total += rho[i] * stack[i, r, q]
            out[r, q] = total


@njit
def _estimate(z, y, t2, out):
    """x^ = z + T2 y, eq. (38)."""
    for i in range(6):
        total = z[i]
        for j in range(4):
            total += t2[i, j] * y[j]
        out[i] = total


@njit
def _innovation(x, y, c, out):
    for i in range(4):
        total = -y[i]
        for j in range(6):
            total += c[i, j] * x[j]
        out[i] = total


@njit
def _exact_rates(x, y, torque, t1, k, c, s, s_inv, arm, held, drift, r, out):
    """z' of method ``exact``; ``drift`` and ``r`` are scratch of size 6 and 4."""
    _innovation(x, y, c, r)
    # Measured rates in absolute coordinates feed friction and Coriolis terms: no fault in them.
    rate_1 = s_inv[0, 0] * y[2] + s_inv[0, 1] * y[3]
    rate_2 = s_inv[1, 0] * y[2] + s_inv[1, 1] * y[3]
    drift[0], drift[1] = x[2], x[3]
    drift[2], drift[3] = acceleration(x[0], x[1], rate_1, rate_2, torque[0], torque[1], arm)
    drift[4], drift[5] = -x[4], -x[5]
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += t1[i, j] * drift[j]
        for j in range(4):
            total += k[i, j] * r[j]
        out[i] = total
    for link in range(2):
        if held[link]:
            # Dead reckoning: theta^' is the measured rate; f^ = y_p - S theta^ stays consistent.
            rate = rate_1 if link == 0 else rate_2
            correction = rate - out[link]
            out[link] = rate
            for i in range(2):
                out[4 + i] -= s[i, link] * correction


@njit
def exact_step(z, y_old, y_new, torque, dt, gains, t1, t2, c, s, s_inv, arm, slope_low,
               slope_high, corners, held, x, scratch, k, rho):
    """Advance the exact observer over one sample interval, in place.

    Where the estimate leaves the region of certified gravity slopes, the correction of that
    link's angle is suspended (``held``): the configuration carries no information there.

    Parameters
    ----------
    z : ndarray, shape (6,)
        Observer state, eq. (38); advanced in place.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends of the interval, sensor coordinates [rad], [rad/s].
    torque : ndarray, shape (2,)
        Generalised torques Q held over the interval [N m].
    dt : float
        Length of the interval [s].
    gains : ndarray, shape (16, 6, 4)
        K_i.
    t1, t2, c : ndarray
        T1 (6, 6), T2 (6, 4), C~ (4, 6).
    s, s_inv : ndarray, shape (2, 2)
        Sensor matrix S and its inverse.
    arm : ndarray, shape (12,)
        Constants of the arm.
    slope_low, slope_high : ndarray, shape (2,)
        Certified range of cos(theta_i).
    corners : ndarray, shape (4, 2)
        Quadrangle of the exact polytope.
    held : ndarray of bool, shape (2,)
        Receives which links are held.
    x : ndarray, shape (6,)
        Receives x^ = [theta^, theta^', f^] at the end of the interval.
    scratch : ndarray, shape (5, 6)
        Work space.
    k, rho : ndarray, shapes (6, 4) and (16,)
        Receive the interpolated gain and the weights.
    """
    first, second, drift, r, trial = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    _estimate(z, y_old, t2, x)
    for link in range(2):
        cosine = math.cos(x[link])
        held[link] = cosine < slope_low[link] or cosine > slope_high[link]
    exact_weights(x[0], x[1], slope_low, slope_high, corners, arm, drift[:4], rho)
    _blend(rho, gains, k)
    _exact_rates(x, y_old, torque, t1, k, c, s, s_inv, arm, held, drift, r, first)
    for i in range(6):
        trial[i] = z[i] + dt * first[i]
    _estimate(trial, y_new, t2, x)
    _exact_rates(x, y_new, torque, t1, k, c, s, s_inv, arm, held, drift, r, second)
    for i in range(6):
        z[i] += 0.5 * dt * (first[i] + second[i])
    _estimate(z, y_new, t2, x)


@njit
def _paper_rates(x, y, torque, t1, c, a, b, k, drift, r, out):
    _innovation(x, y, c, r)
    for i in range(6):
        total = b[i, 0] * torque[0] + b[i, 1] * torque[1]
        for j in range(6):
            total += a[i, j] * x[j]
        drift[i] = total
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += t1[i, j] * drift[j]
        for j in range(4):
            total += k[i, j] * r[j]
        out[i] = total


@njit
def paper_step(z, y_old, y_new, torque, dt, gains, t1, t2, c, a_vertices, b_vertices, box,
               x, scratch, k, a, b, rho):
    """Advance the paper's observer (38) over one sample interval, in place.

    The weights come from the estimated angles: theta is not measured without the fault.

    Parameters
    ----------
    z : ndarray, shape (6,)
        Observer state; advanced in place.
    y_old, y_new : ndarray, shape (4,)
        Outputs at both ends of the interval.
    torque : ndarray, shape (2,)
        Input u [N m], absolute coordinates.
    dt : float
        Length of the interval [s].
    gains : ndarray, shape (8, 6, 4)
        K_i.
    t1, t2, c : ndarray
        T1, T2, C~.
    a_vertices, b_vertices : ndarray, shapes (8, 6, 6) and (8, 6, 2)
        A~_i and B~_i.
    box : ndarray, shape (3, 2)
        Ranges of phi1, phi2, phi3.
    x : ndarray, shape (6,)
        Receives the estimate at the end of the interval.
    scratch : ndarray, shape (5, 6)
        Work space.
    k, a, b, rho : ndarray, shapes (6, 4), (6, 6), (6, 2), (8,)
        Receive the interpolated matrices and the weights.
    """
    first, second, drift, r, trial = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    _estimate(z, y_old, t2, x)
    phi_1, phi_2, phi_3 = paper_scheduling(x[0], x[1])
    paper_weights(phi_1, phi_2, phi_3, box, rho)
    _blend(rho, a_vertices, a)
    _blend(rho, b_vertices, b)
    _blend(rho, gains, k)
    _paper_rates(x, y_old, torque, t1, c, a, b, k, drift, r, first)
    for i in range(6):
        trial[i] = z[i] + dt * first[i]
    _estimate(trial, y_new, t2, x)
    _paper_rates(x, y_new, torque, t1, c, a, b, k, drift, r, second)
    for i in range(6):
        z[i] += 0.5 * dt * (first[i] + second[i])
    _estimate(z, y_new, t2, x)
