"""What an estimator knows of the arm: everything, or what the arm file states.

All constants of an arm (`lpv_core.model.arm.ARM_CONSTANTS`) are linear in the masses, the inertias,
an extra point mass at the tip and a common factor of friction.  An arm that is known within priors
is therefore ``constants + parameters @ sensitivity`` exactly, with constant unknown parameters.
"""

from dataclasses import dataclass, replace

import numpy as np

from lpv_core.model.arm import N_CONSTANTS, ArmParameters, constants_vector
from lpv_core.simulation.scenario import Scenario

FRICTION_UNCERTAINTY = 0.3
"""Largest relative error of friction, as in `lpv_core.decision.diagnosis.DiagnosisParameters`."""
_UNIFORM = 1.0 / np.sqrt(3.0)
"""Standard deviation of what is uniform in +-1."""


@dataclass(frozen=True)
class ArmKnowledge:
    """An arm with constant unknown parameters."""

    constants: np.ndarray  # (12,) Constants of the arm where all parameters are zero
    sensitivity: np.ndarray  # (p, 12) Change of the constants with each parameter
    deviation: np.ndarray  # (p,) Standard deviation of each parameter before any data
    truth: np.ndarray  # (p,) Parameters of the true arm
    names: tuple  # Names of the parameters


def known_exactly(arm: ArmParameters, scenario: Scenario) -> ArmKnowledge:
    """Know the true arm.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm.
    scenario : Scenario
        Makes the true one.

    Returns
    -------
    ArmKnowledge
        Without parameters.
    """
    constants = constants_vector(scenario.true_arm(arm).constants(_has_coriolis(scenario)))
    return ArmKnowledge(constants, np.zeros((0, N_CONSTANTS)), np.zeros(0), np.zeros(0), ())


def known_within_priors(arm: ArmParameters, scenario: Scenario) -> ArmKnowledge:
    """Know what the arm file states: model error, payload, friction; each uniform, independent.

    Parameters
    ----------
    arm : ArmParameters
        Nominal arm, with ``model_error`` and ``payload``.
    scenario : Scenario
        For the true values.

    Returns
    -------
    ArmKnowledge
        With those parameters that can differ: factors of masses and inertias less one, payload
        [kg], factor of friction less one.
    """
    coriolis = _has_coriolis(scenario)
    nominal = constants_vector(arm.constants(coriolis))
    masses, inertias = scenario.mass_factors, scenario.inertia_factors
    error = arm.model_error
    rows = []
    for i in range(2):
        factors = tuple(2.0 if j == i else 1.0 for j in range(2))
        rows.append((f'mass {i + 1}', arm.scaled(mass_factors=factors), error, masses[i] - 1.0))
        rows.append(
            (f'inertia {i + 1}', arm.scaled(inertia_factors=factors), error, inertias[i] - 1.0)
        )
    rows.append(('payload', arm.with_payload(1.0), arm.payload, scenario.payload))
    rubbing = replace(
        arm,
        viscous=tuple(2.0 * v for v in arm.viscous),
        coulomb=tuple(2.0 * v for v in arm.coulomb),
    )
    rough = FRICTION_UNCERTAINTY if any((*arm.viscous, *arm.coulomb)) else 0.0
    rows.append(('friction', rubbing, rough, scenario.friction_factor - 1.0))
    rows = [row for row in rows if row[2] > 0.0]
    return ArmKnowledge(
        nominal,
        np.array(
            [constants_vector(other.constants(coriolis)) - nominal for _, other, _, _ in rows]
        ).reshape(-1, N_CONSTANTS),
        _UNIFORM * np.array([most for _, _, most, _ in rows]),
        np.array([true for _, _, _, true in rows]),
        tuple(name for name, _, _, _ in rows),
    )


def _has_coriolis(scenario: Scenario) -> bool:
    return scenario.plant in ('nonlinear', 'mujoco')
