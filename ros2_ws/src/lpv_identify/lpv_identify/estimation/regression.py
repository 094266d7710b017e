"""Robust weighted regression of torques on base parameters and friction.

Rows are filtered torques: both sides of tau = Y(q, v, a) phi + friction go through the same
zero-phase low-pass filter, so accelerations are derivatives of smoothed rates and need no sensor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio
from scipy.optimize import nnls
from scipy.stats import f as fisher
from scipy.stats import t as student

from lpv_identify.estimation.autocorrelation import residual_autocovariances, score_covariance
from lpv_identify.model.base_parameters import BaseParameters
from lpv_identify.model.friction import SLOPES, TERMS, direction, direction_slope, friction_columns
from lpv_identify.model.rigid_body import torque_regressor
from lpv_identify.recordings.filters import derivative, low_pass
from lpv_identify.recordings.motion import Motion

HUBER = 3.0
"""Residuals beyond this many scales weigh less (contacts, outliers)."""
_SWEEPS = 6
_REFINEMENTS = 3
_SLOPE_HELD = 1.0  # information on a slope's logarithm: known within a factor of e


@dataclass(frozen=True)
class Rows:
    """Regressor of a segment at full rate, before filters."""

    step: float  # [s]
    base: np.ndarray  # of the base parameters, shape (samples, n, base)
    velocity: np.ndarray  # shape (samples, n) [rad/s]
    effort: np.ndarray  # shape (samples, n) [N m]
    speed_limit: np.ndarray  # of the joints, shape (n,) [rad/s]
    part: slice = field(default_factory=lambda: slice(None))  # samples that count
    cache: dict[tuple[float, float], np.ndarray] = field(  # filtered regressors of base parameters
        default_factory=dict, compare=False, repr=False
    )

    def filtered_base(self, filters: 'Filters') -> np.ndarray:
        """Regressor of the base parameters through both filters."""
        key = (filters.effort, filters.analysis)
        if key not in self.cache:
            if len(self.cache) > 2:  # of the bandwidths that are tried
                self.cache.clear()
            self.cache[key] = low_pass(self.base, filters.effort, self.step, filters.analysis)
        return self.cache[key]


@dataclass(frozen=True)
class Filters:
    """What lies between the joint torque and a row of the regression."""

    effort: float = np.inf  # bandwidth of the effort sensor, applied to the model only [Hz]
    analysis: float = np.inf  # applied to both sides [Hz]
    thinning: int = 1  # every so many samples are kept
    test: float = np.inf  # of the causal filter through which residuals are rated [Hz]


@dataclass(frozen=True)
class Prior:
    """Normal distribution of the parameters before the data."""

    mean: np.ndarray  # shape (parameters,)
    information: np.ndarray  # inverse covariance, shape (parameters, parameters)


@dataclass(frozen=True)
class Fit:
    """Result of the regression.

    The parameters are the base parameters, then for each joint viscous, Coulomb, load-dependent
    friction and offset (joint by joint).
    """

    parameters: np.ndarray  # shape (base + 4 n,)
    slope: np.ndarray  # of the Coulomb term, shape (n,) [s/rad]
    scale: np.ndarray  # robust scale of the filtered residuals, shape (n,) [N m]
    base_size: int
    normal: np.ndarray  # normal matrix of the weighted rows, without the prior
    right: np.ndarray  # its right-hand side: normal @ parameters = right without a prior
    covariance: np.ndarray  # of the parameters, with correlated residuals accounted for
    freedom: float  # degrees of freedom of the covariance
    used_load: np.ndarray  # joints with load-dependent friction, shape (n,)

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Half width of each parameter's interval at a level of confidence (Student's t)."""
        factor = float(student.ppf(0.5 + 0.5 * level, self.freedom))
        return factor * np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def region(self, size: int, level: float = 0.95) -> float:
        """Largest squared distance, in covariances, inside the joint region (Hotelling's T^2)."""
        rest = max(1.0, self.freedom - size + 1.0)
        return size * self.freedom / rest * float(fisher.ppf(level, size, rest))

    @property
    def base(self) -> np.ndarray:
        """Base parameters."""
        return self.parameters[: self.base_size]

    @property
    def friction(self) -> np.ndarray:
        """Friction parameters in the order of `TERMS`, shape (n, 4)."""
        return self.parameters[self.base_size :].reshape(-1, len(TERMS))


