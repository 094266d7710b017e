"""``ros2 param dump``."""

from argparse import ArgumentParser, Namespace
from typing import Any

import yaml

from lpv_ros2cli.graph import discovery, listing
from lpv_ros2cli.param.client import ParameterAccess, plain_value


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    listing.add_node_name(parser)


def run(arguments: Namespace) -> None:
    """Print a node's parameters in the form of a parameter file."""
    with discovery.command_node() as node:
        access = ParameterAccess(node, arguments.node_name, arguments.spin_time)
        names = access.names()
        values = dict(zip(names, access.values(names)))
    nested: dict[str, Any] = {}
    for name, value in values.items():
        if not value.type:  # declared, never set: a file cannot say so
            continue
        *parents, leaf = name.split('.')
        level = nested
        for parent in parents:
            level = level.setdefault(parent, {})
        level[leaf] = plain_value(value)
    print(
        yaml.safe_dump({access.name: {'ros__parameters': nested}}, default_flow_style=False), end=''
    )
