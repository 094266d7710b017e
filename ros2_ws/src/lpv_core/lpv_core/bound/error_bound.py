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

from lpv_core.bound.unknown_torque import UNKNOWN_TORQUE, healthy_arm, unknown_torque
from lpv_core.bound.zonotope import COLUMNS, SIZE, extent, map_columns, reduce_columns
from lpv_core.certificate.gains import ExactObserverGains, Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.model.joints import JointMap, row_dot
from lpv_core.residual.dead_reckoning import RATE_BIAS
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type

_LARGEST = 10.0
"""A larger set says nothing more [rad]."""
_LONGEST = 60.0
"""After so long a gap the set has come to rest; a clock that jumps by years must not take hours
[s]."""

BOUND_CONSTANTS = record_type(
    ('exact', '?'),  # method exact; otherwise the static bound of method paper
    ('sign', 'f8'),  # s: +1 upright, -1 hanging
    ('kappa', 'f8', (2,)),  # [1/(kg m2)]
    ('mu', 'f8', (2,)),  # [1/s]
    ('fastest', 'f8'),  # largest mu [1/s]
    ('slowest_recovery', 'f8'),  # slowest pole of the angle errors [1/s]
    ('decay', 'f8'),  # certified decay rate of method paper [1/s]
    ('spread', 'f8', (2, 2)),  # abs(S): angles to sensors
    ('to_angle', 'f8', (2, 2)),  # abs(S^-1): sensors to angles
    ('noise', 'f8', (2,)),  # noise in the bound, per sensor [rad]
    ('angle_noise', 'f8', (2,)),  # the same per angle [rad]
    ('start', 'f8', (2,)),  # error at the start, per angle [rad]
    ('drift', 'f8', (2,)),  # growth by noise of the rates, per angle [rad/sqrt(s)]
    ('bias', 'f8', (2,)),  # bias of the rates, per angle [rad/s]
    ('gravity', 'f8', (2,)),  # G_i [N m]
    ('inertia', 'f8', (2,)),  # Xi_ii [kg m2]
    ('cos_min', 'f8', (2,)),  # region
    ('unknown', UNKNOWN_TORQUE),  # what a healthy arm may do
)
"""Constants of `update_bound` for one arm."""

BOUND_STATE = record_type(
    ('used', 'i8'),  # columns of the zonotope in use; 0 before the first estimate
    ('columns', 'f8', (SIZE, COLUMNS)),  # zonotope of (e_1, e_2, r_1, r_2) [rad], [rad/s]
    ('extent', 'f8', (SIZE,)),  # its extents; of method paper the bounds on e alone
    ('held_for', 'f8', (2,)),  # how long links were held, less what has decayed [s]
    ('bound', 'f8', (2,)),  # result: bound on the error of each sensor's fault estimate [rad]
    ('momentum', 'f8', (2,)),  # result: bound on r of a healthy arm [rad/s]
    ('torque', 'f8', (2,)),  # bound on the unknown torques [N m]
    ('margin', 'f8', (2,)),  # bound on the angle errors, with noise [rad]
    ('map', 'f8', (SIZE, SIZE)),  # work space: exp(N dt)
    ('n', 'f8', (SIZE, SIZE)),  # work space: N
)
"""Reachable set of the errors; r_i = s m_i/Xi_ii is the momentum error in units of a rate."""


def error_bound(
    arm: ArmParameters, gains: Gains, sigmas: float, friction_uncertainty: float
) -> np.record:
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
    gravity, inertia = constants.gravity, constants.inertia
    to_angle = np.abs(np.linalg.inv(sensor_matrix))
    params = new_record(
        BOUND_CONSTANTS,
        sign=arm.sign,
        spread=spread,
        noise=noise,
        angle_noise=np.linalg.solve(spread, noise),
        start=sigmas * arm.position_noise * to_angle.sum(axis=1),
        drift=(sigmas * arm.velocity_noise * math.sqrt(arm.sample_time) * np.hypot(*to_angle.T)),
        bias=RATE_BIAS * arm.velocity_noise * to_angle.sum(axis=1),
        to_angle=to_angle,
        gravity=gravity,
        inertia=inertia,
        cos_min=arm.cos_min,
        decay=observer.decay,
        unknown=healthy_arm(arm, friction_uncertainty),
    )
    if isinstance(observer, ExactObserverGains):
        kappa, mu = np.asarray(observer.kappa), np.asarray(observer.mu)
        params.exact, params.kappa, params.mu, params.fastest = True, kappa, mu, mu.max()
        params.slowest_recovery = np.min(kappa * gravity * np.asarray(arm.cos_min) / mu)
    return params


