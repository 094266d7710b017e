"""Cost of designing again: 50 variants of the paper's arm, against the first design of this run.

Masses and inertias are drawn within +-10 % (seeded).  Every variant gets a full design: gains of
both links, controller, bounds, and the check of every inequality in NumPy, which decides whether it
counts as verified.  The time is split into cvxpy's canonicalisation, the solver, and the rest.
"""

import time

import numpy as np
from design_solvers import recorded

from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.support.resources import bringup_file
from lpv.core.uio.planar import planar_model
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

VARIANTS = 50
SPREAD = 0.1
SEED = 20240


def variants(arm):
    """Arms with other masses and inertias."""
    rng = np.random.default_rng(SEED)
    return [arm.scaled(*rng.uniform(1.0 - SPREAD, 1.0 + SPREAD, (2, 2))) for _ in range(VARIANTS)]


def timed_design(arm, requirement):
    """Whole time, canonicalisation, solver [s], and whether the gains verify."""
    with recorded() as solved:
        start = time.perf_counter()
        try:
            gains = design(arm, requirement).gains
        except InfeasibleError as error:
            print(f'not designed: {error}')
            gains = None
        total = time.perf_counter() - start
    calls, compiled = np.sum(solved, axis=0)
    verified = gains is not None and all(check.holds for check in gains.verify(arm))
    return total, compiled, calls - compiled, verified


def main():
    """Design them all, and print times and shares."""
    arm = planar_model(load_arm(bringup_file('arms', 'paper')))
    requirement = load_requirement('paper')
    first = timed_design(two_link_arm(arm), requirement)[0]
    rows = np.array([timed_design(two_link_arm(other), requirement) for other in variants(arm)])
    total, compiled, solver, verified = rows.T
    print(
        f'first design of the process: {first:.2f} s; {VARIANTS} variants: median '
        f'{np.median(total):.2f} s, max {total.max():.2f} s, ratio to the first '
        f'{np.median(total) / first:.2f}'
    )
    print(f'verified: {int(verified.sum())} of {VARIANTS}')
    spent = total.sum()
    print(
        f'share of time: canonicalisation {compiled.sum() / spent:.0%}, solver '
        f'{solver.sum() / spent:.0%}, checks and bounds '
        f'{1.0 - (compiled + solver).sum() / spent:.0%}'
    )


if __name__ == '__main__':
    main()
