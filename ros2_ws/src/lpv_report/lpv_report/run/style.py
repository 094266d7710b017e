"""Look of the figures, that of all reports."""

from lpv_report.style import BAND, GRID, INK, PALE, PAPER, SENSOR, SETTINGS, SOFT, png, thin

__all__ = ['BAND', 'GRID', 'INK', 'PALE', 'PAPER', 'SENSOR', 'SETTINGS', 'SOFT', 'png', 'thin']