def make_rows(
    model: pinocchio.Model,
    base: BaseParameters,
    motion: Motion,
    speed_limit: np.ndarray,
    with_gravity: bool = True,
) -> Rows:
    """Regressor of the torques along a smoothed motion with efforts [N m].

    Friction must not drive a joint up to the ``speed_limit``, shape (n,) [rad/s]; ``with_gravity``
    says whether the efforts contain gravity torques.
    """
    position, velocity, acceleration = (
        motion.position, motion.velocity, derivative(motion.velocity, motion.step)
    )  # fmt: skip
    if not with_gravity:
        model = model.copy()
        model.gravity.linear = np.zeros(3)
    n = model.nv
    rotors = acceleration[:, :, None] * np.eye(n)
    rigid = torque_regressor(model, position, velocity, acceleration)
    columns = np.concatenate([rigid, rotors], axis=2)[:, :, base.columns]
    return Rows(motion.step, columns, velocity, motion.effort, speed_limit)


def model_torque(rows: Rows, fit: Fit) -> np.ndarray:
    """Joint torque that a fit predicts, before any filter, shape (samples, n) [N m]."""
    rigid = rows.base @ fit.base
    columns = friction_columns(rows.velocity, fit.slope, rigid)
    return rigid + np.einsum('ijk,jk->ij', columns, fit.friction)


Loads = Sequence[np.ndarray | None]
"""Magnitudes of rigid-body torques, a segment each; None if no friction depends on them."""


class Problem:
    """Filtered rows of all segments; the columns of friction change with slopes and load."""

    def __init__(self, rows: Sequence[Rows], filters: Filters, use_load: np.ndarray):
        self._rows, self._filters, self.use_load = rows, filters, use_load
        self.n = rows[0].effort.shape[1]
        self.base = np.concatenate([self._keep(r.filtered_base(filters), r) for r in rows])
        self.effort = np.concatenate(
            [self._keep(low_pass(r.effort, filters.analysis, r.step), r) for r in rows]
        )
        self.lengths = [
            len(range(*r.part.indices(len(r.effort)))[:: filters.thinning]) for r in rows
        ]
        self._rates = np.concatenate([self._reduce(r.velocity, r) for r in rows])

    def _keep(self, signal: np.ndarray, rows: Rows) -> np.ndarray:
        return signal[rows.part][:: self._filters.thinning]

    def _reduce(self, signal: np.ndarray, rows: Rows) -> np.ndarray:
        """Model torque through both filters, thinned."""
        filters = self._filters
        return self._keep(low_pass(signal, filters.effort, rows.step, filters.analysis), rows)

    def loads(self, beta: np.ndarray) -> Loads:
        """Magnitude of the rigid-body torque of each joint, for each segment."""
        if not self.use_load.any():
            return [None] * len(self._rows)
        return [np.abs(rows.base @ beta) for rows in self._rows]

    def friction(self, slope: np.ndarray, loads: Loads | None) -> np.ndarray:
        """Filtered friction columns of each joint, shape (rows, n, 4)."""
        columns = []
        for rows, load in zip(self._rows, loads or [None] * len(self._rows)):
            way = direction(rows.velocity, slope)
            parts = way if load is None else np.hstack([way, load * way])
            reduced = self._reduce(parts, rows)
            columns.append(np.hstack([reduced, np.zeros_like(reduced)])[:, : 2 * self.n])
        way, loaded = np.hsplit(np.concatenate(columns), 2)
        return np.stack([self._rates, way, loaded, np.ones_like(way)], axis=2)

    def slope_column(self, slope: np.ndarray, loads: Loads, friction: np.ndarray) -> np.ndarray:
        """Derivative of the torque with respect to log(k), shape (rows, n)."""
        parts = []
        for rows, load in zip(self._rows, loads):
            amplitude = friction[:, 1] + friction[:, 2] * (0.0 if load is None else load)
            column = amplitude * direction_slope(rows.velocity, slope)
            parts.append(self._reduce(column, rows))
        return np.concatenate(parts)


