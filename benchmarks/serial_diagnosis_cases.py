"""What the serial diagnosis finds: faults injected into recordings of real and simulated arms.

Recordings are those of the folder $LPV_RECORDINGS, or of `shared/data` (left out where absent): a
two-link arm whose masses (5 %) and friction (30 %) the monitor does not know, and a UR10 and a
Panda, identified on the first 60 % and tested on the rest; simulated arms have errors of the same
kind.  Every line of the tables is one kind of fault, injected at random: named = the first sensor
that is named is the faulty one, in time = within the limit of the line, wrong = another one is
named at any time.  Faults are injected on joints whose level gravity shows, jumps on all.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from lpv_bag.run.csv_import import load_column_map
from lpv_core.serial_arm.chain import Chain, compile_chain
from lpv_core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
    Uncertainty,
)
from lpv_core.serial_arm.diagnosis.monitor import MonitorSettings, SerialMonitor
from lpv_core.serial_arm.dynamics.payload import with_payload
from lpv_core.serial_arm.simulation import Push, SerialSimulator
from lpv_core.serial_arm.two_link import serial_arm_of
from lpv_core.serial_arm.urdf_chain import read_urdf_chain
from lpv_core.support.resources import bringup_file
from lpv_identify.estimation.identification import identify
from lpv_identify.recordings.recording import read_recording

DATA = Path(os.environ.get(
    'LPV_RECORDINGS', Path(__file__).resolve().parents[2] / 'shared' / 'data'))  # fmt: skip
SETTLED = 3.0
"""Before, no fault begins that is not there from the start [s]."""


@dataclass
class Healthy:
    """A recording without faults, and the arm that the monitor believes to see."""

    arm: SerialArm
    stamps: np.ndarray  # [ns], shape (N,)
    samples: np.ndarray  # shape (N, 3, n)

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.stamps[-1] - self.stamps[0]) * 1e-9


@dataclass(frozen=True)
class Case:
    """One kind of fault, and what is asked of the diagnosis."""

    name: str
    kind: str  # bias, drift, scale, stuck
    size: float
    limit: float  # [s]
    with_rate: bool = True  # whether a derived rate fails with the reading
    from_start: bool = False


CASES = (
    Case('offset 0.2, from the start', 'bias', 0.2, 4.0, from_start=True),
    Case('offset 0.5, from the start', 'bias', 0.5, 4.0, from_start=True),
    Case('drift 0.3 rad/s', 'drift', 0.3, 1.0),
    Case('drift 0.1 rad/s', 'drift', 0.1, 2.5),
    Case('stuck, while it moves', 'stuck', 0.0, 0.3),
    Case('scale 20 %', 'scale', 0.2, 2.0),
    Case('step 0.02 with its rate', 'bias', 0.02, 0.02),
    Case('step 0.02, position alone', 'bias', 0.02, 0.02, with_rate=False),
)


def inject(run: Healthy, case: Case, joint: int, onset: float, sign: float) -> Healthy:
    """The same recording with one faulty encoder; a derived rate is its backward difference."""
    samples, time = run.samples.copy(), (run.stamps - run.stamps[0]) * 1e-9
    reading, rate = samples[:, 0, joint], samples[:, 1, joint]
    after, size = time >= onset, sign * case.size
    healthy = reading.copy()
    if case.kind == 'bias':
        reading[after] += size
    elif case.kind == 'drift':
        reading[after] += size * (time[after] - onset)
    elif case.kind == 'scale':
        reading[after] *= 1.0 + size
    else:
        reading[after] = reading[after][0]
    if case.with_rate and run.arm.joints[joint].sensors.rates != 'independent':
        rate[1:] += np.diff(reading - healthy) / np.diff(time)
    return replace(run, samples=samples)


def pushed(run: Healthy, rng: np.random.Generator) -> Healthy:
    """The same recording while something pushes: the drives give less for the same motion."""
    samples, time = run.samples.copy(), (run.stamps - run.stamps[0]) * 1e-9
    limit = np.array([min(joint.limits.torque, 1e3) for joint in run.arm.joints])
    begin = rng.uniform(SETTLED, run.duration - 1.0)
    place = np.clip((time - begin) / np.exp(rng.uniform(np.log(0.05), np.log(2.0))), 0.0, 1.0)
    shapes = (np.sin(np.pi * place), place * (place < 1.0), (place > 0.0) * (place < 1.0))
    size = limit * np.exp(rng.uniform(np.log(0.02), np.log(0.4))) * rng.uniform(-1, 1, len(limit))
    size *= rng.random(len(limit)) < 0.6
    samples[:, 2] -= shapes[rng.integers(3)][:, None] * size
    return replace(run, samples=samples)


def watch(run: Healthy) -> SerialMonitor:
    """The monitor after a recording."""
    monitor = SerialMonitor(run.arm)
    monitor.update_many(run.stamps, run.samples)
    return monitor


@dataclass
class Score:
    """What was found in the injections of one line."""

    delays: list[float]  # inf where not named
    errors: list[float]  # of the estimate at the end [rad]
    wrong: int = 0

    def row(self, limit: float) -> list[str]:
        """Cells of a table."""
        delays, errors = np.array(self.delays), np.array(self.errors)
        named = np.isfinite(delays)
        return [
            str(len(delays)), f'{100 * named.mean():.0f} %',
            f'{100 * (delays <= limit).mean():.0f} %', f'{limit:g} s',
            f'{np.median(delays):.3f}', str(self.wrong),
            f'{100 * (errors < 0.1).mean():.0f} %', f'{np.quantile(errors, 0.9):.3f}']  # fmt: skip


def injections(
    runs: list[Healthy], case: Case, joints: list[int], size: int, rng: np.random.Generator
) -> Iterator[tuple[Healthy, int, float, float]]:
    """Recordings with a random fault; joint, onset and true fault at the end."""
    for k in range(size):
        run = runs[k % len(runs)]
        joint = joints[(k // len(runs)) % len(joints)]
        onset = 0.0 if case.from_start else rng.uniform(SETTLED, run.duration - case.limit - 0.5)
        if case.kind == 'stuck':
            onset = _moving(run, joint, onset)
        faulty = inject(run, case, joint, onset, rng.choice([-1.0, 1.0]))
        end = len(run.stamps) if not case.from_start else _index(run, SETTLED)
        truth = float(faulty.samples[end - 1, 0, joint] - run.samples[end - 1, 0, joint])
        yield faulty, joint, onset, truth


def _index(run: Healthy, seconds: float) -> int:
    return int(np.searchsorted(run.stamps - run.stamps[0], seconds * 1e9))


def _moving(run: Healthy, joint: int, onset: float) -> float:
    """The first moment from ``onset`` on at which a joint moves."""
    moving = np.abs(run.samples[:, 1, joint]) > 0.2
    first = _index(run, onset) + int(np.argmax(moving[_index(run, onset) :]))
    return float(run.stamps[first] - run.stamps[0]) * 1e-9


def judge(
    runs: list[Healthy], case: Case, joints: list[int], size: int, rng: np.random.Generator
) -> Score:
    """Inject and watch."""
    score = Score([], [])
    for run, joint, onset, truth in injections(runs, case, joints, size, rng):
        names = run.arm.sensor_names
        monitor, end = SerialMonitor(run.arm), len(run.stamps)
        if case.from_start:
            end = _index(run, SETTLED)
        monitor.update_many(run.stamps[:end], run.samples[:end])
        estimate = monitor.estimate(0)
        score.errors.append(abs(float(estimate.fault[joint]) - truth))
        if end < len(run.stamps):
            monitor.update_many(run.stamps[end:], run.samples[end:])
        alarms = [a for a in monitor.alarms if a.sensor and a.detected >= onset]
        right = [a for a in alarms if a.sensor == names[joint]]
        score.wrong += any(alarm.sensor != names[joint] for alarm in alarms)
        first = bool(alarms) and alarms[0].sensor == names[joint]
        score.delays.append(right[0].detected - onset if first else np.inf)
    return score


HEADINGS = ('fault', 'injected', 'named', 'in time', 'limit', 'delay median [s]', 'wrong sensor',
            'error < 0.1 rad', 'error 90 % [rad]')  # fmt: skip


def table_of(title: str) -> Table:
    """An empty table."""
    table = Table(title=title)
    for heading in HEADINGS:
        table.add_column(heading)
    return table


def two_link_runs(size: int, rng: np.random.Generator) -> list[Healthy]:
    """Recordings of the two-link arm, each with arms whose parameters are wrong."""
    known = serial_arm_of('real_arm')
    columns, runs = load_column_map(bringup_file('columns', 'real_arm')), []
    files = sorted((DATA / 'real_arm').glob('run_*.csv'))
    for k in range(size * len(files)):
        joints = []
        for joint in known.joints:
            factor = rng.uniform(0.95, 1.05)
            link = LinkInertia.from_vector(factor * joint.link.to_vector())
            coulomb = joint.friction.coulomb * rng.uniform(0.7, 1.3)
            joints.append(replace(
                joint, link=link, friction=replace(joint.friction, coulomb=coulomb)))  # fmt: skip
        arm = replace(known, joints=tuple(joints))
        one = read_recording(files[k % len(files)], arm.joint_names, None, columns)
        runs.append(_healthy(arm, one.time, one.position, one.velocity, one.effort))
    return runs


def _healthy(arm: SerialArm, time: np.ndarray, *readings: Any) -> Healthy:
    stamps = np.round((time - time[0]) * 1e9).astype(np.int64)
    return Healthy(arm, stamps, np.stack(readings, axis=1))


def identified_run(folder: str, urdf: str) -> list[Healthy]:
    """The rest of a recording on whose first part the arm was identified."""
    start = read_urdf_chain(DATA / folder / urdf)
    whole = read_recording(DATA / folder / 'exciting.db3', start.joint_names)
    cut = int(0.6 * len(whole.time))
    first, rest = (
        replace(whole, time=whole.time[part], position=whole.position[part],
                velocity=None if whole.velocity is None else whole.velocity[part],
                effort=whole.effort[part])
        for part in (slice(cut), slice(cut, None))
    )  # fmt: skip
    arm = identify(start, [first]).arm
    return [_healthy(arm, rest.time, rest.position, rest.velocity, rest.effort)]


def shoulder_arm(rates: str) -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    length, turned = 0.4, (np.pi / 2, 0.0, 0.0)
    places = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.2), turned),
              ((length, 0.0, 0.0), (0.0, 0.0, 0.0))]  # fmt: skip
    joints = []
    for i, (mass, limit) in enumerate(zip((4.0, 5.0, 3.0), (60.0, 80.0, 40.0))):
        inertia = mass * length**2 / 3.0
        moment = (0.5 * mass * length, 0.0, 0.0)
        link = LinkInertia(mass, moment, (0.1, 0.0, inertia, 0.0, 0.0, inertia))
        joints.append(SerialJoint(
            f'joint{i + 1}', places[i][0], places[i][1], (0.0, 0.0, 1.0), link,
            JointFriction(viscous=0.3, coulomb=0.3, coulomb_slope=50.0), rotor_inertia=0.05,
            limits=JointLimits(-2.5, 2.5, 2.5, limit),
            sensors=JointSensors(f'encoder{i + 1}', 1e-4, 0.0, rates, 5e-3)))  # fmt: skip
    return SerialArm(
        'shoulder', tuple(joints), tip=(length, 0.0, 0.0), uncertainty=Uncertainty(0.0, 0.3)
    )


def ur10_arm(rates: str) -> SerialArm:
    """The URDF's arm, with friction and rotors."""
    arm, joints = read_urdf_chain(DATA / 'ur10' / 'ur10.urdf'), []
    for joint in arm.joints:
        limit = joint.limits.torque
        joints.append(replace(
            joint, friction=JointFriction(0.0, 0.01 * limit, 0.01 * limit, 50.0),
            rotor_inertia=0.002 * limit,
            sensors=JointSensors(f'{joint.name}_encoder', 1e-4, 0.0, rates, 1e-2)))  # fmt: skip
    return replace(arm, joints=tuple(joints), uncertainty=Uncertainty(2.0, 0.3), sample_time=0.002)


