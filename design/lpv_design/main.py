"""``lpv design``: gains for an arm, written to a ROS 2 parameter file."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from lpv_core.certificate.exact_proof import prove
from lpv_core.certificate.gains import Gains, save_gains
from lpv_core.model.arm import ArmParameters, load_arm
from lpv_core.support.errors import LpvError
from lpv_core.support.resources import bringup_file
from lpv_design.design_flow import NotDetectableError, design
from lpv_design.guarantee import Guarantee
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

EXIT_INFEASIBLE, EXIT_BAD_INPUT, EXIT_NOT_DETECTABLE = 1, 2, 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        '--arm',
        required=True,
        metavar='ARM',
        help='arm file, or name of a shipped arm (paper, real_arm)',
    )
    parser.add_argument(
        '--requirement',
        metavar='REQUIREMENT',
        help='requirement file, or name of a shipped one (paper, paper_literal, '
        "real_arm); without, the one with the arm's name",
    )
    parser.add_argument(
        '--proof',
        action='store_true',
        help='also prove the inequalities in exact rational arithmetic',
    )
    parser.add_argument(
        '--out', required=True, metavar='GAINS.yaml', help='parameter file to write'
    )


def run(
    arguments: argparse.Namespace, draw: Callable[[Guarantee, ArmParameters], None] | None = None
) -> int:
    """Design, report, write; ``draw`` makes a picture of what is guaranteed."""
    try:
        arm = load_arm(bringup_file('arms', arguments.arm))
        requirement = load_requirement(arguments.requirement or arm.name)
        result = design(arm, requirement)
    except NotDetectableError as error:
        print(f'lpv design: not detectable: {error}', file=sys.stderr)
        return EXIT_NOT_DETECTABLE
    except InfeasibleError as error:
        print(f'lpv design: infeasible: {error}', file=sys.stderr)
        return EXIT_INFEASIBLE
    except LpvError as error:
        print(f'lpv design: {error}', file=sys.stderr)
        return EXIT_BAD_INPUT
    comment = '\n'.join(
        [
            f'Gains for arm {arm.name!r}, written by lpv design.',
            f'Requirement: {Path(requirement.source).name}',
            *result.lines,
        ]
    )
    try:
        save_gains(result.gains, arguments.out, comment)
    except OSError as error:
        print(f'lpv design: cannot write {arguments.out}: {error}', file=sys.stderr)
        return EXIT_BAD_INPUT
    print('\n'.join(result.lines))
    if arguments.proof and not _prove(arm, result.gains):
        return EXIT_INFEASIBLE
    if draw is not None:
        draw(result.guarantee, arm)
    print(f'gains written to {arguments.out}')
    return 0


def _prove(arm: ArmParameters, gains: Gains) -> bool:
    results = prove(arm, gains)
    for name, holds in results.items():
        print(f'{"proved" if holds else "REFUTED"}: {name}')
    return all(results.values())


def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run lpv_design design``."""
    parser = argparse.ArgumentParser(prog='design', description=__doc__)
    add_arguments(parser)
    return run(parser.parse_args(argv))


if __name__ == '__main__':
    sys.exit(main())
