"""Elements of the XML that an arm is written as."""

from typing import Any
from xml.etree import ElementTree

import numpy as np


def add_element(parent: ElementTree.Element, tag: str, **attributes: Any) -> ElementTree.Element:
    """A child element; numbers and sequences of numbers keep every digit."""
    texts = {name: _text(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, texts)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ' '.join(map(_digits, np.atleast_1d(value)))


def _digits(value: float) -> str:
    return repr(float(value)) if value else '0'
