"""Where the tip is, how it moves, and which joint positions bring it somewhere.

Frames as of `Chain`; poses are those of the tip in the base frame.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import Chain, FloatArray, joint_count
from lpv.core.serial_arm.dynamics.frames import cross, plus, read, write
from lpv.core.serial_arm.dynamics.momentum import solve_positive
from lpv.core.support.jit import njit

_MAX_STEP = 0.5
"""Largest change of a joint in one iteration of the inverse kinematics, within which the Jacobian
is right to an eighth [rad], [m]."""
_ORIENTATION_WEIGHT = 0.3
"""Length that weighs errors of orientation against those of position [m/rad]."""


@njit
def joint_frames(chain: Chain, q: FloatArray, rotations: FloatArray, origins: FloatArray) -> None:
    """Orientation, (n + 1, 3, 3), and origin, (n + 1, 3) [m], of all joint frames and of the tip.

    Both are written, in the base frame.
    """
    n = q.shape[0]
    for i in range(n + 1):
        local = chain.rotation[i] if i < n else chain.tip_rotation
        place = chain.translation[i] if i < n else chain.tip_translation
        turned, way = 0.0, 0.0
        if i < n:
            turned, way = (0.0, q[i]) if chain.prismatic[i] else (q[i], 0.0)
        c, s = np.cos(turned), np.sin(turned)
        for row in range(3):
            origins[i, row] = 0.0
            write(rotations[i], row, 0, (0.0, 0.0, 0.0))
        for k in range(3):
            # Row k of R_i0 Rz(q_i).
            x, y, z = read(local, k, 0)
            x, y = c * x + s * y, c * y - s * x
            for row in range(3):
                outer = rotations[i - 1, row, k] if i > 0 else (1.0 if row == k else 0.0)
                write(rotations[i], row, 0, plus(read(rotations[i], row, 0), (x, y, z), outer))
                origins[i, row] += outer * (place[k] + way * z)
        if i > 0:
            write(origins, i, 0, plus(read(origins, i, 0), read(origins, i - 1, 0)))


@njit
def fill_jacobian(
    chain: Chain, rotations: FloatArray, origins: FloatArray, jacobian: FloatArray
) -> None:
    """Jacobian of the tip, (6, n), from what `joint_frames` has written.

    Rows 0 to 2 are linear [m/s per rad/s], 3 to 5 angular, in the base frame.
    """
    n = jacobian.shape[1]
    for i in range(n):
        axis = rotations[i, 0, 2], rotations[i, 1, 2], rotations[i, 2, 2]
        linear, angular = cross(axis, plus(read(origins, n, 0), read(origins, i, 0), -1.0)), axis
        if chain.prismatic[i]:
            linear, angular = axis, (0.0, 0.0, 0.0)
        jacobian[0, i], jacobian[1, i], jacobian[2, i] = linear
        jacobian[3, i], jacobian[4, i], jacobian[5, i] = angular


def _frames(chain: Chain, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """What `joint_frames` writes."""
    n = joint_count(chain)
    rotations, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    joint_frames(chain, np.ascontiguousarray(q, dtype=float), rotations, origins)
    return rotations, origins


def forward_kinematics(chain: Chain, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Orientation, shape (3, 3), and position, shape (3,) [m], of the tip in the base frame."""
    rotations, origins = _frames(chain, q)
    return rotations[-1], origins[-1]


def jacobian(chain: Chain, q: npt.ArrayLike) -> FloatArray:
    """Jacobian of the tip, shape (6, n): linear rows first, in the base frame."""
    matrix = np.empty((6, joint_count(chain)))
    fill_jacobian(chain, *_frames(chain, q), matrix)
    return matrix


class InverseKinematics(NamedTuple):
    """Answer of `inverse_kinematics`."""

    # joint positions [rad]; the closest found where the pose is out of reach, shape (n,)
    q: FloatArray
    reached: bool  # whether the pose is met within the tolerances
    position_error: float  # distance of the tip [m]
    orientation_error: float  # angle of the tip [rad]; 0 where no orientation was asked for
    manipulability: float  # smallest singular value of the task's Jacobian; near 0 at a singularity


def _pose_error(
    chain: Chain, q: FloatArray, target: tuple[FloatArray, FloatArray | None]
) -> tuple[FloatArray, FloatArray]:
    """Weighted error of the pose, and the Jacobian of the task with the same weights."""
    (position, orientation), matrix = target, jacobian(chain, q)
    rotation, origin = forward_kinematics(chain, q)
    if orientation is None:
        return position - origin, matrix[:3]
    matrix[3:] *= _ORIENTATION_WEIGHT
    turn = _ORIENTATION_WEIGHT * rotation_vector(orientation @ rotation.T)
    return np.append(position - origin, turn), matrix


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Axis times angle of a rotation matrix, shape (3,) [rad]; angles up to pi."""
    from scipy.spatial.transform import Rotation  # here: few paths have orientations

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def inverse_kinematics(
    chain: Chain,
    position: npt.ArrayLike,
    orientation: npt.ArrayLike | None,
    start: npt.ArrayLike,
    limits: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    tolerance: float = 1e-6,
    iterations: int = 200,
) -> InverseKinematics:
    """Joint positions for a pose, by damped least squares (Levenberg-Marquardt).

    The damping grows where a step does not reduce the error, as at a singularity or out of reach:
    steps stay bounded, and what remains is reported instead of raised.

    Parameters
    ----------
    chain : Chain
        The arm.
    position : array_like, shape (3,)
        Of the tip [m].
    orientation : array_like, shape (3, 3) or None
        Of the tip; None where any will do.
    start : array_like, shape (n,)
        Where the search begins [rad]; the answer is close to it.
    limits : tuple of array_like, optional
        Lowest and highest joint positions [rad].
    tolerance : float, optional
        Largest weighted error of a pose that counts as reached [m].
    iterations : int, optional
        At most so many steps.

    Returns
    -------
    InverseKinematics
        The closest joint positions that were found.
    """
    place = np.asarray(position, float)
    turn = None if orientation is None else np.asarray(orientation, float)
    low, high = (-np.inf, np.inf) if limits is None else limits
    q = np.clip(np.array(start, dtype=float), low, high)
    error, matrix = _pose_error(chain, q, (place, turn))
    damping = 1e-4
    for _ in range(iterations):
        if np.linalg.norm(error) < tolerance or damping > 1e8:
            break
        push = matrix.T @ error
        # A joint that would leave its limits leaves the step to the others.
        held = ((q <= low) & (push < 0.0)) | ((q >= high) & (push > 0.0))
        step = _damped_step(np.where(held, 0.0, matrix), error, damping)
        trial = np.clip(q + step, low, high)
        trial_error, trial_matrix = _pose_error(chain, trial, (place, turn))
        if np.linalg.norm(trial_error) < np.linalg.norm(error):
            q, error, matrix, damping = trial, trial_error, trial_matrix, max(0.2 * damping, 1e-9)
        else:
            damping *= 8.0
    angle = float(np.linalg.norm(error[3:])) / _ORIENTATION_WEIGHT
    return InverseKinematics(
        q,
        bool(np.linalg.norm(error) < tolerance),
        float(np.linalg.norm(error[:3])),
        angle,
        float(np.linalg.svd(matrix, compute_uv=False)[-1]),
    )


def _damped_step(matrix: FloatArray, error: FloatArray, damping: float) -> FloatArray:
    """(J^T J + damping I)^-1 J^T e, shortened where a joint would move too far."""
    normal = matrix.T @ matrix + damping * np.eye(matrix.shape[1])
    step = matrix.T @ error
    solve_positive(normal, step)
    return step * min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
