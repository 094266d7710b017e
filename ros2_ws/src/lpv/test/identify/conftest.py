"""Arms, motions and recordings that the tests share."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_recordings import SensorNoise, simulate

from lpv.core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
)
from lpv.identify.estimation.identification import identify
from lpv.identify.motions.trajectory import Trajectory, random_trajectory
from lpv.identify.recordings.recording import Recording


def link(mass: float, center: tuple[float, float, float]) -> LinkInertia:
    """A ball of 0.1 m around a centre."""
    c = np.array(center)
    inertia = mass * (0.004 * np.eye(3) + c @ c * np.eye(3) - np.outer(c, c))
    return LinkInertia.from_vector(
        np.concatenate([[mass], mass * c, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
    )


@pytest.fixture(scope='session')
def arm() -> SerialArm:
    """Three joints about z, y and y."""
    limits = JointLimits(-2.5, 2.5, 3.0, 100.0)
    friction = JointFriction(0.2, 1.0, 1.5, 40.0)
    parts = [
        ('one', (0.0, 0.0, 0.2), (0.0, 0.0, 1.0), link(4.0, (0.05, 0.0, 0.1))),
        ('two', (0.0, 0.1, 0.0), (0.0, 1.0, 0.0), link(3.0, (0.2, 0.02, 0.0))),
        ('three', (0.4, 0.0, 0.0), (0.0, 1.0, 0.0), link(1.5, (0.15, 0.0, 0.03))),
    ]
    joints = []
    for name, position, axis, body in parts:
        sensors = JointSensors(f'{name}_encoder')
        given = name, position, (0.0, 0.0, 0.0), axis, body, friction, 0.1
        joints.append(SerialJoint(*given, limits=limits, sensors=sensors))
    return SerialArm('three', tuple(joints), tip=(0.3, 0.0, 0.0))


@pytest.fixture(scope='session')
def motion(arm) -> Trajectory:
    rng = np.random.default_rng(4)
    n = len(arm.joints)
    return random_trajectory(rng, np.zeros(n), np.full(n, 1.5), np.full(n, 1.8), 20.0)


@pytest.fixture(scope='session')
def simulated(motion):
    """Records an arm on a motion, with noise of a seed."""

    def record(arm, seed=1, rate=100.0, motion=motion, **noise):
        return simulate(arm, motion, rate, SensorNoise(**noise), np.random.default_rng(seed))

    return record


@pytest.fixture(scope='session')
def recording(arm, simulated) -> Recording:
    return simulated(arm)


@pytest.fixture(scope='session')
def rough():
    """Makes the masses of an arm 20 % too large, and other changes of its joints."""

    def change(arm, **changes):
        links = [LinkInertia.from_vector(1.2 * joint.link.to_vector()) for joint in arm.joints]
        pairs = zip(arm.joints, links)
        return replace(arm, joints=tuple(replace(j, link=link, **changes) for j, link in pairs))

    return change


@pytest.fixture(scope='session')
def rough_arm(arm, rough) -> SerialArm:
    """The arm as a URDF may have it: without friction."""
    return rough(arm, friction=JointFriction(), rotor_inertia=0.0)


@pytest.fixture(scope='session')
def result(rough_arm, recording):
    return identify(rough_arm, [recording])
