"""The compiled serial chain: arrays that every function of the dynamics takes.

Joint i turns about the z axis of its own frame, or moves along it.  A body's inertial parameters
are those of the regressor, in Pinocchio's order: mass, first moment m*c, inertia about the frame's
origin.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.description import N_INERTIAL, SerialArm, rotation_from_rpy
from lpv.core.support.errors import ConfigError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

MAX_JOINTS = 32
"""Longest chain that is accepted; sizes from files are bounded before anything is allocated."""
MASS, MX, MY, MZ, IXX, IXY, IYY, IXZ, IYZ, IZZ = range(10)
"""Columns of `Chain.inertial`."""
VISCOUS, COULOMB, LOAD, OFFSET, SLOPE = range(5)
"""Columns of `Chain.friction`."""
N_FRICTION = SLOPE + 1
WORK_COLUMNS = 43
"""Columns of the scratch array of `workspace`."""
PLACE = 40
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


def make_chain(
    rotation: npt.ArrayLike,
    translation: npt.ArrayLike,
    inertial: npt.ArrayLike,
    motor: npt.ArrayLike | None = None,
    friction: npt.ArrayLike | None = None,
    gravity: npt.ArrayLike = (0.0, 0.0, -9.81),
    tip: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    prismatic: npt.ArrayLike | None = None,
) -> Chain:
    """Chain from inline parameters.

    Parameters
    ----------
    rotation, translation, inertial : array_like
        As the attributes of `Chain`.
    motor : array_like, shape (n,) or (n, n), optional
        Reflected inertias of the rotors, or the matrix with their couplings [kg m2].
    friction : array_like, shape (n, 5), optional
        As `Chain.friction`; none by default.
    gravity : array_like, shape (3,), optional
        In the base frame [m/s2].
    tip : tuple of array_like, optional
        Orientation (3, 3) and origin (3,) of the tip in the last joint frame.
    prismatic : array_like of bool, shape (n,), optional
        As `Chain.prismatic`; all joints are revolute by default.

    Returns
    -------
    Chain
        Of checked, contiguous copies.

    Raises
    ------
    ConfigError
        If a shape, a value or a rotation is invalid; it names the field.
    """
    count = np.shape(translation)[0] if np.ndim(translation) == 2 else 0
    if not 1 <= count <= MAX_JOINTS:
        raise ConfigError('translation', f'must have 1 to {MAX_JOINTS} rows of 3 numbers')
    motor = np.zeros((count, count)) if motor is None else np.asarray(motor, float)
    tip_rotation, tip_translation = (np.eye(3), np.zeros(3)) if tip is None else tip
    if friction is None:
        friction = np.tile([0.0, 0.0, 0.0, 0.0, 100.0], (count, 1))
    chain = Chain(
        _array('rotation', rotation, (count, 3, 3)),
        _array('translation', translation, (count, 3)),
        _array('inertial', inertial, (count, N_INERTIAL)),
        _array('motor', np.diag(motor) if motor.ndim == 1 else motor, (count, count)),
        _array('friction', friction, (count, N_FRICTION)),
        _array('gravity', gravity, (3,)),
        _array('tip_rotation', tip_rotation, (3, 3)),
        _array('tip_translation', tip_translation, (3,)),
        _array('prismatic', [0.0] * count if prismatic is None else prismatic, (count,)) != 0.0,
    )
    for name, matrices in (
        ('rotation', chain.rotation),
        ('tip_rotation', chain.tip_rotation[None]),
    ):
        for i, matrix in enumerate(matrices):
            if not is_rotation(matrix):
                raise ConfigError(f'{name}[{i}]', 'must be a rotation matrix')
    if not np.allclose(chain.motor, chain.motor.T, rtol=1e-9, atol=1e-12):
        raise ConfigError('motor', 'must be symmetric')
    return chain


def _array(name: str, values: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """A checked copy."""
    try:
        array = np.array(values, dtype=float, order='C')
    except (TypeError, ValueError) as error:
        raise ConfigError(name, f'must hold numbers ({error})') from error
    if array.shape != shape:
        raise ConfigError(name, f'must have shape {shape}, got {array.shape}')
    if not np.isfinite(array).all():
        raise ConfigError(name, 'must be finite')
    return array


def is_rotation(matrix: FloatArray) -> bool:
    """Whether a matrix is orthogonal with determinant 1, within 1e-6."""
    return bool(
        np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-6)
        and np.linalg.det(matrix) > 0.0
    )


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
    tip = before.T, before.T @ np.array(arm.tip)
    return make_chain(
        rotations,
        translations,
        bodies,
        motor,
        friction,
        arm.gravity_vector(),
        tip,
        [joint.is_prismatic for joint in arm.joints],
    )


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
    """Inertial parameters of a body about a frame's origin.

    Parameters
    ----------
    mass : float
        [kg].
    center : array_like, shape (3,)
        Centre of mass [m].
    inertia : array_like, shape (3, 3)
        About the centre of mass, along the frame's axes [kg m2].

    Returns
    -------
    ndarray, shape (10,)
        As a row of `Chain.inertial`.
    """
    c = np.asarray(center, float)
    about = np.asarray(inertia, float) + mass * (c @ c * np.eye(3) - np.outer(c, c))
    ixx, ixy, iyy = about[0, 0], about[0, 1], about[1, 1]
    return np.array([mass, *(mass * c), ixx, ixy, iyy, about[0, 2], about[1, 2], about[2, 2]])


def moved_body(body: FloatArray, rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Inertial parameters of a body in the frame that its own frame is placed in.

    Parameters
    ----------
    body : ndarray, shape (10,)
        In its own frame.
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        Placement of that frame in the other one.

    Returns
    -------
    ndarray, shape (10,)
        The same body, in the other frame.
    """
    mass, p = body[MASS], translation
    moment = rotation @ body[MX:IXX]
    ixx, ixy, iyy, ixz, iyz, izz = body[IXX:]
    inertia = rotation @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ rotation.T
    cross = np.outer(moment, p)
    inertia += (2.0 * (p @ moment) + mass * (p @ p)) * np.eye(3)
    inertia -= cross + cross.T + mass * np.outer(p, p)
    ixx, ixy, iyy = inertia[0, 0], inertia[0, 1], inertia[1, 1]
    moment = moment + mass * p
    return np.array([mass, *moment, ixx, ixy, iyy, inertia[0, 2], inertia[1, 2], inertia[2, 2]])
