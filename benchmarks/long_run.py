"""One run of many hours: slow and fast motion over the whole region, long rests near its edge.

The loop of simulator, observer, diagnosis and tracker is closed and compiled; the true arm is at a
corner of its stated model error.  The exit code is 1 if a healthy arm raised an alarm or was not
trusted, if a threshold was ever more than 10 % above that of a fresh start 10 s after the arm came
to rest, or if memory grew.

    python benchmarks/long_run.py --hours 8 --arm paper
"""

import argparse
import resource
import sys
import time
from dataclasses import replace

import numpy as np

from lpv_core.certificate.gains import load_gains
from lpv_core.control.tracking import TRACKING_STATE, track, tracking_constants
from lpv_core.decision.sensor_decision import RAISED
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.monitor import SensorMonitor, monitor_step
from lpv_core.simulation.arm_simulator import ArmSimulator, integrate, read_sensors, set_torque
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.jit import njit
from lpv_core.support.records import new_record, record_type
from lpv_core.support.resources import bringup_file

SETTLED = 10.0
"""After so long at rest thresholds must be those of a fresh start [s]."""
FRESH = 1000.0
"""So long a fresh start is given to reach its final thresholds: until gravity, not the start,
bounds the error [s]."""
SCENARIOS = {'paper': 'two_faults', 'real_arm': 'real_arm'}
"""Shipped ones; plant, noise and disturbance are those of each, its path is not used."""
MOST = 1.1
"""Largest threshold over that of a fresh start."""
GROWTH = 8192
"""Largest growth of memory after a tenth of the run [kB]."""
EDGE, REACH = 0.97, 0.9
"""Shares of the region: of rests near its edge, of other poses."""

COUNTS = record_type(
    ('step', 'i8'),  # samples so far
    ('alarms', 'i8'),  # raised
    ('distrusted', 'i8'),  # samples
    ('inconsistent', 'i8'),  # samples
    ('speed', 'f8', (2,)),  # largest joint rates [rad/s]
    ('ratio', 'f8'),  # largest estimate over threshold, where the threshold says something
    ('widest', 'f8'),  # largest threshold [rad]
)


@njit
def advance(counts, plant, monitor, tracker, references, measurement):
    """Run one sample for each reference."""
    constants, state, faults, noise, push, chance = plant
    parameters, observed, buffers, answer = monitor
    for reference in references:
        read_sensors(constants, state, faults, noise, chance)
        measurement[0, :], measurement[1, :] = state.measured_position, state.measured_velocity
        measurement[2, :] = state.torque
        stamp = 1 + round(counts.step * constants.sample_time * 1e9)
        monitor_step(
            parameters,
            observed,
            buffers,
            answer,
            stamp,
            measurement[0],
            measurement[1],
            measurement[2],
        )
        decision = observed.diagnosis.decision
        counts.distrusted += not decision.trustworthy
        counts.inconsistent += decision.inconsistent
        for i in range(2):
            counts.alarms += answer.has_events and decision.events[i].happened == RAISED
            counts.speed[i] = max(counts.speed[i], abs(state.velocity[i]))
            threshold = answer.fault.threshold[i]
            counts.widest = max(counts.widest, threshold)
            if threshold < 1.5:
                counts.ratio = max(counts.ratio, abs(answer.fault.estimate[i]) / threshold)
        feedback, interval = answer.state.compensated_position, constants.sample_time
        track(
            tracker[0],
            tracker[1],
            reference,
            feedback,
            answer.state.velocity,
            feedback,
            interval if counts.step > 0 else 0.0,
        )
        set_torque(constants, state, tracker[1].torque[0], tracker[1].torque[1], push)
        integrate(constants, state)
        counts.step += 1


