"""One Lyapunov matrix for the tracking loop of an arm and of the arms at its corners."""

import cvxpy as cp
import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.uio.certificate.conditions import controller_loop, corner_arms
from lpv_design.solve import RESERVE, solve, symmetric_below

_ROUNDS = 8
"""Times that the vertices that fail are added."""
_ADDED = 24
"""Vertices added at once: 32 arms have 512, of which few matter."""


def corner_lyapunov(
    arm: ArmParameters, loop: tuple[np.ndarray, ...], m: np.ndarray, p: np.ndarray, alpha: float
) -> np.ndarray:
    """P of LMI (67) that also proves half the decay of the arms at the corners, if one is found.

    Given are vertices A_c, B_c of eq. (64), (M1, M2), and P of the design, which knows nothing of
    those arms: where it does not carry them, another one often does with the same gains.
    """
    loops = [(loop, alpha)]
    loops += [(controller_loop(other, 'exact'), 0.5 * alpha) for other in corner_arms(arm)]
    unit = np.eye(len(p))
    # N + decay I has to be stable; in coordinates in which the given P is the identity.
    shifted = [a + b @ m + decay * unit for one, decay in loops for a, b in zip(*one)]
    factor = np.linalg.cholesky(p).T
    vertices = factor @ np.array(shifted) @ np.linalg.inv(factor)
    found, tried = unit, set(range(len(loop[0])))
    for _ in range(_ROUNDS):
        root = np.linalg.cholesky(found).T
        balanced = root @ vertices @ np.linalg.inv(root)
        left = np.linalg.eigvalsh(balanced + balanced.swapaxes(1, 2))[:, -1]
        if left.max() < 0.0:
            return p if found is unit else factor.T @ found @ factor
        tried.update(k for k in np.argsort(left)[-_ADDED:].tolist() if left[k] >= 0.0)
        common = _common_lyapunov(vertices[sorted(tried)] + RESERVE * alpha * unit)
        if common is None:
            break
        found = common
    return p


def _common_lyapunov(vertices: np.ndarray) -> np.ndarray | None:
    """P by which all vertices are stable, as well conditioned as can be; None if none is found."""
    unit = np.eye(vertices.shape[1])
    p, condition = cp.Variable(unit.shape, symmetric=True), cp.Variable()
    constraints = [p >> unit, p << condition * unit]
    solve(condition, [*constraints, *(symmetric_below(p @ n + n.T @ p) for n in vertices)])
    return None if p.value is None or not np.linalg.eigvalsh(p.value)[0] > 0.0 else p.value
