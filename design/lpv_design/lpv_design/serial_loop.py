"""Certificate of a serial arm's computed-torque loop: the solver's part.

What is found is rebuilt and judged by `LoopGains.verify`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np

from lpv.core.control.tracking import loop_latency
from lpv.core.serial_arm.certificate.link_forms import invariant_basis
from lpv.core.serial_arm.certificate.loop_gains import ErrorProof, LoopGains, LoopProof
from lpv.core.serial_arm.certificate.loop_inequality import (
    LoopNumbers,
    motion_matrix,
    sampled_matrix,
)
from lpv.core.serial_arm.certificate.model_bounds import (
    BOUNDS,
    COEFFICIENTS,
    BoundForms,
    ChainNumbers,
    ModelBounds,
    bound_inequalities,
    chain_numbers,
    invariant_forms,
    twists_of,
)
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.aligned_axes import aligned_axes
from lpv.core.support.config import Section
from lpv.core.support.entries import entry, read_entries
from lpv.core.support.inequalities import largest_eigenvalue
from lpv_design.solve import InfeasibleError, bisect, check_lines, solve, symmetric_below

_SLACKS = (1.005, 1.01, 1.02, 1.05)
"""A bound over the best one, tried in turn: inequalities at the optimum have no margin.  Each is
about twice the one before."""
_MARGIN = 1e-7
"""Of the loop's inequalities, which are of size one: ten times the tolerance of the solver."""
_SHARES = (0.9, 0.8, 0.65, 0.5, 0.3)
"""Of the largest region, tried in turn: at the largest one nothing decays."""
_DECAY = 0.8
"""Of the fastest decay that a region allows."""
_ERROR_SHARE = 0.1
"""Of the velocity limits: region on which the tracking error is bounded, if not too large."""


@dataclass(frozen=True)
class LoopRequest:
    """What to certify."""

    # w, as of the tracker's parameter [rad/s]
    bandwidth: float = entry('number', default=10.0, low=0.1, high=100.0)
    model_error: float = entry('number', default=0.05, low=0.0, high=0.5)  # d [-]
    # of the velocity limits; 0: as large as possible [-]
    rate_share: float = entry('number', default=0.0, low=0.0, high=1.0)
    # of the reference, for the bound of the error [rad/s2]
    acceleration: float = entry('number', default=1.0, low=0.0, high=1e3)


def certify_loop(arm: SerialArm, request: LoopRequest) -> tuple[LoopGains, list[str]]:
    """Find a certificate of the loop, with a region of rates, and check it; the lines are for the
    designer.

    Raises
    ------
    InfeasibleError
        If there is none; it says what limits it.
    """
    read_entries(LoopRequest, Section(vars(request), ''))
    if len(arm.joints) < 2:
        raise InfeasibleError('the certificate is for arms of 2 joints or more')
    if aligned := aligned_axes(arm):
        raise InfeasibleError(aligned)
    if loop_latency(arm, bandwidth=request.bandwidth) < arm.sample_time:
        raise InfeasibleError(
            f'bandwidth: {request.bandwidth:g} rad/s is unstable at {arm.sample_time:g} s a sample'
        )
    model = model_bounds(arm)
    blank = LoopProof(1.0, np.eye(3), np.ones(2))
    gains = LoopGains(
        arm.name,
        arm.sha256(),
        request.bandwidth,
        request.model_error,
        1.0,
        blank,
        blank,
        ErrorProof(1.0, np.eye(3), np.ones(2), 1.0, request.acceleration, 1.0, model.inertia),
        model,
    )
    largest = largest_share(arm, gains)
    if largest <= 0.0:
        raise InfeasibleError(
            f'no decay even at rest: payload {arm.uncertainty.largest_payload:g} kg is '
            f'{model.payload:.3g} of the inertia, viscous friction {model.damping:.3g}/s of it, '
            f'model error {request.model_error:g}; state less, or ask for a larger bandwidth'
        )
    gains = _with_motion(arm, gains, largest, request.rate_share)
    gains = _with_error(arm, gains)
    checks = gains.verify(arm)
    for check in checks:
        if not check.holds:
            raise InfeasibleError(f'{check.name}: {check.margin:.3g} is not negative')
    return gains, [*check_lines(checks), *gains.facts(arm), *_limit_lines(arm, gains, largest)]


