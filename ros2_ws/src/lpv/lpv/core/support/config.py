"""YAML files: safe loader, bounded size, errors that name the field; writing."""

import hashlib
import math
import os
import re
import reprlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import MAX_DEPTH

MAX_BYTES = 4 << 20
"""Largest YAML file that is read [bytes]; a gains file has about 20 kB."""
MAX_VALUES = MAX_BYTES // 20
"""Most values in a file, with those that aliases repeat: a float has up to 20 characters."""
MAX_INTEGER = 2**63 - 1
"""Largest integer, as a ROS parameter has it; all of these are finite floats, too."""
_SCIENTIFIC = re.compile(r'[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+')
"""Floats with an exponent, as in YAML 1.2."""


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """Safe loader that refuses equal keys: the last one would win in silence."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            name = key.value if isinstance(key, yaml.ScalarNode) else None
            if name is not None and name in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f'{_short(name)} is given twice', key.start_mark
                )
            seen.add(name)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Safe dumper that writes what stands at several places at each."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _short(value: object) -> str:
    """Text of a value for messages; nested aliases can stand for megabytes."""
    try:
        return reprlib.repr(value)
    except ValueError:  # an integer of thousands of digits
        return f'a huge {type(value).__name__}'


def read_at_most(path: str | Path, limit: int) -> bytes:
    """First bytes of a file; devices and pipes do not say how large they are."""
    with open(path, 'rb') as file:
        return file.read(limit)


def load_yaml(path: str | Path, max_bytes: int | None = None) -> Any:
    """Load a YAML file of other software through the safe loader, whatever its values are.

    ConfigError if the file is missing, larger than ``max_bytes`` (``MAX_BYTES`` if not given), not
    YAML, nested too deeply, or has more than ``MAX_VALUES`` values.
    """
    path, limit = Path(path), MAX_BYTES if max_bytes is None else max_bytes
    try:
        content = read_at_most(path, limit + 1)
        if len(content) > limit:
            raise ConfigError('file', f'is larger than {limit} bytes', str(path))
        # A safe loader with one check more.
        data = yaml.load(content.decode(), Loader=_Loader)  # noqa: S506
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError('file', f'cannot be read ({error})', str(path)) from error
    except ConfigError:
        raise
    except Exception as error:  # constructors of tags raise many kinds
        text = ' '.join(str(error).split())[:300]
        raise ConfigError('file', f'is not valid YAML ({text})', str(path)) from error
    for _ in _values(data, str(path)):
        pass  # counts them
    return data


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping through the safe loader.

    ConfigError as `load_yaml`, and if the file holds what no file of this software needs: no
    mapping, keys that are not text, dates, binary data, NaN, huge integers.
    """
    data = load_yaml(path)
    if not isinstance(data, dict):
        raise ConfigError('file', 'must hold a mapping at its top level', str(path))
    _check_values(data, str(path))
    return data


def write_parameters(path: str | Path, parameters: dict[str, Any], comment: str = '') -> None:
    """Write a ROS 2 parameter file for all nodes (``/**: ros__parameters: ...``).

    ``comment`` goes to the head of the file; parent directories are made.
    """
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_yaml(path, {'/**': {'ros__parameters': parameters}}, comment)


def write_yaml(path: str | Path, data: object, comment: str = '') -> None:
    """Write a YAML file: groups of plain values in a line each, however long, after a comment."""
    head = ''.join(f'# {line}\n' for line in comment.splitlines())
    layout: dict[str, Any] = {'sort_keys': False, 'default_flow_style': None, 'width': math.inf}
    write_whole(path, head + yaml.dump(data, Dumper=_Dumper, allow_unicode=True, **layout))


def write_whole(path: str | Path, content: str | bytes, sync: bool = False) -> None:
    """Write a file that is there as a whole or not at all.

    With ``sync`` that holds for a power failure, too.
    """
    path = Path(path)
    part = path.with_name(f'{path.name}.{os.getpid()}.part')  # others may write the same file
    if path.is_dir():
        raise ConfigError('file', 'cannot be written, there is a folder', str(path))
    try:
        with open(part, 'wb') as file:
            file.write(content.encode() if isinstance(content, str) else content)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _values(data: object, source: str) -> Iterator[tuple[str, Any]]:
    """Values with their names; those that aliases repeat come as often."""
    left: list[tuple[str, Any, int]] = [('', data, 0)]
    count = 0
    while left:
        name, value, depth = left.pop()
        count += 1
        if count > MAX_VALUES or depth > MAX_DEPTH:
            limit = f'{MAX_VALUES} values' if count > MAX_VALUES else f'{MAX_DEPTH} levels'
            raise ConfigError(name or 'file', f'has more than {limit}', source)
        yield name, value
        items: Iterable[tuple[str, Any]] = ()
        if isinstance(value, dict):
            keys = [key if isinstance(key, str) else _short(key) for key in value]
            items = ((f'{name}.{k}' if name else k, v) for k, v in zip(keys, value.values()))
        elif isinstance(value, (list, tuple, set)):
            items = ((f'{name}[{i}]', item) for i, item in enumerate(value))
        left += [(label, item, depth + 1) for label, item in items]