def wrong_plant(arm: SerialArm, rng: np.random.Generator, payload: float) -> Chain:
    """The arm as it is: masses, centres, friction and payload that the model does not know."""
    chain, n = compile_chain(arm), len(arm.joints)
    inertial, friction = chain.inertial.copy(), chain.friction.copy()
    inertial *= rng.uniform(0.95, 1.05, (n, 1))
    inertial[:, 1:4] *= rng.uniform(0.975, 1.025, (n, 1))
    friction[:, :2] *= rng.uniform(0.7, 1.3, (n, 2))
    plant = chain._replace(inertial=inertial, friction=friction)
    return with_payload(plant, payload) if payload > 0.0 else plant


def simulate(
    arm: SerialArm, seed: int, duration: float, payload: float = 0.0, pushes: tuple[Push, ...] = ()
) -> Healthy:
    """One run of an arm that differs from its model."""
    plant = wrong_plant(arm, np.random.default_rng(seed), payload)
    run = SerialSimulator(arm, plant, seed).run(duration, pushes=pushes)
    return Healthy(arm, run.stamps, run.samples)


def report_faults(
    console: Console, title: str, runs: list[Healthy], level: list[int], size: int, only: str
) -> Table:
    """Healthy runs, then cases by name; offsets only on joints whose level gravity shows."""
    rng = np.random.default_rng(1)
    alarms = [alarm for run in runs for alarm in watch(run).alarms]
    seconds = sum(run.duration for run in runs)
    console.print(f'{title}: {seconds:.0f} s without fault, alarms: {len(alarms)}')
    for alarm in alarms[:5]:
        console.print(f'  {alarm}')
    if only in 'pushes':
        watched = [watch(pushed(runs[k % len(runs)], rng)) for k in range(2 * size)]
        blamed = sum(any(alarm.sensor for alarm in monitor.alarms) for monitor in watched)
        console.print(f'{title}: {2 * size} pushes, {blamed} blamed on an encoder')
    everyone = list(range(len(runs[0].arm.joints)))
    table = table_of(title)
    for case in (one for one in CASES if only in one.name):
        joints = everyone if case.name.startswith('step') else level
        score = judge(runs, case, joints, size, rng)
        table.add_row(case.name, *score.row(case.limit))
    return table


