"""Self-contained pages: templates, embedded pictures."""

import base64
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np


class Tile(NamedTuple):
    """A figure on top of the page."""

    name: str
    value: str | int
    note: str = ''
    look: str = ''  # '', good, bad or warn


def css_string(text: str) -> str:
    """A string of a style sheet that cannot end the string, the sheet or the element."""
    letters = (c if c.isascii() and c.isalnum() else f'\\{ord(c):06x}' for c in text if c != '\0')
    return f'"{"".join(letters)}"'


def environment(folder: str | Path) -> jinja2.Environment:
    """Templates of a folder and all reports' ``style.css``; unknown names are refused."""
    found = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.FileSystemLoader([Path(folder), Path(__file__).parent]),
    )
    found.filters['css_string'] = css_string
    return found


def finite(data: Any) -> Any:
    """Plain data without numbers that are none: JSON has no word for them."""
    data = data.item() if isinstance(data, np.generic) else data
    if isinstance(data, dict):
        return {key: finite(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [finite(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data


def write_page(
    page: Path,
    templates: Path,
    pictures: Iterable[tuple[str, str, bytes]],
    filters: Mapping[str, Any],
    content: Mapping[str, Any],
) -> Path:
    """Write a page by ``report.html`` of a folder, and its pictures: names, captions, PNGs."""
    page.parent.mkdir(parents=True, exist_ok=True)
    figures, found = {}, environment(templates)
    for name, caption, data in pictures:
        page.with_name(f'{name}.png').write_bytes(data)
        figures[name] = {'caption': caption, 'data': embedded(data)}
    found.filters.update(filters)
    text = found.get_template('report.html').render(**content, figures=figures)
    page.write_text(text.lstrip(), encoding='utf-8')
    return page


def embedded(picture: bytes) -> str:
    """A PNG as a data URL."""
    return 'data:image/png;base64,' + base64.b64encode(picture).decode()