class Loop:
    """A healthy arm in a closed loop, at a pose to begin with."""

    def __init__(self, arm: ArmParameters, gains, pose: np.ndarray, seed: int) -> None:
        factor = 1.0 + arm.model_error
        scenario = replace(
            load_scenario(bringup_file('scenarios', SCENARIOS[arm.name])),
            faults=(),
            seed=seed,
            mass_factors=(factor, factor),
            inertia_factors=(factor, factor),
        )
        simulator, self._joints = ArmSimulator(arm, scenario), JointMap(arm)
        simulator.state.state[:2] = self.pose = pose
        self._plant = (
            simulator.constants,
            simulator.state,
            simulator.injector.records,
            simulator.noise,
            simulator.push,
            simulator.injector.generator,
        )
        self._monitor = SensorMonitor('loop', arm, gains).parts
        self._tracker = tracking_constants(arm, gains), new_record(TRACKING_STATE)
        self._simulator, self._period = simulator, arm.sample_time
        self.counts, self._measurement = new_record(COUNTS), np.empty((3, 2))

    @property
    def thresholds(self) -> np.ndarray:
        """Present ones [rad]."""
        return self._monitor[3].fault.threshold.copy()

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
        s = np.arange(round(duration / self._period)) * self._period / duration
        profile = (
            s**3 * (10.0 - 15.0 * s + 6.0 * s**2) - 1.0,
            30.0 * s**2 * (1.0 - s) ** 2 / duration,
            60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration**2,
        )
        way, self.pose = pose - self.pose, pose
        self._run(np.moveaxis(np.multiply.outer(profile, way), 0, 1))

    def _run(self, motion: np.ndarray) -> None:
        """``motion``: absolute angles less those of the pose, rates, accelerations."""
        references = np.empty_like(motion)
        references[:, 0] = self._joints.joint_position(self.pose + motion[:, 0])
        references[:, 1:] = self._joints.joint_velocity(motion[:, 1:])
        advance(
            self.counts, self._plant, self._monitor, self._tracker, references, self._measurement
        )


def rest_poses(arm: ArmParameters) -> np.ndarray:
    """Absolute angles: upright or hanging, inside, and near all corners of the region [rad]."""
    largest = np.arccos(np.asarray(arm.cos_min))
    shares = [(0, 0), (0.5, -0.3), *((EDGE * a, EDGE * b) for a in (-1, 1) for b in (-1, 1))]
    return (0.0 if arm.sign > 0 else np.pi) + np.array([*shares, (EDGE, 0), (0, -EDGE)]) * largest


def fastest_move(arm: ArmParameters, way: np.ndarray) -> float:
    """Shortest duration within a third of the torques and half of the speeds allowed [s]."""
    constants = arm.constants()
    inertia = constants.inertia.sum() + 2.0 * constants.coupling
    most = min(0.33 * arm.torque_limit[0] / inertia, 0.33 * arm.torque_limit[1] / inertia * 2.0)
    joint = 2.0 * np.abs(way).max()
    return max(np.sqrt(5.8 * joint / most), 1.9 * joint / (0.5 * min(arm.velocity_limit)), 0.3)


def main() -> int:
    """Run, compare thresholds at rest, and say what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=8.0)
    parser.add_argument('--arm', default='paper', choices=SCENARIOS, help='shipped arm')
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    arm = load_arm(bringup_file('arms', options.arm))
    gains = load_gains(bringup_file('gains', options.arm))
    rng, poses, fresh = np.random.default_rng(options.seed), rest_poses(arm), []
    for pose in poses:
        loop = Loop(arm, gains, pose, options.seed + 1)
        loop.rest(FRESH)
        fresh.append(loop.thresholds)
    loop, times, memory = Loop(arm, gains, poses[0], options.seed), [], 0
    began = time.process_time()
    samples = options.hours * 3600.0 / arm.sample_time
    middle, largest = poses[0], REACH * np.arccos(np.asarray(arm.cos_min))
    while loop.counts.step < samples:
        for _ in range(rng.integers(1, 20)):
            goal = middle + rng.uniform(-largest, largest)
            quickest = fastest_move(arm, goal - loop.pose)
            loop.move(goal, quickest * 30.0 ** rng.uniform(0.0, 1.0))
        number = int(rng.integers(len(poses)))
        loop.move(poses[number], fastest_move(arm, poses[number] - loop.pose) * rng.uniform(1, 5))
        times.append(loop.settle(fresh[number], 60.0))
        loop.rest(60.0 ** rng.uniform(0.0, 1.5))
        if memory == 0 and loop.counts.step > 0.1 * samples:
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    counts = loop.counts
    print(
        f'{options.arm}: {counts.step * arm.sample_time / 3600.0:.2f} h in '
        f'{time.process_time() - began:.0f} s of CPU time; joint rates up to '
        f'{counts.speed.max():.2f} rad/s; {len(times)} rests, thresholds those of a '
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
