"""Messages as YAML and as comma-separated values."""

import array
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from lpv_ros2cli.errors import CliError

DEFAULT_LENGTH = 128
"""Elements and characters that are shown of a long field."""


@dataclass(frozen=True)
class Style:
    """How messages are shown."""

    truncate: int | None = DEFAULT_LENGTH  # longest list, text or bytes; None shows all
    no_arr: bool = False  # a remark in place of arrays
    no_str: bool = False  # a remark in place of texts
    flow: bool = False  # one line per message


class _Dumper(yaml.SafeDumper):
    """Block style, lists not indented, no aliases."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def to_yaml(value: Any, style: Style = Style()) -> str:  # noqa: B008 - immutable
    """A message, or a field of one, as YAML."""
    plain = to_plain(value, style)
    text = yaml.dump(
        plain,
        Dumper=_Dumper,
        width=sys.maxsize,
        sort_keys=False,
        default_flow_style=style.flow,
        allow_unicode=True,
    )
    return text.removesuffix('...\n')  # the end mark of a bare scalar


def to_plain(value: Any, style: Style = Style()) -> object:  # noqa: B008 - immutable
    """A message as nested dicts, lists and scalars."""
    if is_message(value):
        kinds = value.get_fields_and_field_types()
        return {name: _field(getattr(value, name), kind, style) for name, kind in kinds.items()}
    if isinstance(value, (list, tuple, array.array, np.ndarray)):
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


def to_csv(value: Any, style: Style = Style()) -> str:  # noqa: B008 - immutable
    """A message, or a field of one, as comma-separated values of all its fields."""
    return ','.join(_flat(to_plain(value, style)))


def _flat(plain: object) -> Iterator[str]:
    if isinstance(plain, dict):
        plain = plain.values()
    elif not isinstance(plain, list):
        yield str(plain)
        return
    for item in plain:
        yield from _flat(item)


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
