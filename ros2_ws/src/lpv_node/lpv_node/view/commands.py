"""What a browser may ask for, checked before anything else sees it."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpv.core.simulation.faults import KINDS
from lpv.core.support.errors import LpvError
from lpv.core.support.limits import LARGEST, MOST_TEXT

Reply = Callable[[bool, str], None]
"""Told whether a command succeeded, and a text."""


class CommandError(LpvError):
    """A message of a client that is not understood; the text is sent back to it."""


@dataclass(frozen=True)
class Command:
    """One request: 'inject' (sensor, kind, size, rate, duration), 'clear' (sensor, empty for all),
    'reset', or 'token' (token)."""

    name: str
    number: int = 0  # chosen by the client; the reply carries it
    fields: dict[str, Any] = field(default_factory=dict)


def parse_command(text: str, sensors: Sequence[str]) -> Command:
    """A client's message, JSON of ``type``, ``id`` and known fields in range; or CommandError."""
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise CommandError(f'this is not JSON ({type(error).__name__})') from None
    if not isinstance(data, dict):
        raise CommandError('must be an object')
    name, number, fields = data.get('type'), data.get('id', 0), {}
    if type(number) is not int or not 0 <= number < 2**53:
        raise CommandError('id: must be a whole number, not negative')
    if name == 'token':
        token = fields['token'] = data.get('token')
        if not isinstance(token, str) or len(token) > MOST_TEXT:
            raise CommandError(f'token: must be text of at most {MOST_TEXT} characters')
    elif name == 'clear':
        fields['sensor'] = _choice(data, 'sensor', ('', *sensors), '')
    elif name == 'inject':
        fields['sensor'] = _choice(data, 'sensor', sensors)
        fields['kind'] = _choice(data, 'kind', KINDS)
        fields.update({key: _number(data, key) for key in ('size', 'rate', 'duration')})
    elif name != 'reset':
        raise CommandError('type: must be one of token, inject, clear, reset')
    return Command(name, number, fields)


def _refuse_constant(name: str) -> None:
    raise ValueError(f'{name} is not JSON')


def _choice(data: dict[str, Any], key: str, choices: Sequence[str], default: Any = None) -> str:
    value = data.get(key, default)
    if not isinstance(value, str) or value not in choices:
        raise CommandError(f'{key}: must be one of ' + ', '.join(c for c in choices if c))
    return value


def _number(data: dict[str, Any], key: str) -> float:
    value = data.get(key, 0.0)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    # Comparison comes first: an enormous int has no float.
    if not is_number or not -LARGEST <= value <= LARGEST or not math.isfinite(value):
        raise CommandError(f'{key}: must be a number between {-LARGEST:g} and {LARGEST:g}')
    return float(value)
