"""``lpv design``: gains for an arm, written to a ROS 2 parameter file."""

import argparse
import sys
from pathlib import Path

from lpv.cli import main as cli
from lpv.core.serial_arm.certificate.certified import CertifiedGains
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.errors import ConfigError
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
    arm = arguments.arm
    if arm.lpv is None:
        loop, lines = certify_loop(arm, _loop_request(arm, arguments))
        comment = [f'Tracking of arm {arm.name!r} and its certificate, written by lpv design.']
        return _finish(arguments, loop, comment, lines)
    requirement = load_requirement(arguments.requirement or arm.name)
    found = design(arm, requirement)
    comment = [
        f'Gains for arm {arm.name!r}, written by lpv design.',
        f'Requirement: {Path(requirement.source).name}',
    ]
    code = _finish(arguments, found.gains, comment, found.lines)
    if arguments.map is not None and code == 0:
        from lpv.report.figures import draw_region  # a design without a picture does not wait

        draw_region(found.guarantee, planar_model(arm), arguments.map)
        print(f'map written to {arguments.map}')
    return code


def _loop_request(arm: SerialArm, arguments: argparse.Namespace) -> LoopRequest:
    """What to certify of computed torque."""
    for option, value in (('--map', arguments.map), ('--requirement', arguments.requirement)):
        if value:
            raise ConfigError(option, 'is for arms with an lpv region; see lpv design --help')
    error = arguments.model_error
    if error is None:
        error = arm.uncertainty.model_error or LoopRequest.model_error
    return LoopRequest(arguments.bandwidth, error, arguments.rate_share)


def _finish(
    arguments: argparse.Namespace, gains: CertifiedGains, comment: list[str], lines: list[str]
) -> int:
    """Say what was found and, if asked for, what is proved; write gains that are not refuted."""
    print('\n'.join(lines))
    results = gains.prove(arguments.arm) if arguments.proof else {}
    for name, holds in results.items():
        print(f'{"proved" if holds else "REFUTED"}: {name}')
    if not all(results.values()):
        return EXIT_INFEASIBLE
    gains.save(arguments.out, '\n'.join([*comment, *lines]))
    print(f'gains written to {arguments.out}')
    return 0
