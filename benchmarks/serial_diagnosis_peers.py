"""Offsets of encoders from the first sample on: ours, an EKF, a UKF, and the Cramer-Rao bound.

All see the same samples and have the same unknowns with the same priors: offsets of all encoders,
torque offsets, viscous and Coulomb friction, and the inertial parameters along the directions in
which the monitor takes them to be uncertain.  State of the filters of FilterPy, for n joints:

    x = (q, q', d, f, parameters),  y = q + f + noise,  tau = effort - d,
    d(k+1) = exp(-T / T_d) d(k) + white noise,

with the plant's own Runge-Kutta steps as model.  Rates that are differences of the readings add
nothing to the readings, and are used for the first sample only.

Simulated arms are drawn from these priors, and the efforts carry noise d of that very model.  There
the posterior Cramer-Rao bound is the covariance of the EKF linearised along the true course (van
Trees; Tichavsky and others 1998): no estimator has a smaller mean square error.  On recordings of
the two-link arm, masses 5 % and friction 30 % wrong, the truth of d is not known: the filters get
white noise of the strength that our monitor has learned there.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from fault_injection import DATA, Stream, csv_stream, shoulder_arm, two_links
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from rich.console import Console
from simulated_runs import simulated_run
from watched import Watched

from lpv.core.serial_arm.chain import COULOMB, OFFSET, VISCOUS, Chain, FloatArray, compile_chain
from lpv.core.serial_arm.description import LinkInertia, SerialArm
from lpv.core.serial_arm.diagnosis.estimator import HorizonPlan, OffsetEstimator
from lpv.core.serial_arm.simulation import integration_step, plant_step
from lpv.core.support.jit import njit
from lpv.report.table import print_grid

MOMENTS = (1.0, 3.0, 10.0)
"""At which errors are taken [s]."""
OFFSET_RANGE = (0.2, 0.5)
"""Of the faulty encoder [rad]."""


@dataclass(frozen=True)
class Healthy(Stream):
    """A recording without faults, and the arm that the monitor believes to see."""

    arm: SerialArm


def two_link_runs(count: int, rng: np.random.Generator) -> list[Healthy]:
    """Recordings of the two-link arm, each with arms whose parameters are wrong."""
    known, runs = two_links('real_arm')[0], []
    streams = [csv_stream(file) for file in sorted((DATA / 'real_arm').glob('run_*.csv'))]
    for k in range(count if streams else 0):
        joints = []
        for joint in known.joints:
            link = LinkInertia.from_vector(rng.uniform(0.95, 1.05) * joint.link.to_vector())
            coulomb = joint.friction.coulomb * rng.uniform(0.7, 1.3)
            joints.append(
                replace(joint, link=link, friction=replace(joint.friction, coulomb=coulomb))
            )
        stream = streams[k % len(streams)]
        runs.append(Healthy(stream.stamps, stream.samples, replace(known, joints=tuple(joints))))
    return runs


class Model(NamedTuple):
    """Dynamics of a state (q, q', d, f, parameters), one sample further."""

    chain: Chain
    directions: FloatArray  # shape (k, n, 10)
    step: float  # of integration [s]
    substeps: int  # of a sample
    memory: float  # factor of d, each sample


@njit
def advance(model: Model, x: FloatArray, effort: FloatArray, out: FloatArray) -> None:
    """Write the state one sample further; ``effort`` is read at its end."""
    chain, n = model.chain, effort.shape[0]
    inertial, friction = chain.inertial.copy(), chain.friction.copy()
    for i in range(n):
        friction[i, OFFSET] += x[4 * n + i]
        friction[i, VISCOUS] += x[5 * n + i]
        friction[i, COULOMB] += x[6 * n + i]
    for k in range(model.directions.shape[0]):
        inertial += x[7 * n + k] * model.directions[k]
    arm = Chain(
        chain.rotation, chain.translation, inertial, chain.motor, friction, chain.gravity,
        chain.tip_rotation, chain.tip_translation, chain.prismatic)  # fmt: skip
    state, scratch = x[: 2 * n].copy().reshape((2, n)), np.zeros((11 * n, 40))
    if not plant_step(
        arm, state, effort - x[2 * n : 3 * n], model.step, model.substeps, scratch, np.empty((n, n))
    ):
        state[:] = np.nan
    out[:] = x
    out[: 2 * n] = state.reshape(-1)
    out[2 * n : 3 * n] *= model.memory


@njit
def jacobian(model: Model, x: FloatArray, effort: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State one sample further, and its derivative by differences."""
    m = x.shape[0]
    moved, other, matrix = np.empty(m), np.empty(m), np.empty((m, m))
    advance(model, x, effort, moved)
    for j in range(m):
        changed = x.copy()
        changed[j] += 1e-6
        advance(model, changed, effort, other)
        matrix[:, j] = (other - moved) / 1e-6
    return moved, matrix


@dataclass(frozen=True)
class Torques:
    """Unknown torques d."""

    size: FloatArray  # standard deviation of a sample, shape (n,) [N m]
    correlation: float = 0.0  # T_d [s]


@dataclass(frozen=True)
class Knowledge:
    """What all filters know before the first sample."""

    model: Model
    x: FloatArray  # shape (m,)
    covariance: FloatArray  # shape (m, m)
    process: FloatArray  # shape (m, m)
    noise: FloatArray  # of the readings, shape (n, n)


def knowledge(arm: SerialArm, torques: Torques, first: FloatArray) -> Knowledge:
    """Priors of our monitor; ``first`` is the first sample, shape (3, n)."""
    estimator, n = OffsetEstimator(arm, HorizonPlan.of(arm.sample_time)), len(arm.joints)
    chain, prior = compile_chain(arm), estimator.prior
    memory = np.exp(-arm.sample_time / torques.correlation) if torques.correlation > 0.0 else 0.0
    step, count = integration_step(chain, arm.sample_time)
    model = Model(chain, estimator.balance.directions, step, count, float(memory))
    noise = arm.sensors().position_noise ** 2
    rate = 2.0 * noise / arm.sample_time**2
    covariance = np.diag(np.concatenate([noise, rate, torques.size**2, prior**2]))
    for i in range(n):  # q = y - f
        covariance[i, i] += prior[i] ** 2
        covariance[i, 3 * n + i] = covariance[3 * n + i, i] = -(prior[i] ** 2)
    process = np.zeros_like(covariance)
    process[range(2 * n, 3 * n), range(2 * n, 3 * n)] = (1.0 - memory**2) * torques.size**2
    x = np.concatenate([first[0], first[1], np.zeros(n + len(prior))])
    return Knowledge(model, x, covariance, process, np.diag(noise))


class Ekf(ExtendedKalmanFilter):
    """Extended filter; along the true course its covariance is the Cramer-Rao bound."""

    def __init__(self, known: Knowledge) -> None:
        n, m = len(known.noise), len(known.x)
        super().__init__(dim_x=m, dim_z=n)
        self.known, self._h = known, np.eye(n, m) + np.eye(n, m, 3 * n)
        self.x, self.P = known.x.copy(), known.covariance.copy()
        self.Q, self.R = known.process, known.noise

    def predict_x(self, u: FloatArray) -> None:
        """As FilterPy asks."""
        self.x, self.F = jacobian(self.known.model, self.x, u)

    def take(self, sample: FloatArray) -> None:
        """One sample, shape (3, n)."""
        self.predict(sample[2])
        self.update(sample[0], lambda _: self._h, lambda x: self._h @ x)


class Ukf(UnscentedKalmanFilter):
    """Unscented filter."""

    def __init__(self, known: Knowledge) -> None:
        n, m = len(known.noise), len(known.x)
        points = MerweScaledSigmaPoints(m, 0.1, 2.0, 3.0 - m)
        super().__init__(m, n, 1.0, lambda x: x[:n] + x[3 * n : 4 * n], self._move, points)
        self.known = known
        self.x, self.P = known.x.copy(), known.covariance.copy()
        self.Q, self.R = known.process, known.noise

    def _move(self, x: FloatArray, dt: float, effort: FloatArray) -> FloatArray:
        out = np.empty_like(x)
        advance(self.known.model, x, effort, out)
        return out

    def take(self, sample: FloatArray) -> None:
        """One sample, shape (3, n)."""
        self.P = 0.5 * (self.P + self.P.T)
        self.predict(effort=sample[2])
        self.update(sample[0])


@dataclass
class Offsets:
    """Errors and standard deviations of all offsets at `MOMENTS`; NaN where a filter failed."""

    error: FloatArray  # shape (moments, n) [rad]
    sigma: FloatArray  # shape (moments, n) [rad]
    cost: float  # of a sample [s]


def filtered(
    make: Callable[[Knowledge], Ekf | Ukf], known: Knowledge, run: Healthy, truth: FloatArray
) -> Offsets:
    """What a filter finds of true offsets."""
    n, kalman = run.samples.shape[2], make(known)
    offsets, begin = slice(3 * n, 4 * n), time.process_time()

    def until(first: int, last: int) -> tuple[FloatArray, FloatArray]:
        for sample in run.samples[first:last]:
            kalman.take(sample)
        variance = np.diag(kalman.P)[offsets]
        return kalman.x[offsets].copy(), np.sqrt(np.where(variance > 0.0, variance, np.nan))

    found = np.full((2, len(MOMENTS), n), np.nan)
    ends = [1, *_ends(run)]
    for k in range(len(ends) - 1):
        try:
            found[:, k] = until(ends[k], ends[k + 1])
        except (np.linalg.LinAlgError, ValueError):
            break
    return Offsets(found[0] - truth, found[1], (time.process_time() - begin) / ends[-1])


def bound(known: Knowledge, run: Healthy, course: FloatArray) -> FloatArray:
    """Cramer-Rao bound of the offsets along the true states (N, m): deviations (moments, n)."""
    n, kalman, deviations = run.samples.shape[2], Ekf(known), []
    for k in range(1, _ends(run)[-1]):
        kalman.x = course[k - 1].copy()
        kalman.take(run.samples[k])
        if k + 1 in _ends(run):
            deviations.append(np.sqrt(np.diag(kalman.P)[3 * n : 4 * n]))
    return np.array(deviations)


def ours(run: Healthy, truth: FloatArray) -> Offsets:
    """What our monitor finds of true offsets."""
    monitor, found, done = Watched(run.arm), [], 0
    begin = time.process_time()
    for end in _ends(run):
        monitor.take(run.stamps[done:end], run.samples[done:end])
        estimate, done = monitor.estimate(), end
        found.append((estimate.fault, estimate.sigma))
    cost = (time.process_time() - begin) / done
    estimates, sigmas = np.moveaxis(np.array(found), 1, 0)
    return Offsets(estimates - truth, sigmas, cost)


def _ends(run: Healthy) -> list[int]:
    """Samples until each moment."""
    seconds = (run.stamps - run.stamps[0]) * 1e-9
    return [int(np.searchsorted(seconds, one)) for one in MOMENTS if one <= run.duration + 0.1]


def simulated(
    arm: SerialArm, torques: Torques, seed: int, duration: float
) -> tuple[Healthy, FloatArray]:
    """A run of an arm drawn from the priors, one encoder wrong from the start; the true states."""
    rng, n = np.random.default_rng(seed), len(arm.joints)
    known = knowledge(arm, torques, np.zeros((3, n)))
    chain, parameters = known.model.chain, np.zeros(len(known.x) - 4 * n)
    parameters[:] = np.sqrt(np.diag(known.covariance)[4 * n :]) * rng.normal(size=len(parameters))
    friction = chain.friction.copy()
    for row, column in enumerate((OFFSET, VISCOUS, COULOMB)):
        change = parameters[row * n : (row + 1) * n]
        if column != OFFSET:  # no friction drives
            np.maximum(change, -0.9 * friction[:, column], out=change)
        friction[:, column] += change
    inertial = chain.inertial + np.tensordot(parameters[3 * n :], known.model.directions, 1)
    plant = chain._replace(inertial=inertial, friction=friction)
    run = simulated_run(arm, duration, plant=plant, seed=seed)
    course = np.zeros((len(run.stamps), len(known.x)))
    course[:, :n] = run.position
    course[:, n : 2 * n] = np.gradient(run.position, arm.sample_time, axis=0)
    course[:, 4 * n :] = parameters
    d = torques.size * rng.normal(size=(len(run.stamps), n))
    for k in range(1, len(d)):
        d[k] = known.model.memory * d[k - 1] + np.sqrt(1.0 - known.model.memory**2) * d[k]
    run.samples[1:, 2] += d[:-1]
    course[:, 2 * n : 3 * n] = d
    joint, size = seed % n, rng.choice([-1.0, 1.0]) * rng.uniform(*OFFSET_RANGE)
    run.samples[:, 0, joint] += size
    course[:, 3 * n + joint] = size
    return Healthy(run.stamps, run.samples, arm), course


def cells(runs: list[Offsets], k: int, limits: FloatArray | None) -> list[str]:
    """At a moment: RMS, over the bound, 90 %, over the stated deviation, failures, cost."""
    error, sigma = (np.array([getattr(run, n)[k] for run in runs]) for n in ('error', 'sigma'))
    failed = ~np.isfinite(error).all(1) | (np.abs(error) > np.pi).any(1)
    e, s = error[~failed], sigma[~failed]
    rms, cell = float(np.sqrt(np.mean(e**2))), '-'
    if limits is not None:
        cell = f'{rms / np.sqrt(np.mean(limits[~failed, k] ** 2)):.2f}'
    return [
        f'{rms:.4f}', cell, f'{np.quantile(np.abs(e).max(1), 0.9):.3f}',
        f'{np.sqrt(np.mean((e / s) ** 2)):.1f}', str(int(failed.sum())),
        f'{1e6 * np.mean([run.cost for run in runs]):.0f}']  # fmt: skip


def print_table(
    console: Console, title: str, found: dict[str, list[Offsets]], limits: FloatArray | None = None
) -> None:
    """One row for each moment and estimator."""
    rows = []
    for k, moment in enumerate(MOMENTS):
        if limits is not None:
            rms = np.sqrt(np.mean(limits[:, k] ** 2))
            rows.append([f'{moment:g}', 'bound', f'{rms:.4f}', '1'])
        for name, runs in found.items():
            rows.append([f'{moment:g}', name, *cells(runs, k, limits)])
    heads = ('>after [s]', '', '>RMS [rad]', '>over bound', '>larger error, 90 % [rad]',
             '>RMS over own sigma', '>diverged', '>us a sample')  # fmt: skip
    print_grid(console, heads, rows, title)


PEERS: dict[str, Callable[[Knowledge], Ekf | Ukf]] = {'EKF': Ekf, 'UKF': Ukf}


def report_simulated(
    console: Console, name: str, arm: SerialArm, torques: Torques, runs: int
) -> None:
    """All estimators and the bound on arms drawn from the priors."""
    n, limits = len(arm.joints), []
    found = {key: list[Offsets]() for key in ('ours', *PEERS)}
    for seed in range(runs):
        run, course = simulated(arm, torques, seed, MOMENTS[-1] + 0.1)
        known, truth = knowledge(arm, torques, run.samples[0]), course[0, 3 * n : 4 * n]
        limits.append(bound(known, run, course))
        found['ours'].append(ours(run, truth))
        for key, make in PEERS.items():
            found[key].append(filtered(make, known, run, truth))
    title = f'{name}, simulated, T_d = {torques.correlation:g} s: {runs} runs'
    print_table(console, title, found, np.array(limits))


def report_recorded(console: Console, runs: int, rng: np.random.Generator) -> None:
    """The recorded two-link arm; strength of d as our monitor has learned it."""
    found = {key: list[Offsets]() for key in ('ours', *PEERS)}
    for k, run in enumerate(two_link_runs(runs, rng)):
        monitor = Watched(run.arm)
        monitor.take(run.stamps, run.samples)
        plan, learned = monitor.plan, monitor.estimator.posterior
        size = monitor.estimator.usual_sizes(np.arange(len(monitor.estimator)))
        power = np.mean(size**2, 0) * learned.inflation / (plan.interval * 2.0 / 3.0)
        torques = Torques(np.sqrt(power / run.arm.sample_time))
        joint, size = k % 2, rng.choice([-1.0, 1.0]) * rng.uniform(*OFFSET_RANGE)
        faulty, truth = replace(run, samples=run.samples.copy()), np.zeros(2)
        faulty.samples[:, 0, joint] += size
        truth[joint] = size
        found['ours'].append(ours(faulty, truth))
        for key, make in PEERS.items():
            known = knowledge(run.arm, torques, faulty.samples[0])
            found[key].append(filtered(make, known, faulty, truth))
    print_table(console, f'two-link arm, recorded, {runs} runs', found)


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--runs', type=int, default=20, help='of each kind')
    parser.add_argument('--correlation', type=float, nargs='+', default=[0.0, 0.05])
    parser.add_argument('--noise', type=float, default=0.02, help='of a torque over its limit')
    parser.add_argument('--arms', nargs='+', default=['real_arm', 'recorded'])
    options = parser.parse_args()
    console = Console(width=140)
    for name in options.arms:
        if name == 'recorded':
            report_recorded(console, options.runs, np.random.default_rng(0))
            continue
        arm = shoulder_arm() if name == 'shoulder' else two_links(name)[0]
        arm = replace(arm, uncertainty=replace(arm.uncertainty, friction=0.3))
        limit = np.array([joint.limits.torque for joint in arm.joints])
        for correlation in options.correlation:
            torques = Torques(options.noise * limit, correlation)
            report_simulated(console, name, arm, torques, options.runs)


if __name__ == '__main__':
    main()
