"""Arm files of both kinds, as a start and as a result."""

from pathlib import Path

from lpv_core.model.arm import parse_arm
from lpv_core.serial_arm.arm_file import is_serial_arm, parse_serial_arm, save_serial_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.config import read_yaml
from lpv_core.support.resources import bringup_file
from lpv_identify.results.planar import serial_from_planar, write_planar


def load_any_arm(path: str) -> SerialArm:
    """Arm of n joints from an arm file of n joints or of two links.

    Parameters
    ----------
    path : str
        File, or the name of a shipped arm.

    Returns
    -------
    SerialArm
        A two-link arm moves in the plane of x and y, gravity along -y.

    Raises
    ------
    ConfigError
        If the file is invalid.
    """
    file = bringup_file('arms', path)
    data = read_yaml(file)
    if is_serial_arm(data):
        return parse_serial_arm(data, str(file), Path(file).parent)
    return serial_from_planar(parse_arm(data, str(file)))


def save_like(start: str | None, arm: SerialArm, path: Path) -> None:
    """Write the arm in the format of the file that it was started from.

    Parameters
    ----------
    start : str or None
        Arm file, or None for a URDF.
    arm : SerialArm
        What to write.
    path : pathlib.Path
        File to write.
    """
    if start is not None:
        data = read_yaml(bringup_file('arms', start))
        if not is_serial_arm(data):
            write_planar(data, arm, path)
            return
    save_serial_arm(arm, path)
