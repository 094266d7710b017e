"""State and constants of compiled functions: NumPy records, read and written by name.

Plain Python and compiled code see the same memory, so that a class can hold what a compiled
function works on, and one call takes any number of quantities.
"""

from typing import Any

import numpy as np


def record_type(*fields: tuple[Any, ...]) -> np.dtype:
    """Type of a record, aligned as compiled code wants it.

    Fields are ``(name, type)`` or ``(name, type, shape)`` as for `numpy.dtype`; a type may be
    another record's.  ValueError if NumPy has an attribute of a field's name, which would hide it.
    """
    for name, *_ in fields:
        if hasattr(np.recarray, name) or hasattr(np.record, name):
            raise ValueError(f'{name!r} is an attribute of NumPy records')
    return np.dtype(list(fields), align=True)


def new_record(dtype: np.dtype, **values: Any) -> np.record:
    """A record, all zero but for what is given; fields are attributes.

    ValueError if there is no such field.
    """
    record = np.zeros(1, dtype).view(np.recarray)[0]
    for name, value in values.items():
        record[name] = value
    return record


def new_records(dtype: np.dtype, count: int) -> np.ndarray:
    """So many records, all zero, for compiled functions as `memory`."""
    return np.asarray(np.zeros(count, dtype).view(np.recarray))


def memory(record: np.record) -> np.ndarray:
    """A record as an array of one element, in the same memory.

    Numba takes an array in a tenth of a microsecond, a record in one to twenty: it has NumPy
    describe all the fields, at every call.  For what Python calls at every sample.
    """
    return np.asarray(record.base)


def plain(record: np.record) -> np.void:
    """The memory of a record with fields by item alone, ``fields['name']``.

    Reading a field of a record from Python costs microseconds, of this a fraction of one: for what
    is read at every sample.

    What is written to the record later is seen; nested records are of the same kind, arrays are
    views.
    """
    return memory(record).view(np.dtype((np.void, record.dtype)))[0]
