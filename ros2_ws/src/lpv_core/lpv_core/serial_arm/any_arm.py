"""Arms of either kind: the two-link arm of the paper, and serial arms of n joints."""

from pathlib import Path

from lpv_core.model.arm import ArmParameters, parse_arm
from lpv_core.serial_arm.arm_file import is_serial_arm, parse_serial_arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.config import read_yaml

Arm = ArmParameters | SerialArm
"""Both have name, joint_names, sensor_names, sample_time, velocity_limit, torque_limit, sha256."""


def load_any_arm(path: str | Path) -> Arm:
    """Read an arm file of either kind.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file; see ``docs/arm-file.md``.  Files of n joints say ``kind: serial_arm``.

    Returns
    -------
    ArmParameters or SerialArm
        The validated arm.

    Raises
    ------
    ConfigError
        If a field is missing, unknown, of the wrong type or out of range; it names the field.
    """
    data, source = read_yaml(path), str(Path(path))
    if is_serial_arm(data):
        return parse_serial_arm(data, source, Path(path).parent)
    return parse_arm(data, source)
