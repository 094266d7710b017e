"""How near our estimates are to the best that any estimator could do on the same data.

    python benchmarks/accuracy_limit.py                      # a run of each case
    python benchmarks/accuracy_limit.py --runs 8 --jobs 2    # a mean over eight

Random closed-loop runs as in diagnosis_campaign.py: the true arm differs from the model within what
the arm file states.  Beside our estimates stand FilterPy's EKF and UKF with random-walk faults, and
posterior Cramer-Rao bounds: the inverse of the Fisher information along the run's true trajectory,
in covariance form, with

    x(k+1) = F(x(k), p, Q(k)) + G d(k),   d ~ N(mean, variance),   driven along one direction
    y_i    = S_i theta + f_i + n_i,       v_i = S_i theta' + m_i

The arm is known exactly, or within what its file states (constant unknowns p); of the faults onset
and shape are known but not the size, or nothing is: after the first sample a sensor may read
anything, which is what our observer assumes.  Every figure is the root of a mean square over all
runs, from 1 s after the onset to the fault's end [mrad].
"""

import argparse
import multiprocessing
import time
from dataclasses import dataclass, replace

import numpy as np
from diagnosis_campaign import prepare, random_scenario
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter as FilterPyUkf
from rich.console import Console
from rich.table import Table

from lpv_core.model.arm import ARM_CONSTANTS, constants_vector, set_constants
from lpv_core.model.dynamics import acceleration, rk4_step
from lpv_core.model.joints import JointMap
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record

ONSET, LASTING, SETTLED = 6.0, 8.0, 1.0
FRICTION_UNCERTAINTY = 0.3
FAULT_WALK = 0.02
"""Random walk of the faults as Kalman filters assume it [rad/sqrt(s)]."""
ARBITRARY, WIDE = 10.0, 1.0
"""Standard deviations of a fault that may be anything, and of an amplitude [rad], [rad/s]."""
MARGIN = 0.05
"""Standard deviation of accelerations beside the disturbance, for the EKF and UKF [rad/s2]."""
STEP = 1e-5
EXACT = {
    'mass_factors': (1.0, 1.0),
    'inertia_factors': (1.0, 1.0),
    'payload': 0.0,
    'friction_factor': 1.0,
}
CASES = {
    'healthy, model exact': ((), EXACT),
    'healthy': ((), {}),
    'bias on 1, model exact': (((0, 'bias', 0.2),), EXACT),
    'bias on 1': (((0, 'bias', 0.2),), {}),
    'bias on 2': (((1, 'bias', 0.2),), {}),
    'bias on both': (((0, 'bias', 0.2), (1, 'bias', -0.2)), {}),
    'drift on 1': (((0, 'drift', 0.25, 0.08),), {}),
    'stuck 2': (((1, 'stuck'),), {}),
    'noise on 1': (((0, 'noise', 0.03),), {}),
}
"""Faults (sensor, kind, size, rate) and changes of the random scenario."""
COLUMNS = ('ours', 'confirmed', 'EKF', 'UKF', 'limit, arm known', 'limit, priors',
           'any fault, arm known', 'any fault, priors')  # fmt: skip


# ------------------------------------------------------------------ Kalman filters of FilterPy


@njit
def _move(x, torque, push, dt, constants):
    """State one sample later, by Euler's rule."""
    a_1, a_2 = acceleration(x[0], x[1], x[2], x[3], torque[0], torque[1], constants)
    out = x.copy()
    out[0] += dt * x[2]
    out[1] += dt * x[3]
    out[2] += dt * (a_1 + push[0])
    out[3] += dt * (a_2 + push[1])
    return out


@njit
def _jacobian(x, torque, push, dt, constants):
    """Derivative of `_move` by differences."""
    moved, f = _move(x, torque, push, dt, constants), np.eye(6)
    for j in range(4):
        step = x.copy()
        step[j] += 1e-6
        f[:, j] = (_move(step, torque, push, dt, constants) - moved) / 1e-6
    return moved, f


