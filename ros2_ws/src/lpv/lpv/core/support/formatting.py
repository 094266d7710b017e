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


def seconds(value: float | None) -> str:
    """A time in s or ms; ``-`` where there is none."""
    if value is None:
        return '-'
    return f'{value:.2f} s' if abs(value) >= 1.0 else f'{1e3 * value:.0f} ms'
