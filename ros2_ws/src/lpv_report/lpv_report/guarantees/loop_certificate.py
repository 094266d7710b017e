"""The certificate of a serial arm's tracking loop, verified again."""

from dataclasses import dataclass
from pathlib import Path

from lpv_bag.rosbag.output_folder import GAINS_NAME
from lpv_core.certificate.conditions import Check
from lpv_core.serial_arm.certificate.conditions import region_lines, verify_loop
from lpv_core.serial_arm.certificate.loop_gains import load_loop_gains
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import ConfigError
from lpv_report.guarantees.gains_source import beside_bag


@dataclass(frozen=True)
class LoopCertificate:
    """What is certified of the loop of a recorded run."""

    checks: tuple[Check, ...] = ()  # all inequalities; empty where there is no certificate
    region: tuple[str, ...] = ()  # on what, and which bounds
    problem: str = ''  # why there is none

    @property
    def holds(self) -> bool:
        """Whether every inequality holds now."""
        return bool(self.checks) and all(check.holds for check in self.checks)


def examine_loop(bag: str | Path, arm: SerialArm) -> LoopCertificate:
    """Verify the certificate that lies in a bag.

    Parameters
    ----------
    bag : str or pathlib.Path
        rosbag2 directory or single storage file.
    arm : SerialArm
        The arm of the run.

    Returns
    -------
    LoopCertificate
        What holds now, or why there is none.
    """
    file = beside_bag(bag, GAINS_NAME)
    if file is None:
        return LoopCertificate(problem='the bag holds no parameters of the tracking loop')
    try:
        gains = load_loop_gains(file)
        checks = verify_loop(arm, gains)
    except (ConfigError, OSError) as error:
        return LoopCertificate(problem=str(error))
    return LoopCertificate(tuple(checks), tuple(region_lines(arm, gains)))
