"""metadata.yaml of rosbag2 bags."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.rosbag2.metadata import dump_qos_v9

from lpv_bag.errors import DamageError
from lpv_bag.rosbag.message_loss import RECORD_NAME, Known, known_from_text
from lpv_core.support.config import load_yaml
from lpv_core.support.errors import ConfigError

FILE_NAME = 'metadata.yaml'
VERSION = 9
"""Of the format that is written, that of rosbag2 since Jazzy."""
_MAX_BYTES = 1 << 26
_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)


@dataclass(frozen=True)
class BagMetadata:
    """What a metadata.yaml says that is not in the files themselves."""

    storage: str  # ``mcap`` or ``sqlite3``
    files: tuple[str, ...]  # names of the files in the bag's directory, in order
    compressed: bool  # by rosbag2 itself, beside what a storage does
    counts: dict[str, int]  # messages by topic
    hashes: dict[str, str]  # type description hash by message type
    custom: dict[str, str]  # custom data

    @property
    def known(self) -> Known:
        """What the recorder knew of each topic."""
        return known_from_text(self.custom.get(RECORD_NAME, '{}'))


def read_metadata(folder: str | Path) -> BagMetadata:
    """Read the metadata of a bag; DamageError if they are none."""
    try:
        data = load_yaml(Path(folder) / FILE_NAME, _MAX_BYTES)['rosbag2_bagfile_information']
        return _parse(data)
    except ConfigError as error:
        raise DamageError(f'{FILE_NAME} {error.reason}') from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamageError(
            f'{FILE_NAME} is not that of a bag ({type(error).__name__}: {error})'
        ) from None


def _parse(data: Any) -> BagMetadata:
    if int(data['version']) > VERSION:
        raise ValueError(f'version {data["version"]} is not known')
    counts: dict[str, int] = {}
    hashes: dict[str, str] = {}
    for entry in data['topics_with_message_count'] or []:
        topic = entry['topic_metadata']
        counts[topic['name']] = counts.get(topic['name'], 0) + int(entry['message_count'])
        hashes[topic['type']] = str(topic.get('type_description_hash') or '')
    return BagMetadata(
        str(data['storage_identifier']),
        # A file outside of the bag's directory is never meant.
        tuple(Path(str(name)).name for name in data['relative_file_paths']),
        str(data.get('compression_mode') or 'none').lower() not in ('none', 'storage'),
        counts,
        hashes,
        {str(k): str(v) for k, v in (data.get('custom_data') or {}).items()},
    )


def qos_text(profiles: Any) -> str:
    """Offered QoS as a channel's metadata have them."""
    return dump(dump_qos_v9(list(profiles))).strip()


def dump(data: object) -> str:
    """YAML text."""
    return yaml.dump(data, Dumper=_DUMPER, sort_keys=False, width=1000, allow_unicode=True)


def bag_information(
    files: list[tuple[str, int, int, int]], topics: list[tuple[Any, ...]], custom: dict[str, str]
) -> dict[str, Any]:
    """Content of metadata.yaml.

    Of each file name, first and last log time and number of messages; of each topic name, type,
    QoS, hash and number of messages.
    """
    start = min((first for _, first, _, count in files if count), default=0)
    end = max((last for _, _, last, count in files if count), default=0)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(count for *_, count in files),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': name,
                    'type': msgtype,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': dump_qos_v9(list(profiles)),
                    'type_description_hash': digest,
                },
                'message_count': count,
            }
            for name, msgtype, profiles, digest, count in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [name for name, *_ in files],
        'files': [
            {
                'path': name,
                'starting_time': {'nanoseconds_since_epoch': first},
                'duration': {'nanoseconds': last - first},
                'message_count': count,
            }
            for name, first, last, count in files
        ],
        'custom_data': custom or None,
        'ros_distro': os.environ.get('ROS_DISTRO', 'unknown'),
    }
