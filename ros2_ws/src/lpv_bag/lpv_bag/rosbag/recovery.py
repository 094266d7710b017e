"""Recovery of MCAP bags: everything that is readable into a new bag, and what was lost."""

import contextlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.metadata import parse_qos

from lpv_bag.errors import BagError, DamageError
from lpv_bag.rosbag.mcap_file import McapFile
from lpv_bag.rosbag.message_loss import Known
from lpv_bag.rosbag.metadata import FILE_NAME, BagMetadata, read_metadata
from lpv_bag.rosbag.output_folder import copy_run_files
from lpv_bag.rosbag.writing import BagWriter
from lpv_core.support.errors import ConfigError

_FORMATS = {'ros2msg': MessageDefinitionFormat.MSG, 'ros2idl': MessageDefinitionFormat.IDL}


@dataclass
class TopicRecovery:
    """What became of one topic."""

    recovered: int = 0  # messages in the new bag
    lost: int = 0  # messages that were recorded and are not; at least, where the end is missing


@dataclass
class Recovery:
    """Outcome of a recovery."""

    topics: dict[str, TopicRecovery] = field(default_factory=dict)  # by topic
    damages: list[str] = field(default_factory=list)  # what was wrong
    # whether the recording was not finished: how much came after the last message is not known
    end_missing: bool = False
    end: int = 0  # log time of the last message that was recovered [ns]; 0 without messages
    attachments: int = 0  # attachments that were left out

    @property
    def lost(self) -> int:
        """Messages that are known to be lost."""
        return sum(topic.lost for topic in self.topics.values())

    @property
    def nothing_lost(self) -> bool:
        """Whether every message that was ever recorded is in the new bag."""
        return not (self.lost or self.end_missing or self.attachments)


def recover(path: str | Path, out: str | Path | None = None, preset: str = 'zstd_fast') -> Recovery:
    """Write what can be read of an MCAP bag into a new one, or examine it only.

    A chunk whose checksum is wrong is left out as a whole: one of its messages is wrong, and there
    is no telling which.  Of a file without a whole index, what comes before the first byte that
    makes no sense is kept.  BagError if nothing can be read, ConfigError or OSError if the new bag
    cannot be written.
    """
    path, result = Path(path), Recovery()
    metadata, paths = mcap_files(path, result.damages)
    known: Known = metadata.known if metadata else {}
    found, said = Counter[str](), Counter(metadata.counts if metadata else {})
    with contextlib.ExitStack() as stack:
        writer = None if out is None else stack.enter_context(BagWriter(out, preset))
        complete, failures = True, []
        for one in paths:
            try:
                file = stack.enter_context(contextlib.closing(McapFile(one)))
            except BagError as error:
                failures.append(str(error))
                continue
            counts = _copy(file, metadata, writer, found, result)
            said |= counts
            complete &= file.complete
        result.damages += failures
        if not found and (result.damages or failures):
            raise BagError(
                f'{path}: cannot be read, the bag is damaged or incomplete: {result.damages[-1]}, '
                'and nothing in it can be recovered'
            )
        result.topics = {
            topic: TopicRecovery(found[topic], max(0, said[topic] - found[topic]))
            for topic in sorted({*found, *said})
        }
        result.end_missing = metadata is None and not complete
        if writer is not None:
            missing = writer.close(known)
            if missing:
                raise ConfigError('--out', f'cannot be written as a whole: {missing}', str(out))
            result.damages += copy_run_files(path, writer.path)
    return result


def mcap_files(path: Path, damages: list[str]) -> tuple[BagMetadata | None, list[Path]]:
    """Metadata and files of an MCAP bag; what is wrong with them is added to the damages."""
    if not path.is_dir():
        if path.suffix != '.mcap':
            raise BagError(f'{path}: only MCAP bags can be recovered')
        return None, [path]
    metadata = None
    try:
        metadata = read_metadata(path) if (path / FILE_NAME).exists() else None
        if metadata is None:
            damages.append(f'it has no {FILE_NAME}, its recording was not finished')
    except DamageError as error:
        damages.append(str(error))
    if metadata is not None and (metadata.storage != 'mcap' or metadata.compressed):
        raise BagError(f'{path}: only MCAP bags can be recovered')
    paths = sorted(path.glob('*.mcap'), key=lambda p: (len(p.name), p.name))
    if metadata is not None:
        named = [path / name for name in metadata.files]
        paths = [one for one in named if one.is_file()]
        if missing := [one.name for one in named if one not in paths]:
            damages.append(f'{FILE_NAME} names files that are missing: {", ".join(missing)}')
    if not paths:
        raise BagError(f'{path}: is not a bag, it has no {FILE_NAME} with files, nor MCAP files')
    return metadata, paths


def _copy(
    file: McapFile,
    metadata: BagMetadata | None,
    writer: BagWriter | None,
    found: Counter[str],
    result: Recovery,
) -> Counter[str]:
    """Copy the messages of a file, and count them; what the file itself says that there are."""
    unknown, table = 0, np.zeros(65536, np.int64)
    for block in file.salvage():
        for number, count in zip(*np.unique(block.connection, return_counts=True)):
            channel = file.channels.get(number)
            if channel is None:
                unknown += int(count)
                continue
            found[channel.topic] += int(count)
            if writer is not None and not table[number]:
                writer.copy_topic(_connection(file, number, metadata))
                table[number] = writer.channel(channel.topic)
        if len(block):
            result.end = max(result.end, int(block.time.max()))
        if writer is not None:
            block = block.chosen(table[block.connection] > 0)
            writer.write_chunk(block.copied(table[block.connection]))
    name = file.path.name
    for number, text in enumerate(file.damages):
        if number == 0 and not file.complete:
            text = f'the recording was not finished, its end may be missing ({text})'
        result.damages.append(text if text.startswith(name) else f'{name}: {text}')
    if unknown:
        result.damages.append(f'{name}: {unknown} messages of topics whose definition is lost')
    result.attachments += file.attachments
    return Counter({file.channels[number].topic: count for number, count in file.counts.items()})


def _connection(file: McapFile, number: int, metadata: BagMetadata | None) -> Connection:
    """Topic of a channel, as rosbags has it."""
    channel = file.channels[number]
    schema = file.schemas.get(channel.schema_id)
    name, kind, text = '', MessageDefinitionFormat.NONE, ''
    if schema is not None:
        name, kind = schema.name, _FORMATS.get(schema.encoding, kind)
        text = schema.data.decode(errors='replace') if schema.encoding in _FORMATS else ''
    try:
        profiles = parse_qos(channel.metadata.get('offered_qos_profiles', ''))
    except Exception:  # many kinds; no result depends on it
        profiles = []
    digest = channel.metadata.get('topic_type_hash') or (
        metadata.hashes.get(name, '') if metadata else ''
    )
    ext = ConnectionExtRosbag2(channel.message_encoding, profiles)
    definition = MessageDefinition(kind, text)
    return Connection(number, channel.topic, name, definition, digest, 0, ext, None)
