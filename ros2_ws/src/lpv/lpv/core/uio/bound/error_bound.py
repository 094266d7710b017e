"""Bounds on the error of the fault estimates, by configuration and past.

Gravity is the only absolute reference of an angle: what the model does not know of the torques is
explained as an angle error, and in time an error q/(G cos theta) builds up.

For method ``exact`` the bound is a reachable set plus a multiple of noise: all errors that the
unknown torques and wrong rates of a healthy arm (model error, payload, friction, mean disturbance,
bias and relative error of the rates) can have caused since the start, whatever their time profile.
At every step the set is cut with what dead reckoning allows
(`lpv.core.uio.bound.dead_reckoning`), so that it comes back from wherever gravity could
not bound it.  The model errors of method ``paper`` have no exact form; its bound is the static
error of the configuration, which rises at once and falls at the certified decay rate.
"""

import math

import numpy as np

from lpv.core.serial_arm.description import SIGMAS
from lpv.core.serial_arm.diagnosis.sampler import LATE
from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.jit import njit_in_place as njit
from lpv.core.support.records import new_record, record_type
from lpv.core.uio.bound.dead_reckoning import (
    RECKONING_STATE,
    cut_interval,
    move_interval,
    note_lost_samples,
    start_reckoning,
)
from lpv.core.uio.bound.unknown_torque import (
    MOTION,
    UNKNOWN_TORQUE,
    bound_rate_errors,
    carry_load,
    healthy_arm,
    inertia_errors,
    unknown_torque,
)
from lpv.core.uio.bound.zonotope import (
    COLUMNS,
    SIZE,
    extent,
    map_columns,
    reduce_columns,
    shear_columns,
)
from lpv.core.uio.model.dynamics import COSINE, SINE, coupling, set_pose
from lpv.core.uio.model.joints import row_size
from lpv.core.uio.observer.exact_observer import ExactObserverGains, injection
from lpv.core.uio.observer.sampled_observer import ObserverGains

_LARGEST = 10.0
"""A larger set says nothing more [rad]."""
_FAR = 2.0
"""A set so many times beyond dead reckoning starts again."""
_FADING = 0.95
"""Share of the largest change of theta'' within a sample that counts a sample later: what is left
when a motion that turns in 30 samples has its largest second derivative."""
_INPUTS = 6
"""Columns that a step adds: two torques, two errors of rates, two of the injection."""

BOUND_CONSTANTS = record_type(
    ('exact', '?'),  # method exact; otherwise the static bound of method paper
    ('sign', 'f8'),  # s: +1 upright, -1 hanging
    ('kappa', 'f8', (2,)),  # [1/(kg m2)]
    ('mu', 'f8', (2,)),  # [1/s]
    ('slowest_recovery', 'f8'),  # slowest pole of the angle errors [1/s]
    ('decay', 'f8'),  # certified decay rate of method paper [1/s]
    ('noise', 'f8', (2,)),  # noise in the bound, per sensor [rad]
    ('angle_noise', 'f8', (2,)),  # the same per angle [rad]
    ('start', 'f8', (2,)),  # error at the start, per angle [rad]
    ('drift', 'f8', (2,)),  # growth by noise of the rates, per angle [rad/sqrt(s)]
    ('cos_min', 'f8', (2,)),  # region
    ('longest', 'f8'),  # longest interval without lost samples [s]
    ('sample_time', 'f8'),  # [s]
    ('unknown', UNKNOWN_TORQUE),  # what a healthy arm may do
)
"""Constants of `update_bound` for one arm."""

