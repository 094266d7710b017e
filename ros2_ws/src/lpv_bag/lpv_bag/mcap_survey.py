"""What an MCAP file holds, and where: from its summary, or, if that is damaged, from the data.

Results are taken from bytes under a checksum where the file has checksums: the summary, and the
contents of chunks.  What only the unprotected rest says (times in the head of a chunk, message
indexes) is used for nothing but telling what was lost.
"""

import mmap
import re
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode

from lpv_bag.errors import BagError, DamageError
from lpv_bag.mcap_blocks import inflate, inflate_part, records
from lpv_bag.mcap_format import (
    HEADER,
    MAGIC,
    MAX_RECORD,
    PARSERS,
    Chunk,
    parse_channel,
    parse_chunk,
    parse_chunk_index,
    parse_metadata,
    parse_schema,
    parse_statistics,
)

_FOOTER_SIZE = 29  # with its head
_MOST_DAMAGES = 1000
_CANDIDATE = re.compile(rb'[\x01-\x0f][\s\S]{4}\x00{4}')
"""A record that may begin here: a known opcode, and a length below 4 GiB."""


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

    def define(self, record):
        """Take a schema or channel; DamageError if its number means something else already."""
        known = self.channels if hasattr(record, 'topic') else self.schemas
        if known.setdefault(record.id, record) != record:
            raise DamageError(f'the number {record.id} means two different topics or schemas')


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

    def __init__(self, path):
        self.path = Path(path)
        try:
            with open(path, 'rb') as file:
                self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = 'is empty' if isinstance(error, ValueError) else f'cannot be read ({error})'
            raise BagError(f'{path}: {reason}') from None

    def close(self):
        """Give the file back."""
        self.data.close()

    def content(self, block):
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
        data = self.data[block.offset:block.offset + block.length]
        if block.cut:
            return inflate_part(data, block.compression, block.size)
        return inflate(data, block.compression, block.size, block.crc)


def survey(file):
    """What a file holds: by its summary if that is whole, else by all its data.

    Parameters
    ----------
    file : McapFile
        The file.

    Returns
    -------
    Survey
        What was found; ``damages`` says what is wrong.

    Raises
    ------
    BagError
        If this is no MCAP file, or nothing of it can be used.
    """
    try:
        return _from_summary(file.data)
    except DamageError as error:
        return scan(file, str(error))


def _summary(data):
    """First byte of the summary and of the footer; DamageError if they cannot be trusted."""
    if len(data) < 16 + _FOOTER_SIZE or data[-8:] != MAGIC:
        raise DamageError('it does not end as a finished MCAP file')
    footer = len(data) - 8 - _FOOTER_SIZE
    if HEADER.unpack_from(data, footer) != (Opcode.FOOTER, 20):
        raise DamageError('its footer is damaged')
    start, _, crc = PARSERS[Opcode.FOOTER](data[footer + 9:footer + _FOOTER_SIZE])
    if not 8 <= start <= footer:
        raise DamageError('it has no summary')
    if crc and zlib.crc32(data[start:footer + _FOOTER_SIZE - 4]) != crc:
        raise DamageError('the checksum of its summary is wrong')
    return start, footer


def _from_summary(data):
    if data[:8] != MAGIC:
        raise DamageError('it does not begin as an MCAP file')
    start, footer = _summary(data)
    result = Survey(complete=True)
    for opcode, content, _ in _walk(data, start, footer):
        _take_summary(result, opcode, content)
    _check_blocks(data, result, start)
    return result


def _walk(data, at, end):
    while at < end:
        if end - at < 9:
            raise DamageError('its summary ends within a record')
        opcode, length = HEADER.unpack_from(data, at)
        if length > end - at - 9:
            raise DamageError('a record of its summary is too long')
        yield opcode, data[at + 9:at + 9 + length], at
        at += 9 + length


def _take_summary(result, opcode, content):
    if opcode == Opcode.SCHEMA:
        result.define(parse_schema(content))
    elif opcode == Opcode.CHANNEL:
        result.define(parse_channel(content))
    elif opcode == Opcode.STATISTICS:
        result.counts = parse_statistics(content)
    elif opcode == Opcode.CHUNK_INDEX:
        index = parse_chunk_index(content)
        at = index.offset + 9 + 40 + len(index.compression.encode())
        result.blocks.append(Block(at, index.data_size, index.compression, index.size, 0,
                                   index.start, index.end, index.counts()))
        if at + index.data_size != index.offset + index.length:
            raise DamageError('the place of a chunk is wrong')
    elif opcode == Opcode.METADATA_INDEX:
        offset, _, name = PARSERS[opcode](content)
        result.metadata.append((offset, name, None))
    elif opcode == Opcode.ATTACHMENT_INDEX:
        result.attachments += 1
    elif opcode < 0x80 and opcode != Opcode.SUMMARY_OFFSET:
        raise DamageError(f'its summary holds a record of kind {opcode}')


