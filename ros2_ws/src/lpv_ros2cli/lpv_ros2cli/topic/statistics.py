"""What hz and delay say about intervals and delays."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Statistics:
    """Of some durations."""

    mean: float  # [s]
    least: float  # [s]
    most: float  # [s]
    deviation: float  # standard deviation [s]
    count: int

    @classmethod
    def of(cls, durations: Sequence[float]) -> 'Statistics':
        """Statistics of durations [s], at least one."""
        count = len(durations)
        mean = sum(durations) / count
        deviation = math.sqrt(sum((x - mean) ** 2 for x in durations) / count)
        return cls(mean, min(durations), max(durations), deviation, count)

    def spread(self) -> str:
        """Second line of a report."""
        return (
            f'min: {self.least:.3f}s max: {self.most:.3f}s '
            f'std dev: {self.deviation:.5f}s window: {self.count}'
        )


def table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns under centred headings, three spaces between them."""
    widths = [max(map(len, column)) for column in zip(headings, *rows)]
    lines = [
        '   '.join(h.center(w) for h, w in zip(headings, widths)),
        '=' * (sum(widths) + 3 * (len(widths) - 1)),
        *('   '.join(c.ljust(w) for c, w in zip(row, widths)) for row in rows),
    ]
    return '\n'.join(lines) + '\n'
