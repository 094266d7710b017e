"""Arms, gains and scenarios from files, or by the names of shipped ones."""

from pathlib import Path

import lpv.core.serial_arm.arm_file
import lpv.core.simulation.scenario
import lpv.core.uio.certificate.gains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import Scenario
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import Gains


def load_arm(name: str | Path) -> SerialArm:
    """Read an arm file.

    Parameters
    ----------
    name : str or pathlib.Path
        YAML file, see docs/arm-file.md, or name of a shipped arm (``paper``, ``ur10``).

    Returns
    -------
    SerialArm
        Validated, in SI units.

    Raises
    ------
    ConfigError
        Naming the field that is wrong, or the arms that are shipped.
    """
    return lpv.core.serial_arm.arm_file.load_arm(bringup_file('arms', str(name)))


def load_gains(name: str | Path) -> Gains:
    """Read the gains that `design` or ``lpv design`` has found.

    Parameters
    ----------
    name : str or pathlib.Path
        Gains file, or name of a shipped arm, whose certified gains are shipped, too.

    Returns
    -------
    Gains
        Not verified yet: `Monitor` and `simulate` refuse those of another arm, ``lpv verify``
        rebuilds every inequality of their certificate.

    Raises
    ------
    ConfigError
        Naming the field that is wrong.
    """
    return lpv.core.uio.certificate.gains.load_gains(bringup_file('gains', str(name)))


def save_gains(gains: Gains, path: str | Path, comment: str = 'Designed in Python.') -> None:
    """Write gains to a file that nodes and commands read.

    Parameters
    ----------
    gains : Gains
        Of `design`.
    path : str or pathlib.Path
        YAML file to write.
    comment : str, optional
        First lines of the file.
    """
    gains.save(path, comment)


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario file: path, plant, noise, disturbance and faults of a simulation.

    Parameters
    ----------
    name : str or pathlib.Path
        YAML file, see docs/scenario-file.md, or name of a shipped one (``two_faults``).

    Returns
    -------
    Scenario
        Validated; ``dataclasses.replace`` changes single fields.

    Raises
    ------
    ConfigError
        Naming the field that is wrong, or the scenarios that are shipped.
    """
    return lpv.core.simulation.scenario.load_scenario(bringup_file('scenarios', str(name)))
