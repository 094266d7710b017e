"""One run of many hours: slow and fast motion over the whole region, long rests near its edge.

The true arm is at a corner of its stated model error; a healthy arm's loop is closed on its
readings, as the tracker's is while nothing is confirmed.  The exit code is 1 if an alarm was raised
or a sample was not trusted, if the designed observer's threshold was ever more than 10 % above that
of a fresh start 10 s after the arm came to rest, or if memory grew.

    python benchmarks/long_run.py --hours 8 --arm paper
"""

import argparse
import resource
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
from fault_injection import minimum_jerk

from lpv import Gains, SerialArm, load_arm, load_gains, load_scenario
from lpv.core.control.tracking import TrackingController
from lpv.core.control.tracking_law import track
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.simulation.arm_simulator import ArmSimulator, drive, read_sensors
from lpv.core.support.jit import njit
from lpv.core.uio.planar import planar_model

SETTLED = 10.0
"""After so long at rest thresholds must be those of a fresh start [s]."""
FRESH = 1000.0
"""So long a fresh start is given to reach its final thresholds: until gravity, not the start,
bounds the error [s]."""
SCENARIOS = {'paper': 'two_faults', 'real_arm': 'real_arm'}
"""Shipped ones; plant, noise and disturbance are those of each, its path is not used."""
MOST = 1.1
"""Largest threshold over that of a fresh start."""
TELLING = 1.5
"""Thresholds beyond say nothing [rad]."""
GROWTH = 8192
"""Largest growth of memory after a tenth of the run [kB]."""
EDGE, REACH = 0.97, 0.9
"""Shares of the region: of rests near its edge, of other poses."""


@njit
def _advance(plant, chances, tracker, references, samples):
    """One sample for each reference; writes readings, their rates and efforts, (N, 3, n)."""
    constants, state = plant.constants, plant.state
    for k in range(len(references)):
        read_sensors(plant, chances.noise, chances.fault)
        sample = samples[k]
        sample[0, :], sample[1, :] = state.measured_position, state.measured_velocity
        sample[2, :] = state.torque
        track(tracker, references[k], sample[0], sample[1], sample[0], constants.sample_time)
        drive(plant, tracker.torque, chances.push)


@dataclass
class Counts:
    """What was seen so far."""

    samples: int = 0
    alarms: int = 0  # raised
    distrusted: int = 0  # samples
    inconsistent: int = 0  # samples
    speed: float = 0.0  # largest joint rate [rad/s]
    ratio: float = 0.0  # largest estimate over threshold, where the threshold says something
    widest: float = 0.0  # largest threshold [rad]


class Loop:
    """A healthy arm in a closed loop, at a pose to begin with."""

    def __init__(self, arm: SerialArm, gains: Gains, pose: np.ndarray, seed: int) -> None:
        factor = 1.0 + (arm.uncertainty.model_error or 0.0)
        scenario = replace(
            load_scenario(SCENARIOS[arm.name]),
            faults=(), seed=seed, mass_factors=(factor, factor), inertia_factors=(factor, factor),
        )  # fmt: skip
        one = ArmSimulator(arm, scenario)
        one.state.motion[0] = self.pose = pose
        self._plant = one.parts, one.chances
        self._tracker = TrackingController(arm, gains).parts
        self._monitor = SerialSensorMonitor('loop', arm, gains=gains, observer='uio')
        self._simulator, self._period = one, arm.sample_time
        self.counts, self.thresholds = Counts(), np.full(2, np.inf)

    def rest(self, duration: float) -> None:
        """Stay at the pose."""
        left, second = round(duration / self._period), round(1.0 / self._period)
        while left > 0:
            self._run(np.zeros((min(left, second), 3, 2)))
            left -= second

    def settle(self, fresh: np.ndarray, longest: float) -> float:
        """Rest until the thresholds are those of a fresh start; how long it took [s]."""
        passed = 0.0
        while passed < longest and (self.thresholds > MOST * fresh).any():
            self.rest(1.0)
            passed += 1.0
        return passed

    def move(self, pose: np.ndarray, duration: float) -> None:
        """Go to another pose, from rest to rest."""
        share, slope, bend = minimum_jerk(
            np.arange(round(duration / self._period)) * self._period / duration
        )
        profile = share - 1.0, slope / duration, bend / duration**2
        way, self.pose = pose - self.pose, pose
        self._run(np.moveaxis(np.multiply.outer(profile, way), 0, 1))

    def _run(self, motion: np.ndarray) -> None:
        """``motion``: joint positions less those of the pose, rates, accelerations."""
        references, samples = motion.copy(), np.empty((len(motion), 3, 2))
        references[:, 0] += self.pose
        _advance(*self._plant, self._tracker, references, samples)
        counts = self.counts
        steps = 1 + counts.samples + np.arange(len(motion))
        stamps = np.round(steps * self._period * 1e9).astype(np.int64)
        found = self._monitor.take_many(stamps, *np.moveaxis(samples, 1, 0))
        counts.samples += len(motion)
        counts.alarms += sum(event.event.name == 'RAISED' for _, event in found.events)
        counts.distrusted += int((~found.state.trustworthy).sum())
        counts.inconsistent += int(found.inconsistent.sum())
        counts.speed = max(counts.speed, float(np.abs(samples[:, 1]).max()))
        bound = found.fault.bound
        telling = np.where(bound < TELLING, np.abs(found.fault.estimate) / bound, 0.0)
        counts.ratio = max(counts.ratio, float(telling.max()))
        counts.widest = max(counts.widest, float(bound[np.isfinite(bound)].max(initial=0.0)))
        self.thresholds = bound[-1].copy()


