"""The healthy arms that an arm file allows: a zonotope of parameters.

Every parameter error is sum_k z_k G_k with abs(z_k) <= 1, each z_k constant over the horizon.
"""

from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import (
    COULOMB,
    IXX,
    IYY,
    IZZ,
    LOAD,
    MASS,
    MX,
    OFFSET,
    VISCOUS,
    Chain,
    FloatArray,
    IntArray,
    joint_count,
)
from lpv.core.serial_arm.description import RATE_BIAS, SerialArm
from lpv.core.serial_arm.diagnosis.parameter_error import relative_factor
from lpv.core.serial_arm.dynamics.payload import PAYLOAD_PLACE, payload_parameters

PAYLOAD_PARTS = 10
"""Generators of a payload: its mass at the tip, 3 first moments, 6 inertias."""


class ParameterSet(NamedTuple):
    """Half widths of everything that may differ from the file, as generators."""

    body: IntArray  # link to which each of the inertial generators belongs, shape (k,)
    inertial: FloatArray  # of the links and of the payload, shape (k, 10)
    rotor: FloatArray  # of the rotors' inertias and couplings, shape (n, n) [kg m2]
    viscous: FloatArray  # (n,) of friction [N m s]
    coulomb: FloatArray  # (n,) of friction [N m]
    load: FloatArray  # (n,) of friction [-]
    offset: FloatArray  # (n,) of friction [N m]
    rate_bias: FloatArray  # of independent rates, shape (n,) [rad/s]
    rounding: FloatArray  # of readings, shape (n,) [rad]
    # (2, n) of the efforts against the motion [s], and its share of how torques bend [s2]
    delay: FloatArray
    tolerance: FloatArray  # (n, 2, s) speeds [rad/s], torques that the model may miss there [N m]


def is_stated(arm: SerialArm) -> bool:
    """Whether the file says what a healthy arm may be: no guarantee without it."""
    return arm.uncertainty.model_error is not None


def parameter_set(arm: SerialArm, chain: Chain) -> ParameterSet:
    """Set of the healthy arms of a file, by its `Uncertainty` and sensors.

    ``model_error`` e scales each link by 1 +- e, and, apart from that, changes its first moments by
    e/2 of mass times distance of its centre, its inertias by e/2 of their mean, and the rotors by
    e.  A payload of up to the stated mass is a point within `PAYLOAD_PLACE` of the tip along each
    axis.  Efforts are half a sample early or late, beside what the file states of delay and
    bandwidth.
    """
    error = arm.uncertainty.model_error or 0.0
    friction, share = chain.friction, arm.uncertainty.friction
    links = relative_factor(chain, error)
    load = _payload(chain, arm.uncertainty.largest_payload)
    inertial = np.vstack([links, load]).reshape(-1, joint_count(chain), 10)
    body = np.abs(inertial).max(2).argmax(1)
    inertial = inertial[np.arange(len(body)), body]
    counts = np.abs(inertial).max(1) > 0.0
    sensors = arm.sensors()
    return ParameterSet(
        body[counts], inertial[counts], error * chain.motor, share * np.abs(friction[:, VISCOUS]),
        share * friction[:, COULOMB], share * friction[:, LOAD],
        share * np.abs(friction[:, OFFSET]),
        RATE_BIAS * sensors.velocity_noise * sensors.independent, 0.5 * sensors.quantization,
        _delay(arm), _tolerance(arm))  # fmt: skip


def payload_generator(sizes: ParameterSet, largest: float) -> int:
    """Index of the generator of a payload's mass at the tip; -1 if no payload is stated.

    The generators behind it are those of its place, and belong to the full mass.
    """
    if largest == 0.0:
        return -1
    return len(sizes.inertial) - PAYLOAD_PARTS


