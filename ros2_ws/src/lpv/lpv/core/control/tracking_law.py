"""What the tracking controllers of all arms share: one call a sample, limits, integral action."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lpv.core.serial_arm.chain import Chain, FloatArray
from lpv.core.support.jit import njit_in_place as njit


@njit
def apply_limits(state: np.record, limit: np.ndarray) -> None:
    """Clip torques to their limits [N m], and integrate eps where none is met.

    ``state`` has the ``torque`` that is wanted and the ``step`` of ``integral``; ``saturated`` is
    written.
    """
    state.saturated = False
    for i in range(limit.shape[0]):
        wanted = state.torque[i]
        state.torque[i] = min(max(wanted, -limit[i]), limit[i])
        if state.torque[i] != wanted:
            state.saturated = True
    if not state.saturated:
        # Conditional integration: no wind-up at the limit.
        for i in range(limit.shape[0]):
            state.integral[i] += state.step[i]


class LawParts(NamedTuple):
    """What a law is made of."""

    chain: Chain  # the arm's model
    state: np.ndarray  # memory of its record, with ``integral``, ``torque``, ``saturated``
    work: FloatArray  # from `lpv.core.serial_arm.chain.workspace`


class TrackingLaw:
    """A tracking controller with integral action.

    Parameters
    ----------
    law : callable
        Compiled; takes ``parts`` and what `answer` does.
    parts : LawParts
        Its model and state.

    Attributes
    ----------
    torque : ndarray, shape (n,)
        Joint torques of the last command [N m].
    """

    def __init__(self, law: Callable[..., None], parts: LawParts) -> None:
        self._law, self.parts = law, parts
        self.state = parts.state.view(np.recarray)[0]
        self.torque: np.ndarray = parts.state['torque'][0]

    @property
    def integral(self) -> np.ndarray:
        """State eps of the integral action, shape (n,) [rad s]."""
        return self.state.integral

    def reset(self) -> None:
        """Empty the integrator."""
        self.state.integral[:] = 0.0

    def answer(
        self,
        reference: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        integrated: np.ndarray,
        interval: float,
    ) -> None:
        """Write the command for the present sample into ``torque``.

        Parameters
        ----------
        reference : ndarray, shape (3, n)
            Positions, rates and accelerations [rad], [rad/s], [rad/s2].
        position, velocity : ndarray, shape (n,)
            State to feed back, joint coordinates, contiguous [rad], [rad/s].
        integrated : ndarray, shape (n,)
            Position that eps integrates, contiguous [rad].
        interval : float
            Time since the previous command [s]; 0 at the first.
        """
        self._law(self.parts, reference, position, velocity, integrated, interval)
