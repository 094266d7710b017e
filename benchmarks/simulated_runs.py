"""Runs of the simulator, in closed loop on a random path, as a driver would deliver them."""

from typing import NamedTuple

import numpy as np
from fault_injection import motion_range, sines, with_joints

from lpv.core.serial_arm.chain import Chain, FloatArray, compile_chain, workspace
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.simulation.arm_simulator import ArmSimulator, Chances, PlantParts, drive, read_sensors
from lpv.core.simulation.faults import Fault
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.jit import njit_in_place as njit


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


class _Loop(NamedTuple):
    """The true arm, and its controller's model."""

    plant: PlantParts
    chances: Chances
    model: Chain
    limit: FloatArray  # of the commanded torques [N m]
    work: FloatArray
    vectors: FloatArray  # scratch, shape (3, n)


@njit
def _close(
    loop: _Loop, path: FloatArray, outside: FloatArray, samples: FloatArray, position: FloatArray
) -> None:
    """Follow a path, shape (3, N, n), against torques from outside."""
    plant, state, chances = loop.plant, loop.plant.state, loop.chances
    wanted, load, torque = loop.vectors
    for k in range(len(samples)):
        read_sensors(plant, chances.noise, chances.fault)
        sample, q, v = samples[k], path[0, k], path[1, k]
        for i in range(len(q)):
            sample[0, i], sample[1, i] = state.measured_position[i], state.measured_velocity[i]
            sample[2, i], position[k, i] = torque[i], state.position[i]
            error = 100.0 * (q[i] - sample[0, i]) + 20.0 * (v[i] - sample[1, i])
            wanted[i] = path[2, k, i] + error
        inverse_dynamics(loop.model, q, v, wanted, loop.work, load)
        friction_torque(loop.model, v, load, torque)
        for i in range(len(q)):
            torque[i] = min(max(load[i] + torque[i], -loop.limit[i]), loop.limit[i])
            load[i] = torque[i] + outside[k, i]
        drive(plant, load, chances.push)


def simulated_run(
    arm: SerialArm,
    duration: float,
    *faults: Fault,
    plant: Chain | None = None,
    pushes: tuple[Push, ...] = (),
    seed: int = 1,
    noise: bool = True,
) -> Run:
    """A run whose controller knows the arm, and not the true ``plant``; its readings are finite."""
    count, n = round(duration / arm.sample_time), len(arm.joints)
    time = arm.sample_time * np.arange(count)
    path = np.array(sines(*motion_range(arm, 0.5), np.random.default_rng(seed))(time))
    rests = tuple(path[0, 0].tolist())
    scenario = Scenario(
        'test', duration, seed, (0.0, duration), (rests, rests), faults, noise=noise,
        disturbance=False)  # fmt: skip
    unlimited = with_joints(arm, limits={'torque': 1e6})  # its drives are as strong as any push
    simulator, model = ArmSimulator(unlimited, scenario), compile_chain(arm)
    simulator.state.motion[1] = path[1, 0]
    parts = simulator.parts if plant is None else simulator.parts._replace(chain=plant)
    limit = np.array(arm.torque_limit)
    loop = _Loop(parts, simulator.chances, model, limit, workspace(model), np.zeros((3, n)))
    samples, position, outside = np.zeros((count, 3, n)), np.zeros((count, n)), np.zeros((count, n))
    for push in pushes:
        outside[(push.begin <= time) & (time < push.end)] += push.torque
    _close(loop, path, outside, samples, position)
    if simulator.state.own['failed'][0] or not np.isfinite(samples).all():
        raise ValueError('the simulated run has no numbers')
    return Run(np.round(1e9 * time).astype(np.int64), samples, position)
