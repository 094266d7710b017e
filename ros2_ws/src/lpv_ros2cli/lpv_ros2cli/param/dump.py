"""``ros2 param dump``."""

import yaml

from lpv_ros2cli import completion, discovery
from lpv_ros2cli.param.client import ParameterAccess


def add_arguments(parser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    parser.add_argument('node_name', help='node').completer = completion.nodes
    parser.add_argument('--include-hidden-nodes', action='store_true')


def run(arguments) -> None:
    """Print a node's parameters in the form of a parameter file."""
    from rclpy.parameter import parameter_value_to_python

    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        names = access.names()
        values = dict(zip(names, access.values(names)))
    nested = {}
    for name, value in values.items():
        if not value.type:  # declared, never set: a file cannot say so
            continue
        *parents, leaf = name.split('.')
        level = nested
        for parent in parents:
            level = level.setdefault(parent, {})
        plain = parameter_value_to_python(value)
        level[leaf] = (
            list(plain) if isinstance(plain, (tuple, list)) or hasattr(plain, 'tolist') else plain
        )
    print(
        yaml.safe_dump({access.name: {'ros__parameters': nested}}, default_flow_style=False), end=''
    )
