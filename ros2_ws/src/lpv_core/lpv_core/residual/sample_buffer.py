"""The last seconds of one sensor: residual, reading, allowance, innovation, rate."""

from typing import NamedTuple

import numpy as np

from lpv_core.support.jit import njit

RESIDUAL, READING, ALLOWANCE, INNOVATION, RATE = range(5)
"""Columns of the values."""
_COLUMNS = 5


class SampleBuffer(NamedTuple):
    """Samples of one sensor in the order of time; of several sensors with one more dimension.

    Rows stay contiguous: when all ``2 * size`` are in use, the newer half moves to the front.
    """

    stamps: np.ndarray
    """Time of each row [ns], shape (2*size,)."""
    values: np.ndarray
    """Residual and allowance (`lpv_core.residual.dead_reckoning`) and reading [rad], innovation of
    the rate and measured rate [rad/s], shape (2*size, 5)."""
    used: np.ndarray
    """Rows in use, shape (1,); the newest ``size`` of them are certain to be kept."""


def new_buffers(sensors: int, size: int) -> SampleBuffer:
    """Empty buffers of several sensors for so many samples each; see `buffer_of`."""
    return SampleBuffer(
        np.zeros((sensors, 2 * size), np.int64),
        np.zeros((sensors, 2 * size, _COLUMNS)),
        np.zeros((sensors, 1), np.int64),
    )


@njit
def buffer_of(buffers: SampleBuffer, sensor: int) -> SampleBuffer:
    """The buffer of one sensor; it shares the memory."""
    return SampleBuffer(buffers.stamps[sensor], buffers.values[sensor], buffers.used[sensor])


@njit
def clear_buffer(buffer: SampleBuffer) -> None:
    """Forget all samples."""
    buffer.used[0] = 0


@njit
def add_sample(buffer: SampleBuffer, sample: np.record) -> None:
    """Add a sample (`lpv_core.decision.sensor_state.SAMPLE`) that is newer than all others."""
    stamps, values, count = buffer.stamps, buffer.values, buffer.used[0]
    if count == len(stamps):
        count = len(stamps) // 2
        for k in range(count):
            stamps[k] = stamps[count + k]
            for column in range(_COLUMNS):
                values[k, column] = values[count + k, column]
    stamps[count] = sample.stamp
    row = values[count]
    row[RESIDUAL], row[READING] = sample.residual, sample.reading
    row[ALLOWANCE], row[INNOVATION] = sample.allowance, sample.innovation
    row[RATE] = sample.rate
    buffer.used[0] = count + 1


@njit
def index_at(buffer: SampleBuffer, stamp: int, guess: int) -> int:
    """Row of the latest sample not after a stamp; -1 if the buffer does not reach back so far.

    A good guess of the row saves time; the result does not depend on it.
    """
    stamps, count = buffer.stamps, buffer.used[0]
    oldest = max(0, count - len(stamps) // 2)
    row = min(max(guess, oldest), count - 1)
    while row >= oldest and stamps[row] > stamp:
        row -= 1
    while row + 1 < count and row >= oldest and stamps[row + 1] <= stamp:
        row += 1
    return row if row >= oldest else -1


@njit
def first_since(buffer: SampleBuffer, stamp: int) -> int:
    """First row that is kept and not before a stamp; the number of rows if there is none."""
    stamps, row = buffer.stamps, buffer.used[0]
    oldest = max(0, row - len(stamps) // 2)
    while row > oldest and stamps[row - 1] >= stamp:
        row -= 1
    return row


@njit
def median_before(buffer: SampleBuffer, row: int, count: int) -> float:
    """Median of the last ``count`` residuals up to a row [rad]: single bad samples do not count."""
    few = np.sort(buffer.values[max(0, row + 1 - count) : row + 1, RESIDUAL])
    return few[len(few) // 2]
