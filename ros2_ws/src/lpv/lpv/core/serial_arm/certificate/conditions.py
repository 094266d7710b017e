"""The certificate of a serial arm's loop: every inequality rebuilt from the file and the arm.

No solver is needed, and none is trusted.
"""

import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.disturbance import MotionRange, missed_torque
from lpv.core.serial_arm.certificate.loop_gains import LoopGains, LoopProof, loop_checksum
from lpv.core.serial_arm.certificate.loop_inequality import (
    LoopNumbers,
    motion_matrix,
    sampled_matrix,
)
from lpv.core.serial_arm.certificate.model_bounds import (
    bound_inequalities,
    chain_numbers,
    invariant_forms,
)
from lpv.core.serial_arm.chain import FloatArray
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import (
    SAME,
    Check,
    array_of,
    is_negative,
    largest_eigenvalue,
    require_all,
)

NO_CERTIFICATE = 'none (lpv design writes one)'
"""Of a loop whose parameter file has a bandwidth only, for the reader."""
_MODEL_TEXT = {
    'payload': 'payload M_p(q) <= {:.4g} M(q) at every q',
    'damping': 'viscous friction F_v <= {:.4g}/s M(q) at every q',
    'growth': "abs(M') <= {:.4g}/s M(q) at the velocity limits, every q",
    'inertia': 'M(q) >= diag(c) at every q, smallest c {:.4g} kg m2',
}


def loop_numbers(
    arm: SerialArm, gains: LoopGains, share: float, number: Callable[[Any], Any] = float
) -> LoopNumbers:
    """Intervals of the loop's eigenvalues where joints move at a share of their limits.

    ``number`` makes floats or fractions.
    """
    model, w, d = gains.model, number(gains.bandwidth), number(gains.model_error)
    friction = 1 + number(arm.uncertainty.friction)
    return LoopNumbers(
        growth=number(model.growth) * number(share) / w,
        damping=number(model.damping) * friction / w,
        low=1 / (1 + d + number(model.payload)),
        high=1 / (1 - d),
        step=number(arm.sample_time) * w,
    )


def error_bound(arm: SerialArm, gains: LoopGains) -> dict[str, FloatArray]:
    """Bounds of the tracking error of each joint by cause, in time; they add up [rad].

    V ends below mu abs(omega)^2, P >= e_2 e_2^T, and omega = M^^(-1/2) delta / w.
    """
    proof, w = gains.error, gains.bandwidth
    motion = MotionRange(proof.rate_share * np.array(arm.velocity_limit), proof.acceleration)
    causes = missed_torque(arm, gains.model, gains.model_error, motion)
    each = math.sqrt(proof.level) / (w * w * np.sqrt(gains.model.inertia))
    return {name: size * each for name, size in causes.items()}


def certified_region(gains: LoopGains) -> str:
    """One line on what a certificate that holds is about."""
    return (
        f'holds for joint rates to {gains.rate_share:.3g} of their limits, model error '
        f'{gains.model_error:g}'
    )


def region_lines(arm: SerialArm, gains: LoopGains) -> list[str]:
    """The region of a certificate and its bounds, for the reader."""
    rates, error = np.array(arm.velocity_limit), gains.error
    rows = [
        ('total', error.bound),
        *sorted(error_bound(arm, gains).items(), key=lambda item: -float(item[1].max())),
    ]
    return [
        f'region: every position, joint rates to {_listed(gains.rate_share * rates)} rad/s, all at '
        'once',
        f'model error {gains.model_error:g} of every link, payload to '
        f'{arm.uncertainty.largest_payload:g} kg, friction {arm.uncertainty.friction:g} off; '
        f'bandwidth {gains.bandwidth:g} rad/s',
        'bound of the tracking error of each joint [rad], rates to '
        f'{_listed(error.rate_share * rates)} rad/s, accelerations of the path to '
        f'{error.acceleration:g} rad/s2:',
        *(f'  {name}: {_listed(values)}' for name, values in rows),
    ]


def _listed(values: FloatArray) -> str:
    return ', '.join(f'{value:.3g}' for value in values)


