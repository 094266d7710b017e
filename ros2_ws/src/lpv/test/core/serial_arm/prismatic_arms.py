"""Arms with prismatic joints: a SCARA, a large arm on a linear axis, nine mixed joints."""

from dataclasses import replace

import numpy as np

from lpv.core.serial_arm import description as parts
from lpv.files import load_arm

UPRIGHT = (0.0, 0.0, 0.0)
# Place and orientation of the frame, axis, mass, centre of mass, limits of position, rate, torque.
RAIL = ('rail', (0.0, 0.0, 0.4), UPRIGHT, (1.0, 0.0, 0.0), 60.0, (0.0, 0.0, 0.1),
        (-2.0, 2.0), 1.5, 1500.0, 'prismatic')  # fmt: skip
SCARA = (
    ('turn_1', (0.0, 0.0, 0.3), UPRIGHT, (0.0, 0.0, 1.0), 8.0, (0.15, 0.0, 0.0),
     (-2.5, 2.5), 4.0, 150.0, 'revolute'),
    ('turn_2', (0.35, 0.0, 0.0), UPRIGHT, (0.0, 0.0, 1.0), 5.0, (0.12, 0.0, 0.0),
     (-2.5, 2.5), 5.0, 80.0, 'revolute'),
    ('lift', (0.3, 0.0, -0.05), UPRIGHT, (0.0, 0.0, 1.0), 1.5, (0.0, 0.02, -0.1),
     (-0.2, 0.0), 0.8, 120.0, 'prismatic'),
    ('turn_3', (0.0, 0.0, -0.02), UPRIGHT, (0.0, 0.0, -1.0), 0.5, (0.01, 0.0, 0.0),
     (-3.1, 3.1), 8.0, 10.0, 'revolute'),
)  # fmt: skip


def _joint(name, place, rpy, axis, mass, center, span, rate, torque, kind):
    center, size = np.array(center), 0.02 * mass * np.diag([1.0, 0.8, 0.6])
    about = size + mass * (center @ center * np.eye(3) - np.outer(center, center))
    inertia = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    slides = kind == 'prismatic'
    return parts.SerialJoint(
        name, place, rpy, axis, parts.LinkInertia.from_vector([mass, *(mass * center), *inertia]),
        parts.JointFriction(viscous=20.0 if slides else 0.5, coulomb=15.0 if slides else 0.5,
                      coulomb_slope=100.0),
        rotor_inertia=5.0 if slides else 0.05, limits=parts.JointLimits(*span, rate, torque),
        sensors=parts.JointSensors(f'{name}_encoder', 2e-5 if slides else 5e-5, 0.0, 'derived'),
        type=kind)  # fmt: skip


def _floats(values):
    return tuple(float(value) for value in values)


def arm_of(name: str, rows: tuple, tip: tuple[float, float, float]) -> parts.SerialArm:
    """An arm of joints that are described by rows as above."""
    joints = tuple(_joint(*row) for row in rows)
    return parts.SerialArm(name, joints, tip=tip, uncertainty=parts.Uncertainty(0.5, 0.3))


def scara() -> parts.SerialArm:
    """Joints RRPR: the quill turns below its slide."""
    return arm_of('scara', SCARA, (0.05, 0.0, -0.15))


def ur10_on_rail() -> parts.SerialArm:
    """The shipped UR10 on a horizontal rail, without its last joint: its compiled code serves."""
    arm = load_arm('ur10')
    own = {'name': 'ur10_on_rail', 'covariance': None, 'urdf': '', 'locked': ()}
    joints = (_joint(*RAIL), *arm.joints[:-1])
    return replace(arm, joints=joints, uncertainty=parts.Uncertainty(0.5, 0.3), **own)


def mixed_arm(seed: int = 9, joints: int = 9) -> parts.SerialArm:
    """Joints of both types in any direction."""
    rng, rows = np.random.default_rng(seed), []
    for i in range(joints):
        axis, turn = rng.normal(size=3), _floats(rng.uniform(-3.0, 3.0, 3))
        kind = ('revolute', 'prismatic')[i % 3 == 1]
        span = (-0.5, 0.6) if kind == 'prismatic' else (-2.0, 2.0)
        rows.append((f'joint{i + 1}', _floats(rng.uniform(-0.4, 0.4, 3)),
                     turn, _floats(axis / np.linalg.norm(axis)),
                     float(rng.uniform(0.5, 8.0)), _floats(rng.uniform(-0.2, 0.2, 3)), span, 2.0,
                     500.0, kind))  # fmt: skip
    return arm_of('mixed', tuple(rows), (0.1, 0.0, 0.2))


def middle(arm: parts.SerialArm) -> np.ndarray:
    """Positions in the middle of the joints' ranges."""
    return np.array([0.5 * sum(joint.range) for joint in arm.joints])
