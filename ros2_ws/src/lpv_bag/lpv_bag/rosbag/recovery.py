"""Recovery of MCAP bags: everything that is readable into a new bag, and what was lost."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rosbags.interfaces import Connection

from lpv_bag.errors import BagError, DamageError
from lpv_bag.mcap.content import Message, records
from lpv_bag.mcap.file import Block, McapFile, Survey
from lpv_bag.mcap.survey import read_metadata
from lpv_bag.mcap.writer import LIBRARY
from lpv_bag.rosbag.mcap_bag import McapBag
from lpv_bag.rosbag.message_loss import RECORD_NAME
from lpv_bag.rosbag.output_folder import (
    GAINS_NAME,
    SCENARIO_NAME,
    copy_file,
    read_gains_file,
    read_scenario_file,
)
from lpv_bag.rosbag.reading import open_bag
from lpv_bag.rosbag.writing import BagWriter
from lpv_core.support.errors import ConfigError

_ORDER = 1 << 31


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
    """Write what can be read of a bag into a new one.

    Messages keep their times and their order.  A chunk whose checksum is wrong is left out as a
    whole: one of its messages is wrong, and there is no telling which.  Of a chunk in which the
    file ends, the messages before the end are kept.

    Parameters
    ----------
    path : str or pathlib.Path
        rosbag2 directory with MCAP files, or one MCAP file.
    out : str or pathlib.Path, optional
        Bag to create; without, the bag is examined only.
    preset : str, optional
        Compression of the new bag, a key of `lpv_bag.mcap.writer.PRESETS`.

    Returns
    -------
    Recovery
        What was recovered and what was lost.

    Raises
    ------
    BagError
        If nothing can be read, or it is no MCAP bag.
    ConfigError
        If the new bag cannot be made.
    OSError
        If it cannot be written.
    """
    with open_bag(path) as reader:
        bag = reader.source
        if not isinstance(bag, McapBag):
            raise BagError(f'{path}: only MCAP bags can be recovered')
        tally = _Tally(bag)
        if out is None:
            for _ in tally.messages():
                pass
            return tally.finish()
        place = _write(bag, tally, out, preset)
        result = tally.finish()
        result.damages += _copy_files(bag.path, place)
        return result


def _write(bag: McapBag, tally: '_Tally', out: str | Path, preset: str) -> Path:
    with BagWriter(out, preset, split_size=1 << 62 if len(bag.parts) > 1 else 0) as writer:
        for connection in bag.connections:
            writer.copy_topic(connection)
        part = 0
        for number, connection, message in tally.messages():
            if number != part:
                _copy_metadata(bag.parts[part], writer)
                writer.split()
                part = number
            writer.write_raw(connection.topic, message.log_time, message.data, message.publish_time)
        _copy_metadata(bag.parts[part], writer)
        writer.close(bag.known)
    return writer.path


def _copy_files(bag: Path, out: Path) -> list[str]:
    """Copy gains and scenario of the run, if the bag has them; what is wrong with them."""
    wrong = []
    for name, read in ((GAINS_NAME, read_gains_file), (SCENARIO_NAME, read_scenario_file)):
        try:
            if (bag / name).is_file():
                copy_file(read(bag / name), out, name)
        except ConfigError as error:
            wrong.append(f'{name} is left out: {error}')
    return wrong


def _copy_metadata(part: tuple[McapFile, Survey], writer: BagWriter) -> None:
    """Other people's metadata records."""
    for name, values in read_metadata(*part):
        if name not in ('rosbag2', RECORD_NAME):
            writer.add_metadata(name, values)


class _Tally:
    """Goes through the messages of a bag in the order of its files, and counts."""

    def __init__(self, bag: McapBag) -> None:
        self._bag, self._result = bag, Recovery()
        # Numbers go through all files of a bag; a single file may be any one of them.
        self._sequences = {c.topic: 0 for c in bag.connections} if bag.path.is_dir() else {}
        self._bad = 0
        self._gaps: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._found: Counter[str] = Counter()
        self._expected: dict[str, int] = {}

    def messages(self) -> Iterator[tuple[int, Connection, Message]]:
        for part, (file, found) in enumerate(self._bag.parts):
            connections = self._bag.connections_of(part)
            there: Counter[str] = Counter()
            for block in sorted(found.blocks, key=lambda b: b.offset):
                try:
                    messages, _, wrong = records(file.content(block))
                    if wrong and not block.cut:
                        raise DamageError(wrong)
                except DamageError as error:
                    self._bad += 1
                    self._drop(connections, block)
                    self._result.damages.append(
                        f'{file.path.name}: the chunk at byte {block.offset} is damaged ({error})'
                    )
                    continue
                for message in messages:
                    connection = connections.get(message.channel)
                    if connection is None:
                        continue  # a topic whose definition is lost; said when the bag was opened
                    there[connection.topic] += 1
                    self._result.end = max(self._result.end, message.log_time)
                    if found.library == LIBRARY:
                        self._follow(connection.topic, message.sequence)
                    yield part, connection, message
            for block in found.lost_blocks:
                self._drop(connections, block)
            self._expect(connections, found, there)
            self._found += there

    def _drop(self, connections: dict[int, Connection], block: Block) -> None:
        for number, count in block.counts.items():
            if number in connections:
                self._dropped[connections[number].topic] += count

    def _follow(self, topic: str, sequence: int) -> None:
        """Our recordings number the messages of a topic: what is missing is then known."""
        step = (sequence - self._sequences.get(topic, sequence - 1)) & 0xFFFFFFFF
        if 0 < step < _ORDER:
            self._gaps[topic] += step - 1
            self._sequences[topic] = sequence

    def _expect(
        self, connections: dict[int, Connection], found: Survey, there: Counter[str]
    ) -> None:
        """What the file's own statistics say is missing."""
        if found.counts is None:
            return
        said: Counter[str] = Counter()
        for number, count in found.counts.items():
            if number in connections:
                said[connections[number].topic] += count
        for topic, count in said.items():
            self._expected[topic] = self._expected.get(topic, 0) + max(0, count - there[topic])

    def finish(self) -> Recovery:
        """The outcome, when all messages have been gone through."""
        if not self._found and self._bad:
            raise BagError(
                f'{self._bag.path}: cannot be read, the bag is damaged: no chunk of it is whole'
            )
        result, metadata = self._result, self._bag.metadata
        result.damages = [*self._bag.warnings, *result.damages]
        for connection in self._bag.connections:
            topic = connection.topic
            lost = max(self._expected.get(topic, 0), self._gaps[topic], self._dropped[topic])
            if metadata is not None and topic in metadata.counts:
                lost = max(lost, metadata.counts[topic] - self._found[topic])
            result.topics[topic] = TopicRecovery(self._found[topic], lost)
        for topic, count in (metadata.counts if metadata is not None else {}).items():
            result.topics.setdefault(topic, TopicRecovery(0, count))
        result.end_missing = metadata is None and not all(
            found.complete for _, found in self._bag.parts
        )
        result.attachments = sum(found.attachments for _, found in self._bag.parts)
        return result
