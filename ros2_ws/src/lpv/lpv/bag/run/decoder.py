"""Decodes messages of one type, thousands at a time where they have the same shape."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from lpv.bag.blocks.cdr_layout import Layout, find_layout
from lpv.bag.blocks.message_blocks import Block
from lpv.bag.rosbag.reading import BagReader
from lpv.core.support.errors import SampleError
from lpv.core.support.timestamps import to_nanoseconds

MOST_LAYOUTS = 8
"""Shapes of one topic's messages that are learnt; each is tried on every block."""
_MOST_ATTEMPTS = 4 * MOST_LAYOUTS
"""Messages from which a shape is to be learnt; then they are read one by one."""
Columns = tuple[Any, int]
"""Columns to take of a field, and how many it must have for that; -1 for any number."""
Table = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]
"""Positions in a block, header stamps [ns] (zeros without a header) and fields, a row each."""


class Decoder:
    """Decodes numbers at some paths; ``choose`` gives a shape's columns or raises SampleError."""

    def __init__(
        self, reader: BagReader, msgtype: str, paths: Sequence[str], choose: Callable[..., Columns]
    ) -> None:
        self._reader, self._msgtype, self._choose = reader, msgtype, choose
        self._paths, self._attempts = tuple(paths), _MOST_ATTEMPTS
        self._shapes: list[tuple[Layout, Columns | str]] = []  # and why they cannot be used
        self.rejected = Counter[str]()

    def read(self, block: Block, positions: np.ndarray) -> Table | None:
        """Messages at some positions of a block, in their order; None if none can be used."""
        parts = list(self._parts(block, positions))
        if len(parts) < 2:
            return parts[0] if parts else None
        places, stamps = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
        order = np.argsort(places)
        fields = {path: np.concatenate([p[2][path] for p in parts])[order] for path in self._paths}
        return places[order], stamps[order], fields

    def _parts(self, block: Block, left: np.ndarray) -> Iterator[Table]:
        for shape in self._shapes:
            found, left = _match(block, left, shape[0])
            yield from self._part(block, found, *shape)
        while len(left):
            data = block.message(left[0])
            message = self._reader.deserialize(data, self._msgtype)
            try:
                columns: Columns | str = self._choose(message)
            except SampleError as error:
                columns = str(error)
            layout = self._layout(data, message)
            if layout is not None:
                self._shapes.append((layout, columns))
                found, left = _match(block, left, layout)
                yield from self._part(block, found, layout, columns)
                continue
            if isinstance(columns, str):
                self.rejected[columns] += 1
            else:
                stamp = to_nanoseconds(message.header.stamp) if hasattr(message, 'header') else 0
                read = {path: np.atleast_1d(value_at(message, path))[None] for path in self._paths}
                picked = {path: _picked(values, *columns) for path, values in read.items()}
                yield left[:1], np.array([stamp]), picked
            left = left[1:]

    def _part(
        self, block: Block, places: np.ndarray, layout: Layout, columns: Columns | str
    ) -> Iterator[Table]:
        """Messages of one shape; none where they cannot be used, as ``columns`` say."""
        if isinstance(columns, str) and len(places):
            self.rejected[columns] += len(places)
        elif len(places):
            starts, stamps = block.start[places], np.zeros(len(places), np.int64)
            if 'header.stamp.sec' in layout.fields:
                stamps = layout.stamps(block.data, starts)
            read = {path: layout.read(block.data, starts, path) for path in self._paths}
            yield places, stamps, {path: _picked(v, *columns) for path, v in read.items()}

    def _layout(self, data: bytes, message: Any) -> Layout | None:
        """Layout of a message, if the general reader gives the same numbers."""
        if len(self._shapes) == MOST_LAYOUTS or not self._attempts:
            return None
        self._attempts -= 1
        layout = find_layout(data, self._msgtype, self._reader.typestore)
        if layout is None:
            return None
        bytes_, start = np.frombuffer(data, np.uint8), np.zeros(1, int)
        for path in layout.fields:
            found, value = layout.read(bytes_, start, path)[0], value_at(message, path)
            if not np.array_equal(found, np.atleast_1d(value), equal_nan=found.dtype.kind == 'f'):
                return None
        return layout


def _match(block: Block, places: np.ndarray, layout: Layout) -> tuple[np.ndarray, np.ndarray]:
    """Those of some messages that have a shape, and the others."""
    if not len(places):
        return places, places
    same = layout.match(block.data, block.start[places], block.size[places])
    return (places, places[:0]) if same.all() else (places[same], places[~same])


def _picked(values: np.ndarray, columns: Any, width: int) -> np.ndarray:
    """Columns of a field; NaN where it does not have as many as are expected."""
    if width in (-1, values.shape[1]):
        return values[:, columns].astype(float)
    return np.full((len(values), len(columns)), np.nan)


def value_at(message: Any, path: str) -> Any:
    """Field of a message, as ``header.stamp.sec`` or ``points.0.effort``."""
    for part in path.split('.'):
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    return message
