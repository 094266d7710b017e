"""Recovery of bags: everything that is readable into a new bag, and what was lost."""

import contextlib
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lpv.bag.rosbag.output_folder import copy_run_files
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.support.errors import ConfigError


class TopicRecovery(NamedTuple):
    """What became of one topic."""

    recovered: int  # messages in the new bag
    lost: int  # messages that were recorded and are not; at least, where the end is missing


class Recovery(NamedTuple):
    """Outcome of a recovery."""

    topics: dict[str, TopicRecovery]  # by topic
    damages: list[str]  # what was wrong
    end_missing: bool  # whether the last file is cut: the recording was not finished
    cut: list[str]  # files whose ends are lost; how much is not known
    end: int  # the last message that was recovered, from the first one on [ns]
    attachments: int  # attachments that were left out

    @property
    def lost(self) -> int:
        """Messages that are known to be lost."""
        return sum(topic.lost for topic in self.topics.values())

    @property
    def nothing_lost(self) -> bool:
        """Whether every message that was ever recorded is in the new bag."""
        return not (self.lost or self.cut or self.attachments)


def recover(path: str | Path, out: str | Path | None = None, preset: str = 'zstd_fast') -> Recovery:
    """Write what can be read of a bag into a new one, or examine it only."""
    # Of a chunk whose checksum is wrong nobody knows which message is wrong: it is left out.
    path, found, end = Path(path), Counter[str](), 0
    with contextlib.ExitStack() as stack:
        reader = stack.enter_context(open_bag(path))
        writer = None if out is None else stack.enter_context(BagWriter(out, preset))
        topics = [connection.topic for connection in reader.connections]
        for block in reader.blocks(reader.connections):
            for number, count in zip(*np.unique(block.connection, return_counts=True)):
                if writer is not None and topics[number] not in writer.counts:
                    writer.copy_topic(reader.connections[number])
                found[topics[number]] += int(count)
            if writer is not None:
                known = writer.counts
                channels = [writer.channel(topic) if topic in known else -1 for topic in topics]
                writer.write_chunk(block.copied(np.array(channels)[block.connection]))
            end = max(end, int(block.time.max()) - reader.start_time)
        result = {
            topic: TopicRecovery(found[topic], max(0, reader.said[topic] - found[topic]))
            for topic in sorted({*found, *reader.said})
        }
        damages = list(reader.warnings)
        if writer is not None:
            missing = writer.close(reader.known)
            if missing:
                raise ConfigError('--out', f'cannot be written as a whole: {missing}', str(out))
            damages += copy_run_files(path, writer.path)
        attachments = sum(file.attachments for file in reader.files)
    return Recovery(result, damages, not reader.finished, reader.cut, end, attachments)