BOUND_STATE = record_type(
    ('used', 'i8'),  # columns of the zonotope in use; 0 before the first estimate
    ('columns', 'f8', (SIZE, COLUMNS)),  # zonotope of (e_1, e_2, r_1, r_2) [rad], [rad/s]
    ('extent', 'f8', (SIZE,)),  # its extents; of method paper the bounds on e alone
    ('held_for', 'f8', (2,)),  # how long links were held, less what has decayed [s]
    ('bound', 'f8', (2,)),  # result: bound on the error of each sensor's fault estimate [rad]
    ('reckoning', RECKONING_STATE),  # the errors by dead reckoning
    ('motion', MOTION),  # signals of the present step
    ('bend', 'f8', (2,)),  # largest change of theta'' within a sample, fading [rad/s2]
    ('rate_error', 'f8', (2,)),  # of the motion, at the last sample alone [rad/s]
    ('turned', 'f8', (2,)),  # Xi times that [N m]
    ('torque', 'f8', (2,)),  # bound on the unknown torques [N m]
    ('kappa', 'f8', (2,)),  # of the constants, 0 for a held link [1/(kg m2)]
    ('n', 'f8', (SIZE, SIZE)),  # N of the error
    ('half', 'f8', (SIZE, SIZE)),  # work space: I + N dt/2
    ('map', 'f8', (SIZE, SIZE)),  # work space: exp(N dt)
    ('inputs', 'f8', (SIZE, _INPUTS)),  # largest inputs, one a column
    ('sizes', 'f8', (COLUMNS,)),  # work space of `reduce_columns`
    ('box', 'f8', (SIZE,)),
)
"""Reachable set of the errors; r_i = s m_i/Xi_ii is the momentum error in units of a rate."""


def error_bound(arm: ArmParameters, observer: ObserverGains, sigmas: float = SIGMAS) -> np.record:
    """Constants of the bound, of type `BOUND_CONSTANTS`, with ``sigmas`` standard deviations of
    noise."""
    unknown = healthy_arm(arm, sigmas)
    noise, to_angle = sigmas * observer.fault_sigma, np.abs(unknown.joints.angle)
    # Of f^ less that of the reading: `exact_fault_sigma` adds squares, not deviations.
    of_angles = np.sqrt(np.maximum(noise**2 - (sigmas * arm.position_noise) ** 2, 0.0))
    params = new_record(
        BOUND_CONSTANTS,
        sign=arm.sign,
        noise=noise,
        angle_noise=np.linalg.solve(np.abs(unknown.joints.sensor), of_angles),
        start=sigmas * arm.position_noise * to_angle.sum(axis=1),
        drift=(sigmas * arm.velocity_noise * math.sqrt(arm.sample_time) * np.hypot(*to_angle.T)),
        cos_min=arm.cos_min,
        decay=observer.decay,
        longest=LATE * arm.sample_time,
        sample_time=arm.sample_time,
        unknown=unknown,
    )
    if isinstance(observer, ExactObserverGains):
        params.exact, params.kappa, params.mu = True, observer.kappa, observer.mu
        gravity = np.array(arm.numbers().gravity)
        params.slowest_recovery = np.min(observer.kappa * gravity * arm.cos_min / observer.mu)
    return params


@njit
def reset_bound(state: np.record) -> None:
    """Forget the past: the next estimate is a first one."""
    state.columns[:] = 0.0
    state.extent[:] = 0.0
    state.held_for[:] = 0.0
    state.bend[:] = state.rate_error[:] = 0.0
    state.used = 0


@njit
def update_bound(params: np.record, state: np.record, observer: np.record) -> None:
    """Follow one estimate; fills ``bound`` of the state."""
    if state.used == 0:
        start_reckoning(state.reckoning, observer, params.start, params.angle_noise)
    else:
        note_lost_samples(params.longest, state.reckoning, observer)
    if params.exact:
        _follow_set(params, state, observer)
    else:
        _follow_static(params, state, observer)
    error_1, error_2 = _angle_error(params, state, 0), _angle_error(params, state, 1)
    for i in range(2):
        error = row_size(params.unknown.joints.sensor, i, error_1, error_2)
        state.bound[i] = error + params.noise[i]


@njit
def _follow_set(params: np.record, state: np.record, observer: np.record) -> None:
    if state.used == 0:
        state.columns[0, 0], state.columns[1, 1] = params.start[0], params.start[1]
        state.used = 2
        _read_motion(params, state, observer)
    else:
        for i in range(2):
            if state.reckoning.jump[i] > 0.0:  # one more column
                state.columns[:, state.used] = 0.0
                state.columns[i, state.used] = state.reckoning.jump[i]
                state.used += 1
                _make_room(params, state)
        _read_motion(params, state, observer)
        move_interval(state.reckoning, observer, state.motion.rate_error)
        if not observer.bridged:
            _advance(params, state, observer)
    if observer.innovation[0] == 0.0 and observer.innovation[1] == 0.0:
        _begin_momenta(params, state)
    extent(state.columns, state.used, state.extent)
    _cut(params, state)
    for i in range(2):
        if observer.held[i]:
            state.held_for[i] += observer.interval
        elif state.held_for[i] > 0.0:
            state.held_for[i] *= math.exp(-observer.interval * params.slowest_recovery)


