"""Pictures of an identification."""

from collections.abc import Callable

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lpv_identify.estimation.identification import Identification
from lpv_report.style import INK, SENSOR, SETTINGS, SOFT, thin

_MOST_POINTS = 4000


def torque_figure(result: Identification) -> Figure:
    """Measured and predicted torque of each joint over time, on data held back."""

    def draw(axes: Axes, joint: int) -> None:
        for k, part in enumerate(result.predictions):
            axes.plot(
                *thin(part.time, part.measured[:, joint]),
                color=SENSOR[0],
                label='measured' if k == 0 else None,
            )
            axes.plot(
                *thin(part.time, part.predicted[:, joint]),
                color=SENSOR[1],
                label='predicted' if k == 0 else None,
            )
            axes.plot(
                *thin(part.time, part.measured[:, joint] - part.predicted[:, joint]),
                color=SOFT,
                lw=0.8,
                label='difference' if k == 0 else None,
            )
        axes.set_ylabel('N m')

    return _rows(result, draw, 'time [s]', legend=True)


def residual_figure(result: Identification) -> Figure:
    """Residuals against speed with the tolerance, and against angle."""
    n = len(result.arm.joints)
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(n, 2, figsize=(9.0, 1.5 * n + 0.5), squeeze=False)
        speed = np.concatenate([p.velocity for p in result.predictions])
        angle = np.concatenate([p.position for p in result.predictions])
        residual = np.concatenate([p.measured - p.predicted for p in result.predictions])
        every = slice(None, None, max(1, len(residual) // _MOST_POINTS))
        for j, joint in enumerate(result.arm.joints):
            axes[j, 0].plot(speed[every, j], residual[every, j], '.', ms=1.5, color=SENSOR[0])
            knots = np.array(joint.torque_tolerance.speed)
            level = np.array(joint.torque_tolerance.torque)
            for side in (-1.0, 1.0):
                for sign in (-1.0, 1.0):
                    axes[j, 0].plot(side * knots, sign * level, color=SENSOR[1], lw=1.0)
            axes[j, 1].plot(angle[every, j], residual[every, j], '.', ms=1.5, color=SENSOR[0])
            axes[j, 0].set_title(joint.name)
            axes[j, 0].set_ylabel('N m')
        axes[-1, 0].set_xlabel('rate [rad/s]')
        axes[-1, 1].set_xlabel('angle [rad]')
    return figure


def _rows(
    result: Identification, draw: Callable[[Axes, int], None], label: str, legend: bool
) -> Figure:
    n = len(result.arm.joints)
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(n, 1, figsize=(9.0, 1.5 * n + 0.6), sharex=True, squeeze=False)
        for j, name in enumerate(result.arm.joint_names):
            draw(axes[j, 0], j)
            axes[j, 0].set_title(name, color=INK)
        if legend:
            axes[0, 0].legend(loc='upper right', ncols=3)
        axes[-1, 0].set_xlabel(label)
    return figure
