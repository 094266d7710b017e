"""Messages of a fixed shape in the form in which they are sent, with stamp and numbers in place.

rclpy copies a message field by field whenever it is published, which takes longer than all of this
graph's mathematics.  Here a message is serialised once; numbers then go straight from the memory of
compiled code to their places.
"""

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from lpv.bag.blocks.cdr_layout import Layout
from lpv.bag.rosbag.interfaces import standard_types
from lpv.bag.rosbag.messages import BagMessages
from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS

_TIME = struct.Struct('<iI')


class SerializedMessage:
    """A message of which only the stamp and some ``numbers``, by contiguous memory, change."""

    def __init__(
        self, msgtype: str, frame_id: str, numbers: Mapping[str, np.ndarray], **others: Any
    ) -> None:
        types = standard_types()
        kinds, fields = dict(types.fielddefs[msgtype][1]), others
        for name, values in numbers.items():
            fields[name] = values[0] if kinds[name][0] == Nodetype.BASE else values
        data = BagMessages(types, frame_id).cdr(msgtype, 0, fields)
        places, self._data = Layout(data, msgtype, types).fields, bytearray(data)
        self._stamp, self._pieces = places['header.stamp.sec'][1], []
        for name, values in numbers.items():
            size, start = places[name][0].itemsize, places[name][1]
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
