"""Report of an identification: one HTML page and its pictures."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from lpv.identify.estimation.identification import Identification
from lpv.identify.results.summary import DRIVES, FIGURES, SENSORS, cells, remarks
from lpv.report.page import Tile, write_page
from lpv.report.style import INK, SENSOR, SOFT, thin

_MOST_POINTS = 4000  # of a scatter plot; more hide each other


def torques(result: Identification) -> Figure:
    """Measured and predicted torque of each joint over time, on data held back."""
    n = len(result.arm.joints)
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


def residuals(result: Identification) -> Figure:
    """Residuals against speed with the tolerance, and against position."""
    n = len(result.arm.joints)
    speed, position, residual = (
        np.concatenate([getattr(p, name) for p in result.predictions])
        for name in ('velocity', 'position', 'residual')
    )
    every = slice(None, None, max(1, len(residual) // _MOST_POINTS))
    figure, axes = plt.subplots(n, 2, figsize=(9.0, 1.7 * n + 0.5), squeeze=False)
    for j, joint in enumerate(result.arm.joints):
        unit, torque = joint.units
        for axis, x, label in zip(axes[j], (speed, position), ('rate [{}/s]', 'position [{}]')):
            axis.plot(x[every, j], residual[every, j], '.', ms=1.5, color=SENSOR[0])
            axis.set_xlabel(label.format(unit))
        tolerance = joint.torque_tolerance
        knots, level = np.array(tolerance.speed), np.array(tolerance.torque)
        for side, sign in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            axes[j, 0].plot(side * knots, sign * level, color=SENSOR[1], lw=1.0)
        axes[j, 0].set(title=joint.name, ylabel=torque)
    return figure


_CAPTIONS = {
    torques: 'Measured and predicted torque on data held back.',
    residuals: 'Residual against rate, with the torque tolerance of the arm file, and against '
    'angle.',
}


def write_report(result: Identification, folder: Path) -> Path:
    """Write ``identification.html`` and its pictures into a folder; the page."""
    page, templates = folder / 'identification.html', Path(__file__).parent
    return write_page(page, templates, _CAPTIONS, result, _content(result))


def _content(result: Identification) -> dict[str, Any]:
    names, found = result.arm.joint_names, result.determination
    held_back = sum(p.time[-1] - p.time[0] for p in result.predictions)
    explained = 100 * np.median(result.figures.r2)
    determined = f'{int(found.determined.sum())} of {len(found.names)}'
    parameters = zip(found.names, found.values, found.sigma, found.determined)
    tables = {'joints': FIGURES, 'drives': DRIVES, 'sensors': SENSORS}
    return {
        'title': f'Identification of {result.arm.name}',
        'tiles': (
            Tile('joints', len(names), result.arm.name),
            Tile('data held back', f'{held_back:.0f} s', 'never fitted'),
            Tile('torque explained', f'{explained:.1f} %', 'median of the joints'),
            Tile('parameters determined', determined, 'by the data alone'),
        ),
        'warnings': result.warnings,
        'band': f'{result.bands.test:.1f}',
        'lag': f'{0.5 / result.bands.test:.2f}',
        'remarks': remarks(result)[1:],
        'parameters': [
            (name, f'{value:.4g}', f'{1.97 * sigma:.2g}', 'yes' if known else 'no')
            for name, value, sigma, known in parameters
        ],
        'tables': {
            name: (['joint', *(f'>{head}' for head, _, _ in columns)], cells(result, columns))
            for name, columns in tables.items()
        },
    }
