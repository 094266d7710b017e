"""Number sequences of messages in the form that rclpy copies as a whole."""

from array import array
from collections.abc import Iterable

import numpy as np


def doubles(values: Iterable[float]) -> 'array[float]':
    """Values of a ``float64[]`` field: rclpy would copy other types number by number."""
    if not isinstance(values, np.ndarray) or values.dtype != float:
        return array('d', values)
    return array('d', values.tobytes())
