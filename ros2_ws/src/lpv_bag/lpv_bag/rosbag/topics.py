"""Topics and types of MCAP files, as rosbags has them."""

from collections.abc import Iterable, Sequence

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lpv_bag.errors import DamageError
from lpv_bag.rosbag.interfaces import make_typestore
from lpv_bag.rosbag.mcap_file import McapFile
from lpv_bag.rosbag.metadata import offered_qos

_FORMATS = {'ros2msg': MessageDefinitionFormat.MSG, 'ros2idl': MessageDefinitionFormat.IDL}
_NONE = MessageDefinition(MessageDefinitionFormat.NONE, '')
_IDL = '=' * 80 + '\n'
"""Before each of the definitions that a type in IDL needs."""


def connections_of(files: Iterable[McapFile], hashes: dict[str, str]) -> list[Connection]:
    """Topics, with the messages that are there; all publishers of a topic are one."""
    found: dict[tuple[str, str], Connection] = {}
    for file in files:
        for number in sorted(file.channels):
            one = _connection(file, number, hashes)
            known = found.setdefault((one.topic, one.msgtype), one)
            if known is not one:
                profiles = offered_qos(known)
                profiles += [qos for qos in offered_qos(one) if qos not in profiles]
                ext = ConnectionExtRosbag2('cdr', profiles)
                count = known.msgcount + one.msgcount
                found[one.topic, one.msgtype] = known._replace(msgcount=count, ext=ext)
    return list(found.values())


def _connection(file: McapFile, number: int, hashes: dict[str, str]) -> Connection:
    channel = file.channels[number]
    schema = file.schemas.get(channel.schema_id)
    name, definition = '', _NONE
    if schema is not None:
        name = schema.name
        if schema.encoding in _FORMATS:
            text = schema.data.decode(errors='replace')
            definition = MessageDefinition(_FORMATS[schema.encoding], text)
    try:
        profiles = parse_qos(channel.metadata.get('offered_qos_profiles', ''))
    except Exception:  # many kinds; no result depends on it
        profiles = []
    digest = channel.metadata.get('topic_type_hash') or hashes.get(name, '')
    ext = ConnectionExtRosbag2(channel.message_encoding, profiles)
    count = file.counts.get(number, 0)
    return Connection(number, channel.topic, name, definition, digest, count, ext, None)


def types_of(connections: Sequence[Connection]) -> Typestore:
    """Types as a bag defines them; the standard ones and lpv_msgs where it defines none."""
    defined = [c for c in connections if c.msgdef.format != MessageDefinitionFormat.NONE]
    if not defined:
        return make_typestore()
    types = get_typestore(Stores.EMPTY)
    found = {}
    for connection in defined:
        text = connection.msgdef.data
        if connection.msgdef.format == MessageDefinitionFormat.MSG:
            found.update(get_types_from_msg(text, connection.msgtype))
            continue
        parts = [part.split('\n', 1)[1] for part in text.split(_IDL)[1:]] or [text]
        for part in parts:
            found.update(get_types_from_idl(part))
    types.register(found)
    for connection in defined:
        if connection.digest and types.hash_rihs01(connection.msgtype) != connection.digest:
            raise DamageError(f'the hash of {connection.msgtype} is not that of its definition')
    return types
