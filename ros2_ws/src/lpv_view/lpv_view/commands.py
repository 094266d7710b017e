"""What a browser may ask for, checked before anything else sees it."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpv_core.simulation.faults import KINDS
from lpv_core.support.errors import LpvError

Reply = Callable[[bool, str], None]
"""Told whether a command succeeded, and a text."""
_LARGEST = 1e6
_MOST_TEXT = 256


class CommandError(LpvError):
    """A message of a client that is not understood; the text is sent back to it."""


@dataclass(frozen=True)
class Command:
    """One request."""

    name: str  # what is asked for: 'token', 'inject', 'clear' or 'reset'
    number: int = 0  # chosen by the client; the reply carries it
    # ``inject``: sensor, kind, size, rate, duration; ``clear``: sensor, empty for all; ``token``:
    # token
    fields: dict[str, Any] = field(default_factory=dict)


def parse_command(text: str, sensors: Sequence[str]) -> Command:
    """Read a client's message.

    Parameters
    ----------
    text : str
        JSON of one object with ``type``, ``id`` and the fields of `Command`.
    sensors : sequence of str
        Names of the arm's sensors.

    Returns
    -------
    Command
        Only known fields, of the right types, finite and in range.

    Raises
    ------
    CommandError
        Saying what is wrong.
    """
    data = _decode(text)
    name = data.get('type')
    number = data.get('id', 0)
    if type(number) is not int or not 0 <= number < 2**53:
        raise CommandError('id: must be a whole number, not negative')
    if name == 'token':
        return Command(name, number, {'token': _text(data, 'token')})
    if name == 'reset':
        return Command(name, number)
    if name == 'clear':
        return Command(name, number, {'sensor': _choice(data, 'sensor', ('', *sensors), '')})
    if name == 'inject':
        fields: dict[str, Any] = {
            'sensor': _choice(data, 'sensor', sensors),
            'kind': _choice(data, 'kind', KINDS),
        }
        fields.update({key: _number(data, key) for key in ('size', 'rate', 'duration')})
        return Command(name, number, fields)
    raise CommandError('type: must be one of token, inject, clear, reset')


def _decode(text: str) -> dict[str, Any]:
    try:
        data = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise CommandError(f'this is not JSON ({type(error).__name__})') from None
    if not isinstance(data, dict):
        raise CommandError('must be an object')
    return data


def _refuse_constant(name: str) -> None:
    raise ValueError(f'{name} is not JSON')


def _text(data: dict[str, Any], key: str) -> str:
    value = data.get(key)
    if not isinstance(value, str) or len(value) > _MOST_TEXT:
        raise CommandError(f'{key}: must be text of at most {_MOST_TEXT} characters')
    return value


def _choice(
    data: dict[str, Any], key: str, choices: Sequence[str], default: str | None = None
) -> str:
    value = data.get(key, default)
    if not isinstance(value, str) or value not in choices:
        raise CommandError(f'{key}: must be one of ' + ', '.join(c for c in choices if c))
    return value


def _number(data: dict[str, Any], key: str) -> float:
    value = data.get(key, 0.0)
    # Comparison comes first: an enormous int has no float.
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or not -_LARGEST <= value <= _LARGEST
        or not math.isfinite(value)
    ):
        raise CommandError(f'{key}: must be a number between {-_LARGEST:g} and {_LARGEST:g}')
    return float(value)