def _check_values(data: dict[str, Any], source: str) -> None:
    """Refuse what no file may hold, before anything else looks at it."""
    for name, value in _values(data, source):
        if isinstance(value, dict):
            wrong = [key for key in value if not isinstance(key, str)]
            if wrong:
                reason = f'has a key that is not text: {_short(wrong[0])}; put it in quotes'
                raise ConfigError(name or 'file', reason, source)
        elif not isinstance(value, list) and (reason := _wrong_scalar(value)):
            raise ConfigError(name, reason, source)


def _wrong_scalar(value: object) -> str:
    """Why a scalar is refused; '' if it is not."""
    if isinstance(value, int) and abs(value) > MAX_INTEGER:
        return f'must be at most {MAX_INTEGER} in magnitude'
    if isinstance(value, float) and math.isnan(value):
        return 'must be a number, got NaN'
    if value is None or isinstance(value, (str, int, float)):
        return ''
    return f'must be a number or text, got a {type(value).__name__}; put text in quotes'


def as_number(value: Any) -> Any:
    """A number for its text: to YAML 1.1 ``1e-5``, without dot or sign, is text.

    For use where a number is expected; elsewhere it stays text, as a joint may be called ``1e5``.
    """
    is_text = isinstance(value, str) and _SCIENTIFIC.fullmatch(value)
    return float(value) if is_text else value


def sha256_of(data: object) -> str:
    """Hexadecimal SHA-256 of a configuration's content, independent of layout and comments."""
    return hashlib.sha256(_canonical(data).encode()).hexdigest()


def _canonical(data: object) -> str:
    if isinstance(data, dict):
        return '{' + ','.join(f'{k}:{_canonical(data[k])}' for k in sorted(data)) + '}'
    if isinstance(data, (list, tuple)):
        return '[' + ','.join(_canonical(v) for v in data) + ']'
    if isinstance(data, bool) or not isinstance(data, (int, float)):
        return repr(data)
    return float(data).hex()