class _Filter:
    """Two absolute angles, two rates, two faults that walk at random; what both filters share."""

    def set_up(self, arm, position):
        """Model of an arm; start without faults at a joint position."""
        direction, dt = np.asarray(arm.disturbance_direction, float), arm.sample_time
        self.fixed = arm.disturbance_mean * direction, dt, arm.constants()
        s, zero = JointMap(arm).sensor_matrix, np.zeros((2, 2))
        self.h = np.block([[s, zero, np.eye(2)], [zero, s, zero]])
        push = np.sqrt(arm.disturbance_variance) * np.abs(direction) + MARGIN
        self.Q = np.diag([1e-10, 1e-10, *(push**2 * dt**2), *[FAULT_WALK**2 * dt] * 2])
        self.R = np.diag([arm.position_noise**2] * 2 + [arm.velocity_noise**2] * 2)
        self.P = 1e-6 * np.eye(6)
        self.x = np.concatenate([JointMap(arm).absolute_position(position), np.zeros(4)])
        return self

    def present(self, y):
        """Readings and their variance; what is missing is as predicted and weighs nothing."""
        missing, r = ~np.isfinite(y), self.R.copy()
        r[missing, missing] = 1e6
        return np.where(missing, self.h @ self.x, y), r


class Ekf(_Filter, ExtendedKalmanFilter):
    """Extended filter; Jacobian by differences."""

    def predict_x(self, u=0):
        """As FilterPy asks."""
        self.x, self.F = _jacobian(self.x.ravel(), u, *self.fixed)

    def take(self, y, torque):
        """One measurement; the fault estimates [rad]."""
        self.predict(torque)
        y, r = self.present(y)
        self.update(y, lambda _: self.h, lambda x: self.h @ x, R=r)
        return self.x[4:]


class Ukf(_Filter, FilterPyUkf):
    """Unscented filter."""

    def take(self, y, torque):
        """One measurement; the fault estimates [rad]."""
        self.predict(torque=torque)
        y, r = self.present(y)
        self.update(y, R=r)
        return self.x[4:]


def make_ekf(arm, position):
    """Extended filter, started without faults at a joint position."""
    return Ekf(dim_x=6, dim_z=4).set_up(arm, position)


def make_ukf(arm, position):
    """Unscented filter, started without faults at a joint position."""
    points = MerweScaledSigmaPoints(6, 0.1, 2.0, -3.0)
    found = Ukf(6, 4, arm.sample_time, None, None, points)
    found.hx = lambda x: found.h @ x
    found.fx = lambda x, dt, torque: _move(x, torque, *found.fixed)
    return found.set_up(arm, position)


def filter_run(make, arm, run):
    """Faults and absolute angles that a filter finds, each (n, 2); NaN once it broke down."""
    joints, n = JointMap(arm), len(run.time)
    torques = joints.absolute_torque(run.torque)
    y = np.hstack(
        [joints.sensor_position(run.measured), joints.sensor_velocity(run.measured_velocity)]
    )
    y[run.lost] = np.nan
    kalman, states = make(arm, run.measured[0]), np.full((n, 6), np.nan)
    for k in range(n):
        try:
            kalman.take(y[k], torques[max(k - 1, 0)])
        except (np.linalg.LinAlgError, ValueError):
            break
        states[k] = kalman.x
    return states[:, 4:], states[:, :2]


# ------------------------------------------------------------------ the bound


@dataclass
class Knowledge:
    """An arm with constant unknown parameters, in which its constants are linear."""

    constants: np.ndarray  # (12,)
    sensitivity: np.ndarray  # (p, 12)
    deviation: np.ndarray  # (p,) before any data
    truth: np.ndarray  # (p,)


def known_exactly(arm, scenario):
    """The true arm."""
    constants = constants_vector(scenario.true_arm(arm).constants(True))
    return Knowledge(constants, np.zeros((0, len(constants))), np.zeros(0), np.zeros(0))


