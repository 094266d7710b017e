"""Self-contained pages: templates, embedded pictures."""

import base64
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
import numpy as np

from lpv.core.support.config import write_whole
from lpv.report.style import picture


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
    loader = jinja2.FileSystemLoader([Path(folder), Path(__file__).parent])
    options: Any = dict.fromkeys(('autoescape', 'trim_blocks', 'lstrip_blocks'), True)
    found = jinja2.Environment(loader=loader, undefined=jinja2.StrictUndefined, **options)
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
    captions: Mapping[Any, str],  # of functions that draw a figure of the subject, or none
    subject: Any,
    content: Mapping[str, Any],
    **filters: Any,
) -> Path:
    """Write a page by ``report.html`` of a folder, and its pictures, named as what draws them."""
    page.parent.mkdir(parents=True, exist_ok=True)
    pictures, found = {}, environment(templates)
    for draw, caption in captions.items():
        if data := picture(draw, subject):
            write_whole(page.with_name(f'{draw.__name__}.png'), data)
            url = f'data:image/png;base64,{base64.b64encode(data).decode()}'
            pictures[draw.__name__] = {'caption': caption, 'data': url}
    found.filters.update(filters)
    text = found.get_template('report.html').render(**content, figures=pictures)
    write_whole(page, text.lstrip())  # someone may look at it
    return page
