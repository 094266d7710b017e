"""Robust weighted regression of torques on base parameters and friction.

Rows are filtered torques: both sides of tau = Y(q, v, a) phi + friction go through the same
zero-phase low-pass filter, so accelerations are derivatives of smoothed rates and need no sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from lpv.core.serial_arm.description import coulomb_direction
from lpv.identify.estimation.autocorrelation import estimate_covariance
from lpv.identify.estimation.robust import (
    invert_normal,
    normal_equations,
    normal_matrix,
    predicted,
    robust_fit,
    solve_normal,
)
from lpv.identify.model.friction import (
    SLOPES,
    TERMS,
    direction_slope,
    friction_columns,
    join_columns,
    least_viscous,
)
from lpv.identify.model.prior import Prior
from lpv.identify.recordings.filters import low_pass
from lpv.identify.recordings.motion import Bandwidths, Motion

_SWEEPS = 9  # of slopes, load and linear parameters in turn
_STEP = 0.5  # largest change of a slope's logarithm in a sweep
_SLOPE_HELD = 1.0  # information on a slope's logarithm: known within a factor of e


@dataclass(frozen=True)
class Rows(Motion):
    """Motion of a segment with efforts [N m], and its regressor at full rate, before filters."""

    base: np.ndarray  # of the base parameters, shape (samples, n, base)
    counts: np.ndarray  # where efforts do: not at rest, as friction is unknown, (samples, n)
    speed_limit: np.ndarray  # up to which friction must not drive, shape (n,) [rad/s]
    part: slice = field(default_factory=lambda: slice(None))  # samples that count
    cache: dict[tuple[float, float], np.ndarray] = field(  # filtered regressors of base parameters
        default_factory=dict, compare=False, repr=False
    )

    def filtered_base(self, bands: Bandwidths) -> np.ndarray:
        """Regressor of the base parameters through both filters."""
        key = (bands.effort, bands.analysis)
        if key not in self.cache:
            if len(self.cache) > 2:  # of the bandwidths that are tried
                self.cache.clear()
            self.cache[key] = low_pass(self.base, bands.effort, self.step, bands.analysis)
        return self.cache[key]


@dataclass(frozen=True)
class Fit:
    """Base parameters, then of each joint viscous, Coulomb, load-dependent friction, offset."""

    parameters: np.ndarray  # shape (base + 4 n,)
    slope: np.ndarray  # of the Coulomb term, shape (n,) [s/rad]
    scale: np.ndarray  # robust scale of the filtered residuals, shape (n,) [N m]
    normal: np.ndarray  # normal matrix of the weighted rows, without the prior
    right: np.ndarray  # its right-hand side: normal @ parameters = right without a prior
    covariance: np.ndarray  # of the parameters, with correlated residuals accounted for
    prior: Prior  # with which it was made

    @property
    def base(self) -> np.ndarray:
        """Base parameters."""
        return self.parameters[: -len(TERMS) * len(self.slope)]

    @property
    def friction(self) -> np.ndarray:
        """Friction parameters in the order of `TERMS`, shape (n, 4)."""
        return self.parameters[-len(TERMS) * len(self.slope) :].reshape(-1, len(TERMS))


def model_torque(rows: Rows, fit: Fit) -> np.ndarray:
    """Joint torque that a fit predicts, before any filter, shape (samples, n) [N m]."""
    rigid = predicted(rows.base, fit.base)
    columns = friction_columns(rows.velocity, fit.slope, rigid)
    return rigid + np.einsum('ijk,jk->ij', columns, fit.friction)


class Problem:
    """Filtered rows of all segments; the columns of friction change with slopes and load."""

    def __init__(self, rows: Sequence[Rows], bands: Bandwidths):
        self._rows, self._bands = rows, bands
        self.n, self.size = rows[0].effort.shape[1], rows[0].base.shape[2]
        self.speed_limit = rows[0].speed_limit
        self.base = np.concatenate([self._keep(r.filtered_base(bands), r) for r in rows])
        self.effort = np.concatenate(
            [self._keep(low_pass(r.effort, bands.analysis, r.step), r) for r in rows]
        )
        self.counts = np.concatenate([self._keep(r.counts, r) for r in rows])
        self.lengths = [len(self._keep(r.effort, r)) for r in rows]
        self._rates = np.concatenate([self._reduce(r.velocity, r) for r in rows])

    def _keep(self, signal: np.ndarray, rows: Rows) -> np.ndarray:
        return signal[rows.part][:: self._bands.thinning(rows.step)]

    def _reduce(self, signal: np.ndarray, rows: Rows) -> np.ndarray:
        """Model torque through both filters, thinned."""
        bands = self._bands
        return self._keep(low_pass(signal, bands.effort, rows.step, bands.analysis), rows)

    def _loads(self, parameters: np.ndarray) -> list[np.ndarray]:
        """Magnitude of the rigid-body torque of each joint, for each segment."""
        return [np.abs(predicted(rows.base, parameters[: self.size])) for rows in self._rows]

    def design(self, slope: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Regressor of all parameters, shape (rows, n, base + 4 n), with the load of known ones."""
        columns = []
        for rows, load in zip(self._rows, self._loads(parameters)):
            way = coulomb_direction(rows.velocity, slope)
            columns.append(self._reduce(np.hstack([way, load * way]), rows))
        way, loaded = np.hsplit(np.concatenate(columns), 2)
        friction = np.stack([self._rates, way, loaded, np.ones_like(way)], axis=2)
        return join_columns(self.base, friction)

    def with_slopes(
        self, design: np.ndarray, slope: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """Regressor with derivatives of the torque with respect to each log(k), too."""
        friction, parts = parameters[self.size :].reshape(self.n, len(TERMS)), []
        for rows, load in zip(self._rows, self._loads(parameters)):
            amplitude = friction[:, 1] + friction[:, 2] * load
            column = amplitude * direction_slope(rows.velocity, slope)
            parts.append(self._reduce(column, rows))
        column = np.concatenate(parts)
        return np.concatenate([design, column[:, :, None] * np.eye(self.n)], axis=2)

    def constraints(self, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Map P from other parameters z, parameters = P z; which z >= 0."""
        # Friction never drives up to the limit w if coulomb >= 0 and it does not at w.
        signed = np.ones((self.n, len(TERMS)), bool)
        signed[:, TERMS.index('offset')] = False
        passive = np.eye(self.size + signed.size)
        first = self.size + len(TERMS) * np.arange(self.n)
        passive[first, first + 1] = least_viscous(slope, self.speed_limit)
        return passive, np.append(np.zeros(self.size, bool), signed)


def fit_parameters(
    rows: Sequence[Rows],
    bands: Bandwidths,
    prior: Prior,
    slope: np.ndarray | None = None,  # shape (n,); searched if not given
    with_covariance: bool = False,
) -> Fit:
    """Fit base parameters, friction and slopes: Huber's estimate with one scale for each joint."""
    problem = Problem(rows, bands)
    n, search = problem.n, slope is None
    slope = prior.slope * np.ones(n) if slope is None else slope.copy()
    parameters = np.zeros(problem.size + len(TERMS) * n)
    scale, weight = np.ones(n), problem.counts.astype(float)
    for sweep in range(_SWEEPS if search else 3):
        if search and sweep:
            slope = _next_slopes(problem, slope, parameters, weight / scale**2, prior)
        design = problem.design(slope, parameters)
        parameters, residual, weight, scale = robust_fit(
            *(design, problem.effort, weight, scale, prior),
            rounds=2, solve=partial(_solve, problem, slope),
        )  # fmt: skip
    weights = weight / scale**2
    covariance = np.zeros((len(parameters), len(parameters)))
    if with_covariance:
        full = problem.with_slopes(design, slope, parameters)
        covariance = _uncertainty(problem, full, residual, weights, prior)
    normal, right = normal_equations(design, problem.effort, weights)
    return Fit(parameters, slope, scale, normal, right, covariance, prior)


def _solve(
    problem: Problem, slope: np.ndarray, matrix: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Solution without the terms of friction that would drive a joint."""
    passive, positive = problem.constraints(slope)
    return passive @ solve_normal(passive.T @ matrix @ passive, passive.T @ right, positive)


def _next_slopes(
    problem: Problem, slope: np.ndarray, parameters: np.ndarray, weight: np.ndarray, prior: Prior
) -> np.ndarray:
    """Gauss-Newton step in the logarithms of the slopes, together with all parameters."""
    # Also with terms that would drive: at another slope they may not, and hold it where it is.
    n, count = problem.n, len(parameters)
    design = problem.design(slope, parameters)
    full = problem.with_slopes(design, slope, parameters)
    matrix, right = normal_equations(full, problem.effort, weight, prior)
    matrix[count:, count:] += _SLOPE_HELD * np.eye(n)
    right[count:] += _SLOPE_HELD * np.log(prior.slope / slope)
    change = solve_normal(matrix, right)[-n:]
    return np.clip(slope * np.exp(np.clip(change, -_STEP, _STEP)), *SLOPES)


def _uncertainty(
    problem: Problem, full: np.ndarray, residual: np.ndarray, weight: np.ndarray, prior: Prior
) -> np.ndarray:
    """Covariance of the parameters; slopes are estimated, too."""
    n, size = problem.n, len(prior.mean)
    slopes = _SLOPE_HELD * np.eye(n)
    inverse = invert_normal(normal_matrix(full, weight) + block_diag(prior.information, slopes))
    root = np.sqrt(weight)
    data = full * root[:, :, None], residual * root, inverse, problem.lengths, problem.counts
    return estimate_covariance(*data, block_diag(prior.score, slopes))[:size, :size]
