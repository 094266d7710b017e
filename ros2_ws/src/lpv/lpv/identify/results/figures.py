"""Pictures of an identification."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from lpv.identify.estimation.identification import Identification
from lpv.report.style import INK, SENSOR, SETTINGS, SOFT, thin

_MOST_POINTS = 4000


def torque_figure(result: Identification) -> Figure:
    """Measured and predicted torque of each joint over time, on data held back."""
    n = len(result.arm.joints)
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(n, 1, figsize=(9.0, 1.5 * n + 0.6), sharex=True, squeeze=False)
        for j, joint in enumerate(result.arm.joints):
            for k, part in enumerate(result.predictions):
                for name, signal, colour, width in (
                    ('measured', part.measured, SENSOR[0], 1.5),
                    ('predicted', part.predicted, SENSOR[1], 1.5),
                    ('difference', part.residual, SOFT, 0.8),
                ):
                    label = name if k == 0 else None
                    points = thin(part.time, signal[:, j])
                    axes[j, 0].plot(*points, label=label, color=colour, lw=width)
            axes[j, 0].set_title(joint.name, color=INK)
            axes[j, 0].set_ylabel(joint.units[1])
        axes[0, 0].legend(loc='upper right', ncols=3)
        axes[-1, 0].set_xlabel('time [s]')
    return figure


def residual_figure(result: Identification) -> Figure:
    """Residuals against speed with the tolerance, and against position."""
    n = len(result.arm.joints)
    speed, position, residual = (
        np.concatenate([getattr(p, name) for p in result.predictions])
        for name in ('velocity', 'position', 'residual')
    )
    every = slice(None, None, max(1, len(residual) // _MOST_POINTS))
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(n, 2, figsize=(9.0, 1.5 * n + 0.5), squeeze=False)
        for j, joint in enumerate(result.arm.joints):
            for axis, x in zip(axes[j], (speed, position)):
                axis.plot(x[every, j], residual[every, j], '.', ms=1.5, color=SENSOR[0])
            tolerance = joint.torque_tolerance
            knots, level = np.array(tolerance.speed), np.array(tolerance.torque)
            for side, sign in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                axes[j, 0].plot(side * knots, sign * level, color=SENSOR[1], lw=1.0)
            axes[j, 0].set_title(joint.name)
            axes[j, 0].set_ylabel(joint.units[1])
        axes[-1, 0].set_xlabel('rate [rad/s]')
        axes[-1, 1].set_xlabel('position [rad]')
    return figure
