"""Our diagnosis beside an EKF and a UKF with random-walk faults, on the same data.

Simulated runs of the paper's arm with model error within the stated 5 %, and, where they are, the
recordings of a real arm with a step added to one encoder.  The peers raise an alarm where their
fault estimate exceeds a threshold, which is chosen in their favour: 1.2 times their largest
estimate over all healthy data of the same arm, for each sensor.
"""

import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from accuracy_limit import make_ekf, make_ukf
from rich.console import Console
from rich.table import Table

from lpv_core.control.tracking import TrackingController
from lpv_core.decision.diagnosis import AlarmEvent
from lpv_core.model.arm import load_arm
from lpv_core.model.joints import JointMap
from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.faults import Fault, FaultInjector
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement

RECORDINGS = Path(__file__).resolve().parents[2] / 'shared' / 'data' / 'real_arm'
RUNS, LENGTH, SETTLED = 6, 10.0, 1.0


def simulated(arm, gains):
    """Healthy messages of arms that differ from the model."""
    runs = []
    for number in range(RUNS):
        rng = np.random.default_rng(number)
        factors = rng.uniform(1.0 - arm.model_error, 1.0 + arm.model_error, 4)
        scenario = replace(
            load_scenario(bringup_file('scenarios', 'two_faults')),
            faults=(),
            seed=number,
            mass_factors=tuple(factors[:2]),
            inertia_factors=tuple(factors[2:]),
        )
        plant, controller = ArmSimulator(arm, scenario), TrackingController(arm, gains)
        path, messages = scenario.path(arm), []
        for _ in range(round(LENGTH / arm.sample_time)):
            measurement, truth = plant.sense()
            messages.append(
                (plant.time, measurement.position, measurement.velocity, measurement.effort)
            )
            plant.step(
                controller.update(
                    path.sample(plant.time),
                    truth.position,
                    truth.velocity,
                    truth.position,
                    arm.sample_time,
                ).torque
            )
        runs.append(messages)
    return runs


def recorded():
    """Messages of the recordings; none where they are absent."""
    runs = []
    for file in sorted(RECORDINGS.glob('run_*.csv')):
        rows = np.genfromtxt(file, delimiter=',', names=True)
        pairs = [
            np.column_stack([rows[f'{name}1'], rows[f'{name}2']])
            for name in ('pos_meas', 'vel_meas', 'tau_meas')
        ]
        runs.append(list(zip(rows['time'] - rows['time'][0], *pairs)))
    return runs


def with_step(arm, messages, sensor, onset, size):
    """The same messages with a bias on one sensor."""
    joints = JointMap(arm)
    injector = FaultInjector(
        arm.sensor_names,
        [Fault(arm.sensor_names[sensor], 'bias', onset, size=size)],
        np.random.default_rng(0),
    )
    return [
        (
            t,
            joints.joint_from_sensor(injector.apply(t, joints.sensor_position(p), arm.sample_time)),
            v,
            u,
        )
        for t, p, v, u in messages
    ]


def ours(arm, gains, messages):
    """Fault estimates (n, 2), alarm times by sensor, seconds a step."""
    monitor, alarms, found = SensorMonitor('bench', arm, gains), {}, []
    monitor.warm_up()
    began = time.perf_counter()
    for t, position, velocity, effort in messages:
        answer = monitor.take(
            1 + round(t * 1e9),
            SimpleNamespace(
                name=list(arm.joint_names), position=position, velocity=velocity, effort=effort
            ),
        )
        found.append(answer.fault['estimate'])
        for event in answer.events:
            if event.event == AlarmEvent.RAISED:
                alarms.setdefault(event.sensor_index, t)
    return np.array(found), alarms, (time.perf_counter() - began) / len(messages)


def peer(make, arm, messages):
    """Fault estimates (n, 2) and seconds a step of a Kalman filter."""
    joints, found = JointMap(arm), []
    kalman = make(arm, messages[0][1])
    began = time.perf_counter()
    for _, position, velocity, effort in messages:
        y = np.concatenate([joints.sensor_position(position), joints.sensor_velocity(velocity)])
        found.append(kalman.take(y, joints.absolute_torque(effort)).copy())
    return np.array(found), (time.perf_counter() - began) / len(messages)