def known_within_priors(arm, scenario):
    """What the arm file states of model error, payload and friction; each uniform, independent."""
    nominal, rows = constants_vector(arm.constants(True)), []
    for i in range(2):
        factors = tuple(2.0 if j == i else 1.0 for j in range(2))
        masses, inertias = scenario.mass_factors[i], scenario.inertia_factors[i]
        rows.append((arm.scaled(mass_factors=factors), arm.model_error, masses - 1.0))
        rows.append((arm.scaled(inertia_factors=factors), arm.model_error, inertias - 1.0))
    rows.append((arm.with_payload(1.0), arm.payload, scenario.payload))
    rubbing = replace(
        arm,
        viscous=tuple(2.0 * v for v in arm.viscous),
        coulomb=tuple(2.0 * v for v in arm.coulomb),
    )
    rough = FRICTION_UNCERTAINTY if any((*arm.viscous, *arm.coulomb)) else 0.0
    rows.append((rubbing, rough, scenario.friction_factor - 1.0))
    rows = [row for row in rows if row[1] > 0.0]
    return Knowledge(
        nominal,
        np.array([constants_vector(other.constants(True)) - nominal for other, _, _ in rows]),
        np.array([most for _, most, _ in rows]) / np.sqrt(3.0),
        np.array([true for _, _, true in rows]),
    )


def acting(fault, time, settle=0.0):
    """When a fault acts."""
    end = fault.onset + fault.duration if fault.duration > 0.0 else np.inf
    return (time >= fault.onset + settle) & (time < end)


def shapes_known(arm, scenario, run):
    """Unknown numbers of the faults: sensor, effect at each sample, memory, growth, deviation."""
    if not scenario.faults:  # both sensors may be biased from then on
        return [(i, (run.time >= SETTLED).astype(float), 1.0, 0.0, WIDE) for i in range(2)]
    found = []
    for fault in scenario.faults:
        sensor, on = arm.sensor_names.index(fault.sensor), acting(fault, run.time).astype(float)
        if fault.kind == 'drift':
            grown = np.maximum(run.time - fault.onset, 0.0)
            on *= np.minimum(grown, abs(fault.size / fault.rate)) if fault.size else grown
        white = {'noise': fault.size, 'stuck': ARBITRARY}.get(fault.kind)
        found.append(
            (sensor, on, 1.0, 0.0, WIDE) if white is None else (sensor, on, 0.0, white**2, white)
        )
    return found


def anything(run):
    """Nothing is known of both sensors after the first sample."""
    later = (np.arange(len(run.time)) > 0).astype(float)
    return [(i, later, 0.0, ARBITRARY**2, ARBITRARY) for i in range(2)]


@njit
def _flow(z, torque, disturbance, constants, sensitivity, direction, dt, work):
    """Mechanical state one sample after angles, rates and parameters ``z``, as the plant moves."""
    found = constants.copy()
    for j in range(len(sensitivity)):
        found += z[4 + j] * sensitivity[j]
    set_constants(work, found)
    x, push = (z[0], z[1], z[2], z[3]), direction * disturbance
    for _ in range(2):
        x = rk4_step(x, (torque[0], torque[1]), (push[0], push[1]), 0.5 * dt, work)
    return np.array(x)


@njit
def _derivatives(states, torques, braked, mean, arm, work):
    """Derivatives of `_flow` by state and by the disturbance along a trajectory."""
    n, size = states.shape
    f = np.zeros((n, 4, size + 1))
    for k in range(n):
        if braked[k]:
            f[k, 0, 0] = f[k, 1, 1] = 1.0
            continue
        for j in range(size + 1):
            step, push = np.zeros(size), 0.0
            if j < size:
                step[j] = STEP
            else:
                push = STEP
            above = _flow(states[k] + step, torques[k], mean + push, *arm, work)
            below = _flow(states[k] - step, torques[k], mean - push, *arm, work)
            f[k, :, j] = (above - below) / (2.0 * STEP)
    return f


