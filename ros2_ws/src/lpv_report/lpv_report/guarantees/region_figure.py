"""Picture of an arm's region: the smallest fault that is surely detected in each configuration."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from lpv_core.model.arm import ArmParameters
from lpv_design.guarantee import Guarantee
from lpv_report.style import INK, PAPER, SETTINGS, SOFT, png

_LEVELS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Sizes of faults whose lines are drawn [rad]."""
_LARGEST = 3.0
"""From here on the picture does not tell sizes apart [rad]."""
_COLOURS = LinearSegmentedColormap.from_list(
    'detectable', ['#e8f1f8', '#9fcbe6', '#4a94c4', '#0b4a75']
)


def draw_region(found: Guarantee, arm: ArmParameters, path: str | Path) -> None:
    """Write the picture, a panel per sensor; hatched where only changes of the fault are seen."""
    degrees = np.degrees(found.deviation)
    ends = degrees[0], degrees[-1]
    with plt.rc_context({**SETTINGS, 'axes.grid': False}):
        figure, axes = plt.subplots(
            1, len(arm.sensor_names), figsize=(8.6, 4.1), sharey=True, layout='constrained'
        )
        for i, (axis, name) in enumerate(zip(np.atleast_1d(axes), arm.sensor_names)):
            values = found.detectable[:, :, i].T
            shades = axis.pcolormesh(
                degrees,
                degrees,
                np.where(np.isfinite(values), values, np.nan),
                cmap=_COLOURS,
                norm=LogNorm(_LEVELS[0], _LARGEST),
                shading='nearest',
                rasterized=True,
            )
            axis.patch.set(facecolor=PAPER, hatch='////', edgecolor=SOFT, linewidth=0.0)
            lines = axis.contour(
                degrees,
                degrees,
                np.where(np.isfinite(values), values, np.nan),
                levels=_LEVELS,
                colors=INK,
                linewidths=0.8,
            )
            axis.clabel(lines, fmt='%g rad', fontsize=7.5)
            axis.plot(0.0, 0.0, '+', color=INK, markersize=7)
            axis.set(title=name, xlabel='link 1 from the vertical [deg]', xlim=ends, ylim=ends)
            axis.set_aspect('equal')
        np.atleast_1d(axes)[0].set_ylabel('link 2 from the vertical [deg]')
        bar = figure.colorbar(shades, ax=axes, ticks=_LEVELS, shrink=0.85, pad=0.02)
        bar.ax.set_yticklabels([f'{level:g}' for level in _LEVELS])
        bar.set_label('smallest lasting fault that is\nalways detected at rest [rad]')
        bar.outline.set_visible(False)
        figure.legend(
            handles=[
                Line2D([], [], marker='+', linestyle='', color=INK, label='both links vertical'),
                Patch(
                    facecolor=PAPER,
                    edgecolor=SOFT,
                    hatch='////',
                    label='gravity does not limit the error: only changes of a fault are seen',
                ),
            ],
            loc='outside lower center',
            ncols=2,
        )
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(png(figure))
        plt.close(figure)
