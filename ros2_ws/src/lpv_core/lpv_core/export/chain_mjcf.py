"""A serial arm as an MJCF model, the file format of MuJoCo.

World frame: the base frame of the arm.  Joint positions are those of the arm.  Friction and drives
are left to the program that runs the model.
"""

import xml.etree.ElementTree as ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from lpv_core.export.mjcf import add_element
from lpv_core.serial_arm.chain import IXX, MASS, MX, Chain, FloatArray
from lpv_core.support.errors import ConfigError


def chain_mjcf(chain: Chain) -> str:
    """Write a serial arm as MJCF, without friction, drives, contacts and shapes.

    Parameters
    ----------
    chain : Chain
        The arm.

    Returns
    -------
    str
        XML.

    Raises
    ------
    ConfigError
        If rotors are coupled, or a link has no mass.
    """
    if np.any(chain.motor != np.diag(np.diag(chain.motor))):
        raise ConfigError('motor', 'must not be coupled for MuJoCo')
    root = ElementTree.Element('mujoco', model='arm')
    add_element(root, 'compiler', angle='radian', autolimits='true')
    option = add_element(
        root, 'option', integrator='RK4', timestep=1e-3, gravity=tuple(chain.gravity)
    )
    add_element(option, 'flag', contact='disable')
    parent = add_element(root, 'worldbody')
    for i in range(len(chain.translation)):
        x, y, z, w = Rotation.from_matrix(chain.rotation[i]).as_quat()
        parent = add_element(
            parent, 'body', name=f'link{i + 1}', pos=tuple(chain.translation[i]), quat=(w, x, y, z)
        )
        add_element(
            parent,
            'joint',
            name=f'joint{i + 1}',
            type='slide' if chain.prismatic[i] else 'hinge',
            axis=(0.0, 0.0, 1.0),
            armature=chain.motor[i, i],
        )
        _add_inertia(parent, chain.inertial[i], i)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding='unicode') + '\n'


def _add_inertia(parent: ElementTree.Element, body: FloatArray, i: int) -> None:
    mass = float(body[MASS])
    if not mass > 0.0:
        raise ConfigError(f'inertial[{i}]', 'must have a mass for MuJoCo')
    center = body[MX:IXX] / mass
    xx, xy, yy, xz, yz, zz = body[IXX:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    about -= mass * (center @ center * np.eye(3) - np.outer(center, center))
    entries = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    add_element(parent, 'inertial', pos=tuple(center), mass=mass, fullinertia=tuple(entries))
