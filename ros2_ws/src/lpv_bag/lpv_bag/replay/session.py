"""What is replayed, and what a replay found."""

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from lpv_bag.blocks.message_blocks import Block
from lpv_bag.run.measurements import Measurements
from lpv_bag.run.streams import RecordedAlarm


@dataclass(frozen=True)
class ReplayOptions:
    """What is replayed, and what is written."""

    topic: str | None = None  # of the measurements, where the bag has several JointState topics
    # torques to use in place of the measured efforts; of a type in torque_reader.EFFORT_TYPES
    effort_topic: str | None = None
    torque_from_command: bool = False  # take torques from the recorded commands
    start: float | None = None  # first message, counted from the first one of the bag [s]
    end: float | None = None  # end of the interval, counted likewise [s]
    estimates_only: bool = False  # write the answers alone; otherwise all topics are copied, too
    preset: str = 'none'  # compression of the new bag, key of `lpv_bag.rosbag.writing.PRESETS`


@dataclass
class ReplayResult:
    """What a replay found."""

    measurements: int = 0  # samples read
    answered: int = 0  # samples that led to an answer
    first_stamp: int | None = None  # stamp of the first sample [ns]
    rejected: Counter[str] = field(default_factory=Counter)  # unusable samples by reason
    events: list[RecordedAlarm] = field(default_factory=list)  # alarm events
    # processor time by stage [s]
    seconds: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    topic: str = ''  # of the measurements
    streams: set[str] = field(default_factory=set)  # of `STREAMS`, that are there
    warnings: list[str] = field(default_factory=list)  # tolerated defects of the bag
    lost: int = 0  # measurements that the recorder says it has lost

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the calling thread's processor time of a ``with`` block."""
        start = time.thread_time()
        try:
            yield
        finally:
            self.seconds[name] += time.thread_time() - start


@dataclass
class Batch:
    """A block of messages and the measurements in it."""

    block: Block
    positions: np.ndarray  # of the measurements in the block, shape (n,)
    measured: Measurements  # the measurements, decoded
    torque: np.ndarray | None  # in place of the measured efforts, shape (n, joints) [N m]
    changed: dict[int, object]  # messages that faults were injected into, by row
