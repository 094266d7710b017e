"""``lpv design``: gains for an arm, written to a ROS 2 parameter file."""

import argparse
import sys
from pathlib import Path

from lpv.cli import main as cli
from lpv.core.serial_arm.certificate.conditions import prove_loop
from lpv.core.serial_arm.certificate.loop_gains import save_loop_gains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
from lpv.core.uio.certificate.conditions import prove
from lpv.core.uio.certificate.gains import save_gains
from lpv.core.uio.planar import planar_model
from lpv_design.design_flow import design
from lpv_design.requirement import load_requirement
from lpv_design.serial_loop import LoopRequest, certify_loop
from lpv_design.solve import InfeasibleError, NotDetectableError

EXIT_INFEASIBLE, EXIT_NOT_DETECTABLE = 1, 3
"""Exit codes."""


def main() -> int:
    """`lpv design`, as ``ros2 run lpv_design design``."""
    return cli.main(['design', *sys.argv[1:]])


def run(arguments: argparse.Namespace) -> int:
    """Design, report, write; with ``map``, too, a picture of what is detected."""
    try:
        return _design(arguments)
    except NotDetectableError as error:
        print(f'lpv design: not detectable: {error}', file=sys.stderr)
        return EXIT_NOT_DETECTABLE
    except InfeasibleError as error:
        print(f'lpv design: infeasible: {error}', file=sys.stderr)
        return EXIT_INFEASIBLE


def _design(arguments: argparse.Namespace) -> int:
    described = arguments.arm
    if described.lpv is None:
        if arguments.map is not None:
            raise ConfigError('--map', 'is for arms with an lpv region')
        return _certify_loop(described, arguments)
    arm = planar_model(described)
    requirement = load_requirement(arguments.requirement or arm.name)
    result = design(arm, requirement)
    comment = '\n'.join(
        [
            f'Gains for arm {arm.name!r}, written by lpv design.',
            f'Requirement: {Path(requirement.source).name}',
            *result.lines,
        ]
    )
    save_gains(result.gains, arguments.out, comment)
    print('\n'.join(result.lines))
    if arguments.proof and not _print_proof(prove(arm, result.gains)):
        return EXIT_INFEASIBLE
    if arguments.map is not None:
        from lpv.report.figures import draw_region  # a design without a picture does not wait

        draw_region(result.guarantee, arm, arguments.map)
        print(f'map written to {arguments.map}')
    print(f'gains written to {arguments.out}')
    return 0


def _certify_loop(arm: SerialArm, arguments: argparse.Namespace) -> int:
    """Certificate of the computed-torque loop."""
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
