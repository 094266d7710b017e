"""Report of an identification: one HTML page and its pictures."""

from pathlib import Path
from typing import Any

import numpy as np

from lpv.identify.estimation.identification import Identification
from lpv.identify.results.figures import residual_figure, torque_figure
from lpv.identify.results.summary import DRIVES, FIGURES, SENSORS, cells, remarks
from lpv.report.page import embedded, environment
from lpv.report.style import png

_CAPTIONS = (
    ('torques', torque_figure, 'Measured and predicted torque on data held back.'),
    (
        'residuals',
        residual_figure,
        'Residual against rate, with the torque tolerance of the arm file, and against angle.',
    ),
)


def write_report(result: Identification, folder: Path) -> Path:
    """Write ``identification.html`` and the pictures as PNG into a folder, which is created.

    Returns the page, which needs nothing from elsewhere.
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
    names, found = result.arm.joint_names, result.determination
    held_back = sum(p.time[-1] - p.time[0] for p in result.predictions)
    explained = 100 * np.median(result.figures.r2)
    determined = f'{int(found.determined.sum())} of {len(found.names)}'
    parameters = zip(found.names, found.values, found.sigma, found.determined)
    tables = {'joints': FIGURES, 'drives': DRIVES, 'sensors': SENSORS}
    return {
        'title': f'Identification of {result.arm.name}',
        'lead': 'Parameters of the arm from recordings of its motion, and how well they predict.',
        'tiles': (
            ('joints', len(names), result.arm.name),
            ('data held back', f'{held_back:.0f} s', 'never fitted'),
            ('torque explained', f'{explained:.1f} %', 'median of the joints'),
            ('parameters determined', determined, 'by the data alone'),
        ),
        'warnings': result.warnings,
        'band': f'{result.filters.test:.1f}',
        'lag': f'{0.5 / result.filters.test:.2f}',
        'remarks': remarks(result)[1:],
        'parameters': [
            (name, f'{value:.4g}', f'{1.97 * sigma:.2g}', 'yes' if known else 'no')
            for name, value, sigma, known in parameters
        ],
        'tables': {
            name: ([header for header, _, _ in columns], cells(result, columns))
            for name, columns in tables.items()
        },
    }
