"""Bounds on the error of the fault estimates, by configuration and past.

Gravity is the only absolute reference of an angle: what the model does not know of the torques is
explained as an angle error, and in time an error q/(G cos theta) builds up.

For method ``exact`` the bound is a reachable set plus a multiple of noise: all errors that the
unknown torques of a healthy arm (model error, payload, friction, mean disturbance) can have caused
since the start, whatever their course in time.  The model errors of method ``paper`` have no exact
form; its bound is the static error of the configuration, which rises at once and falls at the
certified decay rate.
"""

import math

import numpy as np

from lpv_core.arm import A_11, B_12, C_22, G_1, G_2
from lpv_core.dead_reckoning import RATE_BIAS
from lpv_core.jit import njit
from lpv_core.joints import JointMap, weigh
from lpv_core.records import new_record, record_type
from lpv_core.unknown_torque import UNKNOWN_TORQUE, healthy_arm, unknown_torque
from lpv_core.zonotope import COLUMNS, SIZE, extent, map_columns, reduce_columns

_LARGEST = 10.0
"""A larger set says nothing more [rad]."""
_LONGEST = 60.0
"""After so long a gap the set has come to rest; a clock that jumps by years must not take hours
[s]."""

BOUND_CONSTANTS = record_type(
    ('exact', '?'), ('sign', 'f8'), ('kappa', 'f8', (2,)), ('mu', 'f8', (2,)),
    ('fastest', 'f8'), ('unlearn', 'f8'), ('decay', 'f8'), ('spread', 'f8', (2, 2)),
    ('noise', 'f8', (2,)), ('angle_noise', 'f8', (2,)), ('start', 'f8', (2,)),
    ('drift', 'f8', (2,)), ('bias', 'f8', (2,)), ('to_angle', 'f8', (2, 2)),
    ('gravity', 'f8', (2,)), ('inertia', 'f8', (2,)), ('cos_min', 'f8', (2,)),
    ('unknown', UNKNOWN_TORQUE))
"""Method; s; gains; largest mu and slowest recovery [1/s]; decay rate of method paper [1/s];
abs(S); noise part of the bound, per sensor and per angle [rad]; error at the start [rad]; growth by
noise of the rates [rad/sqrt(s)] and by their bias [rad/s]; abs(S^-1); G_i, Xi_ii, region; healthy
arm."""

BOUND_STATE = record_type(
    ('count', 'i8'), ('columns', 'f8', (SIZE, COLUMNS)), ('extent', 'f8', (SIZE,)),
    ('held_for', 'f8', (2,)), ('bound', 'f8', (2,)),
    ('momentum', 'f8', (2,)), ('torque', 'f8', (2,)), ('margin', 'f8', (2,)),
    ('map', 'f8', (SIZE, SIZE)), ('n', 'f8', (SIZE, SIZE)))
"""The set of the errors (e_1, e_2, r_1, r_2), r_i = s m_i/Xi_ii the momentum error in units of a
rate (method paper: ``extent`` alone); how long links have been held, less what was unlearnt [s];
results: bounds on the error per sensor [rad], on r of a healthy arm [rad/s]; work space."""


def error_bound(arm, gains, sigmas, friction_uncertainty):
    """Constants of the bound for one arm and its gains.

    Parameters
    ----------
    arm : ArmParameters
        What a healthy arm may do.
    gains : Gains
        Its gains.
    sigmas : float
        Standard deviations of noise in the bound.
    friction_uncertainty : float
        Relative uncertainty of Coulomb friction.

    Returns
    -------
    numpy.record
        Of type `BOUND_CONSTANTS`.
    """
    observer, constants = gains.observer, arm.constants()
    sensor_matrix = JointMap(arm).sensor_matrix
    spread, noise = np.abs(sensor_matrix), sigmas * np.asarray(observer.fault_sigma)
    gravity, inertia = constants[[G_1, G_2]], constants[[A_11, C_22]]
    to_angle = np.abs(np.linalg.inv(sensor_matrix))
    c = new_record(
        BOUND_CONSTANTS, sign=arm.sign, spread=spread, noise=noise,
        angle_noise=np.linalg.solve(spread, noise),
        start=sigmas * arm.position_noise * to_angle.sum(axis=1),
        drift=(sigmas * arm.velocity_noise * math.sqrt(arm.sample_time)
               * np.hypot(*to_angle.T)),
        bias=RATE_BIAS * arm.velocity_noise * to_angle.sum(axis=1), to_angle=to_angle,
        gravity=gravity, inertia=inertia, cos_min=arm.cos_min, decay=observer.decay,
        unknown=healthy_arm(arm, friction_uncertainty))
    if observer.method == 'exact':
        kappa, mu = np.asarray(observer.kappa), np.asarray(observer.mu)
        c.exact, c.kappa, c.mu, c.fastest = True, kappa, mu, mu.max()
        c.unlearn = np.min(kappa * gravity * np.asarray(arm.cos_min) / mu)
    return c