def model_bounds(arm: SerialArm) -> ModelBounds:
    """The least bounds of the mass matrix, widened a little, and what proves them."""
    numbers = chain_numbers(arm)
    found: dict[str, Any] = {}
    forms: dict[str, np.ndarray] = {}
    for bound in BOUNDS:
        best = _best_value(numbers, bound)
        if bound == 'inertia' and np.min(best) <= 0.0:
            name = arm.joints[int(np.argmin(best))].name
            raise InfeasibleError(
                f'no inertia is sure to be left at every pose for {name}: state its rotor_inertia'
            )
        for slack in _SLACKS:
            value = best / slack if bound == 'inertia' else max(slack * float(best), 1e-3)
            proof = _forms(numbers, bound, value)
            if proof is not None:
                found[bound], forms[bound] = value, proof
                break
        else:
            raise InfeasibleError(f'no bound of {bound} with a margin: is the arm physical?')
    return ModelBounds(forms=BoundForms(**forms), **found)


def _variables(joints: int, twists: int) -> tuple[list[Any], list[Any]]:
    """Coefficients of B_2, ..., B_n, and these matrices."""
    size = 6 * twists
    basis = invariant_basis(twists).reshape(COEFFICIENTS[twists], size * size).T
    rows = [cp.Variable(COEFFICIENTS[twists]) for _ in range(joints - 1)]
    return rows, [cp.reshape(basis @ row, (size, size), order='C') for row in rows]


def _best_value(numbers: ChainNumbers, bound: str) -> Any:
    """Smallest k, phi or nu; the largest c, joint by joint about as much of its inertia."""
    opposed = {'payload': numbers.payload, 'damping': numbers.viscous}
    if bound in opposed and not np.any(opposed[bound]):
        return 0.0  # without an interior around it, a solver may fail
    n = len(numbers.rotor)
    _, invariant = _variables(n, twists_of(bound))
    value = cp.Variable(n) if bound == 'inertia' else cp.Variable()
    objective = value
    unit = float(numbers.rates.sum()) if bound == 'growth' else 1.0
    if bound == 'inertia':
        typical = np.array([float(form[2, 2]) for form in numbers.inertia]) + numbers.rotor
        objective = cp.sum(cp.multiply(typical, cp.inv_pos(value)))
    matrices = bound_inequalities(numbers, bound, value, invariant, unit, cp.bmat)
    status = solve(objective, [symmetric_below(-matrix) for matrix in matrices])
    if value.value is None:
        raise InfeasibleError(f'no bound of {bound} (solver: {status}): is the arm physical?')
    return unit * value.value


def _forms(numbers: ChainNumbers, bound: str, value: Any) -> np.ndarray | None:
    """Coefficients of the matrices that prove a bound, with the largest margin; None if none do."""
    rows, invariant = _variables(len(numbers.rotor), twists_of(bound))
    margin = cp.Variable()
    constraints = [
        symmetric_below(-matrix, margin)
        for matrix in bound_inequalities(numbers, bound, value, invariant)
    ]
    solve(-margin, [*constraints, margin <= 1.0])
    if margin.value is None:
        return None
    found = np.array([row.value for row in rows])
    rebuilt = bound_inequalities(numbers, bound, value, invariant_forms(found, bound))
    holds = all(largest_eigenvalue(-np.asarray(matrix, dtype=float)) < 0.0 for matrix in rebuilt)
    return found if holds else None


def _proof(
    matrix: Callable[..., Any], size: int, numbers: LoopNumbers, decay: float, bandwidth: float
) -> LoopProof | None:
    """Lyapunov matrix with the largest margin; None where there is none."""
    p, multipliers = cp.Variable((size, size), symmetric=True), cp.Variable(2, nonneg=True)
    margin = cp.Variable()
    constraints = [
        cp.trace(p) == 1.0,
        symmetric_below(-p, margin),
        symmetric_below(matrix(p, multipliers, numbers, decay), margin),
    ]
    solve(-margin, constraints)
    if margin.value is None or margin.value < _MARGIN:
        return None
    return LoopProof(decay * bandwidth, np.array(p.value), np.array(multipliers.value))


def largest_share(arm: SerialArm, gains: LoopGains) -> float:
    """Largest share of the velocity limits at which the loop, sampled too, is certified [-]."""

    def works(share: float) -> bool:
        numbers = gains.numbers(arm, share)
        motion = _proof(motion_matrix, 3, numbers, 0.0, gains.bandwidth)
        if motion is None or 2.0 * numbers.step * numbers.growth >= 1.0:
            return False
        return _proof(sampled_matrix, 4, numbers, 0.0, gains.bandwidth) is not None

    return bisect(works, 1.0, 0.005)