@njit
def reset_bound(state: np.record) -> None:
    """Forget the past: the next estimate is a first one."""
    state.columns[:] = 0.0
    state.extent[:] = 0.0
    state.held_for[:] = 0.0
    state.used = 0


@njit
def update_bound(
    params: np.record, state: np.record, estimate: np.record, lost: np.ndarray
) -> None:
    """Follow the configuration; fills ``bound`` and ``momentum`` of the state."""
    for i in range(2):
        gap = row_dot(params.to_angle, i, lost[0], lost[1])
        if gap > 0.0 and state.used > 0:
            _widen(params, state, i, gap)
    if params.exact:
        _follow_set(params, state, estimate)
    else:
        _follow_static(params, state, estimate)


@njit
def _widen(params: np.record, state: np.record, i: int, gap: float) -> None:
    """Add an unknown part of an angle to the errors."""
    if not params.exact:
        state.extent[i] += gap
        return
    column = state.used
    state.columns[:, column] = 0.0
    state.columns[i, column] = gap
    state.used = column + 1
    if column + 1 + SIZE > COLUMNS:
        state.used = reduce_columns(state.columns, column + 1)


@njit
def _follow_set(params: np.record, state: np.record, estimate: np.record) -> None:
    if state.used == 0:
        state.columns[0, 0], state.columns[1, 1] = params.start[0], params.start[1]
        state.used = 2
    elif max(state.extent[0], state.extent[1]) <= _LARGEST:
        _advance(params, state, estimate)
    extent(state.columns, state.used, state.extent)
    _update_held_time(params, state, estimate)
    error_1 = min(state.extent[0] + params.drift[0] * math.sqrt(state.held_for[0]), _LARGEST)
    error_2 = min(state.extent[1] + params.drift[1] * math.sqrt(state.held_for[1]), _LARGEST)
    for i in range(2):
        state.bound[i] = row_dot(params.spread, i, error_1, error_2) + params.noise[i]
        state.momentum[i] = state.extent[2 + i]


@njit
def _advance(params: np.record, state: np.record, estimate: np.record) -> None:
    theta, rate, acc = (
        estimate.absolute_position,
        estimate.absolute_velocity,
        estimate.absolute_acceleration,
    )
    error_matrix(params, theta, rate, acc, estimate.held, state.n)
    for i in range(2):
        state.margin[i] = state.extent[i] + params.angle_noise[i]
    unknown_torque(params.unknown, theta, rate, acc, state.margin, state.torque)
    interval = min(estimate.interval, _LONGEST)
    steps = max(1, math.ceil(interval * params.fastest / 0.5))
    dt = interval / steps
    for _ in range(steps):
        advance_set(params, state, dt)


@njit
def error_matrix(
    params: np.record,
    theta: np.ndarray,
    rate: np.ndarray,
    acc: np.ndarray,
    held: np.ndarray,
    n: np.ndarray,
) -> None:
    """N of the error at the estimate.

    The coupling of inertia and Coriolis terms enters with its known sign; what its linearisation
    leaves out is quadratic in the error.
    """
    arm = params.unknown.arm
    cosine, sine = math.cos(theta[0] - theta[1]), math.sin(theta[0] - theta[1])
    b = params.sign * arm.coupling
    couple_1 = -b * (cosine * rate[1] * rate[1] - sine * acc[1]) / arm.inertia[0]
    couple_2 = b * (cosine * rate[0] * rate[0] + sine * acc[0]) / arm.inertia[1]
    n[0, 2] = 0.0 if held[0] else -params.kappa[0] * arm.inertia[0]
    n[1, 3] = 0.0 if held[1] else -params.kappa[1] * arm.inertia[1]
    n[2, 0] = params.sign * arm.gravity[0] * math.cos(theta[0]) / arm.inertia[0] + couple_1
    n[2, 1] = -couple_1
    n[3, 0] = couple_2
    n[3, 1] = params.sign * arm.gravity[1] * math.cos(theta[1]) / arm.inertia[1] - couple_2
    n[2, 2], n[3, 3] = -params.mu[0], -params.mu[1]


