"""Statistics of an archive of bags as one self-contained HTML file."""

import time
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from lpv_campaign.fleet.statistics import FleetStatistics, Trend
from lpv_core.model.arm import ArmParameters
from lpv_core.support.formatting import number
from lpv_report.page import embedded, environment
from lpv_report.style import BAND, SENSOR, SETTINGS, png

_MOST = 500
"""Rows of a table in the report; all are in the Parquet file."""
_PANELS = 6
_UNUSABLE = ('rejected', 'duplicates', 'out_of_order', 'not_finite', 'implausible')


def write_fleet_report(
    path: str | Path,
    statistics: FleetStatistics,
    arm: ArmParameters,
    title: str,
    parquet: str,
    healthy: bool = False,
) -> None:
    """Write the report.

    Parameters
    ----------
    path : str or pathlib.Path
        HTML file to write.
    statistics : FleetStatistics
        What it says.
    arm : ArmParameters
        The arm.
    title : str
        Heading.
    parquet : str
        Name of the file with all rows.
    healthy : bool, optional
        Whether alarms of bags without truth count as false.
    """
    picture = _trend_picture(statistics.trends, arm)
    Path(path).write_text(
        environment(Path(__file__).parent)
        .get_template('fleet.html')
        .render(
            title=title,
            s=statistics,
            arm=arm.name,
            sensors=arm.sensor_names,
            most=_MOST,
            parquet=parquet,
            rates=rates(statistics),
            truth=truth_text(statistics, healthy),
            tiles=_tiles(statistics),
            trend_picture=picture and embedded(picture),
            number=number,
            date=date,
            milli=lambda value: '-' if value is None else f'{1e3 * value:.1f}',
            unusable=lambda row: sum(row[name] for name in _UNUSABLE),
        ),
        encoding='utf-8',
    )


def _tiles(statistics: FleetStatistics) -> list[tuple[str, Any]]:
    alarms, false = statistics.alarms['all'], statistics.false_alarms
    return [
        ('bags', statistics.bags),
        ('hours observed', number(statistics.hours)),
        ('alarms per hour', number(alarms.value)),
        ('false alarms per hour', number(false.value)),
        ('clear trends', sum(trend.significant for trend in statistics.trends)),
    ]


def rates(statistics: FleetStatistics) -> list[tuple[Any, ...]]:
    """Rates with their names, as table and report show them."""
    named = [
        (name if name != 'all' else 'all sensors', rate) for name, rate in statistics.alarms.items()
    ]
    return [*named, ('false alarms', statistics.false_alarms)]


def truth_text(statistics: FleetStatistics, healthy: bool) -> str:
    """What is known of which alarms are false."""
    text = (
        'Bags without ground truth were said to be of healthy arms: their alarms are false.'
        if healthy
        else 'False alarms are those of bags with ground truth alone; --healthy '
        'says that all arms were healthy.'
    )
    if statistics.faulty:
        text += (
            f' True faults: {statistics.faulty} bags, found on all their sensors in '
            f'{statistics.detected}.'
        )
    return text


def date(stamp: int) -> str:
    """Date of a stamp [ns]; its seconds where it is no date."""
    seconds = stamp / 1e9
    if seconds < 1e8:
        return f'{seconds:.1f} s'
    return time.strftime('%Y-%m-%d %H:%M', time.gmtime(seconds))


def _trend_picture(trends: list[Trend], arm: ArmParameters) -> bytes | None:
    if not trends:
        return None
    shown = trends[:_PANELS]
    with plt.rc_context(SETTINGS):
        figure, axes = plt.subplots(
            len(shown), 1, figsize=(8.0, 1.6 * len(shown) + 0.5), squeeze=False
        )
        for trend, axis in zip(shown, axes[:, 0]):
            colour = SENSOR[trend.sensor]
            axis.axhline(0.0, color=BAND, linewidth=0.8)
            axis.plot(trend.days, 1e3 * trend.means, 'o', color=colour, markersize=3.5)
            for level in (-trend.threshold, trend.threshold):
                axis.axhline(1e3 * level, color=BAND, linewidth=2.0)
            middle = sorted(trend.means - trend.slope * trend.days)[len(trend.days) // 2]
            axis.plot(
                trend.days,
                1e3 * (middle + trend.slope * trend.days),
                color=colour,
                linewidth=1.2 if trend.significant else 0.6,
            )
            axis.set_title(f'{trend.unit or "-"}, {arm.sensor_names[trend.sensor]}')
            axis.set_ylabel('mrad')
        axes[-1, 0].set_xlabel('days since the first bag')
        data = png(figure)
        plt.close(figure)
    return data
