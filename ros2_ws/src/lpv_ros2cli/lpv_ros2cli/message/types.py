"""Interface types: their classes, their definitions, and which are installed."""

import importlib
import re
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.packages import prefix_of, resources

_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]*')


@dataclass(frozen=True)
class Kind:
    """Of interfaces."""

    heading: str
    noun: str
    option: str  # that chooses them


KINDS = {
    'msg': Kind('Messages', 'messages', 'msgs'),
    'srv': Kind('Services', 'services', 'srvs'),
    'action': Kind('Actions', 'actions', 'actions'),
}
"""Kinds of interfaces by the folder of their definitions."""


def add_kind_arguments(parser: ArgumentParser) -> None:
    """Declare the options that choose kinds."""
    for name, kind in KINDS.items():
        parser.add_argument(
            f'-{name[0]}',
            f'--only-{kind.option}',
            action='append_const',
            dest='kinds',
            const=name,
            help=f'only {kind.noun}',
        )


def chosen_kinds(arguments: Namespace) -> list[str]:
    """Kinds that were chosen, or all, in the order of `KINDS`."""
    return [name for name in KINDS if arguments.kinds is None or name in arguments.kinds]


def full_type(text: str, kind: str | None = None) -> str:
    """Full name of an interface type."""
    parts = text.split('/')
    if len(parts) == 2 and kind is not None:
        parts.insert(1, kind)
    if (
        len(parts) != 3
        or parts[1] not in KINDS
        or (kind is not None and parts[1] != kind)
        or not all(_NAME.fullmatch(part) for part in parts)
    ):
        example = 'std_srvs/srv/Trigger' if kind == 'srv' else 'std_msgs/msg/String'
        raise CliError(f"The passed type '{text}' is invalid: it should look like {example}")
    return '/'.join(parts)


def load(text: str, kind: str) -> Any:
    """Class of an interface type."""
    package, kind, name = full_type(text, kind).split('/')
    try:
        return getattr(importlib.import_module(f'{package}.{kind}'), name)
    except (ImportError, AttributeError) as error:
        raise CliError(f"The passed type '{text}' is not installed") from error


def installed(packages: Iterable[str] | None = None) -> list[str]:
    """Interface types that are installed."""
    found = set()
    for package, prefix in resources('rosidl_interfaces').items():
        if packages is not None and package not in packages:
            continue
        entry = prefix / 'share' / 'ament_index' / 'resource_index' / 'rosidl_interfaces' / package
        for line in entry.read_text(encoding='utf-8').split():
            kind, _, file = line.partition('/')
            if kind in KINDS and file.endswith(f'.{kind}'):
                found.add(f'{package}/{kind}/{file.rpartition(".")[0]}')
    return sorted(found)


def definition(name: str) -> str:
    """Text of an interface's definition file; errors as upstream."""
    parts = name.split('/')
    if len(parts) != 3 or not all(_NAME.fullmatch(part) for part in parts):
        raise CliError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    package, kind, short = parts
    if package not in resources('packages'):
        raise CliError(f"Unknown package '{package}'")
    folder = prefix_of(package) / 'share' / package / kind
    try:
        return (folder / f'{short}.{kind}').read_text(encoding='utf-8')
    except OSError as error:
        raise CliError(f"Could not find the interface '{folder / short}.idl'") from error
