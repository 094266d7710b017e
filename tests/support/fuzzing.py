"""Mutations of files, and what became of reading them: the machinery of all fuzzers of files.

Every mutation depends on its seed alone, so that a failure is repeated by its number.
"""

import math
import os
import random
import re
import resource
import time
import traceback
from contextlib import contextmanager
from dataclasses import dataclass, field, is_dataclass
from functools import partial

import numpy as np

from lpv.core.support.errors import LpvError

SECONDS = float(os.environ.get('LPV_FUZZ_SECONDS', 0))
"""How long each fuzzer runs; 0 for the fixed number of cases of a test run [s]."""
SCALARS = (
    '1e400', '-1e400', '.inf', '-.inf', '.nan', '1e308', '-1e-320', '9' * 400, '-' + '9' * 400,
    '9' * 5000, '0x' + 'f' * 5000, '0b2', '0o9', '1:60:60', '1_0', '0', '-0.0', '1', '-1', 'true',
    'null', '~', '""', '[]', '{}', '[[]]', '[1, 2, 3]', '{1: 2}', '=', '<<', '!!int x', '!!int ""',
    '!!float x', '!!bool x', '!!bool 1', '!!timestamp x', '2001-99-99', '2001-01-01', '!!binary x',
    '!!set {a}', '!!omap [a]', '!!pairs [a]', '!!python/name:os.system', '!!python/object:os.x {}',
    '*x', '&x [*x]', '&y 1', '!x 1', '"\\x00"', '"\\ud800"', '"\\U0010ffff"', 'a: b: c', '|', '>',
    '%', '@', '`', 'é', '😀', 'x' * 3000, '[' * 300, '{a: ' * 300, '- ' * 300, '? [a]', '? {a: 1}',
)  # fmt: skip
"""Values with which parsers have trouble: beyond floats, beyond integers, tags, deep nesting."""
XML_VALUES = (
    'nan', '-inf', '1e308', '-1e308', '1e-320', '1e400', '0', '-1', '', ' ', '1,5', '0x10', '1 2',
    '1 2 3 4', '1e200 1e200 1e200', 'nan nan nan', '0 0 0', '9' * 400, 'x' * 5000, 'base_link',
    'world', 'fixed', 'floating', 'planar', 'prismatic', 'continuous', 'revolute', '&amp;',
)  # fmt: skip
"""Attributes with which readers of XML models have trouble."""
ODD = (*'\t\0\x85\u2028:{}[]&*!|>%@`"\'#,;=-?\\', ' ', '  ', ' ' * 7, '\n', '<<: ', '? [a]\n: ')
"""What a parser may not expect between other characters."""


@dataclass(frozen=True)
class Format:
    """What a kind of text is made of; of values and keys the first group is replaced."""

    values: tuple
    places: tuple  # patterns of a value and of a key
    number: str
    piece: str  # what can be left out, doubled or moved


_YAML = Format(
    SCALARS,
    (r'(?<=[:,\-\[])[ ]*([^\s,\[\]{}:#][^,\[\]{}#\n]*)', r'(?m)^[ -]*([^ :\n-][^:\n]*):'),
    r'[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?',
    r'[^\n]*\n',
)
_XML = Format(XML_VALUES, (r'="([^"]*)"',), r'-?\d+\.\d+(?:e-?\d+)?', r'<[^<>]*>')


