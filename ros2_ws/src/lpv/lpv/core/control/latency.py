"""Latency that the tracking loop tolerates."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from lpv.core.uio.certificate.conditions import controller_loop
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.arm import ArmParameters

_MOST_SAMPLES = 128


def tolerated_latency(arm: ArmParameters, gains: Gains) -> float:
    """Longest constant latency from measurement to torque with which the loop is stable [s].

    Computed for the sampled loop, linear at each vertex of the controller's polytope, with the
    torque held between samples: the spectral radius of the loop with d samples of delay is below 1
    for all d up to the result.  That is an eigenvalue check at the vertices, no proof for an arm
    that moves between them.
    """
    controller = gains.controller
    m = np.hstack([controller.m1, controller.m2])
    return _tolerated(arm, controller.method, controller.sinc_min, m.tobytes())


@lru_cache(maxsize=16)
def _tolerated(arm: ArmParameters, method: str, sinc_min: float, gain: bytes) -> float:
    """Kept: campaigns ask for each of their runs."""
    loops = zip(*controller_loop(arm, method, sinc_min))
    return loop_latency(loops, np.frombuffer(gain).reshape(2, -1), arm.sample_time)


def loop_latency(
    loops: Iterable[tuple[np.ndarray, np.ndarray]], m: np.ndarray, sample_time: float
) -> float:
    """Longest constant latency with which sampled loops x' = A x + B u, u = M x are stable [s].

    Parameters
    ----------
    loops : iterable of tuple of ndarray
        A and B, one pair a vertex.
    m : ndarray
        M.
    sample_time : float
        [s].
    """
    sampled = [_discretise(a, b, sample_time) for a, b in loops]
    delay = 0
    while delay < _MOST_SAMPLES and all(_radius(a, b, m, delay + 1) < 1.0 for a, b in sampled):
        delay += 1
    return delay * sample_time


def _discretise(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold: exp([[A, B], [0, 0]] T)."""
    n, k = b.shape
    block = np.zeros((n + k, n + k))
    block[:n] = period * np.hstack([a, b])
    result = expm(block)
    return result[:n, :n], result[:n, n:]


def _radius(a: np.ndarray, b: np.ndarray, m: np.ndarray, delay: int) -> float:
    """Spectral radius of x+ = A x + B u_d, u_1+ = M x, u_2+ = u_1, ..."""
    n, k = b.shape
    loop = np.zeros((n + k * delay, n + k * delay))
    loop[:n, :n], loop[:n, -k:] = a, b
    loop[n : n + k, :n] = m
    loop[n + k :, n:-k] = np.eye(k * (delay - 1))
    return float(np.abs(np.linalg.eigvals(loop)).max())
