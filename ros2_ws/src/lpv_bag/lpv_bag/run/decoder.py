"""Decodes messages of one type, thousands at a time where they have the same shape."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_core.support.errors import SampleError

MOST_LAYOUTS = 8
_MOST_ATTEMPTS = 32
"""Messages from which a shape is to be learnt; then they are read one by one."""


class Decoder:
    """Decodes messages of one type.

    Parameters
    ----------
    reader : BagReader
        Open bag.
    msgtype : str
        Message type.
    learn : callable
        What the user of the messages wants to know of all messages of one shape, from the first of
        them; raises SampleError for messages that are to be handled one by one.
    """

    def __init__(self, reader: BagReader, msgtype: str, learn: Callable[[Any], Any]) -> None:
        self._reader, self._msgtype, self._learn = reader, msgtype, learn
        self.shapes: list[tuple[Layout, Any]] = []
        self._attempts = _MOST_ATTEMPTS

    def read(
        self, block: Block, positions: np.ndarray
    ) -> Iterator[tuple[np.ndarray, Layout | None, Any]]:
        """Messages at some positions of a block.

        Yields
        ------
        tuple
            Rows of ``positions``, layout of these messages, and what was learnt of them; or one
            row, None, and the message.
        """
        left = np.arange(len(positions))
        for shape in self.shapes:
            found, left = self._match(block, positions, left, shape[0])
            if len(found):
                yield found, *shape
        while len(left):
            data = block.message(positions[left[0]])
            message = self._reader.deserialize(data, self._msgtype)
            new = self._shape(data, message)
            if new is None:
                yield left[:1], None, message
                left = left[1:]
            else:
                self.shapes.append(new)
                found, left = self._match(block, positions, left, new[0])
                yield found, *new

    @staticmethod
    def _match(
        block: Block, positions: np.ndarray, rows: np.ndarray, layout: Layout
    ) -> tuple[np.ndarray, np.ndarray]:
        if not len(rows):
            return rows, rows
        same = layout.match(block.data, block.start[positions[rows]], block.size[positions[rows]])
        return (rows, rows[:0]) if same.all() else (rows[same], rows[~same])

    def _shape(self, data: bytes, message: Any) -> tuple[Layout, Any] | None:
        if len(self.shapes) == MOST_LAYOUTS or not self._attempts:
            return None
        self._attempts -= 1
        layout = find_layout(data, self._msgtype, self._reader.typestore_of(self._msgtype))
        try:
            # The general reader decides what the bytes mean.
            if layout is not None and _agrees(layout, data, message):
                return layout, self._learn(message)
        except SampleError:
            pass
        return None


def _agrees(layout: Layout, data: bytes, message: Any) -> bool:
    bytes_, start = np.frombuffer(data, np.uint8), np.zeros(1, int)
    for path in layout.fields:
        value = message
        for part in path.split('.'):
            value = value[int(part)] if part.isdigit() else getattr(value, part)
        found = layout.read(bytes_, start, path)[0]
        if not np.array_equal(found, np.atleast_1d(value), equal_nan=found.dtype.kind == 'f'):
            return False
    return True
