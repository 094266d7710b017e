"""Numbers as people read them, the same in every report and command."""

import math


def number(value: float | None, digits: int = 3) -> str:
    """A number with some significant digits; ``-`` where there is none."""
    if value is None or math.isnan(value):
        return '-'
    return 'infinite' if math.isinf(value) else f'{value:.{digits}g}'


def decimals(unit: str) -> int:
    """Decimals of an error in radians or metres: it is a tenth of a millimetre that counts."""
    return 4 if unit.startswith('m') else 3


def bound(value: float, unit: str) -> str:
    """Bound of an error in radians or metres, rounded up; ``-`` where none is stated."""
    if not 0.0 < value < math.inf:
        return '-'
    digits = decimals(unit)
    return f'{math.ceil(value * 10**digits - 1e-6) / 10**digits:.{digits}f}'


def sized(error: float, most: float, unit: str) -> str:
    """An error in radians or metres with its bound; without a finite one its size is not known."""
    if not most < math.inf:
        return 'of unknown size'
    stated = f' (bound {bound(most, unit)} {unit})' if most > 0.0 else ''
    return f'{error:+.{decimals(unit)}f} {unit}{stated}'


def seconds(value: float | None) -> str:
    """A time in s or ms; ``-`` where there is none."""
    if value is None:
        return '-'
    return f'{value:.2f} s' if abs(value) >= 1.0 else f'{1e3 * value:.0f} ms'
