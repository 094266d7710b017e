"""Arms, motions and recordings that the tests share."""

import numpy as np
import pytest
from simulated_recordings import SensorNoise, simulate

from lpv.core.serial_arm import description as model
from lpv.identify.estimation.assembly import with_joint_values
from lpv.identify.estimation.identification import identify
from lpv.identify.motions import random_trajectory


def joint(name, position, axis, mass, center):
    """A joint whose link is a ball of 0.1 m around a centre."""
    c = np.array(center)
    inertia = mass * (0.004 * np.eye(3) + c @ c * np.eye(3) - np.outer(c, c))
    link = model.LinkInertia.from_vector([mass, *mass * c, *inertia[np.tril_indices(3)]])
    friction, limits = (0.2, 1.0, 1.5, 40.0), (-2.5, 2.5, 3.0, 100.0)
    return model.SerialJoint(
        name, position, (0.0, 0.0, 0.0), axis, link, model.JointFriction(*friction), 0.1,
        limits=model.JointLimits(*limits), sensors=model.JointSensors(f'{name}_encoder'),
    )  # fmt: skip


@pytest.fixture(scope='session')
def arm():
    """Three joints about z, y and y."""
    joints = (
        joint('one', (0.0, 0.0, 0.2), (0.0, 0.0, 1.0), 4.0, (0.05, 0.0, 0.1)),
        joint('two', (0.0, 0.1, 0.0), (0.0, 1.0, 0.0), 3.0, (0.2, 0.02, 0.0)),
        joint('three', (0.4, 0.0, 0.0), (0.0, 1.0, 0.0), 1.5, (0.15, 0.0, 0.03)),
    )
    return model.SerialArm('three', joints, tip=(0.3, 0.0, 0.0))


@pytest.fixture(scope='session')
def motion():
    center, reach, speed = np.zeros(3), np.full(3, 1.5), np.full(3, 1.8)
    return random_trajectory(np.random.default_rng(4), center, reach, speed, 20.0)


@pytest.fixture(scope='session')
def simulated(motion):
    def record(arm, seed=1, rate=100.0, motion=motion, **noise):
        return simulate(arm, motion, rate, SensorNoise(**noise), np.random.default_rng(seed))

    return record


@pytest.fixture(scope='session')
def recording(arm, simulated):
    return simulated(arm)


@pytest.fixture(scope='session')
def rough_arm(arm):
    """The arm as a URDF may have it: without friction, and with masses that are 20 % too large."""
    links = [model.LinkInertia.from_vector(1.2 * j.link.to_vector()) for j in arm.joints]
    bare = {'friction': [model.JointFriction()] * 3, 'rotor_inertia': [0.0] * 3}
    return with_joint_values(arm, link=links, **bare)


@pytest.fixture(scope='session')
def result(rough_arm, recording):
    return identify(rough_arm, [recording])
