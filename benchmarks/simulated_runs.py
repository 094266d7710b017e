"""Runs of the simulator, in closed loop on a random path, as a driver would deliver them."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from fault_injection import motion_range, sines

from lpv.core.serial_arm.chain import Chain, compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import Scenario


class Push(NamedTuple):
    """Torques from outside, for some time."""

    begin: float  # [s]
    end: float  # [s]
    torque: tuple[float, ...]  # on each joint [N m]


class Run(NamedTuple):
    """What was simulated."""

    stamps: np.ndarray  # [ns], shape (N,)
    samples: np.ndarray  # readings, rates, efforts of the joints, shape (N, 3, n)
    position: np.ndarray  # true joint positions [rad], shape (N, n)


def simulated_run(
    arm: SerialArm,
    duration: float,
    *faults: Fault,
    plant: Chain | None = None,
    pushes: tuple[Push, ...] = (),
    seed: int = 1,
    noise: bool = True,
) -> Run:
    """A run whose controller knows the arm, and not the true ``plant``."""
    count, n = round(duration / arm.sample_time), len(arm.joints)
    time = arm.sample_time * np.arange(count)
    q, v, a = sines(*motion_range(arm, 0.5), np.random.default_rng(seed))(time)
    rests = tuple(q[0].tolist())
    scenario = Scenario(
        'test', duration, seed, (0.0, duration), (rests, rests), faults, noise=noise,
        disturbance=False)  # fmt: skip
    simulator, model = ArmSimulator(_unlimited(arm), scenario), SerialModel(compile_chain(arm))
    simulator.chain = simulator.chain if plant is None else plant
    simulator.state.motion[1] = v[0]
    samples, position = np.zeros((count, 3, n)), np.zeros((count, n))
    torque, limit = np.zeros(n), np.array(arm.torque_limit)
    for k in range(count):
        sensed = simulator.sense()
        reading, rate = sensed['measured_position'], sensed['measured_velocity']
        samples[k] = reading, rate, torque
        position[k] = sensed['position']
        error = 100.0 * (q[k] - reading) + 20.0 * (v[k] - rate)
        torque = np.clip(model.torque(q[k], v[k], a[k] + error), -limit, limit)
        outside = [push.torque for push in pushes if push.begin <= time[k] < push.end]
        simulator.step(torque + sum(map(np.array, outside)))
    return Run(np.round(1e9 * time).astype(np.int64), samples, position)


def _unlimited(arm: SerialArm) -> SerialArm:
    """The arm whose drives are as strong as what pushes it."""
    joints = (replace(j, limits=replace(j.limits, torque=1e6)) for j in arm.joints)
    return replace(arm, joints=tuple(joints))
