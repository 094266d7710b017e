"""Self-contained pages: templates, embedded pictures."""

import base64
from pathlib import Path

import jinja2
from matplotlib.figure import Figure

from lpv_report.style import png


def css_string(text: str) -> str:
    """A string of a style sheet that cannot end the string, the sheet or the element."""
    return (
        '"'
        + ''.join(
            c if c.isascii() and c.isalnum() else f'\\{ord(c):06x}' for c in text if c != '\0'
        )
        + '"'
    )


def environment(folder: str | Path) -> jinja2.Environment:
    """Templates of a folder; they escape everything, and refuse names that are not given.

    They can include ``style.css`` of all reports, too, which needs ``title`` and ``tiles``: the
    list of figures in the row of tiles on top.
    """
    found = jinja2.Environment(
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
        loader=jinja2.FileSystemLoader([Path(folder), Path(__file__).parent]),
    )
    found.filters['css_string'] = css_string
    return found


def embedded(figure: Figure | bytes) -> str:
    """A figure as a data URL."""
    data = figure if isinstance(figure, bytes) else png(figure)
    return 'data:image/png;base64,' + base64.b64encode(data).decode()
