"""Maps of where the loop stays stable."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lpv_campaign.report.sections.stability import size_of
from lpv_report.style import INK, SENSOR, SETTINGS

_COLUMNS = 3
_FEW = 6
_COLOURS = LinearSegmentedColormap.from_list(
    'stable', [(0.0, SENSOR[1]), (0.5, '#f7ecd9'), (1.0, SENSOR[0])]
)


def draw_stability(data: dict[str, Any]) -> Figure | None:
    """Rate of stable runs, one map per pair of factors.

    Returns None with fewer than two factors.
    """
    if not data['unstable']:
        return None
    return _draw(data['maps'], 'cells', 'stable runs')


def draw_going(data: dict[str, Any]) -> Figure | None:
    """Rate of stable runs without a safe stop, likewise.

    Returns None with fewer than two factors, or without any safe stop.
    """
    if not data['stopped']:
        return None
    return _draw(data['maps'], 'going', 'stable, without a safe stop')


def _draw(maps: list[dict[str, Any]], key: str, label: str) -> Figure | None:
    if not maps:
        return None
    columns = min(_COLUMNS, len(maps))
    rows = -(-len(maps) // columns)
    with plt.rc_context({**SETTINGS, 'axes.grid': False}):
        figure, axes = plt.subplots(
            rows, columns, squeeze=False, figsize=(max(3.1 * columns + 0.5, 5.0), 2.75 * rows)
        )
        for axis, entry in zip(axes.flat, maps):
            image = _draw_map(axis, entry, entry[key])
        for axis in axes.flat[len(maps) :]:
            axis.set_visible(False)
        bar = figure.colorbar(image, ax=axes, shrink=min(1.0, 1.6 / rows), aspect=25, pad=0.02)
        bar.set_label(label)
        bar.outline.set_visible(False)
        bar.set_ticks([0.0, 0.5, 1.0], labels=['0%', '50%', '100%'])
    return figure


def _draw_map(axis: Axes, entry: dict[str, Any], cells: list[list[dict[str, Any]]]) -> Any:
    rates = np.array([[np.nan if c['rate'] is None else c['rate'] for c in line] for line in cells])
    image = axis.imshow(rates, origin='lower', aspect='auto', cmap=_COLOURS, vmin=0.0, vmax=1.0)
    for (row, column), rate in np.ndenumerate(rates):
        cell = cells[row][column]
        if np.isnan(rate):
            axis.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5),
                    1.0,
                    1.0,
                    fill=False,
                    hatch='////',
                    linewidth=0.0,
                    edgecolor='#9aa5b4',
                )
            )
            continue
        colour = 'white' if rate > 0.85 or rate < 0.12 else INK
        text = f'{100.0 * rate:.0f}'
        if max(rates.shape) <= _FEW:
            text += f'\nof {cell["cases"]}'
        axis.text(column, row, text, ha='center', va='center', color=colour, fontsize=7)
    _ticks(axis.xaxis, entry['x'])
    _ticks(axis.yaxis, entry['y'])
    axis.set(xlabel=entry['x']['name'], ylabel=entry['y']['name'])
    axis.tick_params(length=0)
    for side in ('left', 'bottom'):
        axis.spines[side].set_visible(False)
    return image


def _ticks(axis: Axis, factor: dict[str, Any]) -> None:
    """Levels in the middle of cells, edges between them."""
    if factor['levels'] is not None:
        axis.set_ticks(range(size_of(factor)), [f'{v:.3g}' for v in factor['levels']])
        return
    edges = factor['edges']
    places = range(0, len(edges), 1 if len(edges) <= _FEW else 2)
    ticks = axis.set_ticks([k - 0.5 for k in places], [f'{edges[k]:.3g}' for k in places])
    # At the corners of maps labels of both axes and of neighbours meet: they are pulled inwards.
    if isinstance(axis, XAxis):
        ticks[0].label1.set(horizontalalignment='left')
        ticks[-1].label1.set(horizontalalignment='right')
    else:
        ticks[0].label1.set(verticalalignment='bottom')
        ticks[-1].label1.set(verticalalignment='top')
