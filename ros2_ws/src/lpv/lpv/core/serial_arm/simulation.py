"""A simulated serial arm with faulty sensors, in closed loop on a random path.

The plant has friction and torque limits, and is advanced in sub-steps.  Faults are injected as
hardware does it: a rate that is derived from an encoder fails with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpv.core.serial_arm.chain import (
    COULOMB,
    SLOPE,
    VISCOUS,
    Chain,
    FloatArray,
    IntArray,
    compile_chain,
    workspace,
)
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.friction import friction_torque
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.momentum import forward_dynamics
from lpv.core.serial_arm.dynamics.newton_euler import inverse_dynamics
from lpv.core.support.errors import ConfigError
from lpv.core.support.jit import njit_in_place as njit

FAULT_KINDS = ('bias', 'drift', 'scale', 'stuck')
MAX_SUBSTEPS = 64
_HARMONICS = 3


@dataclass(frozen=True)
class EncoderFault:
    """Fault of a position sensor, from its onset on."""

    joint: int
    kind: str  # one of FAULT_KINDS
    onset: float  # [s]
    size: float = 0.0  # [rad] of a bias, [rad/s] of a drift, [-] of a scale error


@dataclass(frozen=True)
class Push:
    """Torques from outside, for some time."""

    begin: float  # [s]
    end: float  # [s]
    torque: tuple[float, ...]  # on each joint [N m]


@dataclass(frozen=True)
class SerialRun:
    """What was simulated."""

    stamps: IntArray  # [ns], shape (N,)
    samples: FloatArray  # readings, rates, efforts, shape (N, 3, n)
    position: FloatArray  # true joint positions [rad], shape (N, n)


@njit
def plant_step(
    chain: Chain,
    state: FloatArray,
    torque: FloatArray,
    step: float,
    count: int,
    scratch: FloatArray,
    matrix: FloatArray,
    push: FloatArray | None = None,
) -> bool:
    """Advance the arm by Runge-Kutta steps with held torques.

    Parameters
    ----------
    chain : Chain
        The true arm.
    state : ndarray, shape (2, n)
        Positions and rates, changed [rad], [rad/s].
    torque : ndarray, shape (n,)
        Of drives and from outside [N m].
    step : float
        Of integration [s].
    count : int
        Number of steps.
    scratch : ndarray, shape (11 n, columns of `workspace`)
        Scratch: the workspace in the first n rows, vectors behind.
    matrix : ndarray, shape (n, n)
        Scratch.
    push : ndarray, shape (n,), optional
        Accelerations by a disturbance, held, too [rad/s2].

    Returns
    -------
    bool
        False if the mass matrix was not positive definite.
    """
    n = torque.shape[0]
    work = scratch[:n]
    vectors = scratch[n:].reshape(-1)
    rate, position = vectors[:n], vectors[n : 2 * n]
    friction, net = vectors[2 * n : 3 * n], vectors[3 * n : 4 * n]
    slopes = vectors[4 * n : 12 * n].reshape((8, n))
    for _ in range(count):
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            for i in range(n):
                position[i], rate[i] = state[0, i], state[1, i]
                if stage > 0:
                    position[i] += share * step * slopes[2 * stage - 2, i]
                    rate[i] += share * step * slopes[2 * stage - 1, i]
            friction_torque(chain, rate, torque, friction)
            for i in range(n):
                net[i] = torque[i] - friction[i]
                slopes[2 * stage, i] = rate[i]
            if not forward_dynamics(
                chain, position, rate, net, work, matrix, slopes[2 * stage + 1]
            ):
                return False
            if push is not None:
                for i in range(n):
                    slopes[2 * stage + 1, i] += push[i]
        for part in range(2):
            for i in range(n):
                state[part, i] += (step / 6.0) * (
                    slopes[part, i] + 2.0 * slopes[2 + part, i] + 2.0 * slopes[4 + part, i]
                    + slopes[6 + part, i])  # fmt: skip
    return True


class SerialSimulator:
    """Closed loop of a simulated arm.

    Parameters
    ----------
    arm : SerialArm
        What the controller knows, and the sensors.
    plant : Chain, optional
        The true arm; that of ``arm`` by default.
    seed : int, optional
        Of noise and path.
    """

    def __init__(self, arm: SerialArm, plant: Chain | None = None, seed: int = 0) -> None:
        self.arm, self.model = arm, compile_chain(arm)
        self.plant = self.model if plant is None else plant
        self.joints = len(arm.joints)
        self._rng = np.random.default_rng(seed)
        self._step, self._count = integration_step(self.plant, arm.sample_time)

    def random_path(self, speed: float = 0.5) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Sums of sines in the middle of the joints' ranges.

        Parameters
        ----------
        speed : float, optional
            Largest rate, as a share of the joint's limit.

        Returns
        -------
        tuple of ndarray
            Centres (n,) [rad], amplitudes and frequencies, (n, harmonics) [rad], [rad/s].
        """
        n, rng = self.joints, self._rng
        low, high = np.array([joint.range for joint in self.arm.joints]).T
        rate = np.array([min(joint.limits.velocity, 4.0) for joint in self.arm.joints])
        frequency = rng.uniform(0.5, 3.0, (n, _HARMONICS))
        share = rng.dirichlet(np.ones(_HARMONICS), n)
        amplitude = share * (speed * rate)[:, None] / frequency
        room = 0.4 * (high - low) / amplitude.sum(1)
        amplitude *= np.minimum(1.0, room)[:, None]
        return 0.5 * (low + high), amplitude, frequency

    def run(
        self,
        duration: float,
        faults: Sequence[EncoderFault] = (),
        pushes: Sequence[Push] = (),
        path: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    ) -> SerialRun:
        """Simulate a run.

        Parameters
        ----------
        duration : float
            [s].
        faults : sequence of EncoderFault, optional
            On the readings.
        pushes : sequence of Push, optional
            Torques from outside.
        path : tuple, optional
            As of `random_path`.

        Returns
        -------
        SerialRun
            Samples as a driver would deliver them, and the truth.

        Raises
        ------
        ConfigError
            If a fault is of no known kind, or the plant is not physical.
        """
        _check_faults(faults, self.joints)
        centre, amplitude, frequency = path or self.random_path()
        period, n = self.arm.sample_time, self.joints
        count = int(round(duration / period))
        noise = self._noise(count)
        limit = np.array([joint.limits.torque for joint in self.arm.joints])
        readings = _Readings(self.arm, faults, noise)
        samples, positions = np.zeros((count, 3, n)), np.zeros((count, n))
        state = np.ascontiguousarray(np.stack([centre, (amplitude * frequency).sum(1)]))
        torque = np.zeros(n)
        scratch, matrix, work = plant_scratch(self.plant), np.empty((n, n)), workspace(self.model)
        wanted, friction = np.empty(n), np.empty(n)
        for k in range(count):
            time = k * period
            samples[k, 0], samples[k, 1] = readings.take(k, time, state)
            samples[k, 2], positions[k] = torque, state[0]
            phase = frequency * time
            goal = centre + (amplitude * np.sin(phase)).sum(1)
            rate = (amplitude * frequency * np.cos(phase)).sum(1)
            acceleration = -(amplitude * frequency**2 * np.sin(phase)).sum(1)
            acceleration += 100.0 * (goal - samples[k, 0]) + 20.0 * (rate - samples[k, 1])
            inverse_dynamics(self.model, goal, rate, acceleration, work, wanted)
            friction_torque(self.model, rate, wanted, friction)
            torque = np.clip(wanted + friction, -limit, limit)
            outside = _outside(pushes, time, n)
            if not plant_step(
                self.plant, state, torque + outside, self._step, self._count, scratch, matrix
            ):
                raise ConfigError('plant', 'has a mass matrix that is not positive definite')
        stamps = np.round(1e9 * period * np.arange(count)).astype(np.int64)
        return SerialRun(stamps, samples, positions)

    def _noise(self, count: int) -> FloatArray:
        """Noise of readings and rates, shape (count, 2, n)."""
        size = np.array([[joint.sensors.position_noise for joint in self.arm.joints],
                         [joint.sensors.velocity_noise for joint in self.arm.joints]])  # fmt: skip
        return size * self._rng.normal(size=(count, 2, self.joints))


