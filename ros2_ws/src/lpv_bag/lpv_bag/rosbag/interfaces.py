"""Message definitions for reading and writing bags without ROS."""

import os
import site
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReaderError
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lpv_core.support.errors import ConfigError


def share_folders(package: str) -> list[Path]:
    """Folders that may hold a package's interface files, in order of preference."""
    prefixes = [p for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    folders = [Path(p) / 'share' / package for p in (*prefixes, sys.prefix, site.getuserbase())]
    folders.append(Path(__file__).resolve().parents[3] / package)
    return folders


def message_text(msgtype: str) -> str:
    """Definition of a message type from its ``.msg`` file."""
    package, _, name = msgtype.split('/')
    for folder in share_folders(package):
        path = folder / 'msg' / f'{name}.msg'
        if path.is_file():
            return path.read_text(encoding='utf-8')
    raise ConfigError(
        'message type',
        f'{msgtype} is not installed: no {package}/msg/{name}.msg below any sourced prefix',
    )


_PADDING = 4
"""More bytes that some publishers leave behind a message that ends with an empty sequence of
doubles, as JointState without efforts: room for its alignment, beside the usual 0 to 3."""


def decode(deserialize: Callable[[bytes, str], Any], data: bytes, msgtype: str) -> Any:
    """A message from its CDR by a typestore's or reader's method, whatever padding follows it."""
    try:
        return deserialize(data, msgtype)
    except (SerdeError, AnyReaderError) as error:
        if 'size mismatch' not in str(error):
            raise
        return deserialize(data[:-_PADDING], msgtype)


def add_type(typestore: Typestore, msgtype: str) -> None:
    """Make a type known to a typestore, with the types that it uses.

    Raises ConfigError if a definition is not installed.
    """
    missing = [msgtype]
    while missing:
        name = missing.pop()
        if name in typestore.fielddefs:
            continue
        found = get_types_from_msg(message_text(name), name)
        typestore.register(found)
        missing += [used for used in _used_types(found[name]) if used not in typestore.fielddefs]


def _used_types(definition: Any) -> list[str]:
    """Names of nested message types; a field is (name, (kind, what)) and arrays nest one level."""

    def names(kind: Any) -> list[str]:
        node, what = kind
        if int(node) == 2:  # Nodetype.NAME
            return [what]
        if int(node) in (3, 4):  # Nodetype.ARRAY, Nodetype.SEQUENCE
            return names(what[0])
        return []

    return [name for _, kind in definition[1] for name in names(kind)]


LPV_TYPES = (
    'FaultAlarm',
    'FaultEstimate',
    'GroundTruth',
    'JointReference',
    'StateEstimate',
    'TorqueCommand',
)


def make_typestore() -> Typestore:
    """Typestore with the standard types of ROS 2 Jazzy and those of lpv_msgs."""
    typestore = get_typestore(Stores.ROS2_JAZZY)
    for name in LPV_TYPES:
        add_type(typestore, f'lpv_msgs/msg/{name}')
    return typestore