@njit
def _variances(f, push, memory, growth, h, r, deviation, rows):
    """Variances of combinations of states after the readings up to each sample."""
    n, moving = len(f), f.shape[2] - 1
    found, p = np.zeros((n, rows.shape[1])), np.diag(deviation**2)
    for k in range(n):
        for i in range(h.shape[1]):
            if r[k, i] < np.inf:
                ph = p @ h[k, i]
                p = p - np.outer(ph, ph) / (h[k, i] @ ph + r[k, i])
        for i in range(rows.shape[1]):
            found[k, i] = max(rows[k, i] @ (p @ rows[k, i]), 0.0)
        a = np.diag(memory)
        a[:4] = 0.0
        a[:4, :moving] = f[k, :, :moving]
        q = np.diag(growth)
        q[:4, :4] = push[k] * np.outer(f[k, :, moving], f[k, :, moving])
        p = a @ p @ a.T + q
        p = 0.5 * (p + p.T)
    return found


def limit(arm, scenario, run, known, faults):
    """Least standard deviations of both faults and both absolute angles, shape (n, 4)."""
    joints, n, p = JointMap(arm), len(run.time), len(known.deviation)
    states = np.zeros((n, 4 + p))
    states[:, :2] = joints.absolute_position(run.position)
    states[:, 2:4] = joints.absolute_velocity(run.velocity)
    states[:, 4:] = known.truth
    factor = scenario.disturbance_factor if scenario.disturbance else 0.0
    setup = (known.constants, known.sensitivity, np.asarray(arm.disturbance_direction, float),
             arm.sample_time)  # fmt: skip
    braked = np.ascontiguousarray(run.braked)
    f = _derivatives(states, joints.absolute_torque(run.torque), braked,
                     factor * arm.disturbance_mean, setup, new_record(ARM_CONSTANTS))  # fmt: skip
    size, first = 4 + p + len(faults), 4 + p
    memory, growth = np.ones(size), np.zeros(size)
    deviation = np.concatenate([[1.0, 1.0, 1e-6, 1e-6], known.deviation, [m[4] for m in faults]])
    rows, h = np.zeros((n, 4, size)), np.zeros((n, 4, size))
    s = joints.sensor_matrix
    h[:, :2, :2] = h[:, 2:, 2:4] = s
    rows[:, 2:, :2] = np.eye(2)
    for column, (sensor, shape, kept, gained, _) in enumerate(faults, first):
        memory[column], growth[column] = kept, gained
        h[:, sensor, column] = rows[:, sensor, column] = shape
    noise = scenario.noise_factor if scenario.noise else 0.0
    r = np.empty((n, 4))
    r[:, :2] = max(noise * arm.position_noise, 1e-9) ** 2
    r[:, 2:] = max(noise * arm.velocity_noise, 1e-9) ** 2
    for fault in scenario.faults:
        if fault.kind == 'stuck':  # the frozen value carries no noise
            r[acting(fault, run.time), arm.sensor_names.index(fault.sensor)] = 1e-18
    r[:, :2][~np.isfinite(joints.sensor_position(run.measured))] = np.inf
    r[run.lost] = np.inf
    push = arm.disturbance_variance * factor**2 * ~run.braked
    return np.sqrt(_variances(f, push, memory, growth, h, r, deviation, rows))


