"""Launch arguments: those of the command line, and those that a file declares."""

from pathlib import Path
from typing import Any

from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.context import Context
from lpv_ros2cli.launch.entity import Entity
from lpv_ros2cli.launch.files import read_launch_file
from lpv_ros2cli.launch.substitutions import describe, parse


def parse_arguments(words: list[str]) -> dict[str, str]:
    """Launch arguments of a command line."""
    arguments = {}
    for word in words:
        name, found, value = word.partition(':=')
        if not found or not name:
            raise CliError(f"malformed launch argument '{word}', expected format '<name>:=<value>'")
        arguments[name] = value
    return arguments


def declared(path: str | Path, context: Context) -> dict[str, tuple[Any, ...]]:
    """Arguments that a launch file and the files that it includes declare."""
    found: dict[str, tuple[Any, ...]] = {}
    with context.inside(Path(path).absolute()):
        _collect(read_launch_file(path), context, found, set())
    return found


def _collect(
    entity: Entity, context: Context, found: dict[str, tuple[Any, ...]], given: set[str]
) -> None:
    for child in entity.children():
        if child.tag == 'arg':
            name, default = child.required('name'), child.text('default')
            choices = [choice.required('value') for choice in child.all('choice')]
            if name not in given:
                found.setdefault(
                    name,
                    (
                        child.text('description', 'no description given'),
                        None if default is None else parse(default),
                        choices,
                    ),
                )
            _assume(context, name, default)
        elif child.tag == 'let':
            _assume(context, child.required('name'), child.text('value'))
        elif child.tag == 'group':
            _collect(child, context, found, given)
        elif child.tag == 'include':
            _include(child, context, found, given)


def _assume(context: Context, name: str, text: str | None) -> None:
    if name not in context.scope.configurations and text is not None:
        try:
            context.scope.configurations[name] = context.perform(text)
        except CliError:
            return  # of a mandatory argument: needed only if a file's name depends on it


def _include(
    entity: Entity, context: Context, found: dict[str, tuple[Any, ...]], given: set[str]
) -> None:
    passed = {a.required('name') for a in (*entity.all('arg'), *entity.all('let'))}
    try:
        path = context.perform(entity.required('file'))
    except CliError:
        return  # depends on an argument without default
    with context.inside(path):
        _collect(read_launch_file(path), context, found, given | passed)


def describe_arguments(found: dict[str, Any]) -> str:
    """Text of --show-args."""
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for name, (description, default, choices) in found.items():
        if choices:
            description += f'. Valid choices are: {choices}'
        lines += ['', f"    '{name}':", f'        {description}']
        if default is not None:
            lines.append(f'        (default: {describe(default)})')
    if not found:
        lines += ['', '  No arguments.']
    return '\n'.join(lines)
