"""Offsets of encoders from the first sample on: ours, an EKF, and the Cramer-Rao bound.

All see the same samples and have the same unknowns with the same priors: offsets of all encoders,
torque offsets, viscous and Coulomb friction, and the inertial parameters along the directions in
which the monitor takes them to be uncertain.  State of the filter, for n joints:

    x = (q, q', d, f, parameters),  y = q + f + noise,  tau = effort - d,
    d(k+1) = exp(-T / T_d) d(k) + white noise,

with the plant's own Runge-Kutta steps as model.  Rates that are differences of the readings add
nothing to the readings, and are used for the first sample only.

Simulated arms are drawn from these priors, and the efforts carry noise d of that very model.  There
the posterior Cramer-Rao bound is the covariance of the EKF linearised along the true course (van
Trees; Tichavsky and others 1998): no estimator has a smaller mean square error.  On recordings of
the two-link arm, masses 5 % and friction 30 % wrong, the truth of d is not known: the filter gets
white noise of the strength that our monitor has learned there.
"""

import argparse
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from fault_injection import DATA, Stream, csv_stream, shoulder_arm, two_links
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
class Torques:
    """Unknown torques d."""

    size: FloatArray  # standard deviation of a sample, shape (n,) [N m]
    correlation: float = 0.0  # T_d [s]


@dataclass(frozen=True)
class Run:
    """Readings of an arm, of which one encoder is off, and the arm that estimators know."""

    stream: Stream
    arm: SerialArm
    torques: Torques
    truth: FloatArray  # offsets, shape (n,) [rad]
    course: FloatArray | None = None  # true states of the filter, shape (N, m), where known

    def ends(self) -> list[int]:
        """Samples until each moment."""
        seconds = (self.stream.stamps - self.stream.stamps[0]) * 1e-9
        moments = [one for one in MOMENTS if one <= self.stream.duration + 0.1]
        return [int(np.searchsorted(seconds, one)) for one in moments]


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


class Ekf:
    """Extended filter with the priors of our monitor, from the first sample on, shape (3, n)."""

    def __init__(self, arm: SerialArm, torques: Torques, first: FloatArray) -> None:
        estimator, n = OffsetEstimator(arm, HorizonPlan.of(arm.sample_time)), len(arm.joints)
        chain, prior, variance = compile_chain(arm), estimator.prior, torques.size**2
        correlation = torques.correlation
        memory = float(np.exp(-arm.sample_time / correlation)) if correlation > 0.0 else 0.0
        step, count = integration_step(chain, arm.sample_time)
        self.model = Model(chain, estimator.balance.directions, step, count, memory)
        noise = arm.sensors().position_noise ** 2
        rate = 2.0 * noise / arm.sample_time**2
        self.covariance = np.diag(np.concatenate([noise, rate, variance, prior**2]))
        for i in range(n):  # q = y - f
            self.covariance[i, i] += prior[i] ** 2
            self.covariance[i, 3 * n + i] = self.covariance[3 * n + i, i] = -(prior[i] ** 2)
        self.x = np.concatenate([first[0], first[1], np.zeros(n + len(prior))])
        self._process, self._noise = np.zeros_like(self.covariance), np.diag(noise)
        self._process[range(2 * n, 3 * n), range(2 * n, 3 * n)] = (1.0 - memory**2) * variance
        self._h, self._offsets = np.eye(n, len(self.x)) + np.eye(n, len(self.x), 3 * n), 3 * n

    def take(self, sample: FloatArray) -> None:
        """One sample, shape (3, n)."""
        self.x, f = jacobian(self.model, self.x, sample[2])
        h, predicted = self._h, f @ self.covariance @ f.T + self._process
        gain = predicted @ h.T @ np.linalg.inv(h @ predicted @ h.T + self._noise)
        left = np.eye(len(self.x)) - gain @ h
        self.x = self.x + gain @ (sample[0] - h @ self.x)
        self.covariance = left @ predicted @ left.T + gain @ self._noise @ gain.T

    def offsets(self) -> tuple[FloatArray, FloatArray]:
        """Offsets and their standard deviations [rad]."""
        part = slice(self._offsets, self._offsets + len(self._noise))
        return self.x[part].copy(), np.sqrt(np.diag(self.covariance)[part])


@dataclass
class Offsets:
    """Errors and standard deviations of all offsets at `MOMENTS`."""

    error: FloatArray  # shape (moments, n) [rad]
    sigma: FloatArray  # shape (moments, n) [rad]
    cost: float  # of a sample [s]


def filtered(run: Run, course: FloatArray | None = None) -> Offsets:
    """What the filter finds; along a course of true states (N, m) its sigma is the bound."""
    samples, ends, found = run.stream.samples, run.ends(), []
    kalman, begin = Ekf(run.arm, run.torques, samples[0]), time.process_time()
    for k in range(1, ends[-1]):
        if course is not None:
            kalman.x = course[k - 1].copy()
        kalman.take(samples[k])
        if k + 1 in ends:
            found.append(kalman.offsets())
    return _compared(found, run, time.process_time() - begin)


def ours(run: Run) -> Offsets:
    """What our monitor finds."""
    monitor, found, done, begin = Watched(run.arm), [], 0, time.process_time()
    for end in run.ends():
        monitor.take(run.stream.stamps[done:end], run.stream.samples[done:end])
        found.append(monitor.estimate()[:2])
        done = end
    return _compared(found, run, time.process_time() - begin)


def _compared(found: list[tuple[FloatArray, FloatArray]], run: Run, spent: float) -> Offsets:
    estimates, sigmas = np.moveaxis(np.array(found), 1, 0)
    return Offsets(estimates - run.truth, sigmas, spent / run.ends()[-1])