def report_levels(console: Console, title: str, run: Healthy, seconds: float = 5.0) -> None:
    """Errors of all offsets after some seconds, from each second of a recording on."""
    errors, sigmas = [], []
    for begin in np.arange(0.0, run.duration - seconds, 1.0):
        part = slice(_index(run, begin), _index(run, begin + seconds))
        window = replace(run, stamps=run.stamps[part], samples=run.samples[part])
        estimate = watch(window).estimate(0)
        errors.append(estimate.fault)
        sigmas.append(estimate.sigma)
    error, sigma = np.array(errors), np.array(sigmas)
    columns = (error, sigma, error / sigma)
    rms, stated, ratio = (np.sqrt(np.mean(one**2, axis=0)) for one in columns)
    table = Table(title=f'{title}: offsets after {seconds:g} s, {len(error)} windows')
    for heading in ('sensor', 'RMS error [rad]', 'largest [rad]', 'stated [rad]', 'RMS ratio'):
        table.add_column(heading)
    for i, name in enumerate(run.arm.sensor_names):
        values = (rms[i], np.abs(error[:, i]).max(), stated[i], ratio[i])
        table.add_row(name, *(f'{value:.3f}' for value in values))
    console.print(table)


def report_kr300(console: Console, size: int) -> None:
    """Steps of 2 mrad in link-side encoders beside motor-side rates; efforts are not used."""
    names, delays, alarms = ('A', 'B', 'C'), [], 0
    joints = [
        SerialJoint(
            f'axis{i}', (0.0, 0.0, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
            LinkInertia(100.0, (0.0, 0.0, 10.0), (10.0, 0.0, 10.0, 0.0, 0.0, 10.0)),
            sensors=JointSensors(f'link{i}', 1e-5, 0.0, 'independent', 1e-3))
        for i in (1, 2, 3)
    ]  # fmt: skip
    arm = SerialArm('kr300', tuple(joints), effort_includes_gravity=False, sample_time=0.004)
    settings, rng = MonitorSettings(smallest_step=0.001), np.random.default_rng(0)
    for k in range(-3, size):
        rows = np.genfromtxt(
            DATA / 'kr300' / f'{names[k % 3]}.csv', delimiter=',', names=True)  # fmt: skip
        y, v = (
            np.stack([rows[f'{name}{i}'] for i in (1, 2, 3)], 1)
            for name in ('link_position', 'motor_velocity')
        )
        monitor, joint, onset = SerialMonitor(arm, settings), int(rng.integers(3)), 0
        if k >= 0:
            onset = int(rng.integers(250, len(y) - 50))
            y[onset:, joint] += 0.002 * rng.choice([-1.0, 1.0])
        stamps = np.round((rows['time'] - rows['time'][0]) * 1e9).astype(np.int64)
        monitor.update_many(stamps, np.stack([y, v, 0.0 * y], 1))
        if k < 0:
            alarms += len(monitor.alarms)
            continue
        found = [(a.sensor, a.kind) for a in monitor.alarms] == [(f'link{joint + 1}', 'bias')]
        late = monitor.alarms[0].detected - stamps[onset] * 1e-9 if found else np.inf
        delays.append(late)
    console.print(
        f'kr300: {len(names)} recordings of 10 s, false alarms {alarms}; {size} steps of 2 mrad, '
        f'named alone {np.isfinite(delays).sum()}, largest delay {1e3 * np.max(delays):.0f} ms'
    )


def report_disturbances(console: Console, size: int) -> None:
    """What must not be blamed on an encoder: pushes, payload, friction."""
    for name, arm in (('shoulder', shoulder_arm('derived')), ('ur10', ur10_arm('derived'))):
        n, limit = len(arm.joints), np.array([joint.limits.torque for joint in arm.joints])
        light = 0.1 * arm.joints[-1].link.mass
        groups = {'healthy': [], 'payload of 10 %': [], 'pushes': []}
        for seed in range(size):
            rng = np.random.default_rng(1000 + seed)
            pushes = tuple(
                Push(start, start + rng.uniform(0.05, 1.0),
                     tuple(0.3 * limit * rng.uniform(-1.0, 1.0, n) * (rng.random(n) < 0.6)))
                for start in (3.0, 5.0, 6.5)
            )  # fmt: skip
            groups['healthy'].append(watch(simulate(arm, seed, 8.0)))
            groups['payload of 10 %'].append(watch(simulate(arm, seed, 8.0, light)))
            groups['pushes'].append(watch(simulate(arm, seed, 8.0, pushes=pushes)))
        for group, monitors in groups.items():
            blamed = sum(any(a.sensor for a in monitor.alarms) for monitor in monitors)
            contacts = sum(any(not a.sensor for a in monitor.alarms) for monitor in monitors)
            console.print(
                f'{name}, {group}: {size} runs of 8 s, encoders blamed in {blamed}, '
                f'contacts reported in {contacts}'
            )


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--size', type=int, default=20, help='injections of each kind')
    arms = ['real_arm', 'ur10', 'panda', 'kr300', 'simulated']
    parser.add_argument('--arms', nargs='+', default=arms, choices=arms)
    parser.add_argument('--only', default='', help='cases whose name contains this; pushes; level')
    options = parser.parse_args()
    what = options.size, options.only
    console, rng = Console(width=150), np.random.default_rng(0)
    recorded = DATA.is_dir()
    if recorded and 'real_arm' in options.arms:
        runs = two_link_runs(max(1, options.size // 4), rng)
        console.print(report_faults(console, 'two-link arm, recorded', runs, [0, 1], *what))
    for folder, urdf, level in (('ur10', 'ur10.urdf', [1, 2]), ('panda', 'fer.urdf', [1, 3])):
        if recorded and folder in options.arms:
            runs = identified_run(folder, urdf)
            if options.only in 'level':
                report_levels(console, f'{folder}, recorded', runs[0])
            console.print(report_faults(console, f'{folder}, recorded', runs, level, *what))
    if recorded and 'kr300' in options.arms:
        report_kr300(console, options.size)
    if 'simulated' in options.arms:
        arm = shoulder_arm('derived')
        runs = [simulate(arm, seed, 9.0) for seed in range(max(2, options.size // 5))]
        console.print(report_faults(console, 'shoulder, simulated', runs, [1, 2], *what))
        report_disturbances(console, max(2, options.size // 4))


if __name__ == '__main__':
    main()
