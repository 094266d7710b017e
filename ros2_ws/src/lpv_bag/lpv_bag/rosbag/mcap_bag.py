"""A bag of MCAP files, one or several, whole or damaged."""

import functools
import heapq
import logging
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
)
from rosbags.rosbag2.metadata import parse_qos

from lpv_bag.errors import BagError, DamageError
from lpv_bag.mcap.content import Message, records
from lpv_bag.mcap.file import Block, McapFile, Survey
from lpv_bag.mcap.records import Channel, Schema
from lpv_bag.mcap.survey import read_metadata, survey
from lpv_bag.rosbag.message_loss import RECORD_NAME, Known, from_metadata
from lpv_bag.rosbag.metadata import FILE_NAME, BagMetadata

_LOG = logging.getLogger(__name__)
_FORMATS = {
    'ros2msg': MessageDefinitionFormat.MSG,
    'ros2idl': MessageDefinitionFormat.IDL,
    'omgidl': MessageDefinitionFormat.IDL,
}


class McapBag:
    """Reads the messages of a bag; continues after damaged parts, and reports them."""

    def __init__(
        self, path: str | Path, metadata: BagMetadata | None = None, damage: str | None = None
    ) -> None:
        self.path, self.metadata = Path(path), metadata
        self.warnings: list[str] = []  # what is wrong with the bag; grows while it is read
        self.parts: list[tuple[McapFile, Survey]] = []  # of each file
        self.connections: list[Connection] = []  # their msgcount is what can be read
        self.known: Known = {}  # what the recorder knew of each topic
        self._maps: list[dict[int, Any]] = []
        try:
            self._open(damage)
        except BaseException:
            self.close()
            raise

    def _open(self, damage: str | None) -> None:
        errors = []
        for path in self._paths():
            try:
                self._open_file(path)
            except BagError as error:
                errors.append(error)
        if errors and not self.parts:
            raise errors[0]
        for text in [damage, *errors] if damage else errors:
            self._warn(str(text))
        self._connect()
        self._compare_counts()

    def close(self) -> None:
        """Close the files."""
        for file, _ in self.parts:
            file.close()
        self.parts = []

    def _warn(self, text: str) -> None:
        self.warnings.append(text)
        _LOG.warning('%s: %s', self.path, text)

    # -------------------------------------------------------------- files

    def _paths(self) -> list[Path]:
        if not self.path.is_dir():
            return [self.path]
        there = sorted(self.path.glob('*.mcap'), key=lambda p: (len(p.name), p.name))
        if self.metadata is None:
            return self._checked(there)
        named = [self.path / name for name in self.metadata.files]
        missing = [path.name for path in named if not path.is_file()]
        if missing:
            self._warn(f'{FILE_NAME} names files that are missing: {", ".join(missing)}')
        return self._checked([path for path in named if path.is_file()])

    def _checked(self, paths: list[Path]) -> list[Path]:
        if not paths:
            raise BagError(
                f'{self.path}: is not a bag, it has no {FILE_NAME} with files, nor MCAP files'
            )
        return paths

    def _open_file(self, path: Path) -> None:
        file = McapFile(path)
        try:
            found = survey(file)
        except BaseException:
            file.close()
            raise
        self.parts.append((file, found))
        name = '' if path == self.path else f'{path.name}: '
        if not found.complete:
            self._warn(
                f'{name}the recording was not finished, its end may be missing ({found.damages[0]})'
            )
        elif found.damages:
            self._warn(f'{name}damaged: {found.damages[0]}')
        for text in found.damages[1:]:
            self._warn(f'{name}{text}')
        for name, values in read_metadata(file, found):
            if name == RECORD_NAME:
                self.known.update(from_metadata(values))

    # -------------------------------------------------------------- topics

    def _connect(self) -> None:
        """One connection for each topic, type and QoS, whatever numbers the files give them."""
        found: dict[tuple[Any, ...], Connection] = {}
        for file, result in self.parts:
            numbers, counts = {}, _counts(result)
            for channel in result.channels.values():
                connection = self._connection(channel, result.schemas.get(channel.schema_id))
                key = (connection.topic, connection.msgtype, connection.msgdef, str(connection.ext))
                first = found.setdefault(key, connection._replace(id=len(found) + 1))
                found[key] = first._replace(
                    msgcount=found[key].msgcount + counts.get(channel.id, 0)
                )
                numbers[channel.id] = key
            self._maps.append(numbers)
            unknown = set(counts) - set(result.channels)
            if unknown:
                lost = sum(counts[number] for number in unknown)
                self._warn(
                    f'{file.path.name}: {lost} messages are of topics whose definition is lost'
                )
        order = {name: at for at, name in enumerate(self.metadata.topics)} if self.metadata else {}
        ranked = sorted(found, key=lambda key: order.get(key[0], len(order)))
        self.connections = [found[key]._replace(id=number) for number, key in enumerate(ranked, 1)]
        places = {key: connection for key, connection in zip(ranked, self.connections)}
        self._maps = [
            {number: places[key] for number, key in numbers.items()} for numbers in self._maps
        ]

    def _connection(self, channel: Channel, schema: Schema | None) -> Connection:
        metadata = dict(channel.metadata)
        profiles = list(_profiles(metadata.get('offered_qos_profiles', '')))
        definition = MessageDefinition(MessageDefinitionFormat.NONE, '')
        if schema is not None and schema.data and schema.encoding in _FORMATS:
            try:
                definition = MessageDefinition(_FORMATS[schema.encoding], schema.data.decode())
            except UnicodeDecodeError:
                self._warn(f'the definition of {channel.topic} is no text')
        name = schema.name if schema is not None else ''
        digest = metadata.get('topic_type_hash', '')
        if not digest and self.metadata is not None:
            digest = self.metadata.hashes.get(name, '')
        return Connection(
            0,
            channel.topic,
            name,
            definition,
            digest,
            0,
            ConnectionExtRosbag2(channel.encoding, profiles),
            self,
        )

    def _compare_counts(self) -> None:
        """Warn of messages that metadata.yaml announces and the files do not hold."""
        if self.metadata is None:
            return
        there: Counter[str] = Counter()
        for connection in self.connections:
            there[connection.topic] += connection.msgcount
        for topic, count in self.metadata.counts.items():
            if there[topic] != count:
                self._warn(
                    f'{topic}: {FILE_NAME} says {count} messages, the files hold {there[topic]}'
                )

    @property
    def start_time(self) -> int:
        """Log time of the first message [ns]; 2**63 - 1 without messages."""
        return min((b.start for _, found in self.parts for b in found.blocks), default=2**63 - 1)

    @property
    def end_time(self) -> int:
        """Time after the log time of the last message [ns]; 0 without messages."""
        return max((b.end + 1 for _, found in self.parts for b in found.blocks), default=0)

    def connections_of(self, part: int) -> dict[int, Connection]:
        """Connection by the channel number of a file."""
        return self._maps[part]

    # -------------------------------------------------------------- messages

    def messages(
        self,
        connections: Collection[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages in the order of their log times."""
        wanted = {connection.id for connection in connections or self.connections}
        for connection, message in self._merged(wanted, start, stop):
            if (start is None or message.log_time >= start) and (
                stop is None or message.log_time < stop
            ):
                yield connection, message.log_time, message.data

    def _merged(
        self, wanted: set[int], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, Message]]:
        """Messages by log time; each block is read only when its time has come."""
        blocks = []
        for part, (_, found) in enumerate(self.parts):
            for block in found.blocks:
                if (start is None or block.end >= start) and (stop is None or block.start < stop):
                    blocks.append((block.start, part, block.offset, block))
        blocks.sort(key=lambda entry: entry[:3])
        self._bad = 0
        heap: list[tuple[Any, ...]] = []
        for _, part, place, block in blocks:
            while heap and heap[0][0] < block.start:
                yield from self._step(heap, block.start)
            messages = self._block(part, block, wanted)
            if messages:
                rest = iter(messages)
                connection, message = next(rest)
                # Messages of one time come in the order of the files.
                heapq.heappush(heap, (message.log_time, (part, place), connection, message, rest))
        while heap:
            yield from self._step(heap, None)
        if blocks and self._bad == len(blocks):
            raise BagError(
                f'{self.path}: cannot be read, the bag is damaged: no chunk of it is whole'
            )

    @staticmethod
    def _step(
        heap: list[tuple[Any, ...]], limit: int | None
    ) -> Iterator[tuple[Connection, Message]]:
        """Messages of the block that is due, until another one is."""
        _, place, connection, message, rest = heapq.heappop(heap)
        bound = heap[0][:2] if heap else None
        while True:
            yield connection, message
            connection, message = next(rest, (None, None))
            if message is None:
                return
            if (limit is not None and message.log_time >= limit) or (
                bound is not None and (message.log_time, place) > bound
            ):
                heapq.heappush(heap, (message.log_time, place, connection, message, rest))
                return

    def _block(self, part: int, block: Block, wanted: set[int]) -> list[tuple[Connection, Message]]:
        """Wanted messages of a block, by log time; none of a damaged one."""
        file, _ = self.parts[part]
        connections = self._maps[part]
        numbers = {number for number, connection in connections.items() if connection.id in wanted}
        if block.counts and not numbers & set(block.counts):
            return []
        try:
            found, _, wrong = records(file.content(block), numbers)
            if wrong and not block.cut:
                raise DamageError(wrong)
        except DamageError as error:
            self._bad += 1
            self._warn(
                f'{file.path.name}: the chunk at byte {block.offset} is damaged ({error}), '
                f'its {sum(block.counts.values())} messages are left out'
            )
            return []
        found.sort(key=lambda message: message.log_time)
        return [(connections[message.channel], message) for message in found]


@functools.lru_cache(maxsize=256)
def _profiles(text: str) -> tuple[Qos, ...]:
    """Offered QoS; none where the text is damaged: no result depends on it."""
    try:
        return tuple(parse_qos(text))
    except Exception:  # many kinds
        return ()


def _counts(result: Survey) -> dict[int, int]:
    """Messages by channel: by the statistics of a good file, as counted in a damaged one."""
    if not result.damages:
        return result.counts or {}
    found: Counter[int] = Counter()
    for block in result.blocks:
        found.update(block.counts)
    return found
