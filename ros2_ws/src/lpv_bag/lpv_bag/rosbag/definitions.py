"""Whether a bag means by a message type what this software means."""

import functools
from collections.abc import Iterable
from typing import Any

from lpv_bag.errors import BagError
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.reading import BagReader

_ARRAYS = (3, 4)  # rosbags.interfaces.Nodetype: of a fixed length, sequences
_STAMP = {'std_msgs/msg/Header': ('stamp',), 'builtin_interfaces/msg/Time': ('sec', 'nanosec')}


def check_definition(reader: BagReader, msgtype: str, fields: Iterable[str]) -> None:
    """Check that fields of a message type are there, and are what they are expected to be.

    A definition may have more fields, and arrays of a fixed length where there are sequences now:
    bags outlive the version that wrote them.
    """
    bag, own = reader.typestore_of(msgtype).fielddefs, _own_types()
    wanted = {msgtype: tuple(fields), **(_STAMP if 'header' in fields else {})}
    for name, needed in wanted.items():
        there, expected = (dict(types[name][1]) if name in types else {} for types in (bag, own))
        for field in needed:
            if _element(there.get(field)) != _element(expected[field]):
                what = 'has another type there' if field in there else 'is not in it'
                raise BagError(
                    f"{reader.paths[0]}: the bag's definition of {msgtype} is not the "
                    f'expected one: {field} of {name} {what}'
                )


def _element(kind: Any) -> Any:
    """Type of a field, whatever the length of an array."""
    if kind is not None and int(kind[0]) in _ARRAYS:
        return 'array', kind[1][0]
    return kind


@functools.lru_cache(maxsize=1)
def _own_types() -> Any:
    return make_typestore().fielddefs
