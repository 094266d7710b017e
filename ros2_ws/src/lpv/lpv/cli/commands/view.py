"""``lpv view``: start the live view for a running graph."""

import argparse
import os

from lpv.cli.commands import run as start
from lpv.core.support.resources import bringup_file


def run(arguments: argparse.Namespace) -> None:
    """Become the view node; returns only where it cannot be started."""
    values = {'arm_file': arguments.arm_file}
    if arguments.scenario:
        values['scenario_file'] = bringup_file('scenarios', arguments.scenario)
    values |= {name: getattr(arguments, name) for name in ('address', 'port', 'foxglove_port')}
    words = ['--ros-args', '-r', f'__ns:=/{arguments.namespace.strip("/")}']
    words += [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]
    if arguments.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(arguments.domain_id)
    start.run(argparse.Namespace(package='lpv_node', program='view', rest=words))
