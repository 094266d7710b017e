"""Mass and centre of a tool against a known arm, from one short recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lpv.core.serial_arm.chain import body_parameters
from lpv.core.serial_arm.description import N_INERTIAL, LinkInertia, SerialArm
from lpv.identify.errors import IdentificationError
from lpv.identify.estimation.autocorrelation import estimate_covariance
from lpv.identify.estimation.robust import invert_normal, normal_matrix, robust_fit
from lpv.identify.estimation.torque_error import model_residual
from lpv.identify.model.rigid_body import RigidBody
from lpv.identify.recordings.filters import derivative, low_pass
from lpv.identify.recordings.motion import Segment, check_efforts, find_bandwidths, split
from lpv.identify.recordings.recording import Recording

_HUBER = 2.0  # scales beyond which residuals weigh less


@dataclass(frozen=True)
class Payload:
    """What was found of a tool."""

    mass: float  # [kg]
    center: tuple[float, ...]  # x, y, z in the frame of the last joint [m]
    mass_sigma: float  # standard deviation [kg]
    center_sigma: tuple[float, ...]  # standard deviations [m]
    rms_before: float  # torque residual without the tool [N m]
    rms_after: float  # with it [N m]
    explained: float = 0.0  # share of the residual's variance
    warnings: tuple[str, ...] = ()


def identify_payload(arm: SerialArm, recordings: Sequence[Recording]) -> Payload:
    """Mass and centre of a tool, a point mass on the last link; IdentificationError."""
    segments = [segment for one in recordings for segment in split(one)]
    check_efforts(segments, arm.joint_names)
    parts = [_balance(arm, segment) for segment in segments]
    design, rest = (np.concatenate(part) for part in zip(*parts))
    scale = np.maximum(np.median(np.abs(rest - np.median(rest, axis=0)), axis=0), 1e-6)
    linear, turning = np.delete(design, np.s_[4:N_INERTIAL], axis=2), 0.0 * rest
    ones, counts = np.ones(rest.shape), np.ones(rest.shape, bool)
    for _ in range(4):  # the inertia of a point mass at the centre is known with it
        solution, residual, weight, last = robust_fit(
            linear, rest - turning, ones, scale, bound=_HUBER
        )
        mass = max(float(solution[0]), 1e-6)
        point = body_parameters(mass, solution[1:4] / mass, np.zeros((3, 3)))
        turning = design[:, :, 4:N_INERTIAL] @ point[4:]
    mass, center = float(solution[0]), solution[1:4] / solution[0]
    weight = weight / last**2
    root, inverse = np.sqrt(weight), invert_normal(normal_matrix(linear, weight))
    data = linear * root[:, :, None], residual * root, inverse
    lengths = [len(one) for _, one in parts]
    variances = np.diag(estimate_covariance(*data, lengths, counts))
    sigma = np.sqrt(np.maximum(variances, np.diag(inverse)))  # that of white errors, at least
    before, after = (float(np.sqrt(np.mean(error**2))) for error in (rest, residual))
    if not (mass > 2.0 * sigma[0] and after < before):
        found = f'mass {mass:.4g} kg within {2 * sigma[0]:.4g} kg'
        raise IdentificationError(
            f'the recording shows no tool: {found}, torque residual {before:.4g} -> {after:.4g} '
            'N m RMS; move the joints that carry its weight'
        )
    spread = np.sqrt(sigma[1:4] ** 2 + (center * sigma[0]) ** 2) / mass
    warnings = [
        f'{axis} of the centre is not determined: turn the wrist to other postures'
        for axis, s in zip('xyz', spread)
        if s > 0.1
    ]
    explained = 1.0 - float(np.mean(residual**2) / np.mean(np.var(rest, axis=0)))
    return Payload(
        mass, tuple(center.tolist()), float(sigma[0]), tuple(spread.tolist()), before, after,
        explained, tuple(warnings),
    )  # fmt: skip


def unknown_load(arm: SerialArm, recordings: Sequence[Recording]) -> list[str]:
    """Warning of a load that explains most of what the model of the arm does not."""
    try:
        found = identify_payload(arm, recordings)
    except IdentificationError:
        return []
    if found.explained < 0.5:
        return []
    share = f'{found.explained:.0%} of what torques are off'
    return [f'a load of {found.mass:.2g} kg at the tip explains {share}: give --payload']


def _balance(arm: SerialArm, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    """Regressor of the tool and the offsets, and the torque that the arm leaves unexplained."""
    n = len(arm.joints)
    motion, residual = model_residual(arm, segment)
    acceleration = derivative(motion.velocity, motion.step)
    regressor = RigidBody(arm).regressor(motion.position, motion.velocity, acceleration)
    tool = regressor[:, :, N_INERTIAL * (n - 1) : N_INERTIAL * n]
    bands = find_bandwidths([segment])
    cut = slice(len(tool) // 20, len(tool) - len(tool) // 20, bands.thinning(motion.step))
    filtered = low_pass(tool, arm.effort_bandwidth, motion.step, bands.analysis)[cut]
    offsets = np.broadcast_to(np.eye(n), (len(filtered), n, n))
    design = np.concatenate([filtered, offsets], axis=2)
    return design, low_pass(residual, bands.analysis, motion.step)[cut]


def with_payload(arm: SerialArm, payload: Payload) -> SerialArm:
    """The arm with the tool on its last link, a point mass at its centre."""
    tool = body_parameters(payload.mass, payload.center, np.zeros((3, 3)))
    *others, last = arm.joints
    link = LinkInertia.from_vector(last.link.to_vector() + tool)
    return replace(arm, joints=(*others, replace(last, link=link)))
