"""``lpv design``: gains for an arm, written to a ROS 2 parameter file."""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lpv.cli.options import DESIGN
from lpv.cli.progress import wrapped
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.options import declare
from lpv.core.support.resources import bringup_file

if TYPE_CHECKING:
    from lpv.core.serial_arm.description import SerialArm

EXIT_INFEASIBLE, EXIT_BAD_INPUT, EXIT_NOT_DETECTABLE = 1, 2, 3
"""Exit codes."""


def run(arguments: argparse.Namespace) -> int:
    """Design, report, write; with ``map``, too, a picture of what is detected."""
    with wrapped():
        return _design(arguments, getattr(arguments, 'map', None))


def _design(arguments: argparse.Namespace, picture: str | None) -> int:
    # Only here: help must not wait for the solver.
    from lpv.core.serial_arm.arm_file import load_arm
    from lpv.core.uio.certificate.exact_proof import prove
    from lpv.core.uio.certificate.gains import save_gains
    from lpv.core.uio.planar import planar_model
    from lpv_design.design_flow import NotDetectableError, design
    from lpv_design.requirement import load_requirement
    from lpv_design.solve import InfeasibleError

    try:
        described = load_arm(bringup_file('arms', arguments.arm))
        if described.lpv is None:
            if picture is not None:
                raise ConfigError('--map', 'is for arms with an lpv region')
            return _certify_loop(described, arguments)
        arm = planar_model(described)
        requirement = load_requirement(arguments.requirement or arm.name)
        result = design(arm, requirement)
    except NotDetectableError as error:
        print(f'lpv design: not detectable: {error}', file=sys.stderr)
        return EXIT_NOT_DETECTABLE
    except InfeasibleError as error:
        print(f'lpv design: infeasible: {error}', file=sys.stderr)
        return EXIT_INFEASIBLE
    except (LpvError, OSError) as error:
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
    if arguments.proof and not _print_proof(prove(arm, result.gains)):
        return EXIT_INFEASIBLE
    if picture is not None:
        from lpv.report.figures import draw_region  # a design without a picture does not wait

        draw_region(result.guarantee, arm, picture)
        print(f'map written to {picture}')
    print(f'gains written to {arguments.out}')
    return 0


def _certify_loop(arm: 'SerialArm', arguments: argparse.Namespace) -> int:
    """Certificate of the computed-torque loop."""
    # Only here: designed gains need nothing of it.
    from lpv.core.serial_arm.certificate.exact_proof import prove_loop
    from lpv.core.serial_arm.certificate.loop_gains import save_loop_gains
    from lpv_design.serial_loop import LoopRequest, certify_loop

    if arguments.requirement:
        raise ConfigError('--requirement', 'is for arms with an lpv region; see lpv design --help')
    error = arguments.model_error
    if error is None:
        error = arm.uncertainty.model_error or LoopRequest.model_error
    request = LoopRequest(arguments.bandwidth, error, arguments.rate_share)
    found = certify_loop(arm, request)
    comment = [f'Tracking of arm {arm.name!r} and its certificate, written by lpv design.']
    save_loop_gains(found.gains, arguments.out, '\n'.join([*comment, *found.lines]))
    print('\n'.join(found.lines))
    if arguments.proof and not _print_proof(prove_loop(arm, found.gains)):
        return EXIT_INFEASIBLE
    print(f'gains written to {arguments.out}')
    return 0


def _print_proof(results: dict[str, bool]) -> bool:
    for name, holds in results.items():
        print(f'{"proved" if holds else "REFUTED"}: {name}')
    return all(results.values())


def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run lpv_design design``."""
    parser = argparse.ArgumentParser(prog='design', description=__doc__)
    declare(parser, DESIGN)
    return run(parser.parse_args(argv))


if __name__ == '__main__':
    sys.exit(main())
