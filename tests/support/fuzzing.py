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
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass

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


def mutate_text(text: str, seed: int) -> bytes:
    """A YAML or CSV file with one to four mutations, as bytes."""
    rng = random.Random(seed)
    lines = text.split('\n')
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        if not lines:
            break
        _MUTATIONS[rng.randrange(len(_MUTATIONS))](lines, rng)
    data = '\n'.join(lines).encode('utf-8', 'surrogatepass')
    return mutate_bytes(data, rng.randrange(1 << 30)) if rng.random() < 0.15 else data


def _chosen(lines, rng, pattern):
    """A line in which a pattern occurs, and one of its places; None if there is none."""
    found = [i for i, line in enumerate(lines) if re.search(pattern, line)]
    if not found:
        return None
    i = rng.choice(found)
    return i, rng.choice(list(re.finditer(pattern, lines[i])))


def _put(lines, i, begin, end, text):
    lines[i] = lines[i][:begin] + text + lines[i][end:]


def _set_value(lines, rng):
    if found := _chosen(lines, rng, r'(?<=[:,\-\[])\s*([^\s,\[\]{}:#][^,\[\]{}#]*)'):
        _put(lines, found[0], *found[1].span(1), rng.choice(SCALARS))


def _set_key(lines, rng):
    if found := _chosen(lines, rng, r'^[ -]*([^ :-][^:]*):'):
        _put(lines, found[0], *found[1].span(1), rng.choice(SCALARS))


def _scale_number(lines, rng):
    if found := _chosen(lines, rng, r'[-+]?\d+(\.\d*)?([eE][-+]?\d+)?'):
        factor = rng.choice((-1, 0, 1e-300, 1e-9, 0.5, 2, 1e9, 1e300))
        _put(lines, found[0], *found[1].span(), repr(float(found[1].group()) * factor))


def _change_line(lines, rng):
    """Drop, repeat, swap, indent or cut a line, or put one or a character in."""
    i, j, kind = rng.randrange(len(lines)), rng.randrange(len(lines)), rng.randrange(7)
    at = rng.randrange(len(lines[i]) + 1)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(i, lines[i])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 3:
        lines[i] = rng.choice((' ', '  ', ' ' * 7)) + lines[i] if i < j else lines[i].lstrip()
    elif kind == 4:
        lines[i] = lines[i][:at]
    elif kind == 5:
        key = rng.choice(('x', '1', 'name', '<<', '? [a]', 'null', '2001-01-01', 'true', '.nan'))
        lines.insert(i, f'{key}: {rng.choice(SCALARS)}')
    else:
        _put(lines, i, at, at, rng.choice('\t\0\x85\u2028:{}[]&*!|>%@`"\'#,;=-?\\'))


_MUTATIONS = (*[_set_value] * 3, _set_key, *[_scale_number] * 2, *[_change_line] * 7)


