"""Scenarios and simulated arms of either kind."""

from pathlib import Path
from typing import Any

from lpv_core.control.path import CartesianPath
from lpv_core.control.serial_path import SerialPath
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.scenario import Scenario, parse_scenario
from lpv_core.simulation.serial_scenario import (
    SerialScenario,
    is_serial_scenario,
    parse_serial_scenario,
)
from lpv_core.simulation.serial_simulator import SerialArmSimulator
from lpv_core.support.config import read_yaml
from lpv_core.support.errors import ConfigError

AnyScenario = Scenario | SerialScenario
"""Both have name, duration, seed, faults, and `path` and `true_arm` for an arm of their kind."""

AnySimulator = ArmSimulator | SerialArmSimulator
"""Both step, hold and sense alike."""


def load_any_scenario(path: str | Path, arm: Arm | None = None) -> AnyScenario:
    """Read a scenario file of either kind.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/scenario-file.md``.  Files for serial arms say ``kind: serial_arm``.
    arm : ArmParameters or SerialArm, optional
        The arm that it must be for.

    Returns
    -------
    Scenario or SerialScenario
        Validated.

    Raises
    ------
    ConfigError
        Naming the offending field, or the kind where the arm is of the other one.
    """
    return parse_any_scenario(read_yaml(path), str(Path(path)), arm)


def parse_any_scenario(
    data: dict[str, Any], source: str = 'scenario', arm: Arm | None = None
) -> AnyScenario:
    """Build a scenario of either kind from the mapping of its file, as `load_any_scenario`."""
    scenario: AnyScenario
    serial = is_serial_scenario(data)
    scenario = parse_serial_scenario(data, source) if serial else parse_scenario(data, source)
    if arm is not None and isinstance(arm, SerialArm) != serial:
        raise _other_kind(arm, scenario, source)
    return scenario


def _other_kind(arm: Arm, scenario: AnyScenario, source: str = '') -> ConfigError:
    is_for = 'a serial arm' if isinstance(scenario, SerialScenario) else 'the two-link arm'
    return ConfigError('kind', f'is of a scenario for {is_for}, which {arm.name} is not', source)


def new_path(arm: Arm, scenario: AnyScenario) -> CartesianPath | SerialPath:
    """Path of a scenario for an arm.

    Parameters
    ----------
    arm : ArmParameters or SerialArm
        The arm.
    scenario : Scenario or SerialScenario
        Of the same kind.

    Returns
    -------
    CartesianPath or SerialPath
        See `lpv_core.control.path.TimedPath`.

    Raises
    ------
    ConfigError
        If arm and scenario are of different kinds, or the path is not possible.
    UnreachableError
        If a part of it is out of the arm's reach.
    """
    if isinstance(arm, ArmParameters) and isinstance(scenario, Scenario):
        return scenario.path(arm)
    if isinstance(arm, SerialArm) and isinstance(scenario, SerialScenario):
        return scenario.path(arm)
    raise _other_kind(arm, scenario)


def new_simulator(arm: Arm, scenario: AnyScenario, substeps: int = 2) -> AnySimulator:
    """Simulator of an arm in a scenario.

    Parameters
    ----------
    arm : ArmParameters or SerialArm
        The arm.
    scenario : Scenario or SerialScenario
        Of the same kind.
    substeps : int, optional
        Least number of Runge-Kutta steps per sample.

    Returns
    -------
    ArmSimulator or SerialArmSimulator
        With the same methods.

    Raises
    ------
    ConfigError
        If arm and scenario are of different kinds, or a value of the scenario is not possible.
    """
    if isinstance(arm, ArmParameters) and isinstance(scenario, Scenario):
        return ArmSimulator(arm, scenario, substeps)
    if isinstance(arm, SerialArm) and isinstance(scenario, SerialScenario):
        return SerialArmSimulator(arm, scenario, substeps)
    raise _other_kind(arm, scenario)
