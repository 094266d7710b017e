"""Message definitions for reading and writing bags without ROS."""

import functools
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lpv.core.support.errors import ConfigError
from lpv.core.support.resources import SOURCES, prefixes

_PADDING = 4
"""Bytes that some publishers leave for the alignment of an empty sequence of doubles at the end."""
_OWN = 'FaultAlarm FaultEstimate GroundTruth JointReference StateEstimate TorqueCommand'


def message_text(msgtype: str) -> str:
    """Definition of a message type from its ``.msg`` file."""
    package, _, name = (*msgtype.split('/'), '', '')[:3]
    folders = [prefix / 'share' / package for prefix in prefixes()]
    for folder in (*folders, SOURCES / package):
        path = folder / 'msg' / f'{name}.msg'
        if path.is_file():
            return path.read_text(encoding='utf-8')
    reason = f'is not installed: no {package}/msg/{name}.msg below any sourced prefix'
    raise ConfigError('message type', f'{msgtype} {reason}')


def decode(typestore: Typestore, data: bytes, msgtype: str) -> Any:
    """A message from its CDR, whatever padding follows it."""
    try:
        return typestore.deserialize_cdr(data, msgtype)
    except SerdeError as error:
        if 'size mismatch' not in str(error):
            raise
        return typestore.deserialize_cdr(data[:-_PADDING], msgtype)


def padded_cdr(typestore: Any, message: object, msgtype: str) -> bytes:
    """CDR of a message, padded to four bytes as DDS does: bags can then be compared."""
    data = bytes(typestore.serialize_cdr(message, msgtype))
    return data + bytes(-len(data) % 4)


def add_type(typestore: Typestore, msgtype: str) -> None:
    """Make a type and those it uses known to a typestore; ConfigError if one is not installed."""
    if msgtype not in typestore.fielddefs:
        found = get_types_from_msg(message_text(msgtype), msgtype)
        typestore.register(found)
        fields: Any = found[msgtype][1]
        for _, kind in fields:
            # Elements of arrays are one level below.
            is_array = kind[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE)
            what, used = kind[1][0] if is_array else kind
            if what == Nodetype.NAME:
                add_type(typestore, used)


@functools.lru_cache(maxsize=1)
def standard_types() -> Typestore:
    """Types of ROS 2 Jazzy and lpv_msgs, of what is written, and of bags without definitions.

    It is shared, with installed types that somebody added: to parse and generate takes longer than
    to read a small bag.
    """
    typestore = get_typestore(Stores.ROS2_JAZZY)
    for name in _OWN.split():
        add_type(typestore, f'lpv_msgs/msg/{name}')
    return typestore
