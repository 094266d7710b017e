"""An MCAP file without its summary: all of it is read, and damaged parts are skipped.

What is used stands under a checksum where the file has checksums: in the contents of chunks.  What
only the unprotected rest says (times in the head of a chunk, message indexes) is used for nothing
but telling what was lost.
"""

import re

from mcap.opcode import Opcode

from lpv_bag.errors import BagError, DamageError
from lpv_bag.mcap.content import inflate, records
from lpv_bag.mcap.file import Block, McapFile, Survey
from lpv_bag.mcap.records import HEADER, MAGIC, MAX_RECORD, PARSERS, parse_chunk, parse_statistics
from lpv_bag.mcap.summary import summary_span, walk_summary

_MOST_DAMAGES = 1000
_CANDIDATE = re.compile(rb'[\x01-\x0f][\s\S]{4}\x00{4}')
"""A record that may begin here: a known opcode, and a length below 4 GiB."""


def scan(file: McapFile, reason: str) -> Survey:
    """Read a whole file without its summary, and continue after damaged parts."""
    result = _Scan(file, reason).run()
    if not result.blocks and not result.lost_blocks:
        # No chunk and no message was met before the damage: it may be a file without chunks.
        result = _Scan(file, reason, loose=True).run()
    if not result.blocks and (len(result.damages) > 1 or not result.complete):
        more = f', {result.damages[1]}' if len(result.damages) > 1 else ''
        raise BagError(
            f'{file.path}: cannot be read, the bag is damaged or incomplete: {reason}'
            f'{more}, and nothing in it can be recovered'
        )
    return result


class _Scan:
    """One pass over a file, from record to record; after damage, to the next good record."""

    def __init__(self, file: McapFile, reason: str, loose: bool = False) -> None:
        self._file, self._data = file, file.data
        self._result = Survey(damages=[reason])
        self._loose: tuple[int, int] | None = (
            None  # messages outside of chunks: first and last byte
        )
        self._has_loose, self._trusted = loose, True
        self._last_chunk: Block | None = None
        self._doubtful: int | None = None

    def run(self) -> Survey:
        at: int | None = 8 if self._data[:8] == MAGIC else 0
        while at is not None and at < len(self._data) and not self._result.complete:
            try:
                at = self._record(at)
            except DamageError as error:
                at = self._resume(at, error)
        self._finish_loose()
        self._use_summary()
        return self._result

    def _record(self, at: int) -> int:
        """Read the record at an offset; the offset of the next one."""
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
            self._chunk(at + 9, data[at + 9 : end])
        elif opcode < 0x80:
            self._other(opcode, data[at + 9 : end], at)
            self._doubtful = None
        else:
            self._doubtful = self._doubtful or at
            self._damage(f'the record at byte {at} is of the unknown kind {opcode}')
        return end

    def _other(self, opcode: int, content: bytes, at: int) -> None:
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

    def _chunk(self, at: int, content: bytes) -> None:
        head = parse_chunk(content)
        block = Block(
            at + head.data_offset,
            head.data_size,
            head.compression,
            head.size,
            head.crc,
            head.start,
            head.end,
        )
        self._doubtful = None
        self._finish_loose()
        try:
            self._use(block, self._file.content(block))
            self._last_chunk, self._trusted = None, True
        except DamageError as error:
            self._result.lost_blocks.append(block)
            self._damage(f'the chunk at byte {at - 9} is damaged ({error})')
            self._last_chunk = block

    def _cut_chunk(self, at: int) -> None:
        """The file ends within a chunk, whose beginning can often be read."""
        try:
            head = parse_chunk(self._data[at : at + 64], whole=False)
        except DamageError:
            return
        offset = at + head.data_offset
        block = Block(
            offset,
            len(self._data) - offset,
            head.compression,
            head.size,
            head.crc,
            head.start,
            head.end,
            cut=True,
        )
        if offset < len(self._data) < offset + head.data_size:
            self._use(block, self._file.content(block))

    def _use(self, block: Block, content: bytes) -> None:
        """Read definitions; times are those of the messages, the head has no checksum."""
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

    def _take_loose(self, at: int, end: int) -> None:
        if not (self._trusted or self._has_loose):
            # Most likely from within a chunk whose head is damaged: no checksum covers it.
            raise DamageError('a message without its chunk')
        PARSERS[Opcode.MESSAGE](self._data[at + 9 : min(end, at + 9 + 22)])
        if self._loose is not None and self._loose[1] != at:
            self._finish_loose()
        self._loose = (self._loose[0] if self._loose else at, end)
        self._doubtful = at

    def _finish_loose(self) -> None:
        """Consecutive messages become a block without compression or checksum."""
        if self._loose is None:
            return
        start, end = self._loose
        self._loose, self._has_loose = None, True
        block = Block(start, end - start, '', end - start, 0, loose=True)
        self._use(block, self._data[start:end])

    # -------------------------------------------------------------- damage

    def _resume(self, at: int, error: DamageError) -> int | None:
        """The next place at which a good record begins, or None."""
        if self._doubtful is not None:  # a record whose own length nothing confirms
            at, self._doubtful = self._doubtful, None
            if self._loose is not None:
                self._loose = (self._loose[0], at) if self._loose[0] < at else None
        self._finish_loose()
        self._trusted = False
        found: int | None = at
        while found is not None:
            match = _CANDIDATE.search(self._data, found + 1)
            found = match.start() if match else None
            if found is not None and self._is_good(found):
                break
        end = len(self._data) if found is None else found
        self._damage(f'{end - at} bytes from byte {at} on are damaged ({error})')
        return found

    def _damage(self, text: str) -> None:
        if len(self._result.damages) < _MOST_DAMAGES:
            self._result.damages.append(text)

    def _is_good(self, at: int) -> bool:
        """Whether a record that can be trusted begins here."""
        data = self._data
        opcode, length = HEADER.unpack_from(data, at)
        end = at + 9 + length
        if length > MAX_RECORD or end > len(data):
            return False
        try:
            if opcode == Opcode.MESSAGE:
                return self._is_loose(at, end)
            found = PARSERS[opcode](data[at + 9 : end])
            if opcode == Opcode.CHUNK:
                start = at + 9 + found.data_offset
                inflate(data[start:end], found.compression, found.size, found.crc)
        except DamageError:
            return False
        return True

    def _is_loose(self, at: int, end: int) -> bool:
        """Whether a message has a known topic, and another record after it: garbage has not."""
        if not self._has_loose:
            return False
        if PARSERS[Opcode.MESSAGE](self._data[at + 9 : end])[0] not in self._result.channels:
            return False
        if len(self._data) - end < 9:
            return False
        opcode, length = HEADER.unpack_from(self._data, end)
        return opcode in PARSERS and length < MAX_RECORD

    def _use_summary(self) -> None:
        """Definitions and statistics of the summary, if it is whole."""
        try:
            for opcode, content in walk_summary(self._data, *summary_span(self._data)):
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._result.define(PARSERS[opcode](content))
                elif opcode == Opcode.STATISTICS:
                    self._result.counts = parse_statistics(content)
        except DamageError:
            return
