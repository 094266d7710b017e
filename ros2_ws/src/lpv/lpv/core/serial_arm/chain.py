"""The compiled serial chain: arrays that every function of the dynamics takes.

Joint i turns about the z axis of its own frame, or moves along it.  A body's inertial parameters
are those of the regressor, in Pinocchio's order: mass, first moment m*c, inertia about the frame's
origin.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.description import SerialArm, inertia_matrix, rotation_from_rpy
from lpv.core.support.errors import ConfigError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MAX_JOINTS = 32
"""Longest chain that is accepted; sizes from files are bounded before anything is allocated."""
_ENTRIES = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
"""Where an inertia has the entries that `inertia_matrix` makes it of."""
MASS, MX, MY, MZ, IXX, IXY, IYY, IXZ, IYZ, IZZ = range(10)
"""Columns of `Chain.inertial`."""
VISCOUS, COULOMB, LOAD, OFFSET, SLOPE = range(5)
"""Columns of `Chain.friction`."""
WORK_COLUMNS = 22
"""Columns of the scratch array of `workspace`."""
PLACE = 19
"""First of its columns with the origin of frame i in frame i-1 [m]."""


class Chain(NamedTuple):
    """A serial chain of n joints; arrays float64 but the last, C-contiguous."""

    # orientation of joint frame i in frame i-1 (the base for i = 0) at q_i = 0, shape (n, 3, 3)
    rotation: FloatArray
    translation: FloatArray  # origin of joint frame i in frame i-1, shape (n, 3) [m]
    # m [kg], m*c [kg m], and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of frame i [kg m2],
    # shape (n, 10)
    inertial: FloatArray
    # constant inertia of rotors and their couplings, added to M(q), shape (n, n) [kg m2]
    motor: FloatArray
    # viscous [N m s], Coulomb [N m], load-dependent Coulomb [-], torque offset [N m], slope of the
    # smoothed sign [s/rad], shape (n, 5)
    friction: FloatArray
    gravity: FloatArray  # acceleration of free fall in the base frame, shape (3,) [m/s2]
    tip_rotation: FloatArray  # orientation of the tip in the last joint frame, shape (3, 3)
    tip_translation: FloatArray  # origin of the tip in the last joint frame, shape (3,) [m]
    prismatic: BoolArray  # which joints move along z instead of turning about it, shape (n,)


def joint_count(chain: Chain) -> int:
    """Number of joints n."""
    return chain.translation.shape[0]


def workspace(chain: Chain) -> FloatArray:
    """Scratch memory of the compiled functions; one for each thread that calls them."""
    return np.zeros((joint_count(chain), WORK_COLUMNS))


def compile_chain(arm: SerialArm) -> Chain:
    """Chain of a described arm.

    Parameters
    ----------
    arm : SerialArm
        The arm; its axes may point anywhere in the joints' frames.

    Returns
    -------
    Chain
        Its frames are the joints' frames, turned so that z is the axis.

    Raises
    ------
    ConfigError
        If a value is not finite or an axis has no direction.
    """
    if not 1 <= len(arm.joints) <= MAX_JOINTS:
        raise ConfigError('joints', f'must be 1 to {MAX_JOINTS}', arm.name)
    rotations, translations, bodies = [], [], []
    before = np.eye(3)
    for joint in arm.joints:
        frame = axis_frame(np.array(joint.axis, dtype=float))
        rotations.append(before.T @ rotation_from_rpy(joint.orientation) @ frame)
        translations.append(before.T @ np.array(joint.position))
        bodies.append(moved_body(joint.link.to_vector(), frame.T, np.zeros(3)))
        before = frame
    friction = [
        [f.viscous, f.coulomb, f.load, f.offset, f.coulomb_slope]
        for f in (joint.friction for joint in arm.joints)
    ]
    motor = np.diag([joint.rotor_inertia for joint in arm.joints])
    for i, joint in enumerate(arm.joints[1:], 1):
        motor[i, i - 1] = motor[i - 1, i] = joint.rotor_coupling
    parts = (rotations, translations, bodies, motor, friction, arm.gravity_vector(), before.T,
             before.T @ np.array(arm.tip))  # fmt: skip
    arrays = {
        name: np.array(part, dtype=float, order='C') for name, part in zip(Chain._fields, parts)
    }
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ConfigError(name, 'must be finite', arm.name)
    return Chain(**arrays, prismatic=np.array([joint.is_prismatic for joint in arm.joints]))


def axis_frame(axis: FloatArray) -> FloatArray:
    """Rotation whose third column points along an axis; the identity for z.

    Raises
    ------
    ConfigError
        If the axis has no direction.
    """
    length = float(np.linalg.norm(axis))
    if not 1e-6 < length < np.inf:
        raise ConfigError('axis', 'must have a direction')
    axis = axis / length
    if axis[2] > 0.0 and not axis[:2].any():
        return np.eye(3)
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(axis)))] = 1.0
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def body_parameters(mass: float, center: npt.ArrayLike, inertia: npt.ArrayLike) -> FloatArray:
    """Inertial parameters of a body about a frame's origin, as a row of `Chain.inertial`.

    ``mass`` is in [kg], ``center`` of mass, shape (3,), in [m]; ``inertia``, shape (3, 3), is about
    it, along the frame's axes [kg m2].
    """
    own = np.array([mass, 0.0, 0.0, 0.0, *np.asarray(inertia, float)[_ENTRIES]])
    return moved_body(own, np.eye(3), np.asarray(center, float))


def moved_body(body: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Inertial parameters of a body, shape (10,), in the frame that its own frame is placed in.

    ``body``, shape (10,), has them in its own frame; ``rotation`` and ``translation``, shapes
    (3, 3) and (3,), place that in the other one [m].
    """
    mass, p = body[MASS], translation
    moment = rotation @ body[MX:IXX]
    inertia = rotation @ inertia_matrix(body[IXX:]) @ rotation.T
    cross = np.outer(moment, p)
    inertia += (2.0 * (p @ moment) + mass * (p @ p)) * np.eye(3)
    inertia -= cross + cross.T + mass * np.outer(p, p)
    return np.array([mass, *(moment + mass * p), *inertia[_ENTRIES]])