def crossings(times, found, threshold):
    """First time above the threshold, by sensor."""
    alarms = {}
    for sensor in range(2):
        above = np.flatnonzero((np.abs(found[:, sensor]) > threshold[sensor]) & (times > SETTLED))
        if above.size:
            alarms[sensor] = times[above[0]]
    return alarms


def judge(arm, gains, runs, sizes, console, title):
    """One table: delay, misses, wrong alarms, error, cost."""
    table = Table(title=title)
    for name in (
        '',
        'step [rad]',
        'detected',
        'delay max [ms]',
        'wrong alarms',
        'RMS error after 0.1 s, faulty sensor [rad]',
        'other sensor [rad]',
        'us a step',
    ):
        table.add_column(name, justify='right')
    makers = {'EKF': make_ekf, 'UKF': make_ukf}
    healthy = {name: [peer(make, arm, run)[0] for run in runs] for name, make in makers.items()}
    limits = {
        name: 1.2
        * np.max([np.abs(f[round(SETTLED / arm.sample_time) :]).max(axis=0) for f in found], axis=0)
        for name, found in healthy.items()
    }
    false = sum(len(ours(arm, gains, run)[1]) for run in runs)
    console.print(
        f'{title}: {len(runs)} healthy runs, our false alarms: {false}; thresholds of '
        + ', '.join(f'{n} {v[0]:.3f}, {v[1]:.3f} rad' for n, v in limits.items())
    )
    for size in sizes:
        rows = {name: [] for name in ('ours', *makers)}
        for number, run in enumerate(runs):
            sensor, onset = number % 2, 3.0 + 0.7 * number
            faulty = with_step(arm, run, sensor, onset, size)
            times = np.array([m[0] for m in faulty])
            truth = np.zeros((len(times), 2))
            truth[times >= onset, sensor] = size
            late = times > onset + 0.1
            found, alarms, cost = ours(arm, gains, faulty)
            rows['ours'].append((found, alarms, cost, sensor, onset, truth, late))
            for name, make in makers.items():
                found, cost = peer(make, arm, faulty)
                rows[name].append(
                    (found, crossings(times, found, limits[name]), cost, sensor, onset, truth, late)
                )
        for name, results in rows.items():
            delays = [
                1e3 * (a[s] - o) for _, a, _, s, o, _, _ in results if s in a and a[s] >= o - 1e-9
            ]
            wrong = sum(len(set(a) - {s}) for _, a, _, s, _, _, _ in results)
            errors = np.sqrt(
                [
                    np.mean(
                        [
                            np.mean((f - t)[late, s ^ other] ** 2)
                            for f, _, _, s, _, t, late in results
                        ]
                    )
                    for other in (0, 1)
                ]
            )
            table.add_row(
                name,
                f'{size:g}',
                f'{len(delays)}/{len(results)}',
                f'{max(delays):.0f}' if delays else '-',
                str(wrong),
                *(f'{error:.4f}' for error in errors),
                f'{1e6 * np.mean([c for _, _, c, *_ in results]):.0f}',
            )
    console.print(table)


def main():
    """Both kinds of data."""
    console = Console(width=120)
    arm = load_arm(bringup_file('arms', 'paper'))
    gains = design(arm, load_requirement('paper')).gains
    judge(arm, gains, simulated(arm, gains), (0.05, 0.1, 0.3), console, 'simulated arm')
    runs = recorded()
    if not runs:
        console.print(f'no recordings at {RECORDINGS}: that part is left out')
        return
    arm = load_arm(bringup_file('arms', 'real_arm'))
    gains = design(arm, load_requirement('real_arm')).gains
    judge(arm, gains, runs, (0.1, 0.2, 0.3), console, 'recordings of a real arm')


if __name__ == '__main__':
    main()
