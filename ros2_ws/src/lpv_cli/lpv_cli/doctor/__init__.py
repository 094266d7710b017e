"""``lpv doctor``: finds the usual mistakes, and says what to do about them."""

import argparse
import json
from typing import TYPE_CHECKING

from lpv_cli.options import flag

if TYPE_CHECKING:
    from lpv_cli.doctor.finding import Finding
    from lpv_core.serial_arm.description import SerialArm

FOUND = 3
"""Exit code where something was found."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        '--arm', help='arm file, or name of a shipped arm; without, that of the running observer'
    )
    parser.add_argument('--gains', help='gains file that should fit the arm')
    parser.add_argument('--scenario', help='scenario file, or name of a shipped one')
    flag(parser, '--offline', 'leave the running graph alone')
    parser.add_argument(
        '--seconds', type=_seconds, default=3.0, help='how long to watch the graph (3)'
    )
    flag(parser, '--json', 'findings as JSON')


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.5 <= value <= 600.0:
        raise ValueError  # argparse says that the value is invalid
    return value


def run(arguments: argparse.Namespace) -> int:
    """Check environment, files and graph."""
    from lpv_cli.doctor.environment import check_environment
    from lpv_cli.doctor.files import check_files
    from lpv_cli.doctor.finding import Level, show

    arm, of_files = check_files(arguments.arm, arguments.gains, arguments.scenario)
    findings = check_environment() + of_files
    # Importing rclpy without its middleware would end this process.
    blocked = any(f.check in ('ros', 'middleware') and f.level == Level.ERROR for f in findings)
    if not arguments.offline and not blocked:
        findings += _check_graph(arm, arguments, alone=not of_files)
    is_ok = all(f.level == Level.OK for f in findings)
    if arguments.json:
        print(json.dumps({'ok': is_ok, 'findings': [f.as_dict() for f in findings]}, indent=2))
    else:
        show(findings)
    return 0 if is_ok else FOUND


def _check_graph(
    arm: 'SerialArm | None', arguments: argparse.Namespace, alone: bool
) -> 'list[Finding]':
    try:
        import rclpy  # noqa: F401

        import lpv_msgs.msg  # noqa: F401
    except ImportError:
        return []  # the check of the environment has said so
    from lpv_cli.doctor.graph import check_graph
    from lpv_cli.doctor.snapshot import watch

    return check_graph(watch(arguments.seconds), arm, alone)
