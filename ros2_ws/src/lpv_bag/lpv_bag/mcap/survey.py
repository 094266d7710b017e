"""What an MCAP file holds, and where: from its summary, or, if that is damaged, from the data."""

import mmap
from collections import Counter
from typing import Any

from mcap.opcode import Opcode

from lpv_bag.errors import DamageError
from lpv_bag.mcap.file import McapFile, Survey
from lpv_bag.mcap.records import HEADER, PARSERS, parse_metadata
from lpv_bag.mcap.scan import scan
from lpv_bag.mcap.summary import Unindexed, from_summary


def survey(file: McapFile) -> Survey:
    """What a file holds: by its summary if that is whole, else by all its data."""
    try:
        result = from_summary(file.data)
    except DamageError as error:
        result = scan(file, str(error))
        if isinstance(error, Unindexed) and result.complete and len(result.damages) == 1:
            result.damages = []
            result.counts = result.counts or _met(result)
    result.library = _library(file.data)
    return result


def _met(result: Survey) -> Counter[int]:
    """Messages by channel, counted."""
    counts: Counter[int] = Counter()
    for block in result.blocks:
        counts.update(block.counts)
    return counts


def _library(data: mmap.mmap | bytes) -> str:
    """What wrote the file; '' where its header is damaged."""
    if len(data) < 17:
        return ''
    length = HEADER.unpack_from(data, 8)[1]
    try:
        return PARSERS[Opcode.HEADER](data[17 : 17 + min(length, 1000)])[1]
    except DamageError:
        return ''


def read_metadata(file: McapFile, found: Survey) -> list[tuple[Any, ...]]:
    """Metadata records of a survey, by name; those that are damaged are left out."""
    result = []
    for offset, name, content in found.metadata:
        try:
            if content is None:
                if not 8 <= offset <= len(file.data) - 9:
                    continue
                opcode, length = HEADER.unpack_from(file.data, offset)
                if opcode != Opcode.METADATA or length > len(file.data) - offset - 9:
                    continue
                name, content = parse_metadata(file.data[offset + 9 : offset + 9 + length])
        except DamageError:
            continue
        result.append((name, content))
    return result
