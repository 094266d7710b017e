"""Pages that need nothing from elsewhere: templates, embedded pictures."""

import base64
from pathlib import Path

import jinja2

from lpv_report.style import png


def environment(folder):
    """Environment of templates.

    Parameters
    ----------
    folder : str or pathlib.Path
        Where the templates are. They can include ``style.css`` of all reports, too, which needs
        ``tiles``: the list of figures in the row of tiles on top.

    Returns
    -------
    jinja2.Environment
        Escapes everything, and refuses names that are not given.
    """
    return jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined,
        loader=jinja2.FileSystemLoader([Path(folder), Path(__file__).parent]))


def embedded(figure):
    """A figure as text that stands in a page.

    Parameters
    ----------
    figure : matplotlib.figure.Figure or bytes
        The figure, or its PNG.

    Returns
    -------
    str
        Address with the scheme ``data``.
    """
    data = figure if isinstance(figure, bytes) else png(figure)
    return 'data:image/png;base64,' + base64.b64encode(data).decode()
