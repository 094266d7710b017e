"""How the arm moved: above its speed limits, without commands, away from its path."""

from dataclasses import dataclass

import numpy as np

from lpv_bag.run.streams import RunRecord
from lpv_core.model.arm import ArmParameters
from lpv_core.model.kinematics import forward
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv_report.history.episodes import intervals
from lpv_report.history.phases import NO_COMMAND, TOO_FAST, Phase

_MOST_TIPS = 5000
"""Samples of a run of which a serial arm's tip is computed."""
_SILENCE = 0.1
"""Measurements without a command for this long are an interval without commands [s]."""


@dataclass(frozen=True)
class Motion:
    """Extremes of a run; None where they are not known."""

    source: str  # whose rates they are: true or measured
    fastest: float  # largest joint rate, as a share of the joint's limit; infinite if not finite
    speed: float  # that rate [rad/s]
    limit: float  # its limit [rad/s]
    joint: str  # the joint
    path_error: float | None  # largest distance of the true tip from the reference [m]


def motion(record: RunRecord, arm: Arm) -> Motion:
    """Extremes of the motion: of the true arm where it is recorded, else as measured.

    Parameters
    ----------
    record : RunRecord
        The run, with the joints of the arm.
    arm : ArmParameters or SerialArm
        Its arm.

    Returns
    -------
    Motion
        What the arm did.
    """
    source, _, rates = _rates(record)
    limits = np.asarray(arm.velocity_limit)
    # A missing rate (NaN) is a matter of the sensor, an infinite one is not.
    shares = np.where(np.isnan(rates), 0.0, np.abs(rates)) / limits
    row, joint = np.unravel_index(int(np.argmax(shares)), shares.shape)
    return Motion(
        source,
        float(shares[row, joint]),
        float(abs(rates[row, joint])),
        float(limits[joint]),
        arm.joint_names[joint],
        _path_error(record, arm),
    )


def _rates(record: RunRecord) -> tuple[str, np.ndarray, np.ndarray]:
    """Whose rates, their times [s], and the rates [rad/s]."""
    stream = 'ground_truth' if 'ground_truth' in record.streams else 'joint_states'
    source = 'true' if stream == 'ground_truth' else 'measured'
    time = np.asarray(record.seconds(record.stamps[stream]))
    return source, time, record.streams[stream]['velocity']


def _path_error(record: RunRecord, arm: Arm) -> float | None:
    truth = record.aligned('ground_truth', 'position')
    reference = record.aligned('reference', 'tip_position')
    if truth is None or reference is None:
        return None
    error = np.linalg.norm(_tips(truth, reference, arm), axis=1)
    return float(np.nanmax(error)) if np.isfinite(error).any() else None


def _tips(position: np.ndarray, reference: np.ndarray, arm: Arm) -> np.ndarray:
    """Positions of the tip less those of the reference, in its coordinates [m]."""
    if isinstance(arm, ArmParameters):
        zero = np.array([arm.zero_angle + np.pi / 2, 0.0])
        return forward(position + zero, arm.lengths) - reference
    rows = np.flatnonzero(np.isfinite(position).all(1) & np.isfinite(reference).all(1))
    rows = rows[:: max(1, len(rows) // _MOST_TIPS)]
    chain = compile_chain(arm)
    tips = [forward_kinematics(chain, q)[1] for q in position[rows]]
    return np.array(tips).reshape(-1, 3) - reference[rows]


def motion_phases(record: RunRecord, arm: Arm) -> list[Phase]:
    """Intervals in which a joint was above its speed limit, or the drives had no command."""
    _, time, rates = _rates(record)
    fast = (np.abs(rates) > np.asarray(arm.velocity_limit)).any(axis=1)
    found = [Phase(TOO_FAST, '', part.start, part.end) for part in intervals(fast, time)]
    return found + _without_commands(record)


def _without_commands(record: RunRecord) -> list[Phase]:
    stamps = record.stamps.get('torque_command')
    if stamps is None:
        return []
    measured = record.stamps['joint_states']
    times = np.asarray(record.seconds(np.append(stamps, max(stamps[-1], measured[-1]))))
    silent = np.flatnonzero(np.diff(times) > _SILENCE)
    return [Phase(NO_COMMAND, '', float(times[k]), float(times[k + 1])) for k in silent]
