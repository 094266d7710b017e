"""Latency that the tracking loop tolerates."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from lpv.core.support.limits import MAX_DELAY
from lpv.core.uio.certificate.conditions import controller_loop, delayed_radius, discretised
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.model.arm import ArmParameters


def tolerated_latency(arm: ArmParameters, gains: Gains) -> float:
    """Longest constant latency from measurement to torque with which the loop is stable [s].

    Computed for the sampled loop, linear at each vertex of the controller's polytope, with the
    torque held between samples: the spectral radius of the loop with d samples of delay is below 1
    for all d up to the result.  That is an eigenvalue check at the vertices, no proof for an arm
    that moves between them.
    """
    controller = gains.controller
    feedback = controller.feedback.tobytes()
    return _tolerated(arm, controller.method, controller.sinc_min, feedback)


@lru_cache(maxsize=16)
def _tolerated(arm: ArmParameters, method: str, sinc_min: float, gain: bytes) -> float:
    """Kept: campaigns ask for each of their runs."""
    loops = zip(*controller_loop(arm, method, sinc_min))
    return loop_latency(loops, np.frombuffer(gain).reshape(2, -1), arm.sample_time)


def loop_latency(
    loops: Iterable[tuple[np.ndarray, np.ndarray]], m: np.ndarray, sample_time: float
) -> float:
    """Longest constant latency with which sampled loops x' = A x + B u, u = M x are stable [s].

    ``loops`` are pairs A, B, one for each vertex.
    """
    sampled = [discretised(a, b, sample_time) for a, b in loops]
    delay = 0
    while delay < MAX_DELAY and all(delayed_radius(a, b, m, delay + 1) < 1.0 for a, b in sampled):
        delay += 1
    return delay * sample_time
