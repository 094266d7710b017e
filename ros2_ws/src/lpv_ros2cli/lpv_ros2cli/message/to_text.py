"""Messages as YAML and as comma-separated values."""

import array
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from lpv_ros2cli.errors import CliError

DEFAULT_LENGTH = 128
"""Elements and characters that are shown of a long field."""


_ARRAYS = (list, tuple, array.array, np.ndarray)


@dataclass(frozen=True)
class Style:
    """How messages are shown."""

    truncate: int | None = DEFAULT_LENGTH  # longest list, text or bytes; None shows all
    no_arr: bool = False  # a remark in place of arrays
    no_str: bool = False  # a remark in place of texts
    flow: bool = False  # lists in one line each


class _Dumper(yaml.SafeDumper):
    """Mappings in block style, lists not indented, no aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _represent_mapping(dumper: yaml.SafeDumper, data: dict[Any, Any]) -> yaml.Node:
    return dumper.represent_mapping('tag:yaml.org,2002:map', data.items(), flow_style=False)


def _represent_text(dumper: yaml.SafeDumper, data: str) -> yaml.Node:
    # Unquoted or in single quotes, a reader would take this character for the end of a line.
    quotes = '"' if '\x85' in data else None
    return dumper.represent_scalar('tag:yaml.org,2002:str', data, style=quotes)


_Dumper.add_representer(dict, _represent_mapping)
_Dumper.add_representer(str, _represent_text)


def to_yaml(message: Any, style: Style = Style()) -> str:  # noqa: B008 - immutable
    """A message as YAML; with ``flow``, lists take one line each, as upstream."""
    return yaml.dump(
        to_plain(message, style),
        Dumper=_Dumper,
        width=sys.maxsize,
        default_flow_style=style.flow,
        allow_unicode=True,
    )


def to_plain(value: Any, style: Style = Style()) -> object:  # noqa: B008 - immutable
    """A message as nested dicts, lists and scalars."""
    if is_message(value):
        kinds = value.get_fields_and_field_types()
        return {name: _field(getattr(value, name), kind, style) for name, kind in kinds.items()}
    if isinstance(value, _ARRAYS):
        return _list(value, style)
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    if isinstance(value, str) and style.truncate is not None and len(value) > style.truncate:
        return value[: style.truncate] + '...'
    return value


def _field(value: Any, kind: str, style: Style) -> object:
    if style.no_arr and kind.startswith('sequence<'):
        element, _, bound = kind.removeprefix('sequence<').removesuffix('>').partition(', ')
        return f'<sequence type: {element}{f"[{bound}]" if bound else ""}, length: {len(value)}>'
    if style.no_arr and kind.endswith(']'):
        return f'<array type: {kind}>'
    if style.no_str and isinstance(value, str):
        return f'<string length: <{len(value)}>>'
    return to_plain(value, style)


def _list(values: Any, style: Style) -> list[object]:
    limit = style.truncate
    shown = values if limit is None else values[:limit]
    shown = shown.tolist() if isinstance(shown, (np.ndarray, array.array)) else shown
    plain = [to_plain(v, style) for v in shown]
    return plain if len(plain) == len(values) else [*plain, '...']


def to_csv(message: Any, style: Style = Style()) -> str:  # noqa: B008 - immutable
    """A message as comma-separated values of all its fields, in upstream's form."""
    kinds = message.get_fields_and_field_types()
    return _joined(_csv_field(getattr(message, name), kind, style) for name, kind in kinds.items())


def _csv_field(value: Any, kind: str, style: Style) -> str:
    if is_message(value):
        return to_csv(value, style)
    if isinstance(value, _ARRAYS) and not style.no_arr:
        shown = value if style.truncate is None else value[: style.truncate]
        parts = [_csv_field(item, '', style) for item in shown]
        return _joined(parts if len(parts) == len(value) else [*parts, '...'])
    if isinstance(value, bytes) and style.truncate is not None and len(value) > style.truncate:
        return str(value[: style.truncate] + b'...')
    return str(value if isinstance(value, bytes) else _field(value, kind, style))


def _joined(parts: Iterable[str]) -> str:
    """As upstream: without commas behind leading empty values."""
    text = ''
    for part in parts:
        text = f'{text},{part}' if text else part
    return text


def field_of(message: Any, path: str) -> object:
    """A field of a message."""
    value = message
    for part in path.replace('[', '.[').split('.'):
        try:
            if part.startswith('['):
                value = value[int(part.removeprefix('[').removesuffix(']'))]
                value = value.item() if isinstance(value, np.generic) else value
            elif part not in value.get_fields_and_field_types():
                raise AttributeError(part)
            else:
                value = getattr(value, part)
        except (AttributeError, IndexError, TypeError, ValueError) as error:
            raise CliError(
                f"Invalid field '{path}': {type(message).__name__} has no such field"
            ) from error
    return value


def is_message(value: object) -> bool:
    """Whether a value is a message."""
    return hasattr(value, 'get_fields_and_field_types')
