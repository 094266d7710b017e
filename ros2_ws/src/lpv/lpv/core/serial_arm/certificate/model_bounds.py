"""Bounds on the mass matrix M(q) of an arm's model that hold for every configuration.

- payload: M_p(q) <= k M(q), M_p of the largest payload at the tip,
- damping: diag(viscous friction) <= phi M(q),
- growth: -nu M <= M' <= nu M while every joint moves at most at its velocity limit; nu is
  proportional to the rates,
- inertia: diag(c) <= M(q).

Each is one chain of inequalities of `link_forms`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lpv.core.serial_arm.certificate.link_forms import (
    STEP,
    chain_inequalities,
    invariant_basis,
    placements,
    rotors_below,
    spatial_inertia,
    turning_steps,
)
from lpv.core.serial_arm.chain import VISCOUS, FloatArray, compile_chain
from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.dynamics.payload import payload_parameters
from lpv.core.support.entries import array, entry, part, positive
from lpv.core.support.errors import ConfigError
from lpv.core.support.inequalities import NumberType, array_of

BOUNDS = ('payload', 'damping', 'growth', 'inertia')


class ChainNumbers(NamedTuple):
    """What the inequalities are made of: arrays of floats or of fractions."""

    placement: list[np.ndarray]  # X_i, n of shape (6, 6)
    inertia: list[np.ndarray]  # spatial inertias, n of shape (6, 6)
    payload: np.ndarray  # spatial inertia of the largest payload, on the last link, (6, 6)
    rotor: np.ndarray  # diagonal below the rotors' matrix, (n,) [kg m2]
    viscous: np.ndarray  # (n,), without what is negative [N m s/rad]
    rates: np.ndarray  # velocity limits, (n,) [rad/s]


COEFFICIENTS = {1: 7, 2: 26}
"""Of one matrix that commutes with rotations about z, by the number of twists."""


@dataclass(frozen=True)
class BoundForms:
    """For each of `BOUNDS` the coefficients of B_2, ..., B_n, shape (n - 1, k)."""

    payload: FloatArray = array(-1, COEFFICIENTS[1])
    damping: FloatArray = array(-1, COEFFICIENTS[1])
    growth: FloatArray = array(-1, COEFFICIENTS[2])
    inertia: FloatArray = array(-1, COEFFICIENTS[1])


@dataclass(frozen=True)
class ModelBounds:
    """The bounds, and the matrices that prove them."""

    payload: float = entry('number', low=0.0)  # k [-]
    damping: float = entry('number', low=0.0)  # phi [1/s]
    growth: float = positive()  # nu at the velocity limits [1/s]
    inertia: FloatArray = array(-1)  # c, shape (n,) [kg m2]
    forms: BoundForms = part(BoundForms)


def chain_numbers(arm: SerialArm, number: NumberType = float) -> ChainNumbers:
    """Numbers of an arm's model, floats or fractions; ConfigError for prismatic joints."""
    for joint in arm.joints:
        if joint.is_prismatic:
            raise ConfigError(
                'joints',
                f'{joint.name} is prismatic: loops are proved for arms of revolute joints alone',
                arm.name,
            )
    chain, array = compile_chain(arm), array_of(number)
    load = payload_parameters(chain, arm.uncertainty.largest_payload)
    return ChainNumbers(
        [array(way) for way in placements(chain.rotation, chain.translation)],
        [array(spatial_inertia(body)) for body in chain.inertial],
        array(spatial_inertia(load)),
        array(rotors_below(chain.motor)),
        array(np.maximum(chain.friction[:, VISCOUS], 0.0)),
        array(np.array(arm.velocity_limit, dtype=float)),
    )


def twists_of(bound: str) -> int:
    """Number of twists that the forms of a bound are about."""
    return 2 if bound == 'growth' else 1


def bound_inequalities(
    numbers: ChainNumbers,
    bound: str,
    value: Any,
    invariant: Sequence[Any],
    unit: Any = None,
    block: Callable[..., Any] = np.block,
) -> Iterator[Any]:
    """Matrices that must be positive definite for one of `BOUNDS` to hold.

    Parameters
    ----------
    numbers : ChainNumbers
        Of the arm.
    bound : str
        One of `BOUNDS`.
    value : number or array
        k, phi, nu or c.
    invariant : sequence of matrix
        B_2, ..., B_n.
    unit : number, optional
        Inverse of the unit of time, of growth [1/s]; nu if not given.  With it inequalities are
        linear in nu, for the solver.
    block : callable, optional
        ``numpy.block`` or ``cvxpy.bmat``.

    Yields
    ------
    matrix
        As of `chain_inequalities`.
    """
    scale = 1 if bound == 'inertia' else value
    if bound == 'growth':  # time in units of 1/unit
        scale, unit = (1, value) if unit is None else (value, unit)
    forms = [scale * form for form in numbers.inertia]
    scalars = [scale * rotor for rotor in numbers.rotor]
    joint_steps = [[STEP]] * len(forms)
    if bound == 'payload':
        forms[-1] = forms[-1] - numbers.payload
    elif bound == 'damping':
        scalars = [rotor - viscous for rotor, viscous in zip(scalars, numbers.viscous)]
    elif bound == 'inertia':
        scalars = [rotor - value[i] for i, rotor in enumerate(scalars)]
    else:
        # nu M - M'; -M' is that of the opposite rates.
        pairs, zero = zip(forms, numbers.inertia), np.zeros((6, 6), dtype=int)
        forms = [block([[form, -own], [-own, zero]]) for form, own in pairs]
        joint_steps = [turning_steps(rate / unit) for rate in numbers.rates]
    yield from chain_inequalities(numbers.placement, forms, scalars, invariant, joint_steps)


def invariant_forms(coefficients: np.ndarray, bound: str) -> list[np.ndarray]:
    """B_2, ..., B_n from their coefficients, floats or fractions, of shape (n - 1, k)."""
    basis = invariant_basis(twists_of(bound)).astype(int)
    return [np.tensordot(row, basis, axes=1) for row in coefficients]