class Section:
    """A mapping that is read field by field, so that every error names its field.

    ``source`` is the file name for error messages, ``prefix`` the dotted name of this mapping
    inside the file.
    """

    def __init__(self, data: dict[str, Any], source: str, prefix: str = '') -> None:
        if not isinstance(data, dict):
            raise ConfigError(prefix or 'file', 'must be a mapping', source)
        self._data = data
        self._source = source
        self._prefix = prefix
        self._seen: set[str] = set()

    def _name(self, key: str) -> str:
        return f'{self._prefix}.{key}' if self._prefix else key

    def error(self, key: str, reason: str) -> ConfigError:
        """Return the ConfigError for ``key`` (to be raised by the caller)."""
        return ConfigError(self._name(key), reason, self._source)

    def __contains__(self, key: str) -> bool:
        self._seen.add(key)  # what is asked for is a known field, whether the file has it or not
        return key in self._data

    def _get(self, key: str, default: Any = None) -> Any:
        """The value of a field, which must be there if it has no default."""
        self._seen.add(key)
        if key not in self._data and default is None:
            raise self.error(key, 'is missing')
        return self._data.get(key, default)

    def section(self, key: str, required: bool = True) -> 'Section':
        """Return the mapping below ``key`` (an empty one if absent and not required)."""
        return Section(self._get(key, None if required else {}), self._source, self._name(key))

    def sections(self, key: str, default: list[Any] | None = None) -> 'list[Section]':
        """Return the list of mappings below ``key``."""
        items = self._get(key, default)
        if not isinstance(items, list):
            raise self.error(key, 'must be a list')
        return [
            Section(item, self._source, f'{self._name(key)}[{i}]') for i, item in enumerate(items)
        ]

    def text(
        self, key: str, default: str | None = None, choices: Iterable[str] | None = None
    ) -> str:
        """Return a string, optionally one of ``choices``."""
        value = self._get(key, default)
        if not isinstance(value, str) or not value:
            raise self.error(key, f'must be a non-empty string, got {_short(value)}')
        if choices is not None and value not in choices:
            raise self.error(key, f'must be one of {", ".join(choices)}; got {_short(value)}')
        return value

    def flag(self, key: str, default: bool | None = None) -> bool:
        """Return a boolean."""
        value = self._get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f'must be true or false, got {_short(value)}')
        return value

    def integer(self, key: str, default: int | None = None, low: int | None = None) -> int:
        """Return an integer, not below ``low``."""
        value = self._get(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.error(key, f'must be an integer, got {_short(value)}')
        if low is not None and value < low:
            raise self.error(key, f'must be at least {low}, got {value}')
        return value

    def number(
        self, key: str, default: float | None = None, *limits: float, **others: float
    ) -> float:
        """Return a finite float within the limits ``low`` and ``high``, and ``above`` another."""
        value = self._get(key, default)
        return self._number(key, value, *limits, **others)

    def _number(
        self,
        key: str,
        value: Any,
        low: float = -math.inf,
        high: float = math.inf,
        above: float | None = None,
    ) -> float:
        value = as_number(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f'must be a number, got {_short(value)}')
        try:
            value = float(value)
        except OverflowError:  # an integer beyond any float
            value = math.inf
        if not math.isfinite(value):
            raise self.error(key, f'must be finite, got {value}')
        if above is not None and (not value > above or value > high):
            allowed = f'lie within ({above}, {high}]' if high < math.inf else f'be above {above}'
            raise self.error(key, f'must {allowed}, got {value}')
        if not low <= value <= high:
            raise self.error(key, f'must lie within [{low}, {high}], got {value}')
        return value

    def _numbers(self, key: str, values: Any, *limits: float, **others: float) -> list[float]:
        return [self._number(f'{key}[{i}]', v, *limits, **others) for i, v in enumerate(values)]

    def vector(
        self, key: str, size: int, default: Any = None, *limits: float, **others: float
    ) -> list[float]:
        """Return ``size`` floats as of `number`; one number stands for all of them."""
        value = self._get(key, default)
        if not isinstance(value, (list, tuple)):
            value = [value] * size
        if len(value) != size:
            raise self.error(key, f'must have {size} numbers, got {len(value)}')
        return self._numbers(key, value, *limits, **others)

    def mapping(
        self, key: str, names: Sequence[str], *limits: float, **others: float
    ) -> list[float]:
        """Return the floats, as of `number`, of a mapping with these names."""
        inside = self.section(key)
        values = [inside.number(name, None, *limits, **others) for name in names]
        inside.finish()
        return values

    def numbers(self, key: str, most: int, *limits: float, **others: float) -> list[float]:
        """Return 1 to ``most`` floats as of `number`."""
        value = self._get(key)
        if not isinstance(value, list) or not 1 <= len(value) <= most:
            raise self.error(key, f'must be a list of 1 to {most} numbers')
        return self._numbers(key, value, *limits, **others)

    def rows(self, key: str, width: int, most: int) -> list[list[float]]:
        """Return 1 to ``most`` lists of ``width`` finite floats each."""
        value = self._get(key)
        if not isinstance(value, list) or not 1 <= len(value) <= most:
            raise self.error(key, f'must be a list of 1 to {most} rows')
        rows = [
            Section({f'{key}[{i}]': row}, self._source, self._prefix) for i, row in enumerate(value)
        ]
        return [row.vector(f'{key}[{i}]', width) for i, row in enumerate(rows)]

    def matrix(
        self, key: str, shape: tuple[int, ...], *limits: float, **others: float
    ) -> np.ndarray:
        """Return an array of the given shape from a flat list (row-major), numbers as of `number`.

        A first size of -1 stands for one row or more.
        """
        value = self._get(key)
        size = abs(int(np.prod(shape)))
        if not isinstance(value, (list, tuple)) or not (
            len(value) == size or (shape[0] < 0 < len(value) and len(value) % size == 0)
        ):
            raise self.error(key, f'must be a flat list of {size} numbers for shape {shape}')
        return np.array(self._numbers(key, value, *limits, **others)).reshape(shape)

    def names(self, key: str, size: int | None = None, default: Any = None) -> tuple[str, ...]:
        """Return distinct non-empty strings, ``size`` of them or at least one."""
        value = self._get(key, default)
        if (
            not isinstance(value, (list, tuple))
            or not 0 < len(value) == (size or len(value))
            or not all(isinstance(v, str) and v for v in value)
        ):
            number = '' if size is None else f'{size} '
            raise self.error(key, f'must be a list of {number}non-empty strings')
        if len(set(value)) != len(value):
            raise self.error(key, f'must hold distinct names, got {_short(value)}')
        return tuple(value)

    def plain(self, key: str) -> dict[str, Any]:
        """Return an optional mapping as it is, for data that is only passed on."""
        is_given = key in self and self._data[key] is not None  # its lines may be commented out
        return dict(self.section(key)._data) if is_given else {}

    def finish(self) -> None:
        """Refuse fields that nobody read: a typing error must not pass in silence."""
        unknown = sorted(set(self._data) - self._seen, key=str)
        if unknown:
            known = ', '.join(sorted(self._seen))
            name = _short(unknown[0]).strip("'")
            raise self.error(name, f'is not a known field; known here: {known}')
