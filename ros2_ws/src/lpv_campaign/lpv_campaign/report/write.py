"""Puts all sections into ``report.html`` and ``report.json``."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pyarrow as pa

from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.report import text
from lpv_campaign.report.pictures.detection_figures import draw_detection
from lpv_campaign.report.pictures.estimate_figures import draw_estimates
from lpv_campaign.report.pictures.roc_figures import draw_roc, draw_sweep
from lpv_campaign.report.pictures.stability_figures import draw_going, draw_stability
from lpv_campaign.report.sections.comparison import comparison
from lpv_campaign.report.sections.detection import detection
from lpv_campaign.report.sections.estimates import estimates, sensor_errors
from lpv_campaign.report.sections.head import head
from lpv_campaign.report.sections.isolation import isolation
from lpv_campaign.report.sections.limit import limit
from lpv_campaign.report.sections.roc import roc
from lpv_campaign.report.sections.stability import stability
from lpv_campaign.report.sections.tiles import tiles
from lpv_campaign.report.sections.tracking import false_alarms, tracking, wrong_alarms
from lpv_campaign.report.sections.worst import worst
from lpv_campaign.report.statistics.intervals import share
from lpv_campaign.report.statistics.results import Results
from lpv_campaign.report.summary import smallest
from lpv_report.page import embedded, environment

HTML, JSON = 'report.html', 'report.json'
_FIGURES: dict[str, tuple[Callable[..., Any], str]] = {
    'roc': (draw_roc, 'roc'),
    'sweep': (draw_sweep, 'roc'),
    'detection': (draw_detection, 'detection'),
    'estimates': (draw_estimates, 'estimates'),
    'stability': (draw_stability, 'stability'),
    'going': (draw_going, 'stability'),
}
"""What draws each picture, and from which section."""
_PAGE_WIDTH = 9.8
"""Width of a figure that fills the page [in]; others keep the same size of letters."""


@dataclass(frozen=True)
class CampaignReport:
    """What was written."""

    html: Path  # The report
    json: Path  # Its numbers
    numbers: dict  # Content of that file


def write_report(campaign: Campaign, table: pa.Table, folder: str | Path) -> CampaignReport:
    """Write the report of a campaign.

    Parameters
    ----------
    campaign : Campaign
        What was run.
    table : pyarrow.Table
        Results, of all runs or of some.
    folder : str or pathlib.Path
        Folder of the results; gets ``report.html`` and ``report.json``.

    Returns
    -------
    CampaignReport
        What was written.
    """
    folder = Path(folder)
    numbers = _finite(report_numbers(Results(campaign, table), folder))
    page = (
        environment(Path(__file__).parent)
        .get_template('report.html')
        .render(
            **numbers,
            title=f'Campaign {campaign.spec.name}',
            tiles=tiles(numbers),
            figures=_figures(numbers),
            text=text,
            smallest=smallest,
        )
    )
    _write(folder / HTML, page)
    _write(folder / JSON, json.dumps(numbers, allow_nan=False, indent=1))
    return CampaignReport(folder / HTML, folder / JSON, numbers)


def report_numbers(results: Results, folder: Path) -> dict[str, Any]:
    """All sections of the report."""
    return {
        'head': head(results),
        'overall': {
            'detected': share(results.flag('detected'), results.faulty),
            'isolated': share(results.flag('isolated'), results.faulty),
            'wrong': wrong_alarms(results),
        },
        'roc': roc(results),
        'detection': detection(results),
        'isolation': isolation(results),
        'estimates': estimates(results),
        'errors': sensor_errors(results),
        'stability': stability(results),
        'tracking': tracking(results),
        'false_alarms': false_alarms(results),
        'comparison': comparison(results),
        'worst': worst(results, folder),
        'limit': limit(results),
    }


def _figures(numbers: dict[str, Any]) -> dict[str, Any]:
    drawn: dict[str, Any] = {}
    for name, (draw, section) in _FIGURES.items():
        figure = draw(numbers[section])
        drawn[name] = None
        if figure is not None:
            width = min(100.0, 100.0 * figure.get_figwidth() / _PAGE_WIDTH)
            drawn[name] = {'source': embedded(figure), 'width': f'{width:.0f}%'}
            plt.close(figure)
    return drawn


def _finite(data: Any) -> Any:
    """Plain data without numbers that are none: JSON has no word for them."""
    data = data.item() if isinstance(data, np.generic) else data
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def _write(path: Path, content: str) -> None:
    # A page that someone looks at is replaced as a whole.
    part = path.with_name(path.name + '.part')
    part.write_text(content, encoding='utf-8')
    part.replace(path)
