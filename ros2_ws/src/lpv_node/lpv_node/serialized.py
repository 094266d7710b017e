"""Messages of a fixed shape in the form in which they are sent, with stamp and numbers in place.

rclpy copies a message field by field whenever it is published, which takes longer than all of this
graph's mathematics.  Here a message is serialised once; numbers then go straight from the memory of
compiled code to their places.
"""

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from lpv.bag.blocks.cdr_layout import Layout
from lpv.bag.rosbag.interfaces import decode, make_typestore, padded_cdr
from lpv.bag.rosbag.live import type_name
from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS

_TIME = struct.Struct('<iI')


class SerializedMessage:
    """A message of which only the stamp and some ``numbers``, by contiguous memory, change."""

    def __init__(
        self, message: Any, numbers: Mapping[str, np.ndarray], stamp: str = 'header.stamp'
    ) -> None:
        for name, values in numbers.items():
            zeros = np.zeros_like(values).tolist()
            setattr(
                message, name, zeros if hasattr(getattr(message, name), '__len__') else zeros[0]
            )
        kind, types = type_name(type(message)), make_typestore()
        # The middleware leaves old memory between fields.
        whole = decode(types.deserialize_cdr, serialize_message(message), kind)
        data = padded_cdr(types, whole, kind)
        places, self._data = Layout(data, kind, types).fields, bytearray(data)
        self._stamp, self._pieces = places[f'{stamp}.sec'].offset, []
        for name, values in numbers.items():
            start, size = places[name].offset, places[name].size
            if size != values.nbytes:
                raise ValueError(f'{name} has {size} bytes in the message, not {values.nbytes}')
            target = memoryview(self._data)[start : start + size]
            self._pieces.append((target, values.data.cast('B')))

    def at(self, stamp: int) -> bytes:
        """The message with a stamp [ns] and the present numbers, for a publisher."""
        seconds, rest = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        _TIME.pack_into(self._data, self._stamp, seconds, rest)
        for target, values in self._pieces:
            target[:] = values
        return bytes(self._data)
