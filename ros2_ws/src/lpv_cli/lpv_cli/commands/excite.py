"""``lpv excite``: a motion that identifies an arm well, as files and as a played reference."""

import argparse
from pathlib import Path

from lpv_cli import arm_choice
from lpv_cli.options import number
from lpv_core.support.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    arm_choice.add_arguments(parser)
    parser.add_argument(
        '--out',
        required=True,
        help='folder to create: trajectory.csv, trajectory.yaml, reference bag, scenario.yaml',
    )
    number(parser, '--duration', 30.0, 'in seconds')
    number(parser, '--rate', 100.0, 'samples per second')
    parser.add_argument(
        '--center',
        nargs='+',
        type=float,
        metavar='ANGLE',
        help="middle of the motion (that of the joints' ranges) [rad]",
    )
    number(parser, '--reach', 1.5, 'largest way of a joint from the middle [rad]')
    number(parser, '--speed-share', 0.6, 'share of the velocity limits that is used')
    number(parser, '--torque-share', 0.8, 'share of the torque limits that is used')
    parser.add_argument(
        '--lowest', type=float, help='height above the base that joints and tip keep [m]'
    )
    parser.add_argument(
        '--radius',
        type=float,
        help="distance from the base's vertical axis that they keep within [m]",
    )
    number(parser, '--trials', 300, 'motions that are tried')
    number(parser, '--seed', 1, 'of the search')


def run(arguments: argparse.Namespace) -> int:
    """Plan and write."""
    _check(arguments)
    import numpy as np

    from lpv_identify.motions.excitation import Bounds, plan_excitation
    from lpv_identify.motions.reference import write_reference

    arm = arm_choice.chosen_arm(arguments)
    center = None if arguments.center is None else np.array(arguments.center)
    if center is not None and len(center) != len(arm.joints):
        raise ConfigError('--center', f'needs {len(arm.joints)} angles')
    bounds = Bounds(
        arguments.speed_share,
        arguments.torque_share,
        reach=arguments.reach,
        lowest=-np.inf if arguments.lowest is None else arguments.lowest,
        radius=np.inf if arguments.radius is None else arguments.radius,
    )
    plan = plan_excitation(
        arm, arguments.duration, bounds, center, arguments.trials, arguments.seed
    )
    files = write_reference(arm, plan.trajectory, arguments.rate, Path(arguments.out))
    print(
        f'condition number {plan.condition:.0f}, log information per parameter '
        f'{plan.information:.2f}'
    )
    for name, torque in zip(arm.joint_names, plan.torque):
        print(f'  {name}: largest torque {torque:.1f} N m')
    for file in files:
        print(file)
    print(
        f'move there first: {", ".join(f"{a:.3f}" for a in plan.trajectory.center)} rad; check '
        'the way for collisions'
    )
    return 0


def _check(arguments: argparse.Namespace) -> None:
    ranges = {
        'duration': (5.0, 600.0),
        'rate': (10.0, 2000.0),
        'reach': (0.05, 3.2),
        'speed_share': (0.01, 1.0),
        'torque_share': (0.01, 1.0),
        'trials': (1, 100_000),
    }
    for name, (low, high) in ranges.items():
        if not low <= getattr(arguments, name) <= high:
            raise ConfigError('--' + name.replace('_', '-'), f'must lie within [{low}, {high}]')
    if Path(arguments.out).exists():
        raise ConfigError('--out', f'{arguments.out} exists already')
