"""An MCAP file that is open for reading, and what is known of it."""

import mmap
from dataclasses import dataclass, field
from pathlib import Path

from lpv_bag.mcap.content import inflate, inflate_part
from lpv_bag.rosbag.errors import BagError, DamageError


@dataclass
class Block:
    """A part of the file that holds messages: a chunk, or messages outside of chunks.

    Attributes
    ----------
    offset, length : int
        Of the stored data.
    compression : str
        '', 'zstd' or 'lz4'.
    size, crc : int
        Of the content; a checksum of 0 is none.
    start, end : int
        Least and greatest log time [ns].
    counts : dict of int to int
        Messages by channel, where known.
    cut : bool
        Whether the file ends within it.
    loose : bool
        Whether its messages are outside of chunks.
    """

    offset: int
    length: int
    compression: str
    size: int
    crc: int
    start: int = 0
    end: int = 0
    counts: dict = field(default_factory=dict)
    cut: bool = False
    loose: bool = False


@dataclass
class Survey:
    """What a file holds.

    Attributes
    ----------
    schemas, channels : dict of int
        `Schema` and `Channel` by their numbers.
    blocks : list of Block
        In the order of the file; in a damaged file only those that can be read.
    lost_blocks : list of Block
        Chunks that cannot be read.
    metadata : list of tuple
        Offset, name and dict of each metadata record (of an undamaged file: offset, name, None).
    attachments : int
        Attachments in the file.
    counts : dict of int to int or None
        Messages by channel by the file's own statistics.
    complete : bool
        Whether the recording was finished: no messages are missing at the end.
    damages : list of str
        What is wrong; empty for a good file.
    library : str
        What wrote the file.
    """

    schemas: dict = field(default_factory=dict)
    channels: dict = field(default_factory=dict)
    blocks: list = field(default_factory=list)
    lost_blocks: list = field(default_factory=list)
    metadata: list = field(default_factory=list)
    attachments: int = 0
    counts: dict = None
    complete: bool = False
    damages: list = field(default_factory=list)
    library: str = ''

    def define(self, record) -> None:
        """Take a schema or channel; DamageError if its number means something else already."""
        known = self.channels if hasattr(record, 'topic') else self.schemas
        if known.setdefault(record.id, record) != record:
            raise DamageError(f'the number {record.id} means two different topics or schemas')


def release(data: mmap.mmap | bytes) -> None:
    """Unmap the pages of a mapped file that have been read: they count as memory otherwise.

    Parameters
    ----------
    data : mmap.mmap or bytes
        The file; it can be read on.
    """
    if hasattr(data, 'madvise') and hasattr(mmap, 'MADV_DONTNEED'):
        data.madvise(mmap.MADV_DONTNEED)


class McapFile:
    """The bytes of a file, mapped.

    Parameters
    ----------
    path : str or pathlib.Path
        File.

    Raises
    ------
    BagError
        If it cannot be read or is empty.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with open(path, 'rb') as file:
                self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = 'is empty' if isinstance(error, ValueError) else f'cannot be read ({error})'
            raise BagError(f'{path}: {reason}') from None

    def close(self) -> None:
        """Give the file back."""
        self.data.close()

    def content(self, block: Block) -> bytes:
        """Checked content of a block.

        Parameters
        ----------
        block : Block
            Of this file.

        Returns
        -------
        bytes
            Content; of a block that is cut off, as much as can be had.

        Raises
        ------
        DamageError
            If it is damaged.
        """
        data = self.data[block.offset : block.offset + block.length]
        release(self.data)
        if block.cut:
            return inflate_part(data, block.compression, block.size)
        return inflate(data, block.compression, block.size, block.crc)
