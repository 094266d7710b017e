"""Bags below a folder."""

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lpv_bag.errors import DamageError
from lpv_bag.rosbag.metadata import FILE_NAME, read_metadata
from lpv_core.support.errors import ConfigError

_STORAGE = ('.mcap', '.db3')
_UNIT = ('serial', 'unit')
"""Keys of a bag's custom data that name the arm, as ``ros2 bag record --custom-data`` sets them."""


@dataclass(frozen=True)
class FoundBag:
    """A bag of an archive."""

    name: str  # Path relative to the archive, with slashes
    # Hash of names, sizes and times of its files: a bag that was changed has another one
    fingerprint: str


def find_bags(root: str | Path, leave_out: Sequence[Path] = ()) -> list[FoundBag]:
    """All rosbag2 bags below a folder.

    A folder with storage files and a metadata.yaml is one bag, and so is one without metadata
    whose MCAP files have its name, as an unfinished recording leaves it; other storage files are
    bags of their own.  Hidden folders and links to folders are left out.

    Parameters
    ----------
    root : str or pathlib.Path
        Archive.
    leave_out : sequence of pathlib.Path, optional
        Folders that are no part of it.

    Returns
    -------
    list of FoundBag
        Sorted by name.

    Raises
    ------
    ConfigError
        If there is no such folder.
    """
    root = Path(root)
    if not root.is_dir():
        raise ConfigError('--bags', 'is not a folder', str(root))
    skipped, found = {Path(path).resolve() for path in leave_out}, []
    for name, folders, files in os.walk(root):
        folder = Path(name)
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith('.') and (folder / name).resolve() not in skipped
        )
        for path, parts in _bags_in(folder, sorted(files)):
            name = path.relative_to(root).as_posix()
            found.append(FoundBag(name, _fingerprint(parts)))
    return sorted(found, key=lambda bag: bag.name)


def _bags_in(folder: Path, files: list[str]) -> list[tuple[Path, list[Path]]]:
    """Bags of one folder, each with the files that make it."""
    storage = [folder / name for name in files if Path(name).suffix in _STORAGE]
    if FILE_NAME in files and (storage or _is_metadata(folder)):
        return [(folder, [folder / FILE_NAME, *storage])]
    own = [
        path
        for path in storage
        if path.suffix == '.mcap' and path.stem.rstrip('0123456789').rstrip('_') == folder.name
    ]
    own += [path for path in storage if path.stem == folder.name and path not in own]
    unfinished = [(folder, own)] if own and own[0].suffix == '.mcap' else []
    taken = own if unfinished else []
    return unfinished + [(path, [path]) for path in storage if path not in taken]


def _is_metadata(folder: Path) -> bool:
    """Whether a metadata.yaml without bag files is that of a bag, whose files are then missing."""
    try:
        with open(folder / FILE_NAME, 'rb') as file:
            return b'rosbag2_bagfile_information' in file.read(4096)
    except OSError:
        return False


def _fingerprint(paths: Iterable[Path]) -> str:
    found = hashlib.sha256()
    for path in paths:
        try:
            status = path.stat()
            text = f'{path.name} {status.st_size} {status.st_mtime_ns}\n'
        except OSError as error:
            text = f'{path.name} {error.errno}\n'
        found.update(text.encode(errors='surrogateescape'))
    return found.hexdigest()[:24]


def unit_of(root: str | Path, name: str) -> str:
    """Which arm of the fleet a bag is of.

    Returns ``serial`` or ``unit`` of its custom data; otherwise its first folder, or '' at the
    top.
    """
    try:
        custom = read_metadata(Path(root) / name).custom
    except DamageError:
        custom = {}
    for key in _UNIT:
        if custom.get(key):
            return custom[key][:200]
    parts = Path(name).parts
    return parts[0] if len(parts) > 1 else ''
