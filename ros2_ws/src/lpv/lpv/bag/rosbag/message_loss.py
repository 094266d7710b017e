"""Counts of what a recorder hears: messages that got lost on the way, and late ones."""

from dataclasses import dataclass, field


@dataclass
class TopicCount:
    """Counts of one topic."""

    messages: int = 0  # messages taken
    lost: int = 0  # published and not received, by the publishers' sequence numbers
    late: int = 0  # messages whose stamp is older than one that came before
    _newest: int | None = None
    _sequences: dict[bytes | None, int] = field(default_factory=dict)

    def take(self, publisher: bytes | None = None, sequence: int | None = None) -> None:
        self.messages += 1
        if sequence is None:
            return
        last = self._sequences.get(publisher)
        if last is None or sequence > last:
            self._sequences[publisher] = sequence
            self.lost += 0 if last is None else sequence - last - 1
        else:  # it was counted as lost when the next one came
            self.lost = max(0, self.lost - 1)

    def stamp(self, stamp: int) -> None:
        """Take note of a message's stamp [ns]."""
        self.late += self._newest is not None and stamp < self._newest
        self._newest = stamp if self._newest is None else max(stamp, self._newest)

    def known(self) -> dict[str, int]:
        """Counts by name."""
        return {'messages': self.messages, 'lost': self.lost, 'late': self.late}
