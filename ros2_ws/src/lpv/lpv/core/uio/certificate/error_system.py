"""The error system of method ``exact``, link by link, and the noise of both methods' estimates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.inequalities import NumberType, array_of
from lpv.core.support.limits import SMALL
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_descriptor
from lpv.core.uio.observer.paper_observer import PaperObserverGains


@dataclass(frozen=True)
class LinkError:
    """Error of one link in the state (e, m/Xi_ii): angle [rad] and weighted rate [rad/s].

    White inputs are noise of both rate sensors and accelerations of both axes.  Of a hanging arm
    the momentum error is counted with the other sign, which makes both orientations one.
    """

    index: int  # 0 or 1
    inertia: float  # Xi_ii [kg m2]
    slopes: tuple  # smallest and largest slope Gamma_i in the region [N m/rad]
    # at both ends of Xi12, between which all is a convex combination: how the inputs enter the
    # error as they are, two rows, and through the output injection L, the last one, shape (3, 4)
    inputs: list
    intensity: np.ndarray  # of the inputs as the arm file states them [rad2/s], [rad2/s3]
    unit: Any  # size of errors [rad], for scaling

    def closed(self, slope: Any, kappa: Any, mu: Any) -> np.ndarray:
        """N of the error e' = -kappa m, m' = Gamma e - mu m, for one slope."""
        return np.array([[0 * mu, -kappa * self.inertia], [slope / self.inertia, -mu]])

    def noises(self, acceleration_noise: Sequence[float], rate_noise: float) -> list[np.ndarray]:
        """``inputs`` of unit intensity, one more column than there: accelerations of given noise
        [rad/s2/sqrt(Hz)], and noise that e' takes beside that of the rates [rad/s/sqrt(Hz)]."""
        root = np.append(np.sqrt(self.intensity[:2]), acceleration_noise)
        return [np.insert(w * root, 2, [rate_noise, 0.0, 0.0], axis=1) for w in self.inputs]

    def input_covariances(self, kappa: Any, mu: Any) -> list[np.ndarray]:
        """B B^T of the white inputs that the arm file states, in `unit`, at both ends of Xi12."""
        gain = -np.array([[kappa * self.inertia], [mu]])
        inputs = [w[:2] + gain @ w[2:] for w in self.inputs]
        return [b * (self.intensity / self.unit**2) @ b.T for b in inputs]


def link_errors(arm: ArmParameters, number: NumberType = float) -> list[LinkError]:
    """Error systems of both links, in floats or in exact fractions."""
    c, sign, array = arm.numbers(number), number(arm.sign), array_of(number)
    rates = array(np.linalg.inv(JointMap(arm).sensor_matrix))  # of the links, from the sensors'
    direction = array(arm.disturbance_direction)
    # One d drives both axes: (a d_1 + b d_2)^2 <= 2 (a^2 d_1^2 + b^2 d_2^2).
    variance = int(np.count_nonzero(direction)) * number(arm.disturbance_variance)
    noise = number(arm.velocity_noise) ** 2
    intensity = number(arm.sample_time) * np.array([noise, noise, *(variance * direction**2)])
    links = []
    for i, (inertia, gravity) in enumerate(zip(c.inertia, c.gravity)):
        inputs = []
        for end in (c.rotor_coupling - c.coupling, c.rotor_coupling + c.coupling):
            row = sign * np.array([inertia, end] if i == 0 else [end, inertia]) / inertia
            inputs.append(np.array([[*rates[i], 0, 0], [0, 0, *row], [*(-row @ rates), 0, 0]]))
        slopes = (gravity * number(arm.cos_min[i]), gravity)
        links.append(LinkError(i, inertia, slopes, inputs, intensity, number(SMALL)))
    return links


def exact_fault_sigma(arm: ArmParameters, lyapunov: np.ndarray) -> np.ndarray:
    """Bound on the standard deviation of f^ of method ``exact``, per sensor [rad].

    P^-1 bounds the covariance of each link's error; sensors add those of their links.
    """
    with np.errstate(invalid='ignore'):  # of a P that is not positive: NaN fails every check
        angle = SMALL * np.sqrt([np.linalg.inv(p)[0, 0] for p in lyapunov])
    spread = np.abs(JointMap(arm).sensor_matrix) @ angle
    return np.hypot(spread, arm.position_noise)


def paper_fault_sigma(arm: ArmParameters, observer: PaperObserverGains) -> np.ndarray:
    """Largest standard deviation of f^ of method ``paper`` over the vertices, per sensor [rad]."""
    from scipy.linalg import solve_continuous_lyapunov  # as `discretised` does

    d = paper_descriptor(arm, observer.box)
    root = math.sqrt(arm.sample_time)
    noise = np.diag([arm.position_noise] * 2 + [arm.velocity_noise] * 2)
    t1, t2, sigma = observer.t1, observer.t2, np.zeros(2)
    for a_i, k_i in zip(d.a, observer.k):
        n = t1 @ a_i + k_i @ d.c
        disturbance = t1 @ d.bd * math.sqrt(arm.disturbance_variance)
        inputs = root * np.hstack([disturbance, (n @ t2 - k_i) @ noise])
        spread = solve_continuous_lyapunov(n, -inputs @ inputs.T) + t2 @ noise @ noise @ t2.T
        sigma = np.maximum(sigma, np.sqrt(np.diag(spread)[4:]))
    return sigma
