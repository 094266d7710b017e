"""How often the true parameters of simulated arms lie inside their 95 % regions.

Usage: python benchmarks/identification_coverage.py [ARM [RUNS]], where ARM is an arm file or a
URDF; the UR10 and 20 runs otherwise.  Each run has sensor noise of its own along the motion that
`lpv excite` plans.
"""

import sys
from dataclasses import replace

import numpy as np
from scipy import stats
from simulated_recordings import SensorNoise, simulate

from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import JointFriction, SerialArm
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.resources import bringup_file
from lpv.identify.estimation.workshop import Workshop
from lpv.identify.model.prior import parameter_map
from lpv.identify.motions import plan_excitation

DURATION, RATE = 30.0, 125.0
LEVEL = 0.95


def arm_with_friction(path: str) -> SerialArm:
    """The arm of a file; drives get friction and rotors in proportion to their torque."""
    arm = read_urdf_chain(path) if path.endswith('.urdf') else load_arm(path)
    joints = []
    for joint in arm.joints:
        size = min(joint.limits.torque, 200.0) / 20.0
        friction = JointFriction(0.1 * size, 0.5 * size, size, 40.0)
        joints.append(replace(joint, friction=friction, rotor_inertia=0.02 * size))
    return replace(arm, joints=tuple(joints))


def main(path: str, runs: int) -> None:
    arm = arm_with_friction(path)
    trajectory = plan_excitation(arm, DURATION).trajectory
    rng = np.random.default_rng(7)
    inside, regions = [], []
    for _ in range(runs):
        recording = simulate(arm, trajectory, RATE, SensorNoise(), rng)
        workshop = Workshop(arm, [recording])
        fit = workshop.fit()
        truth = parameter_map(workshop.base, workshop.n) @ arm.parameter_vector()
        sigma = np.sqrt(np.diag(fit.covariance))
        used = sigma > 0.0
        error = fit.parameters - truth
        factor = float(stats.norm.ppf(0.5 + 0.5 * LEVEL))
        inside.append(np.abs(error[used]) < factor * sigma[used])
        covariance = fit.covariance[np.ix_(used, used)]
        distance = error[used] @ np.linalg.solve(covariance, error[used])
        regions.append(distance < stats.chi2.ppf(LEVEL, int(used.sum())))
    size = inside[0].size
    share = np.mean(inside, axis=0)
    print(
        f'{arm.name}: {size} parameters, {runs} runs: intervals hold the truth in '
        f'{100 * np.mean(inside):.1f} % (worst parameter {100 * share.min():.1f} %), the joint '
        f'region in {100 * np.mean(regions):.1f} %'
    )


if __name__ == '__main__':
    ur10 = str(bringup_file('arms', 'ur10'))
    main(*sys.argv[1:2] or [ur10], *map(int, sys.argv[2:3] or [20]))
