"""metadata.yaml of rosbag2 bags, and the quality of service that is stored beside a topic."""

import json
import os
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from rosbags import interfaces
from rosbags.interfaces import Connection, Qos, QosDurability, QosReliability
from rosbags.rosbag2.metadata import dump_qos_v9

from lpv.bag.errors import DamageError
from lpv.core.support.config import load_yaml
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import MOST_BYTES

FILE_NAME = 'metadata.yaml'
VERSION = 9
"""Of the format that is written, that of rosbag2 since Jazzy."""
RECORD_NAME = 'lpv_recorder'
"""Key of the custom data of a bag for what its recorder knew."""
Known = dict[str, dict[str, int]]
"""What a recorder knows of each topic: messages, lost, late."""
_FORMAT = interfaces.MessageDefinitionFormat
DEFINITIONS = {_FORMAT.MSG: 'ros2msg', _FORMAT.IDL: 'ros2idl'}
"""Names of the kinds of message definitions in MCAP files."""
_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
_FOREVER = interfaces.QosTime(2147483647, 4294967295)


def qos_profile(reliable: bool, transient_local: bool, depth: int) -> Qos:
    """Offered QoS as stored beside a topic."""
    reliability = QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT
    durability = QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE
    always = _FOREVER, _FOREVER, interfaces.QosLiveliness.AUTOMATIC, _FOREVER, False
    return Qos(interfaces.QosHistory.KEEP_LAST, depth, reliability, durability, *always)


def offered_qos(connection: Connection) -> list[Qos]:
    """QoS profiles with which a topic was offered when it was recorded."""
    return list(getattr(connection.ext, 'offered_qos_profiles', None) or ())


def encoding_of(connection: Connection) -> str:
    """Encoding of a topic's messages, of ROS 2 ``cdr``."""
    return str(getattr(connection.ext, 'serialization_format', 'cdr'))


@dataclass(frozen=True)
class BagMetadata:
    """What a metadata.yaml says that is not in the files themselves."""

    storage: str  # ``mcap`` or ``sqlite3``
    files: tuple[str, ...]  # names of the files in the bag's directory, in order
    compressed: bool  # by rosbag2 itself, beside what a storage does
    counts: Counter[str]  # messages by topic
    hashes: dict[str, str]  # type description hash by message type
    custom: dict[str, str]  # what who recorded it said of the bag

    @property
    def known(self) -> Known:
        """What the recorder knew of each topic; nothing where that is damaged."""
        try:
            said = json.loads(self.custom.get(RECORD_NAME, '{}')).items()
            return {t: {name: int(value) for name, value in counts.items()} for t, counts in said}
        except (ValueError, TypeError, AttributeError, RecursionError):
            return {}


def read_metadata(folder: Path) -> BagMetadata:
    """Read the metadata of a bag; DamageError if they are none."""
    try:
        return _parse(load_yaml(folder / FILE_NAME, MOST_BYTES)['rosbag2_bagfile_information'])
    except ConfigError as error:
        raise DamageError(f'{FILE_NAME} {error.reason}') from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        text = f'{FILE_NAME} is not that of a bag ({type(error).__name__}: {error})'
        raise DamageError(text) from None


def _parse(data: Any) -> BagMetadata:
    if int(data['version']) > VERSION:
        raise ValueError(f'version {data["version"]} is not known')
    counts, hashes = Counter[str](), dict[str, str]()
    for entry in data['topics_with_message_count'] or []:
        topic, name = entry['topic_metadata'], str(entry['topic_metadata']['name'])
        counts[name] += int(entry['message_count'])
        hashes[str(topic['type'])] = str(topic.get('type_description_hash') or '')
    return BagMetadata(
        str(data['storage_identifier']),
        # A file outside of the bag's directory is never meant.
        tuple(Path(str(name)).name for name in data['relative_file_paths']),
        str(data.get('compression_mode') or 'none').lower() not in ('none', 'storage'),
        counts,
        hashes,
        {str(key): str(value) for key, value in (data.get('custom_data') or {}).items()},
    )


def dump(data: object) -> str:
    return yaml.dump(data, Dumper=_DUMPER, sort_keys=False, width=1000, allow_unicode=True)


class Content(NamedTuple):
    """Content of a file."""

    entry: tuple[str, int, int, int]  # name, first and last log time [ns], messages
    counts: Counter[str]  # messages by topic
    size: int  # [bytes]


def bag_information(
    contents: Sequence[Content], topics: Collection[Connection], custom: dict[str, str]
) -> dict[str, Any]:
    """Content of metadata.yaml of some files."""
    files = [one.entry for one in contents]
    times = [time for _, *span, count in files if count for time in span] or [0]

    def described(topic: Connection) -> dict[str, Any]:
        about = {
            'name': topic.topic,
            'type': topic.msgtype,
            'serialization_format': encoding_of(topic),
            'offered_qos_profiles': dump_qos_v9(offered_qos(topic)),
            'type_description_hash': topic.digest,
        }
        count = sum(one.counts[topic.topic] for one in contents)
        return {'topic_metadata': about, 'message_count': count}

    def span(first: int, last: int, count: int) -> dict[str, Any]:
        return {
            'starting_time': {'nanoseconds_since_epoch': first},
            'duration': {'nanoseconds': last - first},
            'message_count': count,
        }

    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        **span(min(times), max(times), sum(count for *_, count in files)),
        'topics_with_message_count': [described(topic) for topic in topics],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [name for name, *_ in files],
        'files': [{'path': name, **span(*values)} for name, *values in files],
        'custom_data': custom or None,
        'ros_distro': os.environ.get('ROS_DISTRO', 'unknown'),
    }
