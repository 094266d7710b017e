"""Torque that the model misses, as a function of speed."""

import numpy as np

from lpv_core.serial_arm.description import TorqueTolerance

_QUANTILE = 0.99
_BINS = 8
_LEAST = 30  # samples of a bin


def torque_tolerance(speed: np.ndarray, residual: np.ndarray) -> TorqueTolerance:
    """Envelope of a joint's residuals over its speed.

    Parameters
    ----------
    speed : ndarray, shape (samples,)
        Rates of the joint [rad/s].
    residual : ndarray, shape (samples,)
        Torque minus prediction of data that were held back [N m].

    Returns
    -------
    TorqueTolerance
        99 % of the residuals' magnitudes in bins of speed: finer near standstill, where friction
        reverses.
    """
    speed, size = np.abs(speed), np.abs(residual)
    edges = np.quantile(speed, np.linspace(0.0, 1.0, _BINS + 1) ** 1.5)
    knots: list[float] = []
    torques: list[float] = []
    for low, high in zip(edges[:-1], edges[1:]):
        inside = (speed >= low) & (speed <= high)
        if inside.sum() < _LEAST:
            continue
        middle = float(np.median(speed[inside]))
        if knots and middle <= knots[-1] + 1e-9:
            continue
        knots.append(round(middle, 6))
        torques.append(float(np.quantile(size[inside], _QUANTILE)))
    if not knots:
        return TorqueTolerance((0.0,), (float(np.max(size, initial=0.0)),))
    return TorqueTolerance(tuple(knots), tuple(torques))
