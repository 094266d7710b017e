"""``lpv view``: start the live view for a running graph."""

import argparse
import os

from lpv.cli.needs import require_ros
from lpv.core.support.discovery import stay_local
from lpv.core.support.resources import bringup_file, executable


def run(arguments: argparse.Namespace) -> None:
    """Become the view node; returns only where it cannot be started."""
    require_ros()
    program = executable('lpv_node', 'view')
    values = {'arm_file': arguments.arm_file}
    if arguments.scenario:
        values['scenario_file'] = bringup_file('scenarios', arguments.scenario)
    values |= {name: getattr(arguments, name) for name in ('address', 'port', 'foxglove_port')}
    line = [str(program), '--ros-args', '-r', f'__ns:=/{arguments.namespace.strip("/")}']
    line += [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
    if arguments.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(arguments.domain_id)
    stay_local()
    os.execv(program, line)