def loop_inequalities(
    arm: SerialArm, gains: LoopGains, number: Callable[[Any], Any] = float
) -> Iterator[tuple[str, Any]]:
    """What each Lyapunov matrix must satisfy: names and matrices that must be negative definite."""

    def parts(proof: LoopProof) -> tuple[Any, ...]:
        p = array(proof.lyapunov)
        decay = number(proof.decay) / number(gains.bandwidth)
        return (p + p.T) / 2, array(proof.multipliers), decay

    array, proof = array_of(number), gains.error
    numbers = loop_numbers(arm, gains, gains.rate_share, number)
    share = f'rates to {gains.rate_share:.3g} of the limits'
    p, multipliers, decay = parts(gains.motion)
    yield 'motion: P > 0', -p
    name = f'motion: V decays, alpha {gains.motion.decay:.3g}/s, {share}'
    yield name, motion_matrix(p, multipliers, numbers, decay)
    p, multipliers, decay = parts(gains.sampled)
    yield 'sampled: P > 0', -p
    name = f'sampled with one sample of delay: V decays, alpha {gains.sampled.decay:.3g}/s, {share}'
    yield name, sampled_matrix(p, multipliers, numbers, decay)
    numbers = loop_numbers(arm, gains, proof.rate_share, number)
    p, multipliers, decay = parts(proof)
    middle = np.zeros((3, 3), dtype=int)
    middle[1, 1] = 1
    yield 'error: P > 0 and bounds the position', middle - p
    name = f'error: V ends below its level, rates to {proof.rate_share:.3g} of the limits'
    yield name, motion_matrix(p, multipliers, numbers, decay, number(proof.level))


def model_inequalities(
    arm: SerialArm, gains: LoopGains, number: Callable[[Any], Any] = float
) -> Iterator[tuple[str, list[Any]]]:
    """Bounds of the mass matrix: what they say, and matrices that must be negative definite."""
    numbers, array = chain_numbers(arm, number), array_of(number)
    for bound, text in _MODEL_TEXT.items():
        stored = getattr(gains.model, bound)
        value = array(stored) if np.ndim(stored) else number(stored)
        invariant = invariant_forms(array(getattr(gains.model.forms, bound)), bound)
        matrices = bound_inequalities(numbers, bound, value, invariant)
        yield f'model: {text.format(np.min(stored))}', [-matrix for matrix in matrices]


def verify_loop(arm: SerialArm, gains: LoopGains) -> list[Check]:
    """Rebuild every inequality that a certificate claims; ConfigError for that of another arm."""
    return list(_checks(arm, gains))


def require_loop(arm: SerialArm, gains: LoopGains, source: str = 'gains') -> None:
    """Refuse a certificate that does not hold (ConfigError naming the inequality)."""
    require_all(_checks(arm, gains), 'loop', 'design again', source)


def prove_loop(arm: SerialArm, gains: LoopGains) -> dict[str, bool]:
    """Which matrix inequalities exact rational arithmetic proves or refutes.

    Placements, inertias and gains are floats and therefore fractions: what is proved is proved for
    the arm with exactly these numbers.
    """
    model = model_inequalities(arm, gains, Fraction)
    results = {name: all(map(is_negative, matrices)) for name, matrices in model}
    loop = loop_inequalities(arm, gains, Fraction)
    return {**results, **{name: is_negative(matrix) for name, matrix in loop}}


def _checks(arm: SerialArm, gains: LoopGains) -> Iterator[Check]:
    gains.check_arm(arm)
    if len(gains.model.inertia) != len(arm.joints):
        raise ConfigError('loop.model.inertia', f'must have {len(arm.joints)} numbers')
    if gains.checksum:
        same = gains.checksum == loop_checksum(gains)
        yield Check('gains file: numbers are those of the design', -1.0 if same else 1.0)
    for name, matrices in model_inequalities(arm, gains):
        yield Check(name, max(map(largest_eigenvalue, matrices)))
    sectors = (gains.motion, gains.sampled, gains.error)
    lowest = min(float(part.multipliers.min()) for part in sectors)
    yield Check('multipliers are positive', -lowest)
    yield Check('inertia: c > 0', -float(gains.model.inertia.min()))
    change = 2.0 * arm.sample_time * gains.model.growth * gains.rate_share
    followed = Check('sampling: M^ changes little within a sample and its delay', change - 1.0)
    yield followed
    if not followed.holds:
        return  # the sampled inequality would divide by zero
    for name, matrix in loop_inequalities(arm, gains):
        yield Check(name, largest_eigenvalue(matrix))
    total = sum(error_bound(arm, gains).values())
    away = np.abs(gains.error.bound / total - 1.0).max()
    yield Check('error: bound of each joint as recomputed', float(away) - SAME)