@njit
def advance_set(params: np.record, state: np.record, dt: float) -> None:
    """Map the set by exp(N dt) to second order and add a box of inputs."""
    n, step, columns = state.n, state.map, state.columns
    half = 0.5 * dt * dt
    for r in range(SIZE):
        for q in range(SIZE):
            square = 0.0
            for k in range(SIZE):
                square += n[r, k] * n[k, q]
            step[r, q] = dt * n[r, q] + half * square
        step[r, r] += 1.0
    map_columns(columns, state.used, step)
    for i in range(2):
        push = state.torque[i] / params.inertia[i]
        for r in range(SIZE):
            columns[r, state.used] = columns[r, state.used + 1] = 0.0
        columns[2 + i, state.used] = dt * push
        # Half a step's travel of the input, for its effect within the interval.
        columns[i, state.used] = half * n[i, 2 + i] * push
        columns[i, state.used + 1] = dt * params.bias[i]
        state.used += 2
    if state.used + SIZE > COLUMNS:
        state.used = reduce_columns(columns, state.used)


@njit
def _update_held_time(params: np.record, state: np.record, estimate: np.record) -> None:
    """Count how long noise of the rates was integrated while a link was held; it is unlearnt as
    slowly as the observer recovers."""
    fall = math.exp(-estimate.interval * params.slowest_recovery)
    for i in range(2):
        if estimate.held[i]:
            state.held_for[i] += estimate.interval
        else:
            state.held_for[i] *= fall


@njit
def _follow_static(params: np.record, state: np.record, estimate: np.record) -> None:
    state.margin[:] = 0.0
    unknown_torque(
        params.unknown,
        estimate.absolute_position,
        state.margin,
        state.margin,
        state.margin,
        state.torque,
    )
    fall = math.exp(-params.decay * estimate.interval)
    for i in range(2):
        slope = params.gravity[i] * max(
            abs(math.cos(estimate.absolute_position[i])), params.cos_min[i]
        )
        target = state.torque[i] / slope
        left = state.extent[i] - target if state.used else 0.0
        state.extent[i] = target + max(0.0, fall * left)
        # Nothing is known of the momentum.
        state.momentum[i] = math.inf
    state.used = 1
    for i in range(2):
        state.bound[i] = (
            row_dot(params.spread, i, state.extent[0], state.extent[1]) + params.noise[i]
        )


def static_bound(params: np.record, theta: np.ndarray) -> np.ndarray:
    """Bound at rest in one configuration, after all transients.

    For method ``exact`` from the comparison system of the error, whose poles are real at every
    slope; for method ``paper`` the slope is clipped to the region.

    Parameters
    ----------
    params : numpy.record
        `error_bound`.
    theta : ndarray, shape (2,)
        Absolute angles [rad].

    Returns
    -------
    ndarray, shape (2,)
        Per physical sensor [rad]; infinite where gravity cannot bound it.
    """
    theta, still, torque = np.asarray(theta, float), np.zeros(2), np.zeros(2)
    unknown_torque(params.unknown, theta, still, still, still, torque)
    if not params.exact:
        slope = params.gravity * np.maximum(np.abs(np.cos(theta)), params.cos_min)
        return params.spread @ (torque / slope) + params.noise
    # A bias of the rates is held up by a momentum, and that by a torque.
    torque = torque + params.bias * params.mu / params.kappa
    # Distance from the vertical; the slope falls with it.
    away = np.arccos(np.clip(params.sign * np.cos(theta), -1.0, 1.0))
    error = np.zeros(2)
    for _ in range(100):
        slope = params.gravity * np.cos(np.minimum(away + error + params.angle_noise, math.pi))
        error = np.where(slope > 0.0, torque / np.maximum(slope, 1e-12), math.pi)
        error = np.minimum(error, math.pi)
    error[error >= math.pi] = math.inf
    # Not 0*inf: a sensor that does not see a link does not see its error.
    return (
        np.array([sum(w * e for w, e in zip(row, error) if w) for row in params.spread])
        + params.noise
    )