class _Readings:
    """Sensors with their faults."""

    def __init__(self, arm: SerialArm, faults: Sequence[EncoderFault], noise: FloatArray) -> None:
        self._faults, self._noise, self._period = faults, noise, arm.sample_time
        self._quantum = np.array([joint.sensors.quantization for joint in arm.joints])
        self._derived = np.array([j.sensors.rates != 'independent' for j in arm.joints])
        self._last: FloatArray | None = None
        self._stuck: dict[int, float] = {}

    def take(self, k: int, time: float, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Readings and rates of a sample."""
        reading = state[0] + self._noise[k, 0]
        for fault in self._faults:
            if time >= fault.onset:
                self._apply(fault, reading, time - fault.onset)
        fine = np.where(self._quantum > 0.0, self._quantum, 1.0)
        reading = np.where(self._quantum > 0.0, np.round(reading / fine) * fine, reading)
        last = reading if self._last is None else self._last
        difference = (reading - last) / self._period
        if self._last is None:
            difference = state[1].copy()
        self._last = reading
        return reading, np.where(self._derived, difference, state[1] + self._noise[k, 1])

    def _apply(self, fault: EncoderFault, reading: FloatArray, age: float) -> None:
        """Change a reading."""
        i = fault.joint
        if fault.kind == 'bias':
            reading[i] += fault.size
        elif fault.kind == 'drift':
            reading[i] += fault.size * age
        elif fault.kind == 'scale':
            reading[i] *= 1.0 + fault.size
        else:
            reading[i] = self._stuck.setdefault(i, float(reading[i]))


def _check_faults(faults: Sequence[EncoderFault], joints: int) -> None:
    for k, fault in enumerate(faults):
        if fault.kind not in FAULT_KINDS:
            raise ConfigError(f'faults[{k}].kind', f'must be one of {", ".join(FAULT_KINDS)}')
        if not 0 <= fault.joint < joints:
            raise ConfigError(f'faults[{k}].joint', f'must be 0 to {joints - 1}')


def _outside(pushes: Sequence[Push], time: float, joints: int) -> FloatArray:
    """Torques from outside at a moment [N m]."""
    total = np.zeros(joints)
    for push in pushes:
        if push.begin <= time < push.end:
            total += push.torque
    return total


def plant_scratch(chain: Chain) -> FloatArray:
    """Scratch memory of `plant_step`."""
    return np.zeros((11 * len(chain.translation), workspace(chain).shape[1]))


def integration_step(chain: Chain, period: float) -> tuple[float, int]:
    """Step and steps a sample for which the friction at rest, the stiffest part, is stable.

    Parameters
    ----------
    chain : Chain
        The true arm.
    period : float
        Sample time [s].

    Returns
    -------
    tuple
        Length of a Runge-Kutta step [s], and their number, 2 to `MAX_SUBSTEPS`.
    """
    n, model = len(chain.translation), SerialModel(chain)
    rng = np.random.default_rng(0)
    inertia = np.min([
        1.0 / np.diag(np.linalg.inv(model.mass_matrix(q))) for q in rng.uniform(-3, 3, (20, n))
    ], axis=0)  # fmt: skip
    slope = chain.friction[:, VISCOUS] + 2.0 / np.pi * chain.friction[:, COULOMB] * np.maximum(
        chain.friction[:, SLOPE], 1.0)  # fmt: skip
    needed = int(np.ceil(period * float((slope / inertia).max()) / 1.5))
    count = min(max(needed, 2), MAX_SUBSTEPS)
    return period / count, count
