"""Parameters of launched nodes: files, and values typed in the launch file."""

from typing import Any

import yaml

from lpv_ros2cli.command_line.yaml_text import parse_yaml
from lpv_ros2cli.errors import CliError
from lpv_ros2cli.launch.context import Context
from lpv_ros2cli.launch.entity import Entity

_SCALARS = (bool, int, float, str)
_TYPES = {'bool': bool, 'int': int, 'float': float, 'str': str}


def parameter_sources(context: Context, entity: Entity) -> list[str | dict[str, Any]]:
    """Parameters of a node in the order in which they apply."""
    sources: list[str | dict[str, Any]] = []
    if context.scope.parameters:
        sources.append({name: _from_text(value, name) for name, value in context.scope.parameters})
    for element in entity.all('param'):
        file = element.text('from')
        if file is not None:
            if element.get('name') is not None:
                raise element.error("'name' and 'from' exclude each other")
            element.flag('allow_substs', False)
            sources.append(context.perform(file))
            element.finish()
            continue
        named = _named(context, element)
        if sources and isinstance(sources[-1], dict):
            sources[-1].update(named)
        else:
            sources.append(named)
    return sources


def _named(context: Context, element: Entity) -> dict[str, Any]:
    name = context.perform(element.required('name'))
    nested = element.all('param')
    if nested:
        if element.get('value') is not None:
            raise element.error("'value' and nested parameters exclude each other")
        element.finish()
        below = {}
        for child in nested:
            below.update(_named(context, child))
        return {name: below}
    value = element.get('value')
    if value is None:
        raise element.error("either 'value' or nested parameters are needed")
    return {name: _value(context, element, name, value)}


def _value(context: Context, element: Entity, name: str, value: object) -> Any:
    kind, separator = element.text('type'), element.text('value-sep') or element.text('sep')
    element.finish()
    if isinstance(value, list):
        return _checked([context.perform(v) if isinstance(v, str) else v for v in value], name)
    if not isinstance(value, str):
        return _checked(value, name)
    text = context.perform(value)
    if separator is not None:
        return _checked([_typed(element, part, kind, name) for part in text.split(separator)], name)
    return _typed(element, text, kind, name)


def _typed(element: Entity, text: str, kind: str | None, name: str) -> Any:
    if kind is None:
        return _from_text(text, name)
    kind = kind.removeprefix('list_of_').removesuffix('s') if 'list_of' in kind else kind
    if kind not in _TYPES:
        raise element.error(f"'type' must be one of {', '.join(_TYPES)}; got {kind!r}")
    if kind == 'str':
        return text
    value = parse_yaml(text, f"the value of parameter '{name}'")
    if kind == 'float' and type(value) is int:
        value = float(value)
    if type(value) is not _TYPES[kind]:
        raise element.error(f'{text!r} is not of type {kind}')
    return value


def _from_text(text: str, name: str) -> Any:
    """Value by the rules of YAML; what YAML reads as something else stays a text."""
    value = parse_yaml(text, f"the value of parameter '{name}'")
    if value is None:
        return text
    return _checked(value, name) if isinstance(value, (*_SCALARS, list)) else text


def _checked(value: Any, name: str) -> Any:
    if isinstance(value, list):
        kinds = {type(item) for item in value}
        if len(kinds) != 1 or not kinds <= set(_SCALARS):
            raise CliError(
                f"parameter '{name}' must be a list of values of one type, not empty; got {value!r}"
            )
    elif not isinstance(value, _SCALARS):
        raise CliError(f"parameter '{name}' cannot be {value!r}")
    return value


def file_content(values: dict[str, Any]) -> str:
    """Content of a parameter file with these values for every node that reads it."""
    return yaml.safe_dump({'/**': {'ros__parameters': values}})
