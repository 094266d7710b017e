"""Forward and inverse kinematics, eqs. (32)-(34), with both elbow branches.

Joint coordinates as in the paper's section 2.2: q1 from the x-axis, q2 RELATIVE to link 1.  Arms
whose q1 has another zero add the offset in :class:`lpv.core.control.path.CartesianPath`.
"""

import numpy as np

from lpv.core.support.errors import UnreachableError

ELBOWS = {'positive': 1.0, 'negative': -1.0}
"""Sign of q2 of the two branches; eq. (33) prints the positive one only."""

SINGULAR_SINE = 1e-3
"""Smallest abs(sin q2) of a path; below, the arm is stretched or folded, and
joints turn a thousand times as fast as the tip, seen from the shoulder."""


def forward(q: np.ndarray, lengths: tuple[float, ...]) -> np.ndarray:
    """Tip position (x, y) in the base frame [m], eq. (32), shape (..., 2).

    Joint positions q [rad] have shape (..., 2); ``lengths`` are (L1, L2) [m].
    """
    tip = lengths[0] * np.exp(1j * q[..., 0]) + lengths[1] * np.exp(1j * (q[..., 0] + q[..., 1]))
    return np.stack([tip.real, tip.imag], axis=-1)


def inverse(point: np.ndarray, lengths: tuple[float, ...], elbow: str = 'positive') -> np.ndarray:
    """Joint positions q for tip positions (x, y), eqs. (33), (34), both of shape (..., 2).

    The quotients in (34) lose the quadrant; atan2 keeps it: q1 is in (-pi, pi] up to the second
    term of (34).  ``elbow`` is the sign of q2.

    Raises
    ------
    UnreachableError
        If a point is not finite or outside the annulus abs(L1 - L2) <= r <= L1 + L2.
    """
    point = np.asarray(point, float)
    l_1, l_2 = lengths
    x, y = point[..., 0], point[..., 1]
    radius = np.hypot(x, y)
    low, high = abs(l_1 - l_2), l_1 + l_2
    # Rounding must not make a point on the border unreachable.
    slack = 1e-12 * high
    bad = ~(np.isfinite(radius) & (radius <= high + slack) & (radius >= low - slack))
    if np.any(bad):
        bad_point = point[bad][0] if point.ndim > 1 else point
        raise UnreachableError(
            f'point ({bad_point[0]:.4g}, {bad_point[1]:.4g}) m is out of reach: its distance from '
            f'the base must lie within [{low:.4g}, {high:.4g}] m'
        )
    cosine = np.clip((x**2 + y**2 - l_1**2 - l_2**2) / (2.0 * l_1 * l_2), -1.0, 1.0)
    q_2 = ELBOWS[elbow] * np.arccos(cosine)
    q_1 = np.arctan2(y, x) - np.arctan2(l_2 * np.sin(q_2), l_1 + l_2 * np.cos(q_2))
    return np.stack([q_1, q_2], axis=-1)


def refuse_singular(q: np.ndarray) -> None:
    """UnreachableError if the arm is stretched or folded anywhere: there the tip cannot follow."""
    if np.any(np.abs(np.sin(q[..., 1])) < SINGULAR_SINE):
        raise UnreachableError(
            'the path meets a singularity: the arm is stretched or folded '
            f'(abs(sin q2) < {SINGULAR_SINE})'
        )
