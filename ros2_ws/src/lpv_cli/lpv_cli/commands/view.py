"""``lpv view``: start the live view for a running graph."""

import argparse
import os

from lpv_cli.needs import require_ros
from lpv_cli.options import number
from lpv_core.support.discovery import stay_local
from lpv_core.support.resources import bringup_file, executable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument('--arm', default='paper', help='shipped arm or arm file (paper)')
    parser.add_argument(
        '--scenario', help='shipped scenario or scenario file whose path and obstacle are drawn'
    )
    parser.add_argument('--namespace', default='/lpv', help='namespace of the graph (/lpv)')
    parser.add_argument(
        '--address',
        default='127.0.0.1',
        help='where to listen (127.0.0.1); '
        '0.0.0.0: everywhere, the buttons then need the token that is printed, '
        'or the one in the environment variable LPV_VIEW_TOKEN',
    )
    number(parser, '--port', 8090, 'port of the page')
    number(parser, '--foxglove-port', 8765, 'port of the Foxglove WebSocket protocol; 0: off')
    parser.add_argument(
        '--domain-id', type=int, help="ROS_DOMAIN_ID of the graph; otherwise the environment's"
    )


def run(arguments: argparse.Namespace) -> None:
    """Become the view node; returns only where it cannot be started."""
    require_ros()
    program = executable('lpv_view', 'view')
    parameters = {
        'arm_file': bringup_file('arms', arguments.arm),
        'address': arguments.address,
        'port': arguments.port,
        'foxglove_port': arguments.foxglove_port,
    }
    if arguments.scenario:
        parameters['scenario_file'] = bringup_file('scenarios', arguments.scenario)
    line = [str(program), '--ros-args', '-r', f'__ns:={arguments.namespace}']
    for name, value in parameters.items():
        line += ['-p', f'{name}:={value}']
    if arguments.domain_id is not None:
        os.environ['ROS_DOMAIN_ID'] = str(arguments.domain_id)
    stay_local()
    os.execv(program, line)