def _check_blocks(data, result, end):
    """Checksums stand in the heads of the chunks; what the heads say must be what the index says.

    A file without statistics, or with messages outside of chunks, is read as a whole.
    """
    if result.counts is None or (sum(result.counts.values()) and not result.blocks):
        raise DamageError('its summary does not say where the messages are')
    if not set(result.counts) <= set(result.channels):
        raise DamageError('its summary counts messages of unknown topics')
    for block in sorted(result.blocks, key=lambda b: b.offset):
        head = block.offset - 40 - len(block.compression.encode())
        if head < 17 or block.offset + block.length > end:
            raise DamageError('the place of a chunk is wrong')
        found = parse_chunk(data[head:block.offset], whole=False)
        block.crc = found.crc
        if found != Chunk(block.start, block.end, block.size, found.crc, block.compression,
                          block.offset - head, block.length):
            raise DamageError(f'the head of the chunk at byte {head - 9} is damaged')


def scan(file, reason):
    """Read a file without its summary, all of it, going on behind what is damaged.

    Parameters
    ----------
    file : McapFile
        The file.
    reason : str
        Why the summary is not used.

    Returns
    -------
    Survey
        What was found.

    Raises
    ------
    BagError
        If nothing can be used.
    """
    result = _Scan(file, reason).run()
    if not result.blocks and not result.channels and not result.complete:
        raise BagError(f'{file.path}: cannot be read, the bag is damaged or incomplete: {reason}, '
                       'and nothing in it can be recovered')
    return result