def _with_motion(arm: SerialArm, gains: LoopGains, largest: float, asked: float) -> LoopGains:
    """Proofs of the decay on a region of rates."""
    if asked > largest:
        raise InfeasibleError(
            f'rates: a share of {asked:g} of the velocity limits cannot be certified, '
            f'{largest:.3g} can; ask for less, for a larger bandwidth, or state less payload'
        )
    shares = [share * largest for share in ((1.0,) if largest == 1.0 else _SHARES)]
    for share in [asked] if asked else shares:
        numbers = gains.numbers(arm, share)
        motion = _fast_proof(motion_matrix, 3, numbers, gains.bandwidth)
        sampled = _fast_proof(sampled_matrix, 4, numbers, gains.bandwidth)
        if motion is not None and sampled is not None:
            return replace(gains, rate_share=share, motion=motion, sampled=sampled)
    raise InfeasibleError('no region of rates on which the loop decays, sampled and with delay')


def _fast_proof(
    matrix: Callable[..., Any], size: int, numbers: LoopNumbers, bandwidth: float
) -> LoopProof | None:
    """Proof of most of the fastest decay; None where nothing decays."""

    def works(decay: float) -> bool:
        return _proof(matrix, size, numbers, decay, bandwidth) is not None

    decay = _DECAY * bisect(works, 1.0, 0.002)
    return _proof(matrix, size, numbers, decay, bandwidth) if decay > 0.0 else None


def _with_error(arm: SerialArm, gains: LoopGains) -> LoopGains:
    """Bound of the tracking error, on a part of the region."""
    share = min(_ERROR_SHARE, 0.5 * gains.rate_share)
    numbers = gains.numbers(arm, share)
    # On the larger region V decays as fast as the first one, so that there is a level.
    decays = np.geomspace(min(0.02, gains.motion.decay / gains.bandwidth), 0.8, 12).tolist()
    tried = (_error_proof(gains, numbers, decay) for decay in decays)
    found = [one for one in tried if one is not None]
    if not found:
        raise InfeasibleError('no bound of the tracking error')
    proof = replace(min(found, key=lambda one: one.level), rate_share=share)
    gains = replace(gains, error=proof)
    bound = np.sum(list(gains.error_bound(arm).values()), axis=0)
    return replace(gains, error=replace(proof, bound=bound))


def _error_proof(gains: LoopGains, numbers: LoopNumbers, decay: float) -> ErrorProof | None:
    """Least level mu for a decay, widened a little; None where the solver found no proof of one."""
    p, multipliers = cp.Variable((3, 3), symmetric=True), cp.Variable(2, nonneg=True)
    level, middle = cp.Variable(nonneg=True), np.diag([0.0, 1.0, 0.0])
    matrix = motion_matrix(p, multipliers, numbers, decay, level)
    constraints = [symmetric_below(middle - p, _MARGIN), symmetric_below(matrix, _MARGIN)]
    solve(level, constraints)
    if level.value is None:
        return None
    found, values = np.array(p.value), np.array(multipliers.value)
    rebuilt = middle - found, motion_matrix(found, values, numbers, decay, float(level.value))
    if any(largest_eigenvalue(one) >= 0.0 for one in rebuilt):
        return None
    return replace(
        gains.error,
        decay=decay * gains.bandwidth,
        lyapunov=found,
        multipliers=values,
        level=float(level.value),
    )


def _limit_lines(arm: SerialArm, gains: LoopGains, largest: float) -> list[str]:
    """What limits the region: how far it would reach with one of its figures changed."""
    faster, model = replace(gains, bandwidth=1.5 * gains.bandwidth), gains.model
    others = {
        'without payload': replace(gains, model=replace(model, payload=1e-3)),
        'with a true model': replace(gains, model_error=0.0),
        'without viscous friction': replace(gains, model=replace(model, damping=1e-3)),
        f'with a bandwidth of {faster.bandwidth:g} rad/s': faster,
    }
    return [
        f'largest region: {largest:.3g} of all velocity limits at once; what limits it:',
        *(f'  {text}: {largest_share(arm, other):.3g}' for text, other in others.items()),
    ]
