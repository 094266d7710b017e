"""Fields of nested mappings and lists by dotted names: ``joints[1].link.mass``."""

import re


class Missing:
    """Stands for: take the field away."""


def changed(data, dotted, value):
    """Copy of nested data with one field set, taken away, or what a function makes of it."""
    keys = [key for key in re.split(r'[.\[\]]+', dotted) if key]
    return _set(data, [int(key) if key.isdigit() else key for key in keys], value)


def _set(data, keys, value):
    copy, (key, *rest) = dict(data) if isinstance(data, dict) else list(data), keys
    if rest:
        copy[key] = _set(copy[key], rest, value)
    elif value is Missing:
        del copy[key]
    else:
        copy[key] = value(copy[key]) if callable(value) else value
    return copy


def places(data, prefix=''):
    """Dotted names and values of all fields of nested data, from the outside in."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        name = f'{prefix}[{key}]' if isinstance(data, list) else f'{prefix}.{key}'.lstrip('.')
        yield name, value
        if isinstance(value, (dict, list)):
            yield from places(value, name)


def numbers(data):
    kinds = (int, float)
    return [name for name, v in places(data) if isinstance(v, kinds) and not isinstance(v, bool)]