def member(chain: Chain, sizes: ParameterSet, shares: FloatArray) -> Chain:
    """One arm of the set; delay and bias of the rates are not part of an arm.

    ``shares``, shape (k + 7 n,), are z of the generators, in [-1, 1]: inertial ones, rotors,
    viscous friction, Coulomb friction, its growth with load, offsets; 2 n more.  At the corners of
    the set, the arm is perhaps not physical.
    """
    n, count = joint_count(chain), len(sizes.inertial)
    inertial, friction = chain.inertial.copy(), chain.friction.copy()
    np.add.at(inertial, sizes.body, shares[:count, None] * sizes.inertial)
    parts = shares[count : count + 5 * n].reshape(5, n)
    for column, part, size in (
        (VISCOUS, parts[1], sizes.viscous),
        (COULOMB, parts[2], sizes.coulomb),
        (LOAD, parts[3], sizes.load),
        (OFFSET, parts[4], sizes.offset),
    ):
        friction[:, column] += part * size
    motor = chain.motor + parts[0][np.maximum.outer(np.arange(n), np.arange(n))] * sizes.rotor
    return chain._replace(inertial=inertial, friction=friction, motor=motor)


def heaviest(chain: Chain, sizes: ParameterSet) -> Chain:
    """The arm of the set with the largest inertias, as far as one has all of them."""
    n, count, total = joint_count(chain), len(sizes.inertial), chain.inertial.copy()
    grows = (sizes.inertial[:, [MASS, IXX, IYY, IZZ]] > 0.0).any(1)
    np.add.at(total, sizes.body[grows], sizes.inertial[grows])
    moments = slice(MX, MX + 3)
    outwards = np.sign((sizes.inertial * total[sizes.body])[:, moments].sum(1))
    shares = np.zeros(count + 7 * n)
    shares[:count], shares[count : count + n] = np.where(grows, 1.0, outwards), 1.0
    return member(chain, sizes, shares)


def _delay(arm: SerialArm) -> FloatArray:
    """Largest delays of the efforts; a low-pass filter delays by its time constant.

    Efforts are tau - d tau' + d^2/2 tau'' of a delay, tau - T tau' + T^2 tau'' of a filter.
    """
    filtered = 1.0 / (2.0 * np.pi * arm.effort_bandwidth)
    late = 0.5 * arm.sample_time + np.abs([joint.effort_delay for joint in arm.joints])
    return np.array([late + filtered, 0.5 * late**2 + late * filtered + filtered**2])


def _tolerance(arm: SerialArm) -> FloatArray:
    """Points of the joints' `TorqueTolerance`, all as many."""
    parts = [joint.torque_tolerance for joint in arm.joints]
    most = max(len(part.speed) for part in parts)
    result = np.empty((len(parts), 2, most))
    for row, part in zip(result, parts):
        row[0] = np.pad(part.speed, (0, most - len(part.speed)), 'edge')
        row[1] = np.pad(part.torque, (0, most - len(part.torque)), 'edge')
    return result


def _payload(chain: Chain, mass: float) -> FloatArray:
    """Generators of a point mass near the tip, shape (10, 10 n)."""
    n = joint_count(chain)
    result = np.zeros((10, n, 10))
    if mass == 0.0:
        return result.reshape(10, -1)
    at_tip = payload_parameters(chain, mass)
    reach = np.abs(at_tip[1:4]) / mass
    result[0, -1] = at_tip
    for k in range(3):
        result[1 + k, -1, 1 + k] = mass * PAYLOAD_PLACE
    # Changes of m (p + d)^2 for abs(d) <= PAYLOAD_PLACE: xx, xy, yy, xz, yz, zz.
    square = mass * (2.0 * reach * PAYLOAD_PLACE + PAYLOAD_PLACE**2)
    mixed = mass * np.array([
        PAYLOAD_PLACE * (reach[a] + reach[b] + PAYLOAD_PLACE) for a, b in ((0, 1), (0, 2), (1, 2))
    ])  # fmt: skip
    x, y, z = square
    sizes = (y + z, mixed[0], x + z, mixed[1], mixed[2], x + y)
    for k, size in enumerate(sizes):
        result[4 + k, -1, 4 + k] = size
    return result.reshape(10, -1)
