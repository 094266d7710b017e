"""The sampled tracking loop in motion: held torque, one sample of delay, Coriolis torques.

With x = (theta, theta', eps) of eq. (64) and the held torque u, z = (x, u) follows within a sample

    z' = F(t) z,    F = [[A + K, B], [0, 0]],

where gravity slopes and Xi^-1 lie anywhere in the exact polytope and may change at any time, and
K holds the Coriolis torques at link rates up to a stated one.  The transition over a sample is

    Phi = I + int F + int int F F + ... .

With F = F0 + D its part that is linear in the mean of D lies in the convex hull of the vertices;
all else is bounded entry by entry.  The law sums eps sample by sample, eps+ = eps - h theta+, and
so does Phi.  One P for which every vertex contracts by more than that remainder expands proves that
the loop contracts, whatever the arm does within the region.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.entries import array, entry, positive

SIZE = 8
"""Of (theta, theta', eps, u)."""


@dataclass(frozen=True)
class MotionCertificate:
    """What `SampledLoop` proves of the sampled loop in motion."""

    lyapunov: np.ndarray = array(8, 8)  # P for (theta, theta rates, eps, u), row by row
    rate: float = entry('number', low=0.0)  # fastest link that it holds for [rad/s]
    decay: float = positive()  # certified decay rate of the sampled loop in motion [1/s]


@dataclass(frozen=True)
class SampledLoop:
    """One sample of the loop, z+ = (L + R) z."""

    vertices: np.ndarray  # L is a convex combination of these, shape (n, 8, 8)
    remainder: np.ndarray  # bound of abs(R), entry by entry, shape (8, 8)

    def contraction(self, lyapunov: np.ndarray) -> float:
        """Largest factor by which sqrt(z' P z) changes in a sample; infinite without P > 0."""
        from scipy.linalg import cholesky, solve_triangular  # as `discretised` does

        try:
            factor = cholesky(lyapunov)
            inverse = solve_triangular(factor, np.eye(SIZE))
            worst = max(np.linalg.norm(factor @ vertex @ inverse, 2) for vertex in self.vertices)
            with np.errstate(invalid='ignore'):
                left = np.linalg.norm(np.abs(factor) @ self.remainder @ np.abs(inverse), 2)
        except (np.linalg.LinAlgError, ValueError):  # not positive definite, or not finite
            return np.inf
        return float(worst + left)


def sampled_loop(
    arm: ArmParameters, loop: tuple[np.ndarray, ...], feedback: np.ndarray, rate: float
) -> SampledLoop:
    """One sample of the tracking loop at link rates up to a stated one [rad/s].

    Vertices A_c, B_c of eq. (64) are without Coriolis torques; the torque that the feedback
    (M1, M2) of eq. (65) makes of a measurement acts from the next sample on.
    """
    from scipy.linalg import expm  # as `discretised` does

    step, flows = arm.sample_time, _flows(arm, loop, rate)
    low, high = flows.min(axis=0), flows.max(axis=0)
    center, spread = 0.5 * (low + high), 0.5 * (high - low)
    vertices = []
    for flow in flows:
        away = flow - center
        second = center @ center + center @ away + away @ center
        vertices.append(np.eye(SIZE) + step * flow + 0.5 * step**2 * second)
        vertices[-1][6:] = np.hstack([feedback, np.zeros((2, 2))])
        vertices[-1][4:6] = np.eye(2, SIZE, 4) - step * vertices[-1][:2]
    # int int D D; the first moments of D within the sample; all terms from the third order on.
    moments = np.abs(center) @ spread + spread @ np.abs(center)
    largest = step * np.abs(flows).max(axis=0)
    with np.errstate(over='ignore', invalid='ignore'):  # beyond all numbers nothing is claimed
        higher = expm(largest) - np.eye(SIZE) - largest - 0.5 * largest @ largest
        remainder = 0.5 * step**2 * spread @ spread + 0.25 * step**2 * moments + higher
    remainder[6:], remainder[4:6] = 0.0, step * remainder[:2]
    return SampledLoop(np.array(vertices), remainder)


def _flows(arm: ArmParameters, loop: tuple[np.ndarray, ...], rate: float) -> np.ndarray:
    """F at all corners of the polytope and of the Coriolis torques."""
    most = arm.numbers().coupling * rate
    flows = []
    for a, b in zip(*loop):
        for first, second in product((-most, most), repeat=2):
            flow = np.zeros((SIZE, SIZE))
            flow[:6, :6], flow[:6, 6:] = a, b
            flow[2:4, 2:4] += b[2:4] @ np.array([[0.0, first], [second, 0.0]])
            flows.append(flow)
    return np.array(flows)
