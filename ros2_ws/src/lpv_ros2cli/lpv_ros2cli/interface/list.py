"""``ros2 interface list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.message.types import KINDS, add_kind_arguments, chosen_kinds, installed


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_kind_arguments(parser)


def run(arguments: Namespace) -> None:
    """Print the interface types that are installed."""
    types = installed()
    for kind in chosen_kinds(arguments):
        print(f'{KINDS[kind].heading}:')
        for name in types:
            if f'/{kind}/' in name:
                print(f'    {name}')
