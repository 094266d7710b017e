"""Messages from values of a command line."""

import array
from typing import TYPE_CHECKING, Any

from lpv_ros2cli.command_line.yaml_text import parse_yaml
from lpv_ros2cli.errors import CliError

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time


def message_from_text(message_class: Any, text: str, now: 'Time | None' = None) -> Any:
    """Message from YAML."""
    values = parse_yaml(text, 'the message')
    message = message_class()
    _fill(message, {} if values is None else values, '', now)
    return message


def _fill(message: Any, values: object, prefix: str, now: 'Time | None') -> None:
    kinds = dict(zip(message.get_fields_and_field_types(), message.SLOT_TYPES))
    if not isinstance(values, dict):
        raise CliError(
            f'Failed to populate {prefix or "the message"}: {_name(message)} takes a '
            f'mapping of its fields, not {values!r}'
        )
    for name, value in values.items():
        if name not in kinds:
            raise CliError(
                f'Failed to populate field: {_name(message)} has no field '
                f'{prefix}{name}; it has: {", ".join(kinds) or "none"}'
            )
        setattr(message, name, _value(kinds[name], value, f'{prefix}{name}', now))


def _value(kind: Any, value: Any, path: str, now: 'Time | None') -> object:
    from rosidl_parser import definition as idl

    if isinstance(kind, idl.AbstractNestedType):
        return _sequence(kind, value, path, now)
    if isinstance(kind, idl.NamespacedType):
        return _nested(kind, value, path, now)
    if isinstance(kind, idl.AbstractGenericString):
        return _text(kind, value, path)
    return _number(kind.typename, value, path)


def _nested(kind: Any, value: object, path: str, now: 'Time | None') -> object:
    from lpv_ros2cli.message.types import load

    name = '/'.join(kind.namespaced_name())
    if now is not None and name == 'builtin_interfaces/msg/Time' and value == 'now':
        return now
    message = load(name, 'msg')()
    if now is not None and name == 'std_msgs/msg/Header' and value == 'auto':
        message.stamp = now
    else:
        _fill(message, value, f'{path}.', now)
    return message


def _sequence(kind: Any, value: Any, path: str, now: 'Time | None') -> list[object]:
    from rosidl_parser import definition as idl

    if isinstance(value, str) and getattr(kind.value_type, 'typename', '') in ('octet', 'uint8'):
        value = list(value.encode())
    if not isinstance(value, list):
        raise _error(path, 'takes a list', value)
    items = [_value(kind.value_type, v, f'{path}[{i}]', now) for i, v in enumerate(value)]
    if isinstance(kind, idl.Array) and len(items) != kind.size:
        raise CliError(
            f'Failed to populate field: {path} takes {kind.size} elements, got {len(items)}'
        )
    if isinstance(kind, idl.BoundedSequence) and len(items) > kind.maximum_size:
        raise CliError(
            f'Failed to populate field: {path} takes at most {kind.maximum_size} '
            f'elements, got {len(items)}'
        )
    return items


def _text(kind: Any, value: object, path: str) -> str:
    if isinstance(value, (dict, list)) or value is None:
        raise _error(path, 'takes a text', value)
    text = value if isinstance(value, str) else str(value)
    limit = getattr(kind, 'maximum_size', None)
    if limit is not None and len(text) > limit:
        raise _error(path, f'takes at most {limit} characters', value)
    return text


_FLOATS = {'float': 'f', 'double': 'd', 'long double': 'd'}
_INTEGERS = {
    'int8': 'b',
    'uint8': 'B',
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'short': 'h',
    'unsigned short': 'H',
    'long': 'i',
    'unsigned long': 'I',
    'long long': 'q',
    'unsigned long long': 'Q',
    'octet': 'B',
    'char': 'B',
    'wchar': 'H',
}


def _number(typename: str, value: Any, path: str) -> object:
    if typename == 'boolean':
        if not isinstance(value, bool):
            raise _error(path, 'takes true or false', value)
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise _error(path, 'takes a number', value)
    try:
        if typename in _FLOATS:
            return array.array(_FLOATS[typename], [float(value)])[0]
        if isinstance(value, float) or (isinstance(value, str) and typename != 'octet'):
            value = int(value) if not isinstance(value, float) else _whole(value)
        if typename == 'octet' and isinstance(value, str):
            value = ord(value)
        checked = array.array(_INTEGERS[typename], [value])[0]
    except (ValueError, OverflowError, TypeError) as error:
        kind = 'number' if typename in _FLOATS else 'whole number'
        raise _error(path, f'takes a {kind} of type {typename}', value) from error
    return bytes([checked]) if typename == 'octet' else checked


def _whole(value: float) -> int:
    if not value.is_integer():
        raise ValueError('not whole')
    return int(value)


def _name(message: object) -> str:
    return f'{type(message).__module__.split(".")[0]}/{type(message).__name__}'


def _error(path: str, what: str, value: object) -> CliError:
    return CliError(f'Failed to populate field: {path} {what}, got {value!r}')
