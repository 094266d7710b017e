"""Messages of a fixed shape in the form in which they are sent, with stamp and numbers in place.

rclpy copies a message field by field whenever it is published, which takes longer than all of this
graph's mathematics.  Here a message is serialised once; numbers then go straight from the memory of
compiled code to their places.
"""

import struct
import sys
from collections.abc import Mapping
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from lpv.core.support.timestamps import LAST_STAMP, NANOSECONDS

_LITTLE_ENDIAN = sys.byteorder == 'little'
_HEADER = 4  # the representation identifier; alignment counts from behind it [bytes]
_FORMATS = {'boolean': '?', 'uint8': 'B', 'int32': 'i', 'uint32': 'I', 'float': 'f', 'double': 'd'}
"""Formats of the numbers that this graph's messages are made of, of the module struct."""
_TIME = struct.Struct('=iI')


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
        cdr = _Cdr(message)
        self._data, self._stamp = cdr.data, cdr.places[f'{stamp}.sec'][0]
        self._pieces = []
        for name, values in numbers.items():
            start, size = cdr.places[name]
            if size != values.nbytes:
                raise ValueError(f'{name} has {size} bytes in the message, not {values.nbytes}')
            target = memoryview(self._data)[start : start + size]
            self._pieces.append((target, values.data.cast('B')))
        if deserialize_message(bytes(self._data), type(message)) != message:
            raise ValueError(f'the middleware reads another {type(message).__name__}')

    def at(self, stamp: int) -> bytes:
        """The message with a stamp [ns] and the present numbers, for a publisher."""
        seconds, rest = divmod(min(stamp, LAST_STAMP), NANOSECONDS)
        _TIME.pack_into(self._data, self._stamp, seconds, rest)
        for target, values in self._pieces:
            target[:] = values
        return bytes(self._data)


class _Cdr:
    """A message in the common data representation of DDS: ``data``, and ``places`` of numbers."""

    def __init__(self, message: Any) -> None:
        self.data = bytearray((0, _LITTLE_ENDIAN, 0, 0))
        self.places: dict[str, tuple[int, int]] = {}  # start and size [bytes]
        self._message(message, '')

    def _message(self, message: Any, path: str) -> None:
        for name, kind in message.get_fields_and_field_types().items():
            value = getattr(message, name)
            if kind.startswith('sequence<'):
                self._numbers('uint32', [len(value)], f'len({path}{name})')
                self._elements(kind[9:-1], value, path + name)
            else:
                self._elements(kind, [value], path + name)

    def _elements(self, kind: str, values: Any, name: str) -> None:
        if kind in _FORMATS:
            self._numbers(kind, values, name)
            return
        for value in values:
            if kind == 'string':
                text = value.encode() + b'\0'
                self._numbers('uint32', [len(text)], f'len({name})')
                self.data += text
            else:
                self._message(value, f'{name}.')

    def _numbers(self, kind: str, values: Any, name: str) -> None:
        packed = struct.pack(f'={len(values)}{_FORMATS[kind]}', *values)
        if packed:
            self.data += bytes(-(len(self.data) - _HEADER) % struct.calcsize(_FORMATS[kind]))
        self.places[name] = len(self.data), len(packed)
        self.data += packed
