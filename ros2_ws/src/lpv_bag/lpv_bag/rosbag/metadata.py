"""metadata.yaml of rosbag2 bags."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import dump_qos_v9

from lpv_bag.errors import DamageError
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
    files: tuple  # names of the files in the bag's directory, in order
    # whether files or messages are compressed by rosbag2 itself, beside what a storage does
    compressed: bool
    counts: dict  # messages by topic
    topics: tuple  # in their order
    hashes: dict  # type description hash by message type
    custom: dict  # custom data


def read_metadata(folder: str | Path) -> BagMetadata:
    """Read the metadata of a bag."""
    try:
        data = load_yaml(Path(folder) / FILE_NAME, _MAX_BYTES)
    except ConfigError as error:
        raise DamageError(f'{FILE_NAME} {error.reason}') from None
    try:
        return _parse(data['rosbag2_bagfile_information'])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DamageError(
            f'{FILE_NAME} is not that of a bag ({type(error).__name__}: {error})'
        ) from None


def _parse(data: Any) -> BagMetadata:
    if int(data['version']) > VERSION:
        raise ValueError(f'version {data["version"]} is not known')
    topics = data['topics_with_message_count'] or []
    counts: dict[str, int] = {}
    for entry in topics:
        name = entry['topic_metadata']['name']
        counts[name] = counts.get(name, 0) + int(entry['message_count'])
    # A file outside of the bag's directory is never meant.
    files = tuple(Path(str(name)).name for name in data['relative_file_paths'])
    return BagMetadata(
        str(data['storage_identifier']),
        files,
        str(data.get('compression_mode') or 'none').lower() not in ('none', 'storage'),
        counts,
        tuple(counts),
        {
            e['topic_metadata']['type']: str(e['topic_metadata'].get('type_description_hash') or '')
            for e in topics
        },
        {str(k): str(v) for k, v in (data.get('custom_data') or {}).items()},
    )


def qos_data(profiles: Iterable[Qos]) -> list[Any]:
    """Offered QoS as metadata.yaml has them."""
    return dump_qos_v9(list(profiles))


def dump(data: object) -> str:
    """YAML text."""
    return yaml.dump(
        data,
        Dumper=_DUMPER,
        sort_keys=False,
        default_flow_style=False,
        width=1000,
        allow_unicode=True,
    )


def bag_information(
    files: list[tuple[Any, ...]], topics: list[tuple[Any, ...]], custom: dict[str, str]
) -> dict[str, Any]:
    """Content of metadata.yaml."""
    spans = [span for span in files if span[3]]
    start = min((span[1] for span in spans), default=0)
    end = max((span[2] for span in spans), default=0)
    return {
        'version': VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(span[3] for span in files),
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': name,
                    'type': msgtype,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': qos_data(profiles),
                    'type_description_hash': digest,
                },
                'message_count': count,
            }
            for name, msgtype, profiles, digest, count in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [span[0] for span in files],
        'files': [
            {
                'path': name,
                'starting_time': {'nanoseconds_since_epoch': first},
                'duration': {'nanoseconds': last - first},
                'message_count': count,
            }
            for name, first, last, count in files
        ],
        'custom_data': dict(custom) or None,
        'ros_distro': os.environ.get('ROS_DISTRO', 'unknown'),
    }
