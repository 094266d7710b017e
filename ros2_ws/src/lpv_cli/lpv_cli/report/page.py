"""The page: template, style sheet, and how numbers are written."""

import math
from pathlib import Path

import jinja2


def number(value, form):
    """A number as text.

    Parameters
    ----------
    value : float or None
        The number.
    form : str
        Format of the % operator.

    Returns
    -------
    str
        A dash where there is no finite number.
    """
    return form % value if value is not None and math.isfinite(value) else '-'


def share(value):
    """A share from 0 to 1 as percentage; a dash for None."""
    return '-' if value is None else f'{100.0 * value:.1f} %'


def css_string(text):
    """A string of a style sheet that cannot end the string, the sheet or the element.

    Parameters
    ----------
    text : str
        Any text.

    Returns
    -------
    str
        In quotes, with all but letters and digits escaped by their numbers: safe in HTML, too.
    """
    return '"' + ''.join(c if c.isascii() and c.isalnum() else f'\\{ord(c):06x}'
                         for c in text if c != '\0') + '"'


def render(values, figures):
    """The page as text.

    Parameters
    ----------
    values : dict
        Of `lpv_cli.report.content.content`.
    figures : dict of str to dict
        Caption and data (base64) of each picture by name.

    Returns
    -------
    str
        HTML that needs nothing from elsewhere.
    """
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined,
        loader=jinja2.FileSystemLoader(Path(__file__).parent))
    environment.filters.update(number=number, share=share, css_string=css_string)
    known = {name: None for name in ('timeline', 'detectability', 'map')}
    others = [name for name in figures if name not in known]
    return environment.get_template('report.html').render(
        **values, figures={**known, **figures}, signals=others).lstrip()
