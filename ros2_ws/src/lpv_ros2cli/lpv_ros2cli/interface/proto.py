"""``ros2 interface proto``."""

from argparse import ArgumentParser, Namespace

from lpv_ros2cli.command_line import completion
from lpv_ros2cli.message.to_text import Style, to_yaml
from lpv_ros2cli.message.types import full_type, installed, load


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the verb's arguments."""
    completion.add_argument(parser, lambda **_: installed(), 'type', help='interface type')
    parser.add_argument('--no-quotes', action='store_true', help='no quotes around the prototype')


def run(arguments: Namespace) -> None:
    """Print the fields of a message, request or goal with their default values, as YAML."""
    name = full_type(arguments.type)
    interface = load(name, name.split('/')[1])
    part = next((part for part in ('Request', 'Goal') if hasattr(interface, part)), None)
    message = getattr(interface, part)() if part else interface()
    text = to_yaml(message, Style(truncate=None))
    print(text if arguments.no_quotes else f'"{text}"')