@njit
def reset_bound(s):
    """Forget the past: the next estimate is a first one."""
    s.columns[:] = 0.0
    s.extent[:] = 0.0
    s.held_for[:] = 0.0
    s.count = 0


@njit
def update_bound(c, s, e, lost):
    """Follow the configuration; fills ``bound`` and ``momentum`` of the state.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state.
    e : numpy.record
        Latest estimate.
    lost : ndarray, shape (2,)
        What samples that were lost just before leave unknown of each sensor's angle [rad].
    """
    for i in range(2):
        gap = weigh(c.to_angle, i, lost[0], lost[1])
        if gap > 0.0 and s.count > 0:
            _widen(c, s, i, gap)
    if c.exact:
        _follow_set(c, s, e)
    else:
        _follow_static(c, s, e)


@njit
def _widen(c, s, i, gap):
    """Add an unknown part of an angle to the errors."""
    if not c.exact:
        s.extent[i] += gap
        return
    s.columns[:, s.count] = 0.0
    s.columns[i, s.count] = gap
    s.count += 1
    if s.count + SIZE > COLUMNS:
        s.count = reduce_columns(s.columns, s.count)


@njit
def _follow_set(c, s, e):
    if s.count == 0:
        s.columns[0, 0], s.columns[1, 1] = c.start[0], c.start[1]
        s.count = 2
    elif max(s.extent[0], s.extent[1]) <= _LARGEST:
        _advance(c, s, e)
    extent(s.columns, s.count, s.extent)
    _reckon(c, s, e)
    error_1 = min(s.extent[0] + c.drift[0] * math.sqrt(s.held_for[0]), _LARGEST)
    error_2 = min(s.extent[1] + c.drift[1] * math.sqrt(s.held_for[1]), _LARGEST)
    for i in range(2):
        s.bound[i] = weigh(c.spread, i, error_1, error_2) + c.noise[i]
        s.momentum[i] = s.extent[2 + i]


@njit
def _advance(c, s, e):
    theta, rate, acc = e.absolute_position, e.absolute_velocity, e.absolute_acceleration
    error_matrix(c, theta, rate, acc, e.held, s.n)
    for i in range(2):
        s.margin[i] = s.extent[i] + c.angle_noise[i]
    unknown_torque(c.unknown, theta, rate, acc, s.margin, s.torque)
    interval = min(e.interval, _LONGEST)
    steps = max(1, math.ceil(interval * c.fastest / 0.5))
    dt = interval / steps
    for _ in range(steps):
        advance_set(c, s, dt)


@njit
def error_matrix(c, theta, rate, acc, held, n):
    """N of the error at the estimate.

    The coupling of inertia and Coriolis terms enters with its known sign; what its linearisation
    leaves out is quadratic in the error.

    Parameters
    ----------
    c : numpy.record
        Constants.
    theta, rate, acc : ndarray, shape (2,)
        Absolute angles, rates, accelerations at the estimate.
    held : ndarray of bool, shape (2,)
        Links without correction.
    n : ndarray, shape (4, 4)
        Receives N; entries that are always zero are left alone.
    """
    arm = c.unknown.arm
    cosine, sine = math.cos(theta[0] - theta[1]), math.sin(theta[0] - theta[1])
    b = c.sign * arm[B_12]
    couple_1 = -b * (cosine * rate[1] * rate[1] - sine * acc[1]) / arm[A_11]
    couple_2 = b * (cosine * rate[0] * rate[0] + sine * acc[0]) / arm[C_22]
    n[0, 2] = 0.0 if held[0] else -c.kappa[0] * arm[A_11]
    n[1, 3] = 0.0 if held[1] else -c.kappa[1] * arm[C_22]
    n[2, 0] = c.sign * arm[G_1] * math.cos(theta[0]) / arm[A_11] + couple_1
    n[2, 1] = -couple_1
    n[3, 0] = couple_2
    n[3, 1] = c.sign * arm[G_2] * math.cos(theta[1]) / arm[C_22] - couple_2
    n[2, 2], n[3, 3] = -c.mu[0], -c.mu[1]


