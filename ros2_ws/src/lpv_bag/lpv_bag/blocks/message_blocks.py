"""Messages of a bag in blocks of some megabytes, so that NumPy can work on thousands at once."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from rosbags.interfaces import Connection

from lpv_bag.blocks.mcap_blocks import RECORD_HEADER, Unsuitable, bag_blocks
from lpv_bag.rosbag.mcap_bag import McapBag
from lpv_bag.rosbag.reading import BagReader

BLOCK_SIZE = 2 << 20
"""Of about one block [bytes]: it fits into the caches, and overheads do not count."""


@dataclass
class Block:
    """Consecutive messages."""

    # bytes that hold all messages; before each are at least `RECORD_HEADER` other bytes
    data: np.ndarray
    # index of each message's connection in the list that was asked for; shape (n,)
    connection: np.ndarray
    time: np.ndarray  # log times [ns], in order; shape (n,)
    start: np.ndarray  # where in ``data`` each message begins, and its length [bytes]; shape (n,)
    size: np.ndarray  # where in ``data`` each message begins, and its length [bytes]; shape (n,)

    def __len__(self) -> int:
        return len(self.time)

    def message(self, index: int) -> bytes:
        """Bytes of one message."""
        start = self.start[index]
        return self.data[start : start + self.size[index]].tobytes()


def read_blocks(
    reader: BagReader,
    connections: Sequence[Connection],
    start: int | None = None,
    stop: int | None = None,
    fast: bool = True,
) -> Iterator[Block]:
    """Messages of some connections in the order of ``reader.messages``.

    MCAP files in good order are read a chunk at a time.  Everything else, and every file in which
    something unexpected turns up, is read by the reader itself, which gives the same messages.

    Parameters
    ----------
    reader : lpv_bag.rosbag.reading.BagReader
        Open bag.
    connections : list of rosbags connections
        Wanted ones.
    start, stop : int, optional
        First log time, and first one after the end [ns].
    fast : bool, optional
        False reads message by message whatever the file is like.

    Yields
    ------
    Block
        Not empty.

    Raises
    ------
    BagError
        If the bag is damaged.
    """
    done = 0
    if fast:
        try:
            for block in _fast_blocks(reader, connections, start, stop):
                yield block
                done += len(block)
            return
        except Unsuitable:
            pass
    messages = reader.messages(connections, start=start, stop=stop)
    yield from _collect(islice(messages, done, None), connections)


def _fast_blocks(
    reader: BagReader, connections: Sequence[Connection], start: int | None, stop: int | None
) -> Iterator[Block]:
    if not isinstance(reader.source, McapBag):
        raise Unsuitable
    for parts in bag_blocks(reader.source, connections, start, stop, BLOCK_SIZE):
        yield Block(*parts)


def _collect(
    messages: Iterable[tuple[Connection, int, bytes]], connections: Sequence[Connection]
) -> Iterator[Block]:
    """Blocks of messages that come one by one."""
    index = {id(c): i for i, c in enumerate(connections)}
    rows, data = [], bytearray()
    for connection, time, content in messages:
        data += bytes(RECORD_HEADER)
        number = index.get(id(connection))
        if number is None:
            number = index[id(connection)] = connections.index(connection)
        rows.append((number, time, len(data), len(content)))
        data += content
        if len(data) >= BLOCK_SIZE:
            yield _block(rows, data)
            rows, data = [], bytearray()
    if rows:
        yield _block(rows, data)


def _block(rows: list[tuple[int, int, int, int]], data: bytearray) -> Block:
    columns = np.array(rows, dtype=np.int64).T
    return Block(np.frombuffer(data, np.uint8), *columns)
