"""Where the tip is, how it moves, and which joint positions bring it somewhere.

Frames as of `Chain`; poses are those of the tip in the base frame.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpv.core.serial_arm.chain import Chain, FloatArray, joint_count
from lpv.core.serial_arm.dynamics.momentum import solve_positive
from lpv.core.support.jit import njit

_MAX_STEP = 0.5
"""Largest change of a joint in one iteration of the inverse kinematics, within which the Jacobian
is right to an eighth [rad], [m]."""
_ORIENTATION_WEIGHT = 0.3
"""Length that weighs errors of orientation against those of position [m/rad]."""


@njit
def joint_frames(chain: Chain, q: FloatArray, rotations: FloatArray, origins: FloatArray) -> None:
    """Orientation and origin of every joint frame, and of the tip behind them, in the base.

    Parameters
    ----------
    chain : Chain
        The arm.
    q : ndarray, shape (n,)
        Positions [rad].
    rotations : ndarray, shape (n + 1, 3, 3)
        Written.
    origins : ndarray, shape (n + 1, 3)
        Written [m].
    """
    n = q.shape[0]
    for i in range(n + 1):
        for row in range(3):
            for column in range(3):
                rotations[i, row, column] = 0.0
            origins[i, row] = 0.0
        local = chain.rotation[i] if i < n else chain.tip_rotation
        place = chain.translation[i] if i < n else chain.tip_translation
        turned, way = 0.0, 0.0
        if i < n:
            turned, way = (0.0, q[i]) if chain.prismatic[i] else (q[i], 0.0)
        c, s = np.cos(turned), np.sin(turned)
        for k in range(3):
            # Row k of R_i0 Rz(q_i).
            x, y, z = (
                c * local[k, 0] + s * local[k, 1],
                c * local[k, 1] - s * local[k, 0],
                local[k, 2],
            )
            for row in range(3):
                outer = rotations[i - 1, row, k] if i > 0 else (1.0 if row == k else 0.0)
                rotations[i, row, 0] += outer * x
                rotations[i, row, 1] += outer * y
                rotations[i, row, 2] += outer * z
                origins[i, row] += outer * (place[k] + way * local[k, 2])
        if i > 0:
            for row in range(3):
                origins[i, row] += origins[i - 1, row]


@njit
def fill_jacobian(
    chain: Chain, rotations: FloatArray, origins: FloatArray, jacobian: FloatArray
) -> None:
    """Jacobian of the tip from the frames of `joint_frames`.

    Parameters
    ----------
    chain : Chain
        The arm.
    rotations, origins : ndarray, shapes (n + 1, 3, 3) and (n + 1, 3)
        As written by `joint_frames`.
    jacobian : ndarray, shape (6, n)
        Written: rows 0 to 2 linear [m/s per rad/s], 3 to 5 angular, in the base frame.
    """
    n = jacobian.shape[1]
    for i in range(n):
        zx, zy, zz = rotations[i, 0, 2], rotations[i, 1, 2], rotations[i, 2, 2]
        dx = origins[n, 0] - origins[i, 0]
        dy = origins[n, 1] - origins[i, 1]
        dz = origins[n, 2] - origins[i, 2]
        jacobian[0, i] = zy * dz - zz * dy
        jacobian[1, i] = zz * dx - zx * dz
        jacobian[2, i] = zx * dy - zy * dx
        jacobian[3, i], jacobian[4, i], jacobian[5, i] = zx, zy, zz
        if chain.prismatic[i]:
            jacobian[0, i], jacobian[1, i], jacobian[2, i] = zx, zy, zz
            jacobian[3, i], jacobian[4, i], jacobian[5, i] = 0.0, 0.0, 0.0


def _frames(chain: Chain, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """What `joint_frames` writes."""
    n = joint_count(chain)
    rotations, origins = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    joint_frames(chain, np.ascontiguousarray(q, dtype=float), rotations, origins)
    return rotations, origins


def forward_kinematics(chain: Chain, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Orientation, shape (3, 3), and position, shape (3,) [m], of the tip in the base frame."""
    rotations, origins = _frames(chain, q)
    return rotations[-1].copy(), origins[-1].copy()


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
    position, orientation = target
    matrix = jacobian(chain, q)
    rotation, origin = forward_kinematics(chain, q)
    if orientation is None:
        return position - origin, matrix[:3]
    error = np.concatenate(
        [position - origin, _ORIENTATION_WEIGHT * rotation_vector(orientation @ rotation.T)]
    )
    matrix[3:] *= _ORIENTATION_WEIGHT
    return error, matrix


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
