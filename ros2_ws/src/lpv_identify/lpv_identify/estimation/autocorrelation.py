"""Residuals that are correlated over time: their autocovariance, and what it does to estimates."""

from collections.abc import Sequence

import numpy as np

_DRAWS = 20
_ROUNDS = 2
_RUN = 5  # autocovariances in a row that are noise: here they end


def score_covariance(
    rows: np.ndarray, gammas: Sequence[np.ndarray], lengths: Sequence[int]
) -> np.ndarray:
    """Covariance of the scores sum_k z_k e_k, sum_kl z_k gamma(k - l) z_l^T.

    ``rows`` are the weighted regressor z, shape (samples, n, parameters), made of stretches of some
    ``lengths``; ``gammas`` the autocovariances of each joint's weighted residuals from lag 0 on.
    Joints are independent.
    """
    total = np.zeros((rows.shape[2], rows.shape[2]))
    for j, gamma in enumerate(gammas):
        used = np.flatnonzero(np.any(rows[:, j] != 0.0, axis=0))
        part = np.zeros((len(used), len(used)))
        for block in _stretches(rows[:, j][:, used], lengths):
            for lag in range(min(len(gamma), len(block))):
                product = gamma[lag] * (block[lag:].T @ block[: len(block) - lag])
                part += product if lag == 0 else product + product.T
        total[np.ix_(used, used)] += part
    return total


def residual_autocovariances(
    rows: np.ndarray, residual: np.ndarray, inverse: np.ndarray, lengths: Sequence[int]
) -> list[np.ndarray]:
    """Autocovariance of each joint's errors from lag 0 on, from the residuals of a fit.

    A fit takes out of the residuals what regressors can explain, most at the frequencies of the
    motion.  How much is found by drawing errors with the present autocovariance and fitting them.
    Weighted ``rows``, shape (samples, n, parameters), and ``residual``, shape (samples, n), are
    made of stretches of some ``lengths``; ``inverse`` is that of the normal matrix.
    """
    n = residual.shape[1]
    most = max(2, int(0.15 * max(lengths)))
    found = [_raw(residual[:, j], lengths, most) for j in range(n)]
    ends = [_end(gamma, len(residual)) for gamma in found]
    found = [gamma[:end] for gamma, end in zip(found, ends)]
    errors = [gamma.copy() for gamma in found]
    rng = np.random.default_rng(3)
    for _ in range(_ROUNDS):
        windowed = [_windowed(gamma) for gamma in errors]
        left = [np.zeros(end) for end in ends]
        for _ in range(_DRAWS):
            drawn = np.stack([_draw(gamma, len(residual), rng) for gamma in windowed], axis=1)
            scores = np.einsum('ijk,ij->k', rows, drawn)
            rest = drawn - rows @ (inverse @ scores)
            for j in range(n):
                change = _raw(drawn[:, j], lengths, ends[j]) - _raw(rest[:, j], lengths, ends[j])
                left[j] += change / _DRAWS
        errors = [gamma + lost for gamma, lost in zip(found, left)]
    return [_windowed(gamma) for gamma in errors]


def _stretches(values: np.ndarray, lengths: Sequence[int]) -> list[np.ndarray]:
    return np.split(values, np.cumsum(lengths)[:-1])


def _raw(residual: np.ndarray, lengths: Sequence[int], most: int) -> np.ndarray:
    sums, count = np.zeros(most), 0
    for part in _stretches(residual, lengths):
        count += len(part)
        for lag in range(min(most, len(part))):
            sums[lag] += part[lag:] @ part[: len(part) - lag]
    return sums / max(count, 1)


def _end(gamma: np.ndarray, samples: int) -> int:
    small = np.abs(gamma) < 2.0 * gamma[0] / np.sqrt(samples)
    runs = np.flatnonzero(np.convolve(small, np.ones(_RUN), 'valid') >= _RUN)
    return min(len(gamma), 2 * (int(runs[0]) + 1)) if len(runs) else len(gamma)


def _windowed(gamma: np.ndarray) -> np.ndarray:
    """Flat-top window: autocovariances that count stay as they are."""
    ratio = np.arange(len(gamma)) / len(gamma)
    return gamma * np.minimum(1.0, 2.0 * (1.0 - ratio))


def _draw(gamma: np.ndarray, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Normal errors of an autocovariance, by its spectrum."""
    size = 2 * max(samples, len(gamma))
    circle = np.zeros(size)
    circle[: len(gamma)] = gamma
    circle[-len(gamma) + 1 :] += gamma[1:][::-1]
    power = np.maximum(np.fft.rfft(circle).real, 0.0)
    return np.fft.irfft(np.fft.rfft(rng.normal(size=size)) * np.sqrt(power), size)[:samples]
