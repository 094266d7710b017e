"""A serial arm as an MJCF model, the file format of MuJoCo.

World frame: the base frame of the arm.  Joint positions are those of the arm.  Friction and drives
are left to the program that runs the model.
"""

from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from lpv.core.export.elements import add_element
from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.serial_arm.description import LinkInertia
from lpv.core.support.errors import ConfigError

_THINNEST = 1e-9
"""Least moment of inertia of a link, over the sum of all three: MuJoCo takes no ideal rods."""


def chain_mjcf(chain: Chain) -> str:
    """Write a serial arm as MJCF, without friction, drives, contacts and shapes.

    ConfigError if a link has no mass, or a rotor that couples joints no inertia.
    """
    armature, rotors = _rotors(chain)
    root = ElementTree.Element('mujoco', model='arm')
    add_element(root, 'compiler', angle='radian', autolimits='true')
    option = add_element(root, 'option', integrator='RK4', timestep=1e-3, gravity=chain.gravity)
    add_element(option, 'flag', contact='disable')
    parent = add_element(root, 'worldbody')
    for i in range(len(chain.translation)):
        x, y, z, w = Rotation.from_matrix(chain.rotation[i]).as_quat()
        parent = add_element(
            parent, 'body', name=f'link{i + 1}', pos=chain.translation[i], quat=(w, x, y, z)
        )
        add_element(
            parent,
            'joint',
            name=f'joint{i + 1}',
            type='slide' if chain.prismatic[i] else 'hinge',
            axis=(0.0, 0.0, 1.0),
            armature=armature[i],
        )
        _add_inertia(parent, chain.inertial[i], i)
    tendons = add_element(root, 'tendon') if rotors else None
    for i, inertia, ratio in rotors:
        assert tendons is not None
        tendon = add_element(tendons, 'fixed', name=f'rotor{i + 1}', armature=inertia)
        add_element(tendon, 'joint', joint=f'joint{i}', coef=1.0)
        add_element(tendon, 'joint', joint=f'joint{i + 1}', coef=-ratio)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def _rotors(chain: Chain) -> tuple[FloatArray, list[tuple[int, float, float]]]:
    """Armatures of the joints; joint, inertia and gear ratio of each rotor that spins with a link.

    Such a rotor turns at q_(i-1)' - r q_i', which is the armature of a tendon.
    """
    armature, rotors = np.diag(chain.motor).copy(), []
    for i in range(1, len(armature)):
        coupling, reflected = chain.motor[i - 1, i], chain.motor[i, i]
        if coupling != 0.0:
            if reflected == 0.0:
                raise ConfigError(f'motor[{i}]', 'must have the inertia of its rotor for MuJoCo')
            rotors.append((i, float(coupling**2 / reflected), float(-reflected / coupling)))
            armature[i - 1] -= coupling**2 / reflected
            armature[i] -= reflected
    return armature, rotors


def _add_inertia(parent: ElementTree.Element, body: FloatArray, i: int) -> None:
    link = LinkInertia.from_vector(body)
    if not link.mass > 0.0:
        raise ConfigError(f'inertial[{i}]', 'must have a mass for MuJoCo')
    about = link.about_center()
    about += max(_THINNEST * np.trace(about) - np.linalg.eigvalsh(about)[0], 0.0) * np.eye(3)
    entries = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    add_element(parent, 'inertial', pos=link.center(), mass=link.mass, fullinertia=entries)
