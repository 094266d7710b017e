"""Report of an identification: one HTML page and its pictures."""

from pathlib import Path
from typing import Any

import numpy as np

from lpv_identify.estimation.identification import Identification
from lpv_identify.results.figures import residual_figure, torque_figure
from lpv_identify.results.summary import remarks
from lpv_report.page import embedded, environment
from lpv_report.style import png

_CAPTIONS = (
    ('torques', torque_figure, 'Measured and predicted torque on data held back.'),
    (
        'residuals',
        residual_figure,
        'Residual against rate, with the torque tolerance of the arm file, and against angle.',
    ),
)


def write_report(result: Identification, folder: Path) -> Path:
    """Write ``identification.html`` and the pictures as PNG.

    Parameters
    ----------
    result : Identification
        What to report.
    folder : pathlib.Path
        Created if it does not exist.

    Returns
    -------
    pathlib.Path
        The page, which needs nothing from elsewhere.
    """
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for name, draw, caption in _CAPTIONS:
        figure = draw(result)
        picture = png(figure)
        plt.close(figure)
        (folder / f'{name}.png').write_bytes(picture)
        pictures.append({'source': embedded(picture), 'caption': caption})
    template = environment(Path(__file__).parent).get_template('report.html')
    page = folder / 'identification.html'
    page.write_text(template.render(figures=pictures, **_content(result)), encoding='utf-8')
    return page


def _content(result: Identification) -> dict[str, Any]:
    figures, names = result.figures, result.arm.joint_names
    held_back = sum(p.time[-1] - p.time[0] for p in result.predictions)
    determination = result.determination
    joints = [
        [
            f'{figures.rms[j]:.3f}',
            f'{figures.rms_band[j]:.3f}',
            f'{100 * figures.share[j]:.1f} %',
            f'{figures.r2[j]:.4f}',
            f'{figures.correlation[j]:.2f}',
            f'{result.prior_figures.rms[j]:.2f}',
        ]
        for j in range(len(names))
    ]
    tiles = [
        {'name': 'joints', 'value': str(len(names)), 'note': result.arm.name},
        {'name': 'data held back', 'value': f'{held_back:.0f} s', 'note': 'never fitted'},
        {
            'name': 'torque explained',
            'value': f'{100 * np.median(figures.r2):.1f} %',
            'note': 'median of the joints',
        },
        {
            'name': 'parameters determined',
            'value': f'{int(determination.determined.sum())} of {len(determination.names)}',
            'note': 'by the data alone',
        },
    ]
    parameters = [
        {
            'name': name,
            'value': f'{value:.4g}',
            'width': f'{1.97 * sigma:.2g}',
            'determined': 'yes' if known else 'no',
        }
        for name, value, sigma, known in zip(
            determination.names, determination.values, determination.sigma, determination.determined
        )
    ]
    return {
        'title': f'Identification of {result.arm.name}',
        'lead': 'Parameters of the arm from recordings of its motion, and how well they predict.',
        'tiles': tiles,
        'warnings': result.warnings,
        'joints': _named(names, joints),
        'band': f'{result.filters.test:.1f}',
        'lag': f'{0.5 / result.filters.test:.2f}',
        'remarks': remarks(result)[1:],
        'parameters': parameters,
        **_tables(result),
    }


def _tables(result: Identification) -> dict[str, Any]:
    arm, sensing = result.arm, result.sensing
    drives = [
        [
            f'{j.friction.offset:.3g}',
            f'{j.friction.viscous:.3g}',
            f'{j.friction.coulomb:.3g}',
            f'{j.friction.coulomb_slope:.0f}',
            f'{j.friction.load:.3g}',
            f'{j.rotor_inertia:.3g}',
            f'{j.torque_gain:.4g}',
            f'{1e3 * j.effort_delay:.1f}',
        ]
        for j in arm.joints
    ]
    sensors = [
        [
            f'{sensing.position_noise[k]:.2g}',
            f'{sensing.quantization[k]:.2g}',
            f'{sensing.velocity_noise[k]:.2g}',
            sensing.rates[k],
            f'{sensing.rate_evidence[k]:.2f}',
            f'{1e3 * sensing.rate_delay[k]:.1f}',
        ]
        for k in range(len(arm.joints))
    ]
    return {
        'drive_names': [
            'offset N m',
            'viscous N m s',
            'Coulomb N m',
            'slope s/rad',
            'load',
            'rotor kg m²',
            'gain',
            'delay ms',
        ],
        'drives': _named(arm.joint_names, drives),
        'sensor_names': [
            'position noise rad',
            'step rad',
            'rate noise rad/s',
            'rates',
            'explained',
            'rate delay ms',
        ],
        'sensors': _named(arm.joint_names, sensors),
    }


def _named(names: tuple[str, ...], cells: list[list[str]]) -> list[dict[str, Any]]:
    return [{'name': name, 'cells': row} for name, row in zip(names, cells)]