@njit
def advance_set(c, s, dt):
    """Map the set by exp(N dt) to second order and add a box of inputs.

    Parameters
    ----------
    c, s : numpy.record
        Constants and state, with N in ``n`` and the unknown torques in ``torque``.
    dt : float
        Interval [s].
    """
    n, step, columns = s.n, s.map, s.columns
    half = 0.5 * dt * dt
    for r in range(SIZE):
        for q in range(SIZE):
            square = 0.0
            for k in range(SIZE):
                square += n[r, k] * n[k, q]
            step[r, q] = dt * n[r, q] + half * square
        step[r, r] += 1.0
    map_columns(columns, s.count, step)
    for i in range(2):
        push = s.torque[i] / c.inertia[i]
        for r in range(SIZE):
            columns[r, s.count] = columns[r, s.count + 1] = 0.0
        columns[2 + i, s.count] = dt * push
        # Half a step's travel of the input, for its effect within the interval.
        columns[i, s.count] = half * n[i, 2 + i] * push
        columns[i, s.count + 1] = dt * c.bias[i]
        s.count += 2
    if s.count + SIZE > COLUMNS:
        s.count = reduce_columns(columns, s.count)


@njit
def _reckon(c, s, e):
    """Count how long noise of the rates was integrated while a link was held; it is unlearnt as
    slowly as the observer recovers."""
    fall = math.exp(-e.interval * c.unlearn)
    for i in range(2):
        if e.held[i]:
            s.held_for[i] += e.interval
        else:
            s.held_for[i] *= fall


@njit
def _follow_static(c, s, e):
    s.margin[:] = 0.0
    unknown_torque(c.unknown, e.absolute_position, s.margin, s.margin, s.margin, s.torque)
    fall = math.exp(-c.decay * e.interval)
    for i in range(2):
        slope = c.gravity[i] * max(abs(math.cos(e.absolute_position[i])), c.cos_min[i])
        target = s.torque[i] / slope
        left = s.extent[i] - target if s.count else 0.0
        s.extent[i] = target + max(0.0, fall * left)
        # Nothing is known of the momentum.
        s.momentum[i] = math.inf
    s.count = 1
    for i in range(2):
        s.bound[i] = weigh(c.spread, i, s.extent[0], s.extent[1]) + c.noise[i]


def static_bound(c, theta):
    """Bound at rest in one configuration, after all transients.

    For method ``exact`` from the comparison system of the error, whose poles are real at every
    slope; for method ``paper`` the slope is clipped to the region.

    Parameters
    ----------
    c : numpy.record
        `error_bound`.
    theta : ndarray, shape (2,)
        Absolute angles [rad].

    Returns
    -------
    ndarray, shape (2,)
        Per physical sensor [rad]; infinite where gravity cannot bound it.
    """
    theta, still, torque = np.asarray(theta, float), np.zeros(2), np.zeros(2)
    unknown_torque(c.unknown, theta, still, still, still, torque)
    if not c.exact:
        slope = c.gravity * np.maximum(np.abs(np.cos(theta)), c.cos_min)
        return c.spread @ (torque / slope) + c.noise
    # A bias of the rates is held up by a momentum, and that by a torque.
    torque = torque + c.bias * c.mu / c.kappa
    # Distance from the vertical; the slope falls with it.
    away = np.arccos(np.clip(c.sign * np.cos(theta), -1.0, 1.0))
    error = np.zeros(2)
    for _ in range(100):
        slope = c.gravity * np.cos(np.minimum(away + error + c.angle_noise, math.pi))
        error = np.where(slope > 0.0, torque / np.maximum(slope, 1e-12), math.pi)
        error = np.minimum(error, math.pi)
    error[error >= math.pi] = math.inf
    # Not 0*inf: a sensor that does not see a link does not see its error.
    return np.array([sum(w * e for w, e in zip(row, error) if w) for row in c.spread]) + c.noise
