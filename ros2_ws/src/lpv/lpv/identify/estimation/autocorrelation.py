"""Residuals that are correlated over time: their autocovariance, and what it does to estimates."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import correlate

_DRAWS = 20  # errors that are drawn: their mean is right within a quarter of its size
_ROUNDS = 2  # of drawing errors with what the round before found
_RUN = 5  # autocovariances in a row that are noise: here they end


def estimate_covariance(
    rows: np.ndarray,  # weighted regressor, shape (rows, n, parameters)
    residual: np.ndarray,  # weighted, shape (rows, n)
    inverse: np.ndarray,  # of the normal matrix, that of a prior included
    lengths: Sequence[int],  # of the stretches, in rows
    counts: np.ndarray,  # which residuals do, shape (rows, n); the others are 0
    known: np.ndarray | float = 0.0,  # covariance of the prior's score
) -> np.ndarray:
    """Covariance of an estimate whose error is inverse @ (score of the data + of the prior)."""
    gammas = _residual_autocovariances(rows, residual, inverse, lengths, counts)

    def covariance_with(gammas: Sequence[np.ndarray]) -> np.ndarray:
        return inverse @ (_score_covariance(rows, gammas, lengths) + known) @ inverse

    covariance = covariance_with(gammas)
    # Autocovariances that were cut off may be those of no process: there errors count as white.
    negative = np.flatnonzero(np.diag(covariance) <= 0.0)
    if len(negative):
        white = np.diag(covariance_with([gamma[:1] for gamma in gammas]))
        covariance[negative] = covariance[:, negative] = 0.0
        covariance[negative, negative] = white[negative]
    return covariance


def _score_covariance(
    rows: np.ndarray, gammas: Sequence[np.ndarray], lengths: Sequence[int]
) -> np.ndarray:
    """Covariance of the scores sum_k z_k e_k of stretches: sum_kl z_k gamma(k - l) z_l^T."""
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


def _residual_autocovariances(
    rows: np.ndarray,
    residual: np.ndarray,
    inverse: np.ndarray,
    lengths: Sequence[int],
    counts: np.ndarray,
) -> list[np.ndarray]:
    """Autocovariance of each joint's errors from lag 0 on, from the residuals of a fit."""
    # A fit takes out of the residuals what regressors can explain: how much is found by drawing
    # errors with the present autocovariance and fitting them.
    count, n = residual.shape
    most = max(2, int(0.15 * max(lengths)))
    pairs = [autocovariance(_stretches(c.astype(float), lengths), most) for c in counts.T]

    def found_of(errors: np.ndarray, joint: int, lags: int) -> np.ndarray:
        found = autocovariance(_stretches(errors, lengths), lags)
        return found / np.maximum(pairs[joint][:lags], 1.0 / count)

    found = [_ended(found_of(r, j, most), count) for j, r in enumerate(residual.T)]
    errors, rng = found, np.random.default_rng(3)
    flat = rows.reshape(count * n, -1)
    for _ in range(_ROUNDS):
        left = [np.zeros(len(gamma)) for gamma in found]
        for _ in range(_DRAWS):
            drawn = np.stack([_draw(_windowed(gamma), count, rng) for gamma in errors], axis=1)
            drawn *= counts
            rest = drawn - rows @ (inverse @ (flat.T @ drawn.ravel()))
            for j, (lost, before, after) in enumerate(zip(left, drawn.T, rest.T)):
                both = [found_of(e, j, len(lost)) for e in (before, after)]
                lost += (both[0] - both[1]) / _DRAWS
        errors = [gamma + lost for gamma, lost in zip(found, left)]
    return [_windowed(gamma) for gamma in errors]


def autocovariance(stretches: Sequence[np.ndarray], most: int) -> np.ndarray:
    """Mean products of what is some samples apart, from lag 0 on, shape (most,)."""
    sums = np.zeros(most)
    for part in stretches:
        lags = min(most, len(part))
        sums[:lags] += correlate(part, part, method='fft')[len(part) - 1 :][:lags]
    return sums / max(sum(len(part) for part in stretches), 1)


def _stretches(values: np.ndarray, lengths: Sequence[int]) -> list[np.ndarray]:
    return np.split(values, np.cumsum(lengths)[:-1])


def _ended(gamma: np.ndarray, samples: int) -> np.ndarray:
    small = np.abs(gamma) < 2.0 * gamma[0] / np.sqrt(samples)
    runs = np.flatnonzero(np.convolve(small, np.ones(_RUN), 'valid') >= _RUN)
    return gamma[: 2 * (int(runs[0]) + 1)] if len(runs) else gamma


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
