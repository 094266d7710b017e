"""The last second of one sensor: fault estimate, reading, and the reading that was expected."""

import numpy as np


class History:
    """Ring buffer of samples in the order of their stamps.

    Parameters
    ----------
    size : int
        Samples that are kept.
    """

    FAULT, READING, EXPECTED = range(3)

    def __init__(self, size):
        self._size = size
        self._stamps = np.zeros(2 * size, dtype=np.int64)
        self._values = np.zeros((2 * size, 3))
        self.clear()

    def clear(self):
        """Forget everything."""
        self._end = 0

    def add(self, stamp, fault, reading, expected):
        """Add a sample.

        Parameters
        ----------
        stamp : int
            [ns], larger than the last one.
        fault, reading, expected : float
            f^, y_p and S theta^ of the sensor [rad].
        """
        if self._end == len(self._stamps):
            # Keep the newer half: columns stay contiguous, and copying is rare.
            self._stamps[:self._size] = self._stamps[self._size:]
            self._values[:self._size] = self._values[self._size:]
            self._end = self._size
        self._stamps[self._end] = stamp
        row = self._values[self._end]
        row[0], row[1], row[2] = fault, reading, expected
        self._end += 1

    def at(self, stamp):
        """Fault estimate at the latest sample not after a stamp.

        Parameters
        ----------
        stamp : int
            [ns].

        Returns
        -------
        tuple
            Its stamp [ns] and f^ [rad]; None where the buffer does not reach back so far.
        """
        index = int(np.searchsorted(self._stamps[:self._end], stamp, side='right')) - 1
        if index < max(0, self._end - self._size):
            return None
        return int(self._stamps[index]), float(self._values[index, 0])

    def median_at(self, stamp, count=5):
        """Median of the fault estimates around the latest sample not after a stamp.

        A single bad sample must not be what later ones are compared with.

        Parameters
        ----------
        stamp : int
            [ns].
        count : int, optional
            Samples that are looked at, ending there.

        Returns
        -------
        float
            [rad].
        """
        index = int(np.searchsorted(self._stamps[:self._end], stamp, side='right'))
        values = sorted(self._values[max(0, index - count):index, 0].tolist())
        return values[len(values) // 2]

    def since(self, stamp):
        """Samples from a stamp on, as far as they are kept.

        Parameters
        ----------
        stamp : int
            [ns].

        Returns
        -------
        tuple of ndarray
            Stamps (n,) [ns] and values (n, 3): f^, y_p, S theta^ [rad].
        """
        first = int(np.searchsorted(self._stamps[:self._end], stamp, side='left'))
        first = max(first, self._end - self._size, 0)
        return self._stamps[first:self._end], self._values[first:self._end]

    def last(self, count):
        """The latest samples, as `since`."""
        first = max(0, self._end - count)
        return self._stamps[first:self._end], self._values[first:self._end]
