"""Random serial chains, and the same arms in Pinocchio."""

import numpy as np
import pinocchio

from lpv.core.serial_arm.chain import Chain, body_parameters, make_chain
from lpv.core.serial_arm.description import rotation_from_rpy


def random_chain(seed: int, joints: int) -> Chain:
    """Physical bodies of any shape, joints of any type and direction, a base in any orientation."""
    rng = np.random.default_rng(seed)
    rotation = [rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)) for _ in range(joints)]
    bodies = []
    for _ in range(joints):
        lengths = rng.uniform(0.02, 0.5, 3)
        mass, spread = rng.uniform(0.1, 20.0), lengths**2
        turn = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3))
        inertia = turn @ np.diag(mass / 12 * (spread.sum() - spread)) @ turn.T
        bodies.append(body_parameters(mass, rng.uniform(-0.4, 0.4, 3), inertia))
    tip = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)), rng.uniform(-0.3, 0.3, 3)
    direction = rng.normal(size=3)
    gravity = 9.81 * direction / np.linalg.norm(direction)
    return make_chain(
        rotation,
        rng.uniform(-0.7, 0.7, (joints, 3)),
        bodies,
        rng.uniform(0.0, 0.5, joints),
        gravity=gravity,
        tip=tip,
        prismatic=rng.integers(0, 2, joints),
    )


def pinocchio_model(chain: Chain) -> pinocchio.Model:
    """The same arm, built body by body."""
    model = pinocchio.Model()
    for i in range(len(chain.translation)):
        place = pinocchio.SE3(chain.rotation[i], chain.translation[i])
        joint = pinocchio.JointModelPZ if chain.prismatic[i] else pinocchio.JointModelRZ
        model.addJoint(i, joint(), place, f'joint{i}')
        body = pinocchio.Inertia.FromDynamicParameters(chain.inertial[i])
        model.appendBodyToJoint(i + 1, body, pinocchio.SE3.Identity())
    model.armature = np.diag(chain.motor).copy()
    model.gravity.linear = chain.gravity
    return model


def random_motion(seed: int, joints: int) -> np.ndarray:
    """Positions, rates and accelerations, shape (3, n)."""
    scale = np.array([[3.0], [2.0], [5.0]])
    return scale * np.random.default_rng(seed).uniform(-1.0, 1.0, (3, joints))
