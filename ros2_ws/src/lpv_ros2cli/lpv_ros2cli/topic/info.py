"""``ros2 topic info``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.graph import discovery
from lpv_ros2cli.graph.names import find_topic


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    discovery.add_arguments(parser)
    completion.add_argument(parser, completion.topics, 'topic_name', help='topic')
    parser.add_argument(
        '-v',
        '--verbose',
        action='store_true',
        help='show nodes and QoS of publishers and subscriptions',
    )


def run(arguments: Namespace) -> None:
    """Print type, publishers and subscriptions of a topic."""
    with discovery.command_node() as node:
        name, types = find_topic(node, arguments.topic_name, arguments.spin_time)
        discovery.settle(node, arguments.spin_time)
        publishers = node.get_publishers_info_by_topic(name)
        subscriptions = node.get_subscriptions_info_by_topic(name)
    print(f'Type: {types[0] if len(types) == 1 else types}')
    for what, infos in (('Publisher', publishers), ('Subscription', subscriptions)):
        print(
            f'\n{what} count: {len(infos)}' if arguments.verbose else f'{what} count: {len(infos)}'
        )
        if arguments.verbose:
            for info in infos:
                print(f'\n{info}')
    if arguments.verbose:
        print()