def simulated(arm: SerialArm, torques: Torques, runs: int) -> Iterator[Run]:
    """Runs of arms drawn from the priors."""
    n = len(arm.joints)
    known = Ekf(arm, torques, np.zeros((3, n)))
    model, sigma = known.model, np.sqrt(np.diag(known.covariance)[4 * n :])
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        parameters, friction = sigma * rng.normal(size=len(sigma)), model.chain.friction.copy()
        for row, column in enumerate((OFFSET, VISCOUS, COULOMB)):
            change = parameters[row * n : (row + 1) * n]
            if column != OFFSET:  # no friction drives
                np.maximum(change, -0.9 * friction[:, column], out=change)
            friction[:, column] += change
        inertial = model.chain.inertial + np.tensordot(parameters[3 * n :], model.directions, 1)
        plant = model.chain._replace(inertial=inertial, friction=friction)
        run = simulated_run(arm, MOMENTS[-1] + 0.1, plant=plant, seed=seed)
        d = torques.size * rng.normal(size=run.position.shape)
        for k in range(1, len(d)):
            d[k] = model.memory * d[k - 1] + np.sqrt(1.0 - model.memory**2) * d[k]
        run.samples[1:, 2] += d[:-1]
        stream, truth = shifted(Stream(run.stamps, run.samples), seed % n, rng)
        rate = np.gradient(run.position, arm.sample_time, axis=0)
        steady = np.broadcast_to(np.concatenate([truth, parameters]), (len(d), n + len(sigma)))
        course = np.concatenate([run.position, rate, d, steady], axis=1)
        yield Run(stream, arm, torques, truth, course)


def recorded(count: int) -> Iterator[Run]:
    """Recordings of the two-link arm, whose parameters are wrong; d as our monitor has learned."""
    known, rng, healthy = two_links('real_arm')[0], np.random.default_rng(0), []
    streams = [csv_stream(file) for file in sorted((DATA / 'real_arm').glob('run_*.csv'))]
    for k in range(count if streams else 0):
        joints = []
        for joint in known.joints:
            link = LinkInertia.from_vector(rng.uniform(0.95, 1.05) * joint.link.to_vector())
            friction = replace(
                joint.friction, coulomb=joint.friction.coulomb * rng.uniform(0.7, 1.3)
            )
            joints.append(replace(joint, link=link, friction=friction))
        healthy.append((streams[k % len(streams)], replace(known, joints=tuple(joints))))
    for k, (stream, arm) in enumerate(healthy):
        monitor = Watched(arm)
        monitor.take(stream.stamps, stream.samples)
        learned = monitor.estimator.posterior
        size = monitor.estimator.usual_sizes(np.arange(len(monitor.estimator)))
        power = np.mean(size**2, 0) * learned.inflation / (monitor.plan.interval * 2.0 / 3.0)
        faulty, truth = shifted(stream, k % 2, rng)
        yield Run(faulty, arm, Torques(np.sqrt(power / arm.sample_time)), truth)


def shifted(stream: Stream, joint: int, rng: np.random.Generator) -> tuple[Stream, FloatArray]:
    """A stream with one encoder off, and the offsets of all [rad]."""
    samples, truth = stream.samples.copy(), np.zeros(stream.samples.shape[2])
    truth[joint] = rng.choice([-1.0, 1.0]) * rng.uniform(*OFFSET_RANGE)
    samples[:, 0] += truth
    return Stream(stream.stamps, samples), truth


def report(console: Console, title: str, runs: Iterable[Run]) -> None:
    """Show errors of both, and the bound where the true course is known."""
    found: dict[str, list[Offsets]] = {'bound': [], 'ours': [], 'EKF': []}
    for run in runs:
        if run.course is not None:
            found['bound'].append(filtered(run, run.course))
        found['ours'].append(ours(run))
        found['EKF'].append(filtered(run))
    rows = []
    for k, moment in enumerate(MOMENTS):
        least = [one.sigma[k] for one in found['bound']]
        limit = np.sqrt(np.mean(np.square(least))) if least else np.nan
        for name, those in found.items():
            cells = [f'{limit:.4f}', '1'] if name == 'bound' else _cells(those, k, limit)
            rows += [[f'{moment:g}', name, *cells]] if those else []
    heads = ('>after [s]', '', '>RMS [rad]', '>over bound', '>larger error, 90 % [rad]',
             '>RMS over own sigma', '>us a sample')  # fmt: skip
    print_grid(console, heads, rows, f'{title}: {len(found["ours"])} runs')


def _cells(runs: list[Offsets], k: int, limit: float) -> list[str]:
    """At a moment: RMS, over the bound, 90 %, over the stated deviation, cost."""
    error, sigma = np.array([one.error[k] for one in runs]), np.array([r.sigma[k] for r in runs])
    rms = float(np.sqrt(np.mean(error**2)))
    return [
        f'{rms:.4f}', f'{rms / limit:.2f}' if np.isfinite(limit) else '-',
        f'{np.quantile(np.abs(error).max(1), 0.9):.3f}',
        f'{np.sqrt(np.mean((error / sigma) ** 2)):.1f}',
        f'{1e6 * np.mean([run.cost for run in runs]):.0f}']  # fmt: skip


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
            report(console, 'two-link arm, recorded', recorded(options.runs))
            continue
        arm = shoulder_arm() if name == 'shoulder' else two_links(name)[0]
        arm = replace(arm, uncertainty=replace(arm.uncertainty, friction=0.3))
        size = options.noise * np.array([joint.limits.torque for joint in arm.joints])
        for correlation in options.correlation:
            runs = simulated(arm, Torques(size, correlation), options.runs)
            report(console, f'{name}, simulated, T_d = {correlation:g} s', runs)


if __name__ == '__main__':
    main()