def fit_parameters(
    rows: Sequence[Rows],
    filters: Filters,
    use_load: np.ndarray,
    prior: Prior | None = None,
    slope: np.ndarray | None = None,
    signed: bool = True,
    sweeps: int = _SWEEPS,
    with_covariance: bool = False,
) -> Fit:
    """Fit base parameters, friction and slopes.

    Parameters
    ----------
    rows : sequence of Rows
        One per segment.
    filters : Filters
        Filters and thinning.
    use_load : ndarray of bool, shape (n,)
        Joints with load-dependent friction.
    prior : Prior, optional
        Of all parameters.
    slope : ndarray, shape (n,), optional
        Slopes that are kept; they are searched if not given.
    signed : bool, optional
        Leave out terms of friction that would drive a joint.
    sweeps : int, optional
        Alternations between slopes, load and linear parameters.
    with_covariance : bool, optional
        Compute the covariance, too; it is zero otherwise.

    Returns
    -------
    Fit
        Huber's estimate with one scale for each joint.
    """
    problem = Problem(rows, filters, use_load)
    n, size = problem.n, problem.base.shape[2]
    allowed = _active_columns(size, use_load)
    passive = _passive_map(size, rows[0].speed_limit)
    search = slope is None
    sweeps = sweeps if search else min(sweeps, 3)
    slope = np.full(n, 50.0) if slope is None else slope.copy()
    parameters = np.zeros(size + len(TERMS) * n)
    scale = np.ones(n)
    weight = np.ones_like(problem.effort)
    for sweep in range(sweeps):
        loads = problem.loads(parameters[:size]) if sweep else None
        if search and sweep:
            slope = _search_slopes(
                problem, parameters, loads, slope, weight, sweep, rows[0].speed_limit
            )
        design = join_columns(problem.base, problem.friction(slope, loads))
        for _ in range(2):
            equations = _normal_equations(design, problem.effort, weight / scale**2, prior)
            parameters, active = _solve(*equations, allowed, passive, signed)
            residual = problem.effort - design @ parameters
            scale = _scale(residual)
            weight = _huber(residual / scale)
        if search and sweep == sweeps - 1:
            for _ in range(_REFINEMENTS):
                slope, parameters, residual = _refine(
                    problem, slope, parameters, weight / scale**2, active, prior
                )
                scale = _scale(residual)
                weight = _huber(residual / scale)
            loads = problem.loads(parameters[:size])
            design = join_columns(problem.base, problem.friction(slope, loads))
    covariance, freedom = np.zeros((len(parameters), len(parameters))), 1.0
    if with_covariance:
        column = problem.slope_column(
            slope, problem.loads(parameters[:size]), parameters[size:].reshape(n, len(TERMS))
        )
        weights = weight / scale**2
        covariance, freedom = _uncertainty(
            design, column, residual, weights, active, problem.lengths, prior
        )
    normal, right = _normal_equations(design, problem.effort, weight / scale**2, None)
    return Fit(parameters, slope, scale, size, normal, right, covariance, freedom, use_load)