class _Scan:
    """One pass over a file, from record to record; behind damage, to the next good record."""

    def __init__(self, file, reason):
        self._file, self._data = file, file.data
        self._result = Survey(damages=[reason])
        self._loose = None  # messages outside of chunks: first and last byte
        self._has_loose, self._trusted = False, True
        self._last_chunk = None
        self._doubtful = None

    def run(self):
        at = 8 if self._data[:8] == MAGIC else 0
        while at is not None and at < len(self._data) and not self._result.complete:
            try:
                at = self._record(at)
            except DamageError as error:
                at = self._resume(at, error)
        self._finish_loose()
        self._use_summary()
        return self._result

    def _record(self, at):
        """Take the record at a place; the place of the next one."""
        data = self._data
        if len(data) - at < 9:
            raise DamageError('the file ends within a record')
        opcode, length = HEADER.unpack_from(data, at)
        end = at + 9 + length
        if opcode not in PARSERS and opcode < 0x80:
            raise DamageError('there is no record')
        if end > len(data) or length > MAX_RECORD:
            if opcode == Opcode.CHUNK:
                self._cut_chunk(at + 9)
            raise DamageError('the file ends within a record')
        if opcode == Opcode.MESSAGE:
            self._take_loose(at, end)
        elif opcode == Opcode.CHUNK:
            self._chunk(at + 9, data[at + 9:end])
        elif opcode < 0x80:
            self._other(opcode, data[at + 9:end], at)
            self._doubtful = None
        else:
            self._doubtful = self._doubtful or at
            self._damage(f'the record at byte {at} is of the unknown kind {opcode}')
        return end

    def _other(self, opcode, content, at):
        found, result = PARSERS[opcode](content), self._result
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            result.define(found)
        elif opcode == Opcode.METADATA:
            result.metadata.append((at, *found))
        elif opcode == Opcode.ATTACHMENT:
            result.attachments += 1
        elif opcode == Opcode.MESSAGE_INDEX and self._last_chunk is not None:
            self._last_chunk.counts[found[0]] = found[1]
        elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
            result.complete = True

    # -------------------------------------------------------------- chunks

    def _chunk(self, at, content):
        head = parse_chunk(content)
        block = Block(at + head.data_offset, head.data_size, head.compression, head.size, head.crc,
                      head.start, head.end)
        self._doubtful = None
        self._finish_loose()
        try:
            self._use(block, self._file.content(block))
            self._last_chunk, self._trusted = None, True
        except DamageError as error:
            self._result.lost_blocks.append(block)
            self._damage(f'the chunk at byte {at - 9} is damaged ({error})')
            self._last_chunk = block

    def _cut_chunk(self, at):
        """The file ends within a chunk: its beginning can often be had."""
        try:
            head = parse_chunk(self._data[at:at + 64], whole=False)
        except DamageError:
            return
        offset = at + head.data_offset
        block = Block(offset, len(self._data) - offset, head.compression, head.size, head.crc,
                      head.start, head.end, cut=True)
        if offset < len(self._data) < offset + head.data_size:
            self._use(block, self._file.content(block))

    def _use(self, block, content):
        """Take a chunk's definitions; its times by its messages, its head has no checksum."""
        messages, definitions, wrong = records(content)
        if wrong and not block.cut:
            raise DamageError(wrong)
        for record in definitions:
            self._result.define(record)
        for message in messages:
            block.counts[message.channel] = block.counts.get(message.channel, 0) + 1
        if messages:
            block.start = min(message.log_time for message in messages)
            block.end = max(message.log_time for message in messages)
            self._result.blocks.append(block)

    # -------------------------------------------------------------- messages outside of chunks

    def _take_loose(self, at, end):
        if not (self._trusted or self._has_loose):
            # Most likely from within a chunk whose head is damaged: no checksum covers it.
            raise DamageError('a message without its chunk')
        PARSERS[Opcode.MESSAGE](self._data[at + 9:min(end, at + 9 + 22)])
        if self._loose is not None and self._loose[1] != at:
            self._finish_loose()
        self._loose = (self._loose[0] if self._loose else at, end)
        self._doubtful = at

    def _finish_loose(self):
        """Consecutive messages become a block without compression or checksum."""
        if self._loose is None:
            return
        start, end = self._loose
        self._loose, self._has_loose = None, True
        block = Block(start, end - start, '', end - start, 0)
        self._use(block, self._data[start:end])

    # -------------------------------------------------------------- damage

    def _resume(self, at, error):
        """The next place at which a good record begins, or None."""
        if self._doubtful is not None:  # a record whose own length nothing confirms
            at, self._doubtful = self._doubtful, None
            if self._loose is not None:
                self._loose = (self._loose[0], at) if self._loose[0] < at else None
        self._finish_loose()
        self._trusted, found = False, at
        while found is not None:
            match = _CANDIDATE.search(self._data, found + 1)
            found = match.start() if match else None
            if found is not None and self._is_good(found):
                break
        end = len(self._data) if found is None else found
        self._damage(f'{end - at} bytes from byte {at} on are damaged ({error})')
        return found

    def _damage(self, text):
        if len(self._result.damages) < _MOST_DAMAGES:
            self._result.damages.append(text)

    def _is_good(self, at):
        """Whether a record that can be trusted begins here."""
        data = self._data
        opcode, length = HEADER.unpack_from(data, at)
        end = at + 9 + length
        if length > MAX_RECORD or end > len(data):
            return False
        try:
            if opcode == Opcode.MESSAGE:
                return self._is_loose(at, end)
            found = PARSERS[opcode](data[at + 9:end])
            if opcode == Opcode.CHUNK:
                start = at + 9 + found.data_offset
                inflate(data[start:end], found.compression, found.size, found.crc)
        except DamageError:
            return False
        return True

    def _is_loose(self, at, end):
        """Messages are told from garbage by their topic, and by another record behind them."""
        if not self._has_loose:
            return False
        if PARSERS[Opcode.MESSAGE](self._data[at + 9:end])[0] not in self._result.channels:
            return False
        if len(self._data) - end < 9:
            return False
        opcode, length = HEADER.unpack_from(self._data, end)
        return opcode in PARSERS and length < MAX_RECORD

    def _use_summary(self):
        """Definitions and statistics of the summary, if it is whole."""
        try:
            for opcode, content, _ in _walk(self._data, *_summary(self._data)):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._result.define(PARSERS[opcode](content))
                elif opcode == Opcode.STATISTICS:
                    self._result.counts = parse_statistics(content)
        except DamageError:
            return


def read_metadata(file, found):
    """Metadata records of a survey, by name; those that are damaged are left out.

    Parameters
    ----------
    file : McapFile
        The file.
    found : Survey
        Of it.

    Returns
    -------
    list of tuple
        Name and dict.
    """
    result = []
    for offset, name, content in found.metadata:
        try:
            if content is None:
                if not 8 <= offset <= len(file.data) - 9:
                    continue
                opcode, length = HEADER.unpack_from(file.data, offset)
                if opcode != Opcode.METADATA or length > len(file.data) - offset - 9:
                    continue
                name, content = parse_metadata(file.data[offset + 9:offset + 9 + length])
        except DamageError:
            continue
        result.append((name, content))
    return result
