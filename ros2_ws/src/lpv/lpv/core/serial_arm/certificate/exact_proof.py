"""The certificate of a serial arm's loop in exact rational arithmetic.

Placements, inertias and gains are floats and therefore fractions: what is proved is proved for the
arm with exactly these numbers.
"""

from fractions import Fraction

from lpv.core.serial_arm.certificate.conditions import bound_name, loop_matrices
from lpv.core.serial_arm.certificate.loop_gains import LoopGains
from lpv.core.serial_arm.certificate.model_bounds import (
    BOUNDS,
    ChainNumbers,
    bound_inequalities,
    chain_numbers,
    invariant_forms,
    twists_of,
)
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.inequalities import exact, is_negative


def prove_loop(arm: SerialArm, gains: LoopGains) -> dict[str, bool]:
    """Prove every matrix inequality of a certificate.

    Parameters
    ----------
    arm : SerialArm
        The arm.
    gains : LoopGains
        With its certificate.

    Returns
    -------
    dict of str to bool
        What was proved or refuted.
    """
    numbers, results = _exact_numbers(arm), {}
    for bound in BOUNDS:
        stored = getattr(gains.model, bound)
        value = exact(stored) if bound == 'inertia' else Fraction(stored)
        invariant = invariant_forms(exact(gains.model.forms[bound]), twists_of(bound))
        results[bound_name(gains, bound)] = all(
            is_negative(-matrix) for matrix in bound_inequalities(numbers, bound, value, invariant)
        )
    for name, matrix in loop_matrices(arm, gains, Fraction):
        results[name] = is_negative(matrix)
    return results


def _exact_numbers(arm: SerialArm) -> ChainNumbers:
    numbers = chain_numbers(arm)
    return ChainNumbers(
        [exact(matrix) for matrix in numbers.placement],
        [exact(matrix) for matrix in numbers.inertia],
        *(exact(array) for array in numbers[2:]),
    )
