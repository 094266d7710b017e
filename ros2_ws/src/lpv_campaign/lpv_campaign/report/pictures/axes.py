"""Axes of the pictures."""

from matplotlib.axis import Axis
from matplotlib.ticker import FixedLocator, NullLocator

_MOST_LABELS = 4


def plain_decades(axis: Axis, low: float, high: float) -> None:
    """Few and plain labels on a logarithmic axis, however short it is."""
    marks = [m * 10.0**k for k in range(-9, 10) for m in (1, 2, 5)]
    inside = [m for m in marks if low * 0.95 <= m <= high * 1.05]
    if len(inside) > _MOST_LABELS:
        tens = [m for m in inside if f'{m:e}'.startswith('1')]
        inside = tens if len(tens) > 1 else inside[::2]
    axis.set_major_locator(FixedLocator(inside or [low]))
    axis.set_major_formatter('{x:g}')
    axis.set_minor_locator(NullLocator())
