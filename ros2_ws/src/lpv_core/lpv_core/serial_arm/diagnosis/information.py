"""Least squares over sliding windows of balances, from cumulative sums of their products.

Every balance adds A^T W A of its rows A = [c, J]; the sum over the last L balances is a difference
of two cumulative sums, so that any window costs the same.
"""

from collections import deque

import numpy as np

from lpv_core.serial_arm.chain import FloatArray


class InformationWindow:
    """The last balances of an arm.

    Parameters
    ----------
    columns : int
        Of a row: the constant part, then derivatives.
    capacity : int
        Balances that are kept.
    past_weight : float
        Factor of what has left the window, each time a balance joins it: 0 forgets at once.
    """

    def __init__(self, columns: int, capacity: int, past_weight: float) -> None:
        self.capacity = capacity
        self.past = np.zeros((columns, columns))
        self._past_weight = past_weight
        self._rows: deque[FloatArray] = deque(maxlen=capacity)
        self._sums: deque[FloatArray] = deque(maxlen=capacity + 1)
        self._sums.append(np.zeros((columns, columns)))
        self.times: deque[float] = deque(maxlen=capacity)
        self._trust: deque[float] = deque(maxlen=capacity)

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def rows(self) -> FloatArray:
        """Rows of the balances, shape (L, n, columns), oldest first."""
        return np.array(self._rows)

    def last_rows(self, count: int) -> FloatArray:
        """Rows of the last balances, shape (count, n, columns), oldest first."""
        return np.array([self._rows[k] for k in range(len(self._rows) - count, len(self._rows))])

    @property
    def trust(self) -> FloatArray:
        """Factors of the weights, shape (L,): small where something acted from outside."""
        return np.array(self._trust)

    def add(
        self, time: float, rows: FloatArray, weights: FloatArray, learn: bool, trust: float = 1.0
    ) -> None:
        """Append a balance.

        Parameters
        ----------
        time : float
            Of its middle [s].
        rows : ndarray, shape (n, columns)
            Constant part and derivatives.
        weights : ndarray, shape (n,)
            Inverse variances.
        learn : bool
            Whether the balance that leaves the window is remembered.
        trust : float, optional
            Factor of the weights.
        """
        if len(self._rows) == self.capacity:
            self.past *= self._past_weight
            if learn:
                self.past += self._sums[1] - self._sums[0]
        self._rows.append(rows.copy())
        self.times.append(time)
        self._trust.append(trust)
        self._sums.append(self._sums[-1] + trust * rows.T @ (weights[:, None] * rows))

    def reset(self, rows: FloatArray, weights: FloatArray) -> None:
        """Replace the rows in the window.

        Parameters
        ----------
        rows : ndarray, shape (L, n, columns)
            As many as the window holds.
        weights : ndarray, shape (L, n)
            Inverse variances.
        """
        weights = weights * self.trust[:, None]
        products = np.einsum('kia,ki,kib->kab', rows, weights, rows, optimize=True)
        total = np.zeros_like(self.past)
        self._sums.clear()
        self._sums.append(total)
        self._rows.clear()
        for row, product in zip(rows, products):
            total = total + product
            self._rows.append(row)
            self._sums.append(total)

    def forget(self, keep: int) -> None:
        """Drop all balances but the ``keep`` oldest ones."""
        while len(self._rows) > keep:
            self._rows.pop()
            self._sums.pop()
            self.times.pop()
            self._trust.pop()

    def products(self, last: int | None = None) -> FloatArray:
        """Sum of A^T W A over the last balances (all of them by default)."""
        count = len(self._rows)
        last = count if last is None else min(last, count)
        return self._sums[-1] - self._sums[count - last]
