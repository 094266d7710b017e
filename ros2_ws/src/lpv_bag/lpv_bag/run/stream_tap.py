"""Other streams of a bag beside its measurements, for replays that write nothing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.cdr_layout import Layout, find_layout
from lpv_bag.blocks.message_blocks import Block
from lpv_bag.rosbag.reading import BagReader
from lpv_bag.run.record import STREAMS, find_connections, stamp_of
from lpv_bag.run.streams import lengths

_NONE = np.empty(0, np.int64)


class StreamTap:
    """Reads streams from the blocks that a replay reads; takes the place of its writer."""

    def __init__(self, reader: BagReader, prefix: str, streams: Sequence[str]) -> None:
        self._readers: dict[str, _StreamReader] = {}
        self._connections: Sequence[Connection] = ()
        for name in streams:
            found = find_connections(reader, STREAMS[name][0], name, namespace=prefix)
            if found:
                self._readers[name] = _StreamReader(reader, name, found[0].topic)
        self.present = set(self._readers)
        self._topics = {stream.topic for stream in self._readers.values()}

    def is_copied(self, connection: Connection) -> bool:
        """Whether messages of a connection are wanted."""
        return connection.topic in self._topics

    def choose(
        self, reader: BagReader, connections: Sequence[Connection], block: Block
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nothing is copied; remember what a block's numbers of connections mean."""
        self._connections = connections
        return _NONE, _NONE

    def read(self, block: Block) -> dict[str, tuple[Any, ...] | None]:
        """Messages of the streams in a block."""
        found: dict[str, tuple[Any, ...] | None] = dict.fromkeys(self._readers)
        for name, stream in self._readers.items():
            mine = np.array([c.topic == stream.topic for c in self._connections])
            positions = np.flatnonzero(mine[block.connection])
            if len(positions):
                found[name] = stream.read(block, positions)
        return found


class _StreamReader:
    """Messages of one topic; those whose arrays are longer or shorter than before are left out."""

    def __init__(self, reader: BagReader, name: str, topic: str) -> None:
        self.topic, self._reader, self._name = topic, reader, name
        self._msgtype, self._fields = STREAMS[name]
        self._lengths: dict[str, int] = {}
        self._layout: Layout | None = None

    def read(self, block: Block, positions: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        starts, sizes = block.start[positions], block.size[positions]
        if not self._lengths:
            data = block.message(positions[0])
            self._lengths = lengths(self._name, self._reader.deserialize(data, self._msgtype))
            self._layout = find_layout(
                data, self._msgtype, self._reader.typestore_of(self._msgtype)
            )
        if self._layout is not None and self._layout.match(block.data, starts, sizes).all():
            values = {name: self._layout.read(block.data, starts, name) for name in self._fields}
            return self._layout.stamps(block.data, starts), values
        messages = [self._reader.deserialize(block.message(k), self._msgtype) for k in positions]
        messages = [m for m in messages if lengths(self._name, m) == self._lengths]
        return (
            np.array([stamp_of(m.header.stamp) for m in messages], np.int64),
            {
                name: np.array([np.atleast_1d(getattr(m, name)) for m in messages])
                for name in self._fields
            },
        )
