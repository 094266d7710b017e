"""Choice of the model by prediction of data that were held back."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lpv.identify.estimation.evaluation import predict
from lpv.identify.estimation.regression import Filters, Fit, Rows, fit_parameters
from lpv.identify.estimation.robust import bounded_squares
from lpv.identify.model.prior import Prior

BLOCKS = 4
"""Blocks of the training data, each of which is predicted from the others."""
STRENGTHS = (1e-2, 1e-1, 1.0, 1e1, 1e2)
"""Strengths of the prior that are tried."""
EFFORT_BANDS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0)
"""Bandwidths of the effort sensor that are tried [Hz]."""
_GAIN = 0.9  # ratio of mean squares below which the richer model is taken
_NOTHING = 1e-5  # share of an effort's power that counts for nothing
EQUAL = 0.02
"""Difference of the logarithms of mean squares that counts for nothing."""


def divide(rows: Rows, share: float) -> tuple[Rows, Rows]:
    """First ``share`` of the counted samples, and the rest."""
    start, stop, _ = rows.part.indices(len(rows.effort))
    middle = start + int(round(share * (stop - start)))
    return replace(rows, part=slice(start, middle)), replace(rows, part=slice(middle, stop))


def validation_error(
    rows: Sequence[Rows], filters: Filters, estimate: Callable[[Sequence[Rows]], Fit]
) -> float:
    """Mean logarithm of the joints' mean square errors on blocks of training data [(N m)^2].

    The error of a joint of which nothing counts is 1, whatever the estimate.
    """
    total, count = np.zeros((2, rows[0].effort.shape[1]))
    parts = [one.part.indices(len(one.effort))[:2] for one in rows]
    edges = [np.linspace(*part, BLOCKS + 1).astype(int) for part in parts]
    for block in range(BLOCKS):
        train, valid = [], []
        for one, (start, stop), edge in zip(rows, parts, edges):
            rest = slice(start, edge[block]), slice(edge[block + 1], stop)
            train += [replace(one, part=p) for p in rest if p.stop - p.start > 10]
            valid.append(replace(one, part=slice(edge[block], edge[block + 1])))
        fit = estimate(train)
        for one in valid:
            found = predict(one, fit, filters)
            total += bounded_squares(found.residual_band, found.counts)
            count += found.counts.sum(axis=0)
    errors = np.divide(total, count, out=np.ones_like(total), where=total > 0.0)
    return float(np.mean(np.log(errors)))


def choose_effort_band(rows: Sequence[Rows], filters: Filters, prior: Prior) -> float:
    """Bandwidth of the effort sensor, inf if none is seen: drivers filter their torques."""
    errors: dict[float, float] = {}  # mean logarithms
    bands = [b for b in EFFORT_BANDS[::-1] if b < 0.15 / rows[0].step and _ends(rows, b)]
    for band in (np.inf, *bands):
        trial = replace(filters, effort=band)
        fit = fit_parameters(rows, trial, prior, sweeps=6, with_load=False)
        found = [predict(one, fit, trial) for one in rows]
        error, counts = (
            np.concatenate([getattr(p, x) for p in found]) for x in ('residual', 'counts')
        )
        squares = bounded_squares(error, counts)
        errors[band] = float(np.mean(np.log(squares, where=squares > 0.0, out=0.0 * squares)))
        tried = list(errors.values())
        if len(tried) > 4 and min(tried[-3:]) > min(tried):
            break
    best = min(errors, key=lambda band: errors[band])
    return best if errors[best] - errors[np.inf] < np.log(_GAIN) else np.inf


def _ends(rows: Sequence[Rows], band: float) -> bool:
    """Whether efforts carry next to nothing beyond three times a bandwidth."""
    beyond = 0.0
    for one in rows:
        effort = one.effort[one.part]
        window = np.hanning(len(effort))[:, None]
        power = np.abs(np.fft.rfft((effort - effort.mean(axis=0)) * window, axis=0)) ** 2
        power = power / np.maximum(power.sum(axis=0), 1e-300)
        high = np.fft.rfftfreq(len(effort), one.step) > 3.0 * band
        beyond += float(power[high].sum(axis=0).max())
    return beyond < _NOTHING * len(rows)
