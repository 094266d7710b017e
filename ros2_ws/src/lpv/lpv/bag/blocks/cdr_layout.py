"""Where the numbers of messages of one shape are: found once, then thousands are read at once."""

import struct
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from lpv.bag.blocks.message_blocks import rows

_SIZES = {
    'bool': '?', 'octet': 'u1', 'byte': 'u1', 'char': 'u1', 'int8': '<i1', 'uint8': '<u1',
    'int16': '<i2', 'uint16': '<u2', 'int32': '<i4', 'uint32': '<u4', 'int64': '<i8',
    'uint64': '<u8', 'float32': '<f4', 'float64': '<f8',
}  # fmt: skip
"""NumPy's names of the numbers of messages."""
_HEADER = 4  # the representation identifier; alignment counts from behind it
_LITTLE_ENDIAN = b'\x00\x01'
_MOST_PADDING = 7
"""Bytes behind a message: up to three, and four of an empty sequence of doubles at the end."""
_LARGEST = 4096
"""Messages with more bytes are read one by one: copying them is what takes the time."""


class _NoLayout(Exception):
    """The message has no fixed shape, or is not understood."""


class Layout:
    """Shape of one message and of all that are like it.

    ``fields`` are as those of `numpy.dtype`: type of the vector of all numbers of a field, and its
    offset from the beginning of the message, representation identifier included [bytes].
    """

    def __init__(self, data: bytes, msgtype: str, typestore: Typestore) -> None:
        self.size = len(data)
        self.fields: dict[str, tuple[np.dtype, int]] = {}
        self._data, self._typestore = bytes(data), typestore
        self._fixed = [(0, 2)]
        if data[:2] != _LITTLE_ENDIAN:
            raise _NoLayout
        self._position = _HEADER
        self._node('', (Nodetype.NAME, msgtype))
        if len(data) - self._position > _MOST_PADDING:
            raise _NoLayout
        self._words = self._constant_words()
        del self._data, self._typestore, self._position

    def match(self, buffer: np.ndarray, starts: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Which messages have this shape."""
        found = sizes == self.size
        if not found.all():
            starts = starts[found]
        same = np.ones(len(starts), bool)
        for offset, word in self._words:
            same &= rows(buffer, word.dtype, starts + offset) == word
        found[found] = same
        return found

    def read(self, buffer: np.ndarray, starts: np.ndarray, name: str) -> np.ndarray:
        """Numbers of messages of this shape."""
        vector, offset = self.fields[name]
        if vector.itemsize == 0:
            return np.empty((len(starts), 0), vector.base)
        found = rows(buffer, f'V{vector.itemsize}', starts + offset)
        return found.view(vector.base).reshape(len(starts), *vector.shape)

    def stamps(self, buffer: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Times of messages of this shape as nanoseconds, int64, shape (k,)."""
        seconds = self.read(buffer, starts, 'header.stamp.sec')[:, 0].astype(np.int64)
        return seconds * 1_000_000_000 + self.read(buffer, starts, 'header.stamp.nanosec')[:, 0]

    def _constant_words(self) -> list[tuple[int, np.unsignedinteger]]:
        """What all messages of the shape have in common, as few numbers to compare."""
        found = []
        for start, end in self._fixed:
            while start < end:
                size = next(s for s in (8, 4, 2, 1) if s <= end - start)
                found.append((start, np.frombuffer(self._data, f'<u{size}', 1, start)[0]))
                start += size
        return found

    def _node(self, path: str, node: Any) -> None:
        kind, what = node
        if kind == Nodetype.NAME:
            for name, part in self._typestore.fielddefs[what][1]:
                self._node(f'{path}.{name}' if path else name, part)
        elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (node, size), (form, base) = what, what[0]
            count = size if kind == Nodetype.ARRAY else self._length()
            if form == Nodetype.BASE and base[0] != 'string':
                self._numbers(path, base[0], count)
                return
            for i in range(count):
                self._node(f'{path}.{i}', node)
        elif what[0] == 'string':
            length = self._length()
            start = self._advance(length)
            if length == 0 or self._data[start + length - 1] != 0:
                raise _NoLayout
            # Joined with its length: fewer and longer pieces are compared faster.
            self._fixed[-1] = (start - 4, start + length)
        else:
            self._numbers(path, what[0], 1)

    def _align(self, size: int) -> None:
        self._position += -(self._position - _HEADER) % size

    def _advance(self, size: int) -> int:
        start, self._position = self._position, self._position + size
        if not start <= self._position <= self.size:
            raise _NoLayout
        return start

    def _length(self) -> int:
        self._align(4)
        start = self._advance(4)
        self._fixed.append((start, start + 4))
        return struct.unpack_from('<I', self._data, start)[0]

    def _numbers(self, path: str, kind: str, count: int) -> None:
        if kind not in _SIZES:
            raise _NoLayout
        number = np.dtype(_SIZES[kind])
        if count:
            self._align(number.itemsize)
        start = self._advance(number.itemsize * count)
        self.fields[path] = np.dtype((number, (count,))), start


def find_layout(data: bytes, msgtype: str, typestore: Typestore) -> Layout | None:
    if len(data) > _LARGEST:
        return None
    try:
        return Layout(data, msgtype, typestore)
    except (_NoLayout, KeyError, UnicodeDecodeError):
        return None