@njit
def _begin_momenta(params: np.record, state: np.record) -> None:
    """Momentum errors where the observer begins with the measured rates: m = M eta.

    Noise of these rates does as little as that of the torques leaves out until it has built up.
    """
    unknown, wrong, at = params.unknown, state.motion.rate_error, state.used
    off = abs(coupling(state.motion.pose, unknown.arm)) + inertia_errors(unknown, state.motion)[0]
    state.columns[2:, :at] = 0.0
    state.columns[:, at : at + 2] = 0.0
    for i in range(2):
        inertia = unknown.arm.inertia[i]
        momentum = (inertia + unknown.own[i]) * wrong[i] + off * wrong[1 - i]
        state.columns[2 + i, at + i] = momentum / inertia
    state.used += 2
    _make_room(params, state)


@njit
def _angle_error(params: np.record, state: np.record, i: int) -> float:
    """Bound on an angle error, less the noise of an estimate that gravity renews."""
    noise = params.drift[i] * math.sqrt(state.held_for[i])
    return min(state.extent[i] + noise, _LARGEST)


@njit
def _make_room(params: np.record, state: np.record) -> None:
    """Merge small columns in the coordinates of slow and fast errors, (e_i - shear_i r_i, r_i) with
    shear_i = kappa_i Xi_ii/mu_i [s]."""
    if state.used + _INPUTS > COLUMNS:
        inertia = params.unknown.arm.inertia
        first = state.kappa[0] * inertia[0] / params.mu[0]
        second = state.kappa[1] * inertia[1] / params.mu[1]
        shear_columns(state.columns, state.used, -first, -second)
        state.used = reduce_columns(state.columns, state.used, state.sizes, state.box)
        shear_columns(state.columns, state.used, first, second)


@njit
def _cut(params: np.record, state: np.record) -> None:
    """Take the smaller of the set and dead reckoning for each angle."""
    # A set far beyond dead reckoning starts again as a box within it; before, a box would lose more
    # than it cuts off, namely which errors belong together.
    restart = False
    for i in range(2):
        known = params.angle_noise[i] + params.drift[i] * math.sqrt(state.held_for[i])
        within = cut_interval(state.reckoning, i, state.extent[i] + known, params.drift[i])
        reckoned = params.angle_noise[i] + within
        restart = restart or state.extent[i] > _FAR * reckoned
        state.extent[i] = min(state.extent[i], reckoned)
    if restart:
        state.columns[:] = 0.0
        for k in range(SIZE):
            state.columns[k, k] = state.extent[k]
        state.used = SIZE


@njit
def _read_motion(params: np.record, state: np.record, observer: np.record) -> None:
    """Known signals at the estimate, how wrong angles and rates may be, and what sampling leaves
    out by the change of theta'' within a sample.

    Angles by the trapezoid of the rates miss dt^2/12 of it, more in the reckoning's ``jump``.
    """
    motion, arm, bend = state.motion, params.unknown.arm, state.bend
    for i in range(2):
        for k in range(3):
            motion.pose[i, k] = observer.pose[i, k]
        motion.rate[i] = observer.v_new[i]
        motion.innovation[i] = observer.innovation[i]
        motion.mu[i] = params.mu[i]
        motion.margin[i] = min(state.extent[i] + params.angle_noise[i], math.pi)
        state.kappa[i] = 0.0 if observer.held[i] else params.kappa[i]
        bend[i] = max(observer.bend[i], _FADING * bend[i])
        state.reckoning.jump[i] += observer.interval * observer.interval / 12.0 * bend[i]
    off = abs(coupling(motion.pose, arm))
    state.turned[0] = arm.inertia[0] * bend[0] + off * bend[1]
    state.turned[1] = off * bend[0] + arm.inertia[1] * bend[1]
    bound_rate_errors(params.unknown, motion)
    for i in range(2):  # between two samples as at the worse one
        now = motion.rate_error[i]
        motion.rate_error[i] = max(now, state.rate_error[i])
        state.rate_error[i] = now
    # theta^'' = acceleration - Xi^-1 (mu Xi + Xi'(v)) r of the observer.
    r = motion.innovation[0], motion.innovation[1]
    acc = observer.acceleration
    carry_load(params.unknown, motion, acc)
    _, _, k_1, k_2 = injection(motion.pose, motion.rate, r, params.mu, arm)
    for i in range(2):
        motion.driven[i, 0] = acc[0] - k_1 + params.mu[i] * r[0]
        motion.driven[i, 1] = acc[1] - k_2 + params.mu[i] * r[1]