def mutate_text(text, seed, form=_YAML):
    """A YAML or CSV file with one to four mutations, as bytes."""
    rng = random.Random(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        text = rng.choice(_MUTATIONS)(text, rng, form)
    data = text.encode('utf-8', 'surrogatepass')
    return mutate_bytes(data, rng.randrange(1 << 30)) if rng.random() < 0.15 else data


mutate_xml = partial(mutate_text, form=_XML)


def _place(text, rng, pattern):
    """One of the places of a pattern; there is always the empty one at the end."""
    return rng.choice(list(re.finditer(pattern, text)) or [re.search(r'(\Z)', text)])


def _set_value(text, rng, form):
    pattern = rng.choice((form.places[0], *form.places))
    (a, b), other = _place(text, rng, pattern).span(1), _place(text, rng, pattern).group(1)
    return text[:a] + (rng.choice(form.values) if rng.random() < 0.8 else other) + text[b:]


def _scale_number(text, rng, form):
    a, b = _place(text, rng, form.number).span()
    factor = rng.choice((-1.0, 0.0, 1e-300, 1e-9, 0.5, 2.0, 1e9, 1e150, 1e300))
    return text[:a] + repr(float(text[a:b] or 0.0) * factor) + text[b:]


def _change_piece(text, rng, form):
    (a, b), c = _place(text, rng, form.piece).span(), _place(text, rng, form.piece).start()
    moved, left = text[:c] + text[a:b] + text[c:], text[:a] + text[b:]
    return rng.choice((left, moved, text[:b] + text[a:], left[:c] + text[a:b] + left[c:], text[:b]))


def _insert(text, rng, form):
    at = rng.randrange(len(text) + 1)
    return text[:at] + rng.choice(ODD) + text[at:]


_MUTATIONS = (*[_set_value] * 4, *[_scale_number] * 2, *[_change_piece] * 2, _insert)


def mutate_bytes(data, seed):
    """A binary file with one to four mutations: bits, numbers, pieces missing, doubled or moved."""
    rng, found = random.Random(seed), bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not found:
            break
        at = rng.randrange(len(found))
        size = min(rng.choice((1, 2, 4, 8, 40, 1000)), len(found) - at)
        piece = found[at : at + size]
        flipped = bytes([piece[0] ^ (1 << rng.randrange(8))]) + piece[1:]
        same = rng.choice((b'\0', b'\xff', b'\x7f', b'\x80')) * size
        found[at : at + size] = rng.choice((flipped, same, rng.randbytes(size), b'', 2 * piece))
        if rng.random() < 0.17:
            del found[rng.choice((at, len(found) - size)) :]
    return bytes(found)


ENDLESS = 30.0
"""Time after which a damaged file has made work explode, also on a slow machine [s of CPU]."""


@dataclass
class Tally:
    tried: int = 0
    refused: int = 0  # with a clear message
    accepted: int = 0
    failed: list = field(default_factory=list)  # seed and what went wrong
    unbounded: tuple = ()  # prefixes of numbers that may be infinite: there, it means without bound

    def run(self, seed, read, *arguments):
        """Read one file; anything but a result of finite numbers or an LpvError is a failure."""
        self.tried += 1
        begin = time.thread_time()  # the load of other processes is not the subject
        try:
            bad = not_finite(read(*arguments))
            may_be = {name for name in bad if name.startswith(self.unbounded) and 'nan' not in name}
            wrong = ', '.join(sorted(bad - may_be))[:200]
            self.accepted += not wrong
        except LpvError as error:
            text = str(error)
            is_clear = 0 < len(text) <= 2000 and '\n' not in text
            wrong = '' if is_clear else f'unclear message: {text[:200]!r}'
            self.refused += not wrong
        except Exception as error:  # whatever else is a traceback for the user
            place = traceback.extract_tb(error.__traceback__)[-1]
            wrong = f'{type(error).__name__}: {str(error)[:80]} ({place.name}:{place.lineno})'
        if not wrong and time.thread_time() - begin > ENDLESS:
            wrong = f'took more than {ENDLESS:.0f} s'
        if wrong:
            self.failed.append((seed, wrong))


def not_finite(value, name=''):
    if isinstance(value, (int, float, np.floating)):
        return set() if math.isfinite(value) else {f'{name} {value}'}
    if isinstance(value, np.ndarray):
        good = value.dtype.kind not in 'fc' or bool(np.isfinite(value).all())
        return set() if good else {f'{name} array'}
    if is_dataclass(value):
        value = {key: getattr(value, key) for key in value.__dataclass_fields__}
    elif isinstance(value, (list, tuple)):
        value = dict(enumerate(value))
    items = value.items() if isinstance(value, dict) else ()
    return set().union(*(not_finite(item, f'{name}.{key}') for key, item in items))


def cases(count):
    """Seeds of a fuzzer: a fixed number, or as many as fit into `SECONDS`."""
    end, seed = time.monotonic() + SECONDS, 0
    while seed < count or time.monotonic() < end:
        yield seed
        seed += 1


@contextmanager
def bounded_memory():
    """What is done takes at most 300 MiB more than this process ever had."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300 << 10


def fuzz(count, mutate, use, accepts=True, **options):
    """Counts of a fuzzer: ``mutate`` lays the file of a seed, ``use`` reads it."""
    tally = Tally(**options)
    with bounded_memory():
        for seed in cases(count):
            mutate(seed)
            tally.run(seed, use)
    print(tally)
    assert not tally.failed and (tally.accepted or not accepts), tally.failed[:10]
    return tally
