"""Launch files in YAML."""

from pathlib import Path

from lpv_ros2cli.command_line.yaml_text import read_yaml
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.entity import Entity


def read_yaml_launch(path: Path) -> Entity:
    """Read a launch file."""
    data = read_yaml(path, 'launch file')
    if not isinstance(data, dict) or list(data) != ['launch']:
        raise CliError(f"{path}: must hold a mapping with the one key 'launch'")
    return _entity('launch', data['launch'], str(path))


def _entity(tag: str, data: object, source: str) -> Entity:
    """An element: a list of its children, or a mapping of attributes and nested elements."""
    if isinstance(data, list):
        return Entity(tag, {}, [_child(tag, item, source) for item in data], source)
    if not isinstance(data, dict):
        raise CliError(f'{source}: {tag}: must be a mapping or a list, not {data!r}')
    attributes, nested = {}, []
    for name, value in data.items():
        if name == 'children':
            nested += [_child(tag, item, source) for item in _list(tag, name, value, source)]
        elif _holds_elements(value):
            nested += [_entity(name, item, source) for item in value]
        else:
            attributes[str(name)] = value
    return Entity(tag, attributes, nested, source)


def _holds_elements(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, dict) for v in value)


def _child(tag: str, item: object, source: str) -> Entity:
    if not isinstance(item, dict) or len(item) != 1:
        raise CliError(
            f'{source}: {tag}: each item must be a mapping with one key, the action; got {item!r}'
        )
    ((name, value),) = item.items()
    return _entity(str(name), value, source)


def _list(tag: str, name: str, value: object, source: str) -> list[object]:
    if not isinstance(value, list):
        raise CliError(f"{source}: {tag}: '{name}' must be a list")
    return value