@njit
def _advance(params: np.record, state: np.record, observer: np.record) -> None:
    interval = observer.interval
    unknown_torque(params.unknown, state.motion, state.torque)
    for i in range(2):
        # The rate at the end of a step is predicted without it, in the injection; and the rule's
        # own error, dt^2/12 of the second derivative.
        state.torque[i] += (0.25 * params.mu[i] * interval + 1.0 / 12.0) * state.turned[i]
        # Torques of a longer interval are those of its last sample time; before, they were others.
        state.torque[i] += max(1.0 - params.sample_time / interval, 0.0) * observer.change[i]
    error_system(params, state, interval)
    steps = max(1, math.ceil(interval * max(params.mu[0], params.mu[1]) / 0.5))
    for _ in range(steps):
        _advance_set(params, state, interval / steps)


@njit
def error_system(params: np.record, state: np.record, dt: float) -> None:
    """N of the errors (e, r), r_i = s m_i/Xi_ii, and their largest inputs: unknown torques, wrong
    rates, wrong injection, and what a secant of gravity leaves out.

    ``sin theta^ - sin(theta^ - e) = e cos(theta^ - e/2) sinc(e/2)``: over all errors within the
    margin the slope is a middle value, in N, and a remainder that counts as an unknown torque.
    """
    arm, motion, n, inputs = params.unknown.arm, state.motion, state.n, state.inputs
    cosine, sine = motion.pose[COSINE, 2], motion.pose[SINE, 2]
    sign, turning = params.sign, motion.rate[0] - motion.rate[1]
    b = sign * arm.coupling
    off, cross = coupling(motion.pose, arm), inertia_errors(params.unknown, motion)[0]
    away = motion.margin[0] + motion.margin[1]
    n[:] = 0.0
    inputs[:] = 0.0
    for i in range(2):
        j, inertia, kappa = 1 - i, arm.inertia[i], state.kappa[i]
        spin = motion.rate[j] * motion.rate[j] * (-1.0 if i == 0 else 1.0)
        # Coupling of inertia and Coriolis terms through e_1 - e_2.
        couple = b * (sine * motion.driven[i, j] + cosine * (turning * motion.innovation[j] + spin))
        low, high = _secant_slopes(
            sign * motion.pose[COSINE, i], motion.pose[SINE, i], motion.margin[i]
        )
        n[2 + i, i] = 0.5 * (low + high) * arm.gravity[i] / inertia
        n[2 + i, 0] += couple / inertia
        n[2 + i, 1] -= couple / inertia
        n[2 + i, 2 + i] = -params.mu[i]
        n[i, 2 + i] = -kappa * inertia
        inject = kappa * b * sine * motion.innovation[j]
        n[i, 0] += inject
        n[i, 1] -= inject
        left_out = 0.5 * (high - low) * arm.gravity[i] * motion.margin[i]
        inputs[2 + i, i] = (state.torque[i] + left_out) / inertia
        # e' = (1 + s kappa Xi^) eta - s kappa m, m' = mu Xi^ eta - mu m: signs belong together.
        inputs[i, 2 + i] = motion.rate_error[i]
        for k in range(2):
            through = sign * (inertia if k == i else off) * motion.rate_error[k]
            inputs[i, 2 + k] += kappa * through
            inputs[2 + i, 2 + k] = params.mu[i] / inertia * through
        moved = abs(motion.innovation[i]) + motion.rate_error[i]
        moved_other = abs(motion.innovation[j]) + motion.rate_error[j]
        left = params.unknown.own[i] * moved
        left += (cross + 0.5 * arm.coupling * away * away) * moved_other
        left += arm.coupling * abs(sine) * away * motion.rate_error[j] + 0.25 * dt * state.turned[i]
        inputs[i, 4 + i] = kappa * left + dt / 12.0 * state.bend[i]


