"""Mass and centre of a tool against a known arm, from one short recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpv_core.serial_arm.description import N_INERTIAL, LinkInertia, SerialArm
from lpv_identify.errors import IdentificationError
from lpv_identify.estimation.torque_error import model_residual
from lpv_identify.model.rigid_body import build_model, torque_regressor
from lpv_identify.recordings.filters import derivative, low_pass
from lpv_identify.recordings.motion import Segment, find_bandwidths, split
from lpv_identify.recordings.recording import Recording

_HUBER = 2.0


@dataclass(frozen=True)
class Payload:
    """What was found of a tool."""

    mass: float  # [kg]
    center: tuple[float, float, float]  # in the frame of the last joint [m]
    mass_sigma: float  # standard deviation [kg]
    center_sigma: tuple[float, float, float]  # [m]
    rms_before: float  # torque residual without the tool [N m]
    rms_after: float  # with it [N m]
    warnings: tuple[str, ...] = ()


def identify_payload(arm: SerialArm, recordings: Sequence[Recording]) -> Payload:
    """Find mass and centre of mass of a tool.

    The tool is a point mass on the last link: tau - tau_arm = Y_tool (m, m c), offsets of the
    joints being estimated, too.

    Parameters
    ----------
    arm : SerialArm
        Identified arm without the tool.
    recordings : sequence of Recording
        Motion with the tool.

    Returns
    -------
    Payload
        With standard deviations from residuals that are correlated over time.

    Raises
    ------
    IdentificationError
        If the recordings do not show the tool.
    """
    rows, target = [], []
    for recording in recordings:
        for segment in split(recording):
            design, rest = _balance(arm, segment)
            rows.append(design)
            target.append(rest)
    design, rest = np.concatenate(rows), np.concatenate(target)
    scale = np.maximum(np.median(np.abs(rest - np.median(rest, axis=0)), axis=0), 1e-6)
    linear = np.delete(design, np.s_[4:N_INERTIAL], axis=2)
    solution, covariance, residual = _solve(linear, rest, scale)
    for _ in range(3):  # the inertia of a point mass at the centre is known with it
        mass = max(float(solution[0]), 1e-6)
        inertia = _point_mass(mass, solution[1:4] / mass)[4:]
        turning = design[:, :, 4:N_INERTIAL] @ inertia
        solution, covariance, residual = _solve(linear, rest - turning, scale)
    mass, first = float(solution[0]), solution[1:4]
    sigma = np.sqrt(np.diag(covariance))
    if not mass > 2.0 * sigma[0]:
        raise IdentificationError(
            f'the recording shows no tool: mass {mass:.3f} kg within '
            f'{2 * sigma[0]:.3f} kg; move the joints that carry its weight'
        )
    center = first / mass
    center_sigma = np.sqrt(sigma[1:4] ** 2 + (center * sigma[0]) ** 2) / mass
    warnings = [
        f'{axis} of the centre is not determined: turn the wrist to other postures'
        for axis, s in zip('xyz', center_sigma)
        if s > 0.1
    ]
    return Payload(
        mass,
        (float(center[0]), float(center[1]), float(center[2])),
        float(sigma[0]),
        (float(center_sigma[0]), float(center_sigma[1]), float(center_sigma[2])),
        float(np.sqrt(np.mean(rest**2))),
        float(np.sqrt(np.mean(residual**2))),
        tuple(warnings),
    )


def _balance(arm: SerialArm, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    """Regressor of the tool and the offsets, and the torque that the arm leaves unexplained."""
    n = len(arm.joints)
    motion, residual = model_residual(arm, segment)
    acceleration = derivative(motion.velocity, motion.step)
    regressor = torque_regressor(build_model(arm), motion.position, motion.velocity, acceleration)
    tool = regressor[:, :, N_INERTIAL * (n - 1) :]
    cutoff = find_bandwidths([segment]).analysis
    thin = max(1, int(1.0 / (8.0 * cutoff * motion.step)))
    cut = slice(len(tool) // 20, len(tool) - len(tool) // 20, thin)
    filtered = low_pass(tool, arm.effort_bandwidth, motion.step, cutoff)[cut]
    offsets = np.broadcast_to(np.eye(n), (len(filtered), n, n))
    return (
        np.concatenate([filtered, offsets], axis=2), low_pass(residual, cutoff, motion.step)[cut]
    )  # fmt: skip


def _solve(
    design: np.ndarray, rest: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Huber's estimate and its covariance, clustered over blocks of time."""
    weight = np.ones_like(rest)
    for _ in range(8):
        root = np.sqrt(weight) / scale
        flat = (design * root[:, :, None]).reshape(-1, design.shape[2])
        solution = np.linalg.lstsq(flat, (rest * root).ravel(), rcond=1e-10)[0]
        residual = rest - design @ solution
        scale = np.maximum(np.median(np.abs(residual), axis=0) / 0.6745, 1e-9)
        weight = _HUBER / np.maximum(np.abs(residual / scale), _HUBER)
    inverse = np.linalg.pinv(flat.T @ flat)
    scores = np.einsum('ijk,ij->ik', design, weight / scale**2 * residual)
    blocks = np.array_split(scores, min(20, len(scores)))
    sums = np.array([block.sum(axis=0) for block in blocks])
    meat = sums.T @ sums * len(blocks) / max(1, len(blocks) - 1)
    return solution, inverse @ meat @ inverse, residual


def with_payload(arm: SerialArm, payload: Payload) -> SerialArm:
    """The arm with the tool on its last link, a point mass at its centre."""
    tool = _point_mass(payload.mass, np.array(payload.center))
    last = arm.joints[-1]
    link = LinkInertia.from_vector(last.link.to_vector() + tool)
    return replace(arm, joints=(*arm.joints[:-1], replace(last, link=link)))


def _point_mass(mass: float, center: np.ndarray) -> np.ndarray:
    """Standard inertial parameters of a point mass."""
    inertia = mass * (center @ center * np.eye(3) - np.outer(center, center))
    return np.concatenate([[mass], mass * center, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
