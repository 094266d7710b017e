"""Messages from YAML and as YAML."""

import importlib
import re
import sys
from typing import Any

from lpv_ros2cli.command_line import CliError

_FIELDS = 'get_fields_and_field_types'
_LENGTH = 128
"""Elements and characters that are shown of a long field, as in ros2cli."""


def load(name: str, kind: str) -> Any:
    """Class of an interface type, ``std_msgs/msg/String`` or ``std_msgs/String``."""
    found = re.fullmatch(rf'([a-z]\w*)/(?:{kind}/)?([A-Z]\w*)', name)
    if not found:
        raise CliError(f"The passed type '{name}' is invalid")
    try:
        return getattr(importlib.import_module(f'{found[1]}.{kind}'), found[2])
    except (ImportError, AttributeError) as error:
        raise CliError(f"The passed type '{name}' is not installed") from error


def parse_yaml(text: str, what: str) -> Any:
    """Value of a text."""
    import yaml  # slow, and not for --help

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise CliError(f'{what} is not valid YAML: {" ".join(str(error).split())}') from error


def from_yaml(message_class: Any, text: str) -> Any:
    """Message of which YAML gives some fields."""
    values = parse_yaml(text, 'the message')
    return _filled(message_class, {} if values is None else values, 'the message')


def _filled(message_class: Any, values: Any, where: str) -> Any:
    message = message_class(check_fields=True)  # types and ranges
    kinds = message.get_fields_and_field_types()
    if not isinstance(values, dict):
        raise CliError(f'{where} takes its fields, not {values!r}')
    for name, value in values.items():
        if name not in kinds:
            raise CliError(f'{where} has no field {name}; it has: {", ".join(kinds)}')
        try:
            setattr(message, name, _converted(getattr(message, name), kinds[name], value, name))
        except (AssertionError, TypeError, ValueError, OverflowError) as error:
            raise CliError(f'field {name} takes {kinds[name]}, got {value!r}') from error
    return message


def _converted(present: Any, kind: str, value: Any, name: str) -> Any:
    """A value of YAML as the type of a field, of which the present value is given."""
    if hasattr(present, _FIELDS):
        return _filled(type(present), value, name)
    if kind.startswith('sequence<') or kind.endswith(']'):
        element = kind.removeprefix('sequence<').partition('[')[0].partition(',')[0].rstrip('>')
        if not isinstance(value, list):
            raise TypeError(name)
        if '/' in element:
            return [_filled(load(element, 'msg'), item, name) for item in value]
        like = str if 'string' in element else float if element in ('float', 'double') else None
        return value if like is None else [like(item) for item in value]
    if isinstance(present, str) and not isinstance(value, (dict, list, type(None))):
        return str(value)  # numbers are texts, too
    if isinstance(present, float) and not isinstance(value, bool):
        return float(value)  # whole numbers are; and 1e-3 is a text in YAML
    return bytes([value]) if isinstance(present, bytes) else value


def to_yaml(message: Any) -> str:
    """A message as YAML; of long fields only the beginning is shown."""
    import yaml

    class Dumper(yaml.SafeDumper):
        """Escapes what cannot be printed: a plain U+0085 would be read back as a space."""

        def represent_str(self, data: str) -> yaml.ScalarNode:
            style = None if data.isprintable() else '"'
            return self.represent_scalar('tag:yaml.org,2002:str', data, style)

    Dumper.add_representer(str, Dumper.represent_str)
    return yaml.dump(
        _plain(message), Dumper=Dumper, width=sys.maxsize, sort_keys=False, allow_unicode=True
    )


def _plain(value: Any) -> Any:
    if hasattr(value, _FIELDS):
        names = value.get_fields_and_field_types()
        return {name: _plain(getattr(value, name)) for name in names}
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    if isinstance(value, str):
        return value if len(value) <= _LENGTH else value[:_LENGTH] + '...'
    if hasattr(value, '__len__'):
        shown = value[:_LENGTH]
        plain = [_plain(v) for v in getattr(shown, 'tolist', lambda: shown)()]
        return plain if len(plain) == len(value) else [*plain, '...']
    return value
