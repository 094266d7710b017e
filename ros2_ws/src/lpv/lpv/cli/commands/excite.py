"""``lpv excite``: a motion that identifies an arm well, as files and as a played reference."""

import argparse
import math
from pathlib import Path

import numpy as np

from lpv.cli.arm_choice import chosen_arm
from lpv.core.support.errors import ConfigError
from lpv.identify.motions import Bounds, plan_excitation, write_reference


def run(arguments: argparse.Namespace) -> int:
    """Plan and write."""
    if Path(arguments.out).exists():
        raise ConfigError('--out', f'{arguments.out} exists already')
    arm = chosen_arm(arguments)
    center = None if arguments.center is None else np.array(arguments.center)
    if center is not None and len(center) != len(arm.joints):
        raise ConfigError('--center', f'needs {len(arm.joints)} angles')
    bounds = Bounds(
        arguments.speed_share,
        arguments.torque_share,
        reach=arguments.reach,
        lowest=-math.inf if arguments.lowest is None else arguments.lowest,
        radius=math.inf if arguments.radius is None else arguments.radius,
    )
    trials, seed = arguments.trials, arguments.seed
    plan = plan_excitation(arm, arguments.duration, bounds, center, trials, seed)
    files = write_reference(arm, plan.trajectory, arguments.rate, Path(arguments.out))
    information = f'log information per parameter {plan.information:.2f}'
    print(f'condition number {plan.condition:.0f}, {information}')
    for joint, torque in zip(arm.joints, plan.torque):
        print(f'  {joint.name}: largest torque {torque:.3g} {joint.units[1]}')
    print(*files, sep='\n')
    places = zip(plan.trajectory.center, arm.position_units)
    start = ', '.join(f'{place:.3f} {unit}' for place, unit in places)
    print(f'move there first: {start}; check the way for collisions')
    return 0