def _refine(
    problem: Problem,
    slope: np.ndarray,
    parameters: np.ndarray,
    weight: np.ndarray,
    active: np.ndarray,
    prior: Prior | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss-Newton step in the logarithms of the slopes, together with all parameters."""
    size, n = problem.base.shape[2], problem.n
    friction = parameters[size:].reshape(n, len(TERMS))
    loads = problem.loads(parameters[:size])
    design = join_columns(problem.base, problem.friction(slope, loads))
    column = problem.slope_column(slope, loads, friction)
    full = np.concatenate([design, column[:, :, None] * np.eye(n)], axis=2)
    matrix = normal_matrix(full, weight)
    right = np.einsum('ijk,ij->k', full, weight * problem.effort)
    if prior is not None:
        matrix[: len(active), : len(active)] += prior.information
        right[: len(active)] += prior.information @ prior.mean
    matrix[range(len(active), len(right)), range(len(active), len(right))] += _SLOPE_HELD
    # What is left out stays where it is: at zero, or at the limit of dissipation.
    kept = np.concatenate([active, np.ones(n, bool)])
    fixed = np.concatenate([np.where(active, 0.0, parameters), np.zeros(n)])
    right -= matrix @ fixed
    solution = fixed
    solution[kept] += invert_normal(matrix[np.ix_(kept, kept)]) @ right[kept]
    step = np.clip(solution[len(active) :], -0.3, 0.3)
    residual = problem.effort - full @ np.concatenate([solution[: len(active)], step])
    slope = np.clip(slope * np.exp(step), SLOPES[0], SLOPES[-1])
    return slope, solution[: len(active)], residual


def _active_columns(size: int, use_load: np.ndarray) -> np.ndarray:
    friction = np.ones((len(use_load), len(TERMS)), bool)
    friction[:, TERMS.index('load')] = use_load
    return np.concatenate([np.ones(size, bool), friction.ravel()])


def _passive_map(size: int, speed_limit: np.ndarray) -> np.ndarray:
    """Map from parameters that must not be negative to those of friction.

    Friction drives at no speed up to the limit w if coulomb >= 0 and viscous + coulomb/w >= 0:
    beyond its maximum (Stribeck's effect) friction may fall, down to nothing at w.
    """
    n, terms = len(speed_limit), len(TERMS)
    result = np.eye(size + terms * n)
    first = size + terms * np.arange(n)
    result[first, first + 1] = -1.0 / speed_limit
    return result


def _negative(parameters: np.ndarray, passive: np.ndarray) -> np.ndarray:
    """Viscous (from the Coulomb term's end on), Coulomb and load-dependent terms below zero."""
    result = parameters < 0.0
    first = np.flatnonzero(passive.sum(axis=1) < 1.0)
    result[: first[0]] = False
    result[first + TERMS.index('offset')] = False
    return result


def join_columns(base: np.ndarray, friction: np.ndarray) -> np.ndarray:
    """Regressor of all parameters, shape (rows, n, base + 4 n)."""
    count, n, terms = friction.shape
    spread = np.zeros((count, n, n, terms))
    spread[:, np.arange(n), np.arange(n)] = friction
    return np.concatenate([base, spread.reshape(count, n, n * terms)], axis=2)


def _scale(residual: np.ndarray) -> np.ndarray:
    scale = np.median(np.abs(residual), axis=0) / 0.6745
    return np.maximum(scale, 1e-9 + 1e-6 * np.max(scale))


def _huber(ratio: np.ndarray) -> np.ndarray:
    return HUBER / np.maximum(np.abs(ratio), HUBER)


def normal_matrix(design: np.ndarray, weight: np.ndarray) -> np.ndarray:
    flat = (design * np.sqrt(weight)[:, :, None]).reshape(-1, design.shape[2])
    return flat.T @ flat


def _normal_equations(
    design: np.ndarray, effort: np.ndarray, weight: np.ndarray, prior: Prior | None
) -> tuple[np.ndarray, np.ndarray]:
    matrix = normal_matrix(design, weight)
    right = np.einsum('ijk,ij->k', design, weight * effort)
    if prior is not None:
        matrix = matrix + prior.information
        right = right + prior.information @ prior.mean
    return matrix, right


def _solve(
    matrix: np.ndarray, right: np.ndarray, allowed: np.ndarray, passive: np.ndarray, signed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Solution, and which parameters it has; friction that would drive is left out."""
    matrix, right = passive.T @ matrix @ passive, passive.T @ right
    active = allowed.copy()
    while True:
        result = np.zeros(len(active))
        result[active] = invert_normal(matrix[np.ix_(active, active)]) @ right[active]
        negative = _negative(result, passive) if signed else np.zeros(len(active), bool)
        if not negative.any():
            return passive @ result, active
        active &= ~negative


def invert_normal(matrix: np.ndarray) -> np.ndarray:
    """Inverse of a normal matrix; directions that the rows do not show are left out."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    kept = values > 1e-11 * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return inverse / np.outer(size, size)


def _search_slopes(
    problem: Problem,
    parameters: np.ndarray,
    loads: Loads | None,
    slope: np.ndarray,
    weight: np.ndarray,
    sweep: int,
    speed_limit: np.ndarray,
) -> np.ndarray:
    """Best slope of each joint on a grid, the rigid-body part being held."""
    size, n = problem.base.shape[2], problem.n
    rest = problem.effort - problem.base @ parameters[:size]
    tried = []
    candidates = (
        [np.full(n, k) for k in SLOPES]
        if sweep == 1
        else [slope * f for f in (0.5, 0.71, 1.0, 1.41, 2.0)]
    )
    for candidate in candidates:
        columns = problem.friction(candidate, loads)
        columns[:, :, 1] -= columns[:, :, 0] / speed_limit
        tried.append(
            [
                _cost(
                    columns[:, j][:, [True, True, bool(problem.use_load[j]), True]],
                    rest[:, j],
                    weight[:, j],
                )
                for j in range(n)
            ]
        )
    best = np.argmin(np.array(tried), axis=0)
    chosen = np.array(candidates)[best, np.arange(n)]
    return np.clip(chosen, SLOPES[0], SLOPES[-1])


def _cost(columns: np.ndarray, target: np.ndarray, weight: np.ndarray) -> float:
    root = np.sqrt(weight)
    # The offset may have either sign; the others are friction.
    signed = np.column_stack([columns, -columns[:, -1]]) * root[:, None]
    upper = np.asarray(np.linalg.qr(np.column_stack([signed[:, :-1], target * root]), mode='r'))
    reduced = np.column_stack([upper[:, :-1], -upper[:, -2]])
    return float(nnls(reduced, upper[:, -1])[1] ** 2)


def _uncertainty(
    design: np.ndarray,
    slope_column: np.ndarray,
    residual: np.ndarray,
    weight: np.ndarray,
    active: np.ndarray,
    lengths: Sequence[int],
    prior: Prior | None,
) -> tuple[np.ndarray, float]:
    """Covariance and its degrees of freedom; slopes are estimated, too."""
    n, size = residual.shape[1], design.shape[2]
    full = np.concatenate([design, slope_column[:, :, None] * np.eye(n)], axis=2)
    # A slope that the rows do not show is held within a factor of e.
    known = np.concatenate([active, np.ones(n, bool)])
    matrix = normal_matrix(full, weight)
    matrix[range(size, size + n), range(size, size + n)] += _SLOPE_HELD
    if prior is not None:
        matrix[:size, :size] += prior.information
    inverse = np.zeros_like(matrix)
    inverse[np.ix_(known, known)] = invert_normal(matrix[np.ix_(known, known)])
    root = np.sqrt(weight)
    rows = full * root[:, :, None]
    gammas = residual_autocovariances(rows, residual * root, inverse, lengths)
    covariance = inverse @ score_covariance(rows, gammas, lengths) @ inverse
    independent = sum(residual.shape[0] * g[0] / max(g[0], 2.0 * g.sum() - g[0]) for g in gammas)
    return covariance[:size, :size], max(1.0, float(independent) - float(known.sum()))
