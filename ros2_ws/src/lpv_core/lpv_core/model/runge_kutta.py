"""Classical Runge-Kutta step of a two-link plant with inputs held."""

from lpv_core.support.jit import njit

State = tuple[float, float, float, float]
"""Absolute angles [rad] and rates [rad/s] of both links, or their derivatives."""


@njit
def ahead(x: State, slope: State, h: float) -> State:
    """State after ``h`` [s] along a slope."""
    return (x[0] + h * slope[0], x[1] + h * slope[1], x[2] + h * slope[2], x[3] + h * slope[3])


@njit
def weighted(x: State, k1: State, k2: State, k3: State, k4: State, dt: float) -> State:
    """State after ``dt`` [s] from the four slopes of the method."""
    s = dt / 6.0
    return (
        x[0] + s * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]),
        x[1] + s * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1]),
        x[2] + s * (k1[2] + 2.0 * k2[2] + 2.0 * k3[2] + k4[2]),
        x[3] + s * (k1[3] + 2.0 * k2[3] + 2.0 * k3[3] + k4[3]),
    )
