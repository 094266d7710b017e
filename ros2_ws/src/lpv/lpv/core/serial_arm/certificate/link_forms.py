"""Inequalities between quadratic forms of a serial chain, for every configuration at once.

With V_i the twist (w, u) of link i about the origin of its joint frame, in that frame,

    V_i = Rz(-q_i) X_i V_(i-1) + S y_i,    V_0 = 0,

many statements about the mass matrix are of the form sum_i V_i^T F_i V_i + f_i y_i^2 >= 0 for all
q and y; y^T M y is such a sum, with spatial inertias F_i and rotor inertias f_i.  It is proved link
by link from the tip, as dynamic programming does: if symmetric matrices B_i that commute with
rotations about z satisfy, with T_i = F_i + X_(i+1)^T B_(i+1) X_(i+1),

    (V + S y)^T T_i (V + S y) + f_i y^2 >= V^T B_i V    for all V and y,

then V^T B_i V, which does not depend on q_i, is below all that the links i, ..., n contribute,
and S^T T_1 S + f_1 >= 0 completes the proof.  No angle is gridded.  That is n small matrix
inequalities, linear in F, f and B.

Derivatives along q' are covered by stacking (V, D), D = V' for a constant y:

    D_i = Rz(-q_i) X_i D_(i-1) - q_i' G Rz(-q_i) X_i V_(i-1),

with G the generator of rotations about z.  As D enters no form but with V, the D-D blocks of B are
negative semidefinite, the inequality is concave in q_i', and both ends of its range prove it.

Functions take arrays of floats, of fractions, or expressions of the solver.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lpv.core.serial_arm.chain import IXX, MX, FloatArray
from lpv.core.serial_arm.description import inertia_matrix

AXIS = np.array([0, 0, 1, 0, 0, 0])
"""S, in integers, which no kind of number is rounded by."""
TURN = np.zeros((6, 6), dtype=int)
"""G: d/dq Rz(-q) = -G Rz(-q) for both halves of a twist."""
TURN[0, 1] = TURN[3, 4] = -1
TURN[1, 0] = TURN[4, 3] = 1


def cross_matrix(p: np.ndarray) -> np.ndarray:
    """[p]x, so that [p]x a = p x a, shape (3, 3)."""
    return np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]], dtype=p.dtype)


def spatial_inertia(body: np.ndarray) -> np.ndarray:
    """Form of twice the kinetic energy of a body, shape (6, 6).

    Parameters
    ----------
    body : ndarray, shape (10,)
        A row of `Chain.inertial`.
    """
    about, moment = inertia_matrix(body[IXX:]), cross_matrix(body[MX:IXX])
    return np.block([[about, moment], [moment.T, body[0] * np.eye(3, dtype=int)]])


def rotors_below(motor: FloatArray) -> FloatArray:
    """Diagonal of a matrix that is nowhere above the rotors' one, shape (n,) [kg m2].

    What couples two joints counts against both of them (Gershgorin), rounded down.
    """
    result = np.diag(motor).copy()
    coupling = np.abs(motor - np.diag(result)).sum(axis=1)
    coupled = coupling > 0.0
    result[coupled] = np.nextafter(result - np.nextafter(coupling, np.inf), -np.inf)[coupled]
    return result


def placements(rotation: np.ndarray, translation: np.ndarray) -> list[np.ndarray]:
    """X_i: twist of a frame from that of the frame before, at q_i = 0, each of shape (6, 6)."""
    zero = np.zeros((3, 3), dtype=int)
    return [
        np.block([[r.T, zero], [-(r.T @ cross_matrix(p)), r.T]])
        for r, p in zip(rotation, translation)
    ]


def invariant_basis(twists: int) -> FloatArray:
    """Basis of the symmetric matrices that commute with rotations about z.

    Parameters
    ----------
    twists : int
        1 for V, 2 for (V, D).

    Returns
    -------
    ndarray, shape (k, 6 twists, 6 twists)
        k is 7 for one twist, 26 for two; entries 0, 1 and -1.
    """
    vectors = [3 * k for k in range(2 * twists)]
    size, found = 6 * twists, []

    def add(*entries: tuple[int, int, int]) -> None:
        matrix = np.zeros((size, size))
        for row, column, value in entries:
            matrix[row, column] = matrix[column, row] = value
        found.append(matrix)

    for position, a in enumerate(vectors):
        for b in vectors[position:]:
            add((a, b, 1), (a + 1, b + 1, 1))
            add((a + 2, b + 2, 1))
            if a != b:
                add((a, b + 1, 1), (a + 1, b, -1))
    return np.array(found)


STEP = np.column_stack([np.eye(6, dtype=int), AXIS])
"""Leads from (V, y) to what a joint moves, shape (6, 7)."""


def turning_steps(rate: Any) -> list[np.ndarray]:
    """Matrices that lead from (V, D, y) to what a joint moves, at both ends of its rates."""
    stay, none = np.eye(6, dtype=int), np.zeros((6, 7), dtype=int)
    return [
        np.block([[stay, none[:, 1:], AXIS[:, None]], [-end * TURN, stay, none[:, :1]]])
        for end in (rate, -rate)
    ]


def chain_inequalities(
    placement: Sequence[np.ndarray],
    forms: Sequence[Any],
    scalars: Sequence[Any],
    invariant: Sequence[Any],
    joint_steps: Sequence[Sequence[np.ndarray]],
) -> Iterator[Any]:
    """Matrices that must be positive semidefinite, from the tip to the base.

    Parameters
    ----------
    placement : sequence of ndarray
        X_i, as of `placements`.
    forms, scalars : sequence
        F_i and f_i.
    invariant : sequence
        B_2, ..., B_n, matrices that commute with rotations about z.
    joint_steps : sequence of sequence of ndarray
        For each joint `STEP`, or its `turning_steps`.

    Yields
    ------
    matrix
        One for each joint and end of its rate; of shape (1, 1) for the first joint.
    """
    size = np.shape(joint_steps[0][0])[0]
    keep = np.eye(size, size + 1, dtype=int)
    last = np.zeros((size + 1, size + 1), dtype=int)
    last[size, size] = 1
    for i in range(len(forms) - 1, -1, -1):
        total = forms[i]
        if i + 1 < len(forms):
            moved = np.kron(np.eye(size // 6, dtype=int), placement[i + 1])
            total = total + moved.T @ invariant[i] @ moved
        if i == 0:
            axis = np.eye(size, 1, -2, dtype=int)
            yield axis.T @ total @ axis + scalars[0] * np.eye(1, dtype=int)
            return
        below = keep.T @ invariant[i - 1] @ keep
        for step in joint_steps[i]:
            yield step.T @ total @ step + scalars[i] * last - below
