"""``ros2 interface list``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.message.types import KINDS, installed


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        '-m', '--only-msgs', action='append_const', dest='kinds', const='msg', help='only messages'
    )
    parser.add_argument(
        '-s', '--only-srvs', action='append_const', dest='kinds', const='srv', help='only services'
    )
    parser.add_argument(
        '-a',
        '--only-actions',
        action='append_const',
        dest='kinds',
        const='action',
        help='only actions',
    )


def run(arguments: Namespace) -> None:
    """Print the interface types that are installed."""
    types = installed()
    for kind, heading in KINDS.items():
        if arguments.kinds is None or kind in arguments.kinds:
            print(f'{heading}:')
            for name in types:
                if f'/{kind}/' in name:
                    print(f'    {name}')
