"""Decodes messages of one type, thousands at a time where they have the same shape."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.streams import stamp_of
from lpv_core.support.errors import SampleError

MOST_LAYOUTS = 8
_MOST_ATTEMPTS = 32
"""Messages from which a shape is to be learnt; then they are read one by one."""


class Part(NamedTuple):
    """Messages that are alike."""

    rows: np.ndarray  # which of the positions asked for; shape (k,)
    stamps: np.ndarray  # header stamps [ns]; shape (k,), zeros of types without header
    values: dict[str, np.ndarray]  # by path; shape (k, count)
    learnt: Any  # of these messages; a SampleError if they cannot be used
    message: Any  # of a message that was read alone, otherwise None


class Decoder:
    """Decodes messages of one type: numbers at some paths, as ``points.0.effort``.

    ``learn`` gives what the user of the messages wants to know of all messages of one shape, from
    the first of them; it raises SampleError for messages that cannot be used.
    """

    def __init__(
        self, reader: BagReader, msgtype: str, paths: Sequence[str], learn: Callable[[Any], Any]
    ) -> None:
        self._reader, self._msgtype, self._learn = reader, msgtype, learn
        self._paths, self._attempts = tuple(paths), _MOST_ATTEMPTS
        self.shapes: list[tuple[Layout, Any]] = []

    def read(self, block: Block, positions: np.ndarray) -> Iterator[Part]:
        """Messages at some positions of a block."""
        left = np.arange(len(positions))
        for shape in self.shapes:
            found, left = self._match(block, positions, left, shape[0])
            if len(found):
                yield self._part(block, positions, found, *shape)
        while len(left):
            data = block.message(positions[left[0]])
            message = self._reader.deserialize(data, self._msgtype)
            try:
                learnt = self._learn(message)
            except SampleError as error:
                learnt = error
            layout = self._layout(data, message, learnt)
            if layout is None:
                yield self._single(left[:1], message, learnt)
                left = left[1:]
            else:
                self.shapes.append((layout, learnt))
                found, left = self._match(block, positions, left, layout)
                yield self._part(block, positions, found, layout, learnt)

    @staticmethod
    def _match(
        block: Block, positions: np.ndarray, rows: np.ndarray, layout: Layout
    ) -> tuple[np.ndarray, np.ndarray]:
        if not len(rows):
            return rows, rows
        same = layout.match(block.data, block.start[positions[rows]], block.size[positions[rows]])
        return (rows, rows[:0]) if same.all() else (rows[same], rows[~same])

    def _part(
        self, block: Block, positions: np.ndarray, rows: np.ndarray, layout: Layout, learnt: Any
    ) -> Part:
        starts = block.start[positions[rows]]
        values = {path: layout.read(block.data, starts, path) for path in self._paths}
        if 'header.stamp.sec' in layout.fields:
            return Part(rows, layout.stamps(block.data, starts), values, learnt, None)
        return Part(rows, np.zeros(len(rows), np.int64), values, learnt, None)

    def _single(self, rows: np.ndarray, message: Any, learnt: Any) -> Part:
        stamp = stamp_of(message.header.stamp) if hasattr(message, 'header') else 0
        values = {}
        if not isinstance(learnt, SampleError):
            values = {path: np.atleast_1d(value_at(message, path))[None] for path in self._paths}
        return Part(rows, np.array([stamp]), values, learnt, message)

    def _layout(self, data: bytes, message: Any, learnt: Any) -> Layout | None:
        """Layout of a message that can be used, if the general reader gives the same numbers."""
        full = len(self.shapes) == MOST_LAYOUTS or not self._attempts
        if full or isinstance(learnt, SampleError):
            return None
        self._attempts -= 1
        layout = find_layout(data, self._msgtype, self._reader.typestore_of(self._msgtype))
        if layout is None:
            return None
        bytes_, start = np.frombuffer(data, np.uint8), np.zeros(1, int)
        for path in layout.fields:
            found, value = layout.read(bytes_, start, path)[0], value_at(message, path)
            if not np.array_equal(found, np.atleast_1d(value), equal_nan=found.dtype.kind == 'f'):
                return None
        return layout


def value_at(message: Any, path: str) -> Any:
    """Field of a message, as ``header.stamp.sec`` or ``points.0.effort``."""
    for part in path.split('.'):
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    return message