@njit
def _secant_slopes(cosine: float, sine: float, margin: float) -> tuple[float, float]:
    """Smallest and largest slope of s sin between an angle and others within a margin.

    ``cosine`` is s cos of the angle, ``sine`` its sine.
    """
    half = 0.5 * min(margin, math.pi)
    across, along = math.sin(half), math.cos(half)
    share = across / half if half > 1e-6 else 1.0
    # Cosines of the angle from the slope's maximum on, of 0 to pi, and half the margin.
    low = cosine * along - abs(sine) * across if cosine > -along else -1.0
    high = cosine * along + abs(sine) * across if cosine < along else 1.0
    return low * share if low > 0.0 else low, high if high > 0.0 else high * share


@njit
def _advance_set(params: np.record, state: np.record, dt: float) -> None:
    """Map the set by exp(N dt) to second order and add a box of inputs over an interval [s]."""
    n, half, step, columns, used = state.n, state.half, state.map, state.columns, state.used
    for r in range(SIZE):
        for q in range(SIZE):
            half[r, q] = 0.5 * dt * n[r, q] + (1.0 if r == q else 0.0)
            step[r, q] = dt * half[r, q]
    map_columns(step, SIZE, n)
    for r in range(SIZE):
        step[r, r] += 1.0
    map_columns(columns, used, step)
    for r in range(SIZE):  # half a step's travel of the input
        for q in range(_INPUTS):
            total = 0.0
            for k in range(SIZE):
                total += half[r, k] * (dt * state.inputs[k, q])
            columns[r, used + q] = total
    state.used = used + _INPUTS
    _make_room(params, state)


@njit
def _follow_static(params: np.record, state: np.record, observer: np.record) -> None:
    _rest(params, observer.x, state.motion, state.torque)
    fall = math.exp(-params.decay * observer.interval)
    for i in range(2):
        cosine = max(abs(math.cos(observer.x[i])), params.cos_min[i])
        target = state.torque[i] / (params.unknown.arm.gravity[i] * cosine)
        left = state.extent[i] + state.reckoning.jump[i] - target if state.used else 0.0
        state.extent[i] = target + max(0.0, fall * left)
    if state.used > 0:
        move_interval(state.reckoning, observer, state.motion.rate_error)
    state.used = 1


@njit
def _rest(params: np.record, theta: np.ndarray, motion: np.record, torque: np.ndarray) -> None:
    """Bounds [N m] on the unknown torques of an arm at rest."""
    set_pose(motion.pose, theta)
    carry_load(params.unknown, motion, (0.0, 0.0))
    unknown_torque(params.unknown, motion, torque)


def static_bound(params: np.record, theta: np.ndarray) -> np.ndarray:
    """Bound of each sensor at rest at absolute angles, after all transients, shape (2,) [rad].

    For method ``exact`` from the comparison system of the error, whose poles are real at every
    slope; infinite where gravity cannot bound it.  For method ``paper`` the slope is clipped to the
    region.
    """
    theta, torque = np.asarray(theta, float), np.zeros(2)
    gravity, spread = params.unknown.arm.gravity, np.abs(params.unknown.joints.sensor)
    _rest(params, theta, new_record(MOTION), torque)
    if not params.exact:
        slope = gravity * np.maximum(np.abs(np.cos(theta)), params.cos_min)
        return spread @ (torque / slope) + params.noise
    # A bias of the rates is held up by a momentum, and that by a torque.
    bias = params.unknown.bias * np.abs(params.unknown.joints.angle).sum(axis=1)
    torque += bias * params.mu / params.kappa
    # Distance from the vertical; the secant of gravity over the error falls with it.
    away = np.arccos(np.clip(params.sign * np.cos(theta), -1.0, 1.0))
    error = np.zeros(2)
    for _ in range(100):
        before, half = error, 0.5 * (error + params.angle_noise)
        slope = gravity * np.cos(np.minimum(away + half, math.pi))
        slope *= np.sinc(half / math.pi)
        error = np.where(slope > 0.0, torque / np.maximum(slope, 1e-12), math.pi)
        error = np.minimum(error, math.pi)
        if np.array_equal(error, before):
            break
    error[error >= math.pi] = math.inf
    # Not 0*inf: a sensor that does not see a link does not see its error.
    seen = [sum(w * e for w, e in zip(row, error) if w) for row in spread]
    return np.array(seen) + params.noise