def check(seed=1):
    """The recursion is FilterPy's: raises AssertionError where it is not."""
    rng, n, size = np.random.default_rng(seed), 30, 6
    f, h = rng.normal(0.0, 0.4, (n, 4, 5)), rng.normal(size=(n, 4, size))
    memory, growth = rng.uniform(0.5, 1.0, size), rng.uniform(0.0, 0.1, size)
    r, rows = rng.uniform(0.1, 1.0, (n, 4)), rng.normal(size=(n, 2, size))
    found = _variances(f, np.full(n, 0.3), memory, growth, h, r, np.ones(size), rows)
    kalman = KalmanFilter(size, 4)
    for k in range(n):
        kalman.update(np.zeros(4), R=np.diag(r[k]), H=h[k])
        expected = np.einsum('qi,ij,qj->q', rows[k], kalman.P, rows[k])
        np.testing.assert_allclose(found[k], expected, rtol=1e-6)
        a, q = np.diag(memory), np.diag(growth)
        a[:4] = 0.0
        a[:4, :4] = f[k, :, :4]
        q[:4, :4] = 0.3 * np.outer(f[k, :, 4], f[k, :, 4])
        kalman.predict(F=a, Q=q)


# ------------------------------------------------------------------ cases


def case_run(job):
    """Squared errors of one run of a case: by quantity and column, mean over the window."""
    name, number = job
    arm, gains, base = _shared
    faults, changes = CASES[name]
    scenario = random_scenario(arm, base, np.random.default_rng([5, number]))
    scheduled = tuple(
        Fault(arm.sensor_names[i], kind, ONSET, LASTING, *rest) for i, kind, *rest in faults
    )
    scenario = replace(scenario, faults=scheduled, **changes)
    run, joints = run_closed_loop(arm, gains, scenario), JointMap(arm)
    loop = joints.sensor_position(run.compensated)
    truth = np.hstack([run.fault, joints.absolute_position(run.position)])
    pairs = [
        (run.fault_estimate, joints.absolute_position(run.estimate)),
        (joints.sensor_position(run.measured) - loop, joints.absolute_position(run.compensated)),
        filter_run(make_ekf, arm, run),
        filter_run(make_ukf, arm, run),
    ]
    errors = [np.hstack(pair) - truth for pair in pairs]
    for models in (shapes_known(arm, scenario, run), anything(run)):
        for known in (known_exactly, known_within_priors):
            errors.append(limit(arm, scenario, run, known(arm, scenario), models))
    mask = np.zeros((len(run.time), 4), bool)
    for fault in scheduled:
        settled = acting(fault, run.time, SETTLED)
        mask[:, arm.sensor_names.index(fault.sensor)] |= settled
        mask[:, 2:] |= settled[:, None]
    if not scheduled:
        mask[:] = (run.time >= 2.0 * SETTLED)[:, None]
    mask &= ~run.lost[:, None]
    return name, [
        [float(np.mean(error[:, part][mask[:, part]] ** 2)) for error in errors]
        for part in (slice(0, 2), slice(2, 4))
    ]


_shared = None


def _start(shared):
    global _shared
    _shared = shared


def main():
    """Run all cases and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--runs', type=int, default=1, help='runs of each case (1)')
    parser.add_argument('--jobs', type=int, default=1, help='processes (1)')
    parser.add_argument('--cases', nargs='+', choices=CASES, default=list(CASES))
    arguments = parser.parse_args()
    console, began = Console(width=160), time.monotonic()
    check()
    with multiprocessing.Pool(arguments.jobs, _start, (prepare(),)) as pool:
        jobs = [(name, number) for name in arguments.cases for number in range(arguments.runs)]
        results = pool.map(case_run, jobs, chunksize=1)
    for quantity, title in enumerate(('faults of position sensors', 'absolute joint angles')):
        table = Table('', *COLUMNS, 'ours/limit', title=f'error of the {title}, RMS, mrad')
        for name in arguments.cases:
            squares = [found[quantity] for case, found in results if case == name]
            values = np.sqrt(np.mean(squares, axis=0))
            ratio = values[0] / values[5]
            table.add_row(name, *(f'{1e3 * value:.3g}' for value in values), f'{ratio:.3g}')
        console.print(table)
    console.print(f'{time.monotonic() - began:.0f} s')


if __name__ == '__main__':
    main()
