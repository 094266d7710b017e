"""The page: template, and how numbers are written."""

import math
from pathlib import Path
from typing import Any

from lpv_report.page import environment


def number(value: float | None, form: str) -> str:
    """A number as text."""
    return form % value if value is not None and math.isfinite(value) else '-'


def share(value: float | None) -> str:
    """A share from 0 to 1 as percentage; a dash for None."""
    return '-' if value is None else f'{100.0 * value:.1f} %'


def render(values: dict[str, Any], figures: dict[str, dict[str, Any]]) -> str:
    """The page as text."""
    templates = environment(Path(__file__).parent)
    templates.filters.update(number=number, share=share)
    known = {name: None for name in ('timeline', 'detectability', 'map')}
    others = [name for name in figures if name not in known]
    return (
        templates.get_template('report.html')
        .render(**values, figures={**known, **figures}, signals=others)
        .lstrip()
    )
