"""An archive of bags as a campaign: which bags there are, and one row of figures each."""

import contextlib
import hashlib
import json
import logging
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lpv.bag.replay.replay import Replay, ReplayOptions
from lpv.bag.rosbag.metadata import FILE_NAME, read_metadata
from lpv.campaign.execution.bag_figures import BagFigures
from lpv.campaign.plan.campaign import software
from lpv.core.monitoring.parameters import DiagnosisParameters
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.arm_file import parse_arm, to_mapping
from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.config import sha256_of
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.limits import MAX_GAP, MOST_TEXT
from lpv.core.uio.certificate.gains import Gains

_STORAGE = ('.mcap', '.db3')
_UNIT = ('serial', 'unit')
"""Keys of a bag's custom data that name the arm, as ``ros2 bag record --custom-data`` sets them."""


def archive_text(
    root: str | Path,
    arm: SerialArm,
    gains: Gains | None,
    diagnosis: DiagnosisParameters | None = None,
    options: ReplayOptions | None = None,
    **sampling: Any,
) -> str:
    """Text of an `Archive`; ``sampling`` as of `SerialSensorMonitor`."""
    content = {
        'root': str(Path(root).resolve()),
        'arm': to_mapping(arm),
        'gains': gains and gains.mapping(),
        'diagnosis': asdict(diagnosis or DiagnosisParameters()),
        'options': asdict(options or ReplayOptions()),
        'sampling': sampling,
        'software': software(),
    }
    return json.dumps(content, sort_keys=True)


class Archive:
    """Bags of one arm below ``root``, observed with the same settings; from `archive_text`."""

    def __init__(self, text: str) -> None:
        self.text, data = text, json.loads(text)
        self.root, self.arm = Path(data['root']), parse_arm(data['arm'])
        self.software: str = data.get('software', 'unknown')
        self._gains = data['gains'] and Gains.parse(data['gains'])
        self._diagnosis = DiagnosisParameters(**data['diagnosis'])
        self._options, self._sampling = ReplayOptions(**data['options']), data['sampling']

    @property
    def key(self) -> str:
        """Hash of everything that can change a result but the bags and the software."""
        data = json.loads(self.text)
        return sha256_of({name: data[name] for name in data if name not in ('root', 'software')})

    def monitor(self) -> SerialSensorMonitor:
        """A fresh monitor."""
        return SerialSensorMonitor('/uio', self.arm, self._diagnosis, self._gains, **self._sampling)

    def row(self, name: str) -> dict[str, Any]:
        """Replay a bag and measure it; ``error`` says why it could not be read."""
        path = self.root / name
        row = {'bag': name, 'unit': '', 'error': ''}
        try:
            row['unit'] = unit_of(self.root, name)
            row.update(self._figures(path))
        except LpvError as error:
            row['error'] = _line(str(error).replace(f'{path}: ', ''))
        except Exception as error:  # one bag must not end all others
            row['error'] = _line(f'{type(error).__name__}: {error}')
        return row

    def _figures(self, path: Path) -> dict[str, Any]:
        monitor = self.monitor()
        found = BagFigures(self.arm, self._sampling.get('max_gap', MAX_GAP))
        with _quiet():
            result = Replay(monitor, self._options).watch(path, found.take)
            rejected = sum(result.rejected.values())
            if rejected >= result.measurements:
                raise LpvError('no measurement could be used: ' + next(iter(result.rejected)))
            row = found.row(result.events, path, result)
        notes = [text for _, text in result.notes]
        return {
            'topic': result.topic,
            'measurements': result.measurements,
            'rejected': rejected,
            'recorder_lost': result.lost,
            **vars(monitor.counters),
            'warnings': _line('; '.join([*found.warnings, *notes, *result.warnings])),
            'has_truth': 'ground_truth' in result.streams,
            'has_reference': 'reference' in result.streams,
            **row,
        }


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without the log of what is wrong with a bag, which is in its row."""
    logger = logging.getLogger('lpv.bag')
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)


def _line(text: str) -> str:
    text = ' '.join(text.split())
    return text if len(text) <= MOST_TEXT else text[: MOST_TEXT - 3] + '...'


def find_bags(root: str | Path, leave_out: Sequence[Path] = ()) -> dict[str, list[str]]:
    """All bags below a folder, as chunks of a campaign: relative path by a hash of its files."""
    root = Path(root)
    if not root.is_dir():
        raise ConfigError('DIR', 'is not a folder', str(root))
    skipped, found = {Path(path).resolve() for path in leave_out}, {}
    for name, folders, files in os.walk(root):
        folder = Path(name)
        folders[:] = [
            name
            for name in folders
            if not name.startswith('.') and (folder / name).resolve() not in skipped
        ]
        for path, parts in _bags_in(folder, sorted(files)):
            bag = path.relative_to(root).as_posix()
            found[bag] = _fingerprint(bag, parts)
    return {found[name]: [name] for name in sorted(found)}


def _bags_in(folder: Path, files: list[str]) -> list[tuple[Path, list[Path]]]:
    """Bags of one folder, each with the files that make it."""
    # An unfinished recording leaves MCAP files with the folder's name, and no metadata.
    storage = [folder / name for name in files if Path(name).suffix in _STORAGE]
    if FILE_NAME in files and (storage or _is_metadata(folder)):
        return [(folder, [folder / FILE_NAME, *storage])]
    own = [
        path
        for path in storage
        if path.suffix == '.mcap'
        and folder.name in (path.stem, path.stem.rstrip('0123456789').rstrip('_'))
    ]
    return [(folder, own)] * bool(own) + [(path, [path]) for path in storage if path not in own]


def _is_metadata(folder: Path) -> bool:
    """Whether a metadata.yaml without bag files is that of a bag, whose files are then missing."""
    with contextlib.suppress(OSError), open(folder / FILE_NAME, 'rb') as file:
        return b'rosbag2_bagfile_information' in file.read(4096)
    return False


def _fingerprint(name: str, paths: Iterable[Path]) -> str:
    found = hashlib.sha256(f'{name}\n'.encode(errors='surrogateescape'))
    for path in paths:
        try:
            status = path.stat()
            text = f'{path.name} {status.st_size} {status.st_mtime_ns}\n'
        except OSError as error:
            text = f'{path.name} {error.errno}\n'
        found.update(text.encode(errors='surrogateescape'))
    return found.hexdigest()[:24]


def unit_of(root: Path, name: str) -> str:
    """Which arm a bag is of: ``serial`` or ``unit`` of its custom data, or its first folder."""
    with contextlib.suppress(LpvError, OSError):
        custom = read_metadata(root / name).custom
        if said := next(filter(None, map(custom.get, _UNIT)), ''):
            return said[:200]
    parts = Path(name).parts
    return parts[0] if len(parts) > 1 else ''
