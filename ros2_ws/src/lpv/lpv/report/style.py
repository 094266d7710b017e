"""Look of the figures: palette, Matplotlib settings, thinning of long curves."""

import io
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

matplotlib.use('Agg')

# Okabe-Ito blue and vermilion: told apart by colour-blind readers, and in print by lightness.
_SENSOR = ('#0072b2', '#d55e00', '#00795a', '#a5456f', '#7a5c2e', '#5b4ea8', '#4d4d4d', '#b8860b')
SENSOR = _SENSOR * 4
"""Colour of each sensor or joint, in every figure; from the ninth on, colours come again."""
_PALE = ('#9fcbe6', '#f3bc95', '#96d3c0', '#e3b5c9', '#d3c1a3', '#c3bde3', '#c4c4c4', '#ecd79a')
PALE = _PALE * 4
"""The same, for wide lines below the thin ones."""
INK, SOFT, GRID, BAND = '#1b2733', '#5b6774', '#dde2e8', '#c3cad2'
PAPER = '#ffffff'

SETTINGS: Any = {
    'font.family': 'DejaVu Sans', 'font.size': 9.0, 'axes.titlesize': 9.5, 'axes.labelsize': 9.0,
    'legend.fontsize': 8.5, 'xtick.labelsize': 8.5, 'ytick.labelsize': 8.5,
    'axes.titleweight': 'bold', 'axes.titlelocation': 'left', 'axes.spines.top': False,
    'axes.spines.right': False, 'axes.grid': True, 'axes.axisbelow': True, 'grid.color': GRID,
    'grid.linewidth': 0.8, 'grid.alpha': 1.0, 'axes.edgecolor': SOFT, 'axes.linewidth': 0.8,
    'xtick.color': SOFT, 'ytick.color': SOFT, 'xtick.labelcolor': INK, 'ytick.labelcolor': INK,
    'axes.labelcolor': INK, 'axes.titlecolor': INK, 'text.color': INK, 'figure.facecolor': PAPER,
    'axes.facecolor': 'none', 'legend.frameon': False, 'lines.linewidth': 1.2,
    'lines.solid_capstyle': 'round', 'hatch.linewidth': 0.7, 'hatch.color': SOFT,
    'axes.unicode_minus': True,
    'figure.constrained_layout.use': True, 'figure.constrained_layout.h_pad': 0.06,
    'figure.constrained_layout.w_pad': 0.05,
}  # fmt: skip
_POINTS = 1500
"""Points of a curve: more than a figure has pixels across."""
SPARSE: dict[str, Any] = {'handlelength': 1.7, 'columnspacing': 1.3, 'handletextpad': 0.5}
"""Spacing of legends that stand in one row."""


def thin(time: np.ndarray, *curves: np.ndarray) -> tuple[np.ndarray, ...]:
    """Fewer points that look the same: of every bin the lowest and highest one of each curve."""
    if len(time) < 3 * _POINTS:
        return time, *curves
    index = np.unique(np.concatenate([_extremes(values) for values in curves]))
    return time[index], *(values[index] for values in curves)


def _extremes(values: np.ndarray) -> np.ndarray:
    count = len(values)
    size = -(-count // _POINTS)
    starts = np.arange(0, count, size)
    bins = np.full((len(starts), size), np.nan)
    bins.flat[:count] = values
    gaps = np.isnan(bins)
    lowest = np.where(gaps, np.inf, bins).argmin(axis=1)
    highest = np.where(gaps, -np.inf, bins).argmax(axis=1)
    # A NaN among numbers marks a gap's border, which must not be bridged.
    border = np.where(gaps.any(axis=1), gaps.argmax(axis=1), lowest)
    index = np.unique([starts + lowest, starts + highest, starts + border])
    return np.array([0, *index[index < count], count - 1])


def legend_above(axis: Axes) -> None:
    """Legend in one row on the right, above the data."""
    handles, labels = axis.get_legend_handles_labels()
    if handles:
        place: dict[str, Any] = {'loc': 'lower right', 'bbox_to_anchor': (1.0, 1.0), **SPARSE}
        axis.legend(handles, labels, ncols=len(handles), borderaxespad=0.25, **place)


def shade(axis: Axes, spans: Iterable[tuple[float, float]], label: str, **look: Any) -> None:
    """Shade intervals of time [s] behind the data, with one entry in the legend."""
    for number, (start, end) in enumerate(spans):
        name = None if number else label
        axis.axvspan(start, end, label=name, linewidth=0, zorder=0, **look)


HATCHED = {'facecolor': 'none', 'edgecolor': SOFT, 'hatch': '////'}
"""Look of obstacles, and of where a sensor is not diagnosable."""


def picture(draw: Callable[..., Figure | None], *subject: Any) -> bytes:
    """PNG of the figure that a function draws of a subject; empty where it draws none."""
    buffer = io.BytesIO()
    with plt.rc_context(SETTINGS), warnings.catch_warnings():
        # Names in scripts that the font lacks are boxes here; pages have them as text.
        warnings.filterwarnings('ignore', 'Glyph .* missing from')
        figure = draw(*subject)
        if figure is not None:
            for text in figure.findobj(Text):
                if 'mathdefault' not in text.get_text():  # of logarithmic axes
                    text.set_parse_math(not text.get_text())  # names are no formulas
            figure.savefig(buffer, format='png', dpi=160)
            plt.close(figure)
    return buffer.getvalue()
