"""Gain design by linear matrix inequalities."""

from pathlib import Path

from lpv.core.serial_arm.description import SerialArm
from lpv.core.uio.certificate.gains import Gains
from lpv.core.uio.planar import planar_model


def design(arm: SerialArm, requirement: str | Path | None = None) -> Gains:
    """Design observer and controller of an arm.

    Parameters
    ----------
    arm : SerialArm
        A planar arm with an ``lpv`` region.
    requirement : str or pathlib.Path, optional
        Requirement file, see docs/tracking.md, or name of a shipped one; by default the shipped
        one of the arm's name.

    Returns
    -------
    Gains
        With their certificate: every inequality was rebuilt from these numbers, and holds.

    Raises
    ------
    NotDetectableError
        If a fault cannot be diagnosed in part of the region.
    InfeasibleError
        If the inequalities do not hold.
    ConfigError
        If the arm has no ``lpv`` region, there is no such requirement, or a field of it is wrong.
    """
    planar_model(arm)  # without a region, its name is no requirement's either
    # Only here: the solver takes a second to be imported, and most scripts need none.
    from lpv_design.design_flow import design
    from lpv_design.requirement import load_requirement

    return design(arm, load_requirement(requirement or arm.name)).gains
