"""An MCAP file that is open for reading, and what is known of it."""

import mmap
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lpv_bag.errors import BagError, DamageError
from lpv_bag.mcap.content import inflate, inflate_part
from lpv_bag.mcap.records import Channel, Schema


@dataclass
class Block:
    """A part of the file that holds messages: a chunk, or messages outside of chunks."""

    offset: int  # of the stored data [bytes]
    length: int  # of the stored data [bytes]
    compression: str  # '', 'zstd' or 'lz4'
    size: int  # of the content [bytes]
    crc: int  # checksum of the content; 0 is none
    start: int = 0  # least log time [ns]
    end: int = 0  # greatest log time [ns]
    counts: dict[int, int] = field(default_factory=dict)  # messages by channel, where known
    cut: bool = False  # whether the file ends within it
    loose: bool = False  # whether its messages are outside of chunks


@dataclass
class Survey:
    """What a file holds."""

    schemas: dict[int, Schema] = field(default_factory=dict)  # by their numbers
    channels: dict[int, Channel] = field(default_factory=dict)  # by their numbers
    # in the order of the file; in a damaged file only those that can be read
    blocks: list[Block] = field(default_factory=list)
    lost_blocks: list[Block] = field(default_factory=list)  # chunks that cannot be read
    # offset, name and dict of each metadata record (of an undamaged file: offset, name, None)
    metadata: list[tuple[int, str, dict[str, str] | None]] = field(default_factory=list)
    attachments: int = 0  # attachments in the file
    counts: dict[int, int] | None = None  # messages by channel by the file's own statistics
    complete: bool = False  # whether the recording was finished: no messages are missing at the end
    damages: list[str] = field(default_factory=list)  # what is wrong; empty for a good file
    library: str = ''  # what wrote the file

    def define(self, record: Schema | Channel) -> None:
        """Add a schema or channel; DamageError if its number is in use for another one."""
        known: dict[int, Any] = self.channels if isinstance(record, Channel) else self.schemas
        if known.setdefault(record.id, record) != record:
            raise DamageError(f'the number {record.id} means two different topics or schemas')


def release(data: mmap.mmap | bytes) -> None:
    """Release the pages of a mapped file that have been read: they would count as memory."""
    if hasattr(data, 'madvise') and hasattr(mmap, 'MADV_DONTNEED'):
        data.madvise(mmap.MADV_DONTNEED)


class McapFile:
    """The bytes of a file, mapped."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with open(path, 'rb') as file:
                self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = 'is empty' if isinstance(error, ValueError) else f'cannot be read ({error})'
            raise BagError(f'{path}: {reason}') from None

    def close(self) -> None:
        """Close the file."""
        self.data.close()

    def content(self, block: Block) -> bytes:
        """Checked content of a block."""
        data = self.data[block.offset : block.offset + block.length]
        release(self.data)
        if block.cut:
            return inflate_part(data, block.compression, block.size)
        return inflate(data, block.compression, block.size, block.crc)
