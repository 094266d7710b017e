"""The simulated arm with its sensors: plant, disturbance, noise and faults, step by step."""

from dataclasses import dataclass

import numpy as np

from lpv_core.dynamics import inverse_dynamics, rk4_step
from lpv_core.faults import FaultInjector
from lpv_core.joints import JointMap
from lpv_core.polytope import sinc_box
from lpv_core.state_space import lpv_rk4_step, vertex_matrices


@dataclass(frozen=True)
class Measurement:
    """What the sensors say, in ROS joint coordinates.

    Attributes
    ----------
    position, velocity : ndarray, shape (2,)
        Faulty, noisy joint positions and noisy rates [rad], [rad/s].
    effort : ndarray, shape (2,)
        Joint torque that acted over the step before [N m].
    """

    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What no observer may know.

    Attributes
    ----------
    position, velocity : ndarray, shape (2,)
        True joint positions and rates [rad], [rad/s].
    fault : ndarray, shape (2,)
        Fault of the physical sensors, reading minus truth before noise [rad]; NaN in a dropout.
    disturbance : float
        d over the step before.
    """

    position: np.ndarray
    velocity: np.ndarray
    fault: np.ndarray
    disturbance: float


class ArmSimulator:
    """Plant and sensors of one scenario.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm (sensors, limits, disturbance).
    scenario : Scenario
        What happens.
    substeps : int, optional
        Runge-Kutta steps per sample.

    Attributes
    ----------
    step_count : int
        Number of the present sample.
    injector : FaultInjector
        Faults, scheduled and injected while running.
    """

    def __init__(self, arm, scenario, substeps=2):
        self.arm, self.scenario = arm, scenario
        self.sample_time = arm.sample_time
        self.joints = JointMap(arm)
        self._substeps = substeps
        streams = np.random.SeedSequence(scenario.seed).spawn(3)
        # One stream a purpose: injecting a fault must not change noise and disturbance.
        self._noise, self._push, fault_stream = (np.random.default_rng(s) for s in streams)
        self.injector = FaultInjector(arm.sensor_names, scenario.faults, fault_stream)
        self._set_plant(scenario.true_arm(arm), scenario)
        start = scenario.path(arm).sample(0.0)
        self._state = np.concatenate([self.joints.absolute_position(start.position), np.zeros(2)])
        self.step_count = 0
        self._torque = np.zeros(2)
        self._disturbance = 0.0
        self._reading = None

    def _set_plant(self, true_arm, scenario):
        self._constants = true_arm.constants(scenario.plant == 'nonlinear')
        self._box = None
        if scenario.plant == 'lpv':
            self._box = sinc_box(scenario.sinc_min)
            self._a, self._b = vertex_matrices(self._box, true_arm.constants(False))
            self._rho = np.zeros(8)

    @property
    def time(self):
        """Time of the present sample [s]."""
        return self.step_count * self.sample_time

    def step(self, joint_torque):
        """Apply a torque over one sample time.

        Parameters
        ----------
        joint_torque : sequence of two floats
            Commanded joint torques [N m]; clipped to the arm's limits.

        Raises
        ------
        ValueError
            If a torque is not finite.
        """
        torque = np.asarray(joint_torque, float)
        if torque.shape != (2,) or not np.isfinite(torque).all():
            raise ValueError(f'torque must be two finite numbers, got {joint_torque}')
        self._torque = np.clip(torque, -np.array(self.arm.torque_limit), self.arm.torque_limit)
        self._disturbance = 0.0
        if self.scenario.disturbance:
            self._disturbance = (self.arm.disturbance_mean + np.sqrt(self.arm.disturbance_variance)
                                 * self._push.standard_normal())
        self._integrate()
        self.step_count += 1
        self._reading = None

    def hold(self):
        """Let one sample time pass with the brakes engaged: no motion, no disturbance felt.

        Drives brake until the first command and after a safe stop; the torque sensors then read
        what holds the arm.
        """
        self._state[2:] = 0.0
        holding = inverse_dynamics(*self._state, 0.0, 0.0, self._constants)
        self._torque = self.joints.joint_torque(np.array(holding))
        self._disturbance = 0.0
        self.step_count += 1
        self._reading = None

    def _integrate(self):
        q_1, q_2 = self.joints.absolute_torque(self._torque)
        push_1, push_2 = np.array(self.arm.disturbance_direction) * self._disturbance
        dt = self.sample_time / self._substeps
        state = tuple(self._state)
        for _ in range(self._substeps):
            if self._box is None:
                state = rk4_step(*state, q_1, q_2, push_1, push_2, dt, self._constants)
            else:
                state = lpv_rk4_step(*state, q_1, q_2, push_1, push_2, dt,
                                     self._a, self._b, self._box, self._rho)
        self._state = np.array(state)

    def sense(self):
        """Readings at the present sample; the same ones when asked again.

        Returns
        -------
        tuple
            ``(Measurement, Truth)``.
        """
        if self._reading is None:
            self._reading = self._read()
        return self._reading

    def _read(self):
        position = self.joints.joint_position(self._state[:2])
        velocity = self.joints.joint_velocity(self._state[2:])
        true_reading = self.joints.sensor_position(position)
        faulty = self.injector.apply(self.time, true_reading, self.sample_time)
        # Numbers are drawn with or without noise, so that both runs share the later ones.
        draw = self._noise.standard_normal(4)
        rates = self.joints.sensor_velocity(velocity)
        noisy, noisy_rates = faulty, rates
        if self.scenario.noise:
            noise = self.arm.position_noise * draw[:2]
            noisy = faulty + np.where(self.injector.stuck(self.time), 0.0, noise)
            noisy_rates = rates + self.arm.velocity_noise * draw[2:]
        measurement = Measurement(self.joints.joint_from_sensor(noisy),
                                  self.joints.joint_velocity_from_sensor(noisy_rates),
                                  self._torque.copy())
        return measurement, Truth(position, velocity, faulty - true_reading, self._disturbance)
