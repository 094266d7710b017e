"""``lpv doctor``: finds the usual mistakes, and says what to do about them."""

import argparse
import json
from dataclasses import asdict
from importlib.util import find_spec

from lpv.cli.doctor.environment import check_environment
from lpv.cli.doctor.files import check_files
from lpv.cli.doctor.finding import Level, show


def run(arguments: argparse.Namespace) -> int:
    """Check environment, files and graph; 3 if something was found."""
    arm, of_files = check_files(arguments.arm, arguments.gains, arguments.scenario)
    findings = check_environment() + of_files
    # Importing rclpy without its middleware would end this process.
    blocked = any(f.check in ('ros', 'middleware') and f.level == Level.ERROR for f in findings)
    # Without messages there is no graph; the check of the environment has said so.
    if not arguments.offline and not blocked and find_spec('lpv_msgs'):
        from lpv.cli.doctor.graph import check_graph
        from lpv.cli.doctor.snapshot import watch

        findings += check_graph(watch(arguments.seconds), arm, alone=not of_files)
    is_ok = all(f.level == Level.OK for f in findings)
    if arguments.json:
        found = [{**asdict(f), 'level': f.level.name} for f in findings]
        print(json.dumps({'ok': is_ok, 'findings': found}, indent=2))
    else:
        show(findings)
    return 0 if is_ok else 3