def mutate_bytes(data: bytes, seed: int) -> bytes:
    """A binary file with one to four mutations: bits, numbers, pieces missing, doubled or moved."""
    rng = random.Random(seed)
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not found:
            break
        at = rng.randrange(len(found))
        size = min(rng.choice((1, 2, 4, 8, 40, 1000)), len(found) - at)
        kind = rng.randrange(6)
        if kind == 0:
            found[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            found[at : at + size] = rng.randbytes(size)
        elif kind == 2:
            found[at : at + size] = rng.choice((b'\0', b'\xff', b'\x7f', b'\x80')) * size
        elif kind == 3:
            del found[at : at + size]
        elif kind == 4:
            found[at:at] = found[at : at + size]
        else:
            del found[rng.choice((at, len(found) - size)) :]
    return bytes(found)


XML_VALUES = (
    'nan', '-inf', '1e308', '-1e308', '1e-320', '1e400', '0', '-1', '', ' ', '1,5', '0x10', '1 2',
    '1 2 3 4', '1e200 1e200 1e200', 'nan nan nan', '0 0 0', '9' * 400, 'x' * 5000, 'base_link',
    'world', 'fixed', 'floating', 'planar', 'prismatic', 'continuous', 'revolute', '&amp;',
)  # fmt: skip
"""Attributes with which readers of XML models have trouble."""


def mutate_xml(text: str, seed: int) -> bytes:
    """An XML file with one to four mutations: attributes, elements missing, doubled or moved."""
    rng = random.Random(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        text = rng.choice(_XML_MUTATIONS)(text, rng)
    data = text.encode('utf-8', 'surrogatepass')
    return mutate_bytes(data, rng.randrange(1 << 30)) if rng.random() < 0.15 else data


def _place(text, rng, pattern):
    """One of the places of a pattern; there is always the empty one at the end."""
    return rng.choice(list(re.finditer(pattern, text)) or [re.search(r'($)', text)])


def _set_attribute(text, rng):
    a, b = _place(text, rng, r'="([^"]*)"').span(1)
    c, d = _place(text, rng, r'="([^"]*)"').span(1)
    return text[:a] + (rng.choice(XML_VALUES) if rng.random() < 0.7 else text[c:d]) + text[b:]


def _change_element(text, rng):
    """Remove or repeat an element without children, or a tag."""
    a, b = _place(text, rng, r'<[^<>]*>').span()
    return text[:a] + text[b:] if rng.random() < 0.6 else text[:b] + text[a:b] + text[b:]


def _scale_attribute(text, rng):
    a, b = _place(text, rng, r'-?\d+\.\d+(e-?\d+)?').span()
    factor = rng.choice((-1.0, 0.0, 1e-300, 1e-9, 1e9, 1e150, 1e300))
    return text[:a] + repr(float(text[a:b] or 0.0) * factor) + text[b:]


_XML_MUTATIONS = (*[_set_attribute] * 3, _change_element, *[_scale_attribute] * 2)


ENDLESS = 30.0
"""Time after which a damaged file has made work explode, also on a slow machine [s of CPU]."""


@dataclass
class Tally:
    """What became of the cases of one fuzzer."""

    tried: int = 0
    refused: int = 0  # with a clear message
    accepted: int = 0
    failed: list = field(default_factory=list)  # seed and what went wrong
    messages: Counter = field(default_factory=Counter)  # beginnings of the refusals
    unbounded: tuple = ()  # prefixes of numbers that may be infinite: there, it means without bound

    def run(self, seed, read, *arguments) -> None:
        """Read one file; anything but a result of finite numbers or an LpvError is a failure."""
        self.tried += 1
        begin = time.thread_time()  # the load of other processes is not the subject
        try:
            result = read(*arguments)
            bad = sorted(name for name in not_finite(result) if not self._may_be(name))
            wrong = ', '.join(bad)[:200]
            self.accepted += not wrong
        except LpvError as error:
            wrong = _unclear(str(error))
            self.refused += not wrong
            self.messages[str(error)[:60]] += 1
        except Exception as error:  # whatever else is a traceback for the user
            place = traceback.extract_tb(error.__traceback__)[-1]
            wrong = f'{type(error).__name__}: {str(error)[:80]} ({place.name}:{place.lineno})'
        seconds = time.thread_time() - begin
        if not wrong and seconds > ENDLESS:
            wrong = f'took {seconds:.1f} s'
        if wrong:
            self.failed.append((seed, wrong))

    def _may_be(self, name: str) -> bool:
        return name.startswith(self.unbounded) and 'nan' not in name

    def __str__(self) -> str:
        counts = f'{self.refused} refused, {self.accepted} accepted, {len(self.failed)} failed'
        return f'{self.tried} tried, {counts}'


def _unclear(text: str) -> str:
    """What is wrong with a message for the user; '' if nothing."""
    if not text or len(text) > 2000:
        return f'message of {len(text)} characters'
    return 'message of more than one line' if '\n' in text else ''


def not_finite(value: object, name: str = '') -> set[str]:
    """Where a record holds numbers that are not finite."""
    if isinstance(value, (int, float, np.floating)):
        return set() if math.isfinite(value) else {f'{name} {value}'}
    if isinstance(value, np.ndarray):
        good = value.dtype.kind not in 'fc' or bool(np.isfinite(value).all())
        return set() if good else {f'{name} array'}
    if is_dataclass(value):
        items = [(one.name, getattr(value, one.name)) for one in fields(value)]
    elif isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, (list, tuple)):
        items = list(enumerate(value))
    else:
        return set()
    return set().union(*(not_finite(item, f'{name}.{key}') for key, item in items))


def cases(count: int):
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


def fuzz(count, mutate, use, **options) -> Tally:
    """Counts of a fuzzer: ``mutate`` lays the file of a seed, ``use`` reads it."""
    tally = Tally(**options)
    with bounded_memory():
        for seed in cases(count):
            mutate(seed)
            tally.run(seed, use)
    print(tally)
    assert not tally.failed and tally.accepted
    return tally
