"""What a recorder knows of its topics: messages that got lost on the way, and late ones."""

import json
from dataclasses import dataclass, field

RECORD_NAME = 'lpv_recorder'
"""Key of the custom data of a bag."""
Known = dict[str, dict[str, int]]
"""What a recorder knows of each topic: messages, lost, late."""


@dataclass
class TopicCount:
    """Counts of one topic."""

    messages: int = 0  # messages taken
    lost: int = 0  # published and not received, by the publishers' sequence numbers
    late: int = 0  # messages whose stamp is older than one that came before
    _newest: int | None = None
    _sequences: dict[bytes | None, int] = field(default_factory=dict)

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
        if self._newest is not None and stamp < self._newest:
            self.late += 1
        else:
            self._newest = stamp

    def known(self) -> dict[str, int]:
        """Counts by name."""
        return {'messages': self.messages, 'lost': self.lost, 'late': self.late}


def known_from_text(text: str) -> Known:
    """Counts by topic from custom data; none where they are damaged."""
    try:
        return {
            str(topic): {str(name): int(value) for name, value in counts.items()}
            for topic, counts in json.loads(text).items()
        }
    except (ValueError, TypeError, AttributeError, RecursionError):
        return {}