def rest_poses(arm: SerialArm) -> np.ndarray:
    """Joint positions: upright or hanging, inside, and near all corners of the region [rad]."""
    largest = np.arccos(np.asarray(planar_model(arm).cos_min))
    shares = [(0, 0), (0.5, -0.3), *((EDGE * a, EDGE * b) for a in (-1, 1) for b in (-1, 1))]
    return joints_of(arm, np.array([*shares, (EDGE, 0), (0, -EDGE)]) * largest)


def joints_of(arm: SerialArm, angles: np.ndarray) -> np.ndarray:
    """Joint positions of links' angles from the upper or the lower vertical, shape (..., 2)."""
    planar = planar_model(arm)
    middle = 0.0 if planar.sign > 0 else np.pi
    first = np.remainder(middle + angles[..., 0] - planar.zero_angle + np.pi, 2.0 * np.pi) - np.pi
    return np.stack([first, angles[..., 1] - angles[..., 0]], axis=-1)


def fastest_move(arm: SerialArm, way: np.ndarray) -> float:
    """Shortest duration within a third of the torques and half of the speeds allowed [s]."""
    constants = planar_model(arm).constants()
    inertia = constants.inertia.sum() + 2.0 * constants.coupling
    most = min(0.33 * arm.torque_limit[0] / inertia, 0.33 * arm.torque_limit[1] / inertia * 2.0)
    joint = np.abs(way).max()
    return float(
        max(np.sqrt(5.8 * joint / most), 1.9 * joint / (0.5 * min(arm.velocity_limit)), 0.3)
    )


def main() -> int:
    """Run, compare thresholds at rest, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=8.0)
    parser.add_argument('--arm', default='paper', choices=SCENARIOS, help='shipped arm')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--fresh', type=float, default=FRESH, help='rest of a fresh start [s]')
    options = parser.parse_args()
    arm = load_arm(options.arm)
    gains = load_gains(options.arm)
    rng, poses, fresh = np.random.default_rng(options.seed), rest_poses(arm), []
    for pose in poses:
        loop = Loop(arm, gains, pose, options.seed + 1)
        loop.rest(options.fresh)
        fresh.append(loop.thresholds)
    loop, times, memory = Loop(arm, gains, poses[0], options.seed), [], 0
    began, samples = time.process_time(), options.hours * 3600.0 / arm.sample_time
    largest = REACH * np.arccos(np.asarray(planar_model(arm).cos_min))
    while loop.counts.samples < samples:
        for _ in range(rng.integers(1, 20)):
            goal = joints_of(arm, rng.uniform(-largest, largest))
            quickest = fastest_move(arm, goal - loop.pose)
            loop.move(goal, quickest * 30.0 ** rng.uniform(0.0, 1.0))
        number = int(rng.integers(len(poses)))
        loop.move(poses[number], fastest_move(arm, poses[number] - loop.pose) * rng.uniform(1, 5))
        times.append(loop.settle(fresh[number], 60.0))
        loop.rest(60.0 ** rng.uniform(0.0, 1.5))
        if memory == 0 and loop.counts.samples > 0.1 * samples:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    counts = loop.counts
    print(
        f'{options.arm}: {counts.samples * arm.sample_time / 3600.0:.2f} h in '
        f'{time.process_time() - began:.0f} s of CPU time; joint rates up to '
        f'{counts.speed:.2f} rad/s; {len(times)} rests, thresholds those of a '
        f'fresh start within {SETTLED:g} s in {np.mean(np.array(times) <= SETTLED):.1%} of them, '
        f'in {np.median(times):g} s in the median, {max(times):g} s at most; '
        f'largest threshold {counts.widest:.2f} rad; '
        f'largest estimate over threshold {counts.ratio:.3f}; '
        f'alarms: {counts.alarms}; samples not trusted: {counts.distrusted}; inconsistent: '
        f'{counts.inconsistent}; memory grew by {grown} kB'
    )
    sound = counts.alarms == counts.distrusted == 0 and max(times) <= SETTLED and grown <= GROWTH
    return 0 if sound else 1


if __name__ == '__main__':
    sys.exit(main())
