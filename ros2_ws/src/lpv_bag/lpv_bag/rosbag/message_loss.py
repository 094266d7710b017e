"""What a recorder knows of its topics: messages lost on the way, late ones, gaps."""

import json
import zlib
from collections import deque
from dataclasses import dataclass, field

RECORD_NAME = 'lpv_recorder'
"""Name of the metadata record of a file, and key of the custom data of a bag."""
Known = dict[str, dict[str, int]]
"""What a recorder knows of each topic: messages, lost, late, gaps."""
_WINDOW = 64
_REGULAR = 0.9


@dataclass
class TopicCount:
    """Counts of one topic."""

    messages: int = 0  # messages taken
    # messages that were published and did not arrive, by the publishers' sequence numbers
    lost: int = 0
    late: int = 0  # messages whose stamp is older than one that came before
    gaps: int = 0  # stamps that are missing, where stamps come at a regular period
    _newest: int | None = None
    _sequences: dict[bytes | None, int] = field(default_factory=dict)
    _steps: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    _stepped: int = 0
    _period: int = 0

    def take(self, publisher: bytes | None = None, sequence: int | None = None) -> None:
        """Count a message."""
        self.messages += 1
        if sequence is None:
            return
        last = self._sequences.get(publisher)
        if last is None or sequence > last:
            self._sequences[publisher] = sequence
            if last is not None:
                self.lost += sequence - last - 1
        else:  # it was counted as lost when the next one came
            self.lost = max(0, self.lost - 1)

    def stamp(self, stamp: int) -> None:
        """Take note of a message's stamp [ns]."""
        if self._newest is None:
            self._newest = stamp
            return
        step = stamp - self._newest
        if step < 0:
            self.late += 1
            self.gaps = max(0, self.gaps - 1)
            return
        self._newest = stamp
        if self._period and step > 1.5 * self._period:
            self.gaps += round(step / self._period) - 1
        self._steps.append(step)
        self._stepped += 1
        if len(self._steps) == _WINDOW and self._stepped % (_WINDOW // 2) == 0:
            self._judge()

    def _judge(self) -> None:
        """The period, if nine steps of ten are within a quarter of it."""
        steps = sorted(self._steps)
        period = steps[_WINDOW // 2]
        near = sum(abs(step - period) <= period / 4 for step in steps)
        self._period = period if period > 0 and near >= _REGULAR * _WINDOW else 0

    def known(self) -> dict[str, int]:
        """Counts by name."""
        return {'messages': self.messages, 'lost': self.lost, 'late': self.late, 'gaps': self.gaps}


def as_text(known: Known) -> str:
    """JSON of the counts of all topics."""
    return json.dumps(known, sort_keys=True, separators=(',', ':'))


def as_metadata(known: Known) -> dict[str, str]:
    """Counts as a metadata record, which has no checksum of its own."""
    text = as_text(known)
    return {'topics': text, 'crc32': f'{zlib.crc32(text.encode()):08x}'}


def from_metadata(values: dict[str, str]) -> Known:
    """Counts by topic from a metadata record."""
    text = values.get('topics', '')
    if values.get('crc32') != f'{zlib.crc32(text.encode()):08x}':
        return {}
    try:
        known = json.loads(text)
        return {
            str(topic): {str(name): int(value) for name, value in counts.items()}
            for topic, counts in known.items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError):
        return {}
