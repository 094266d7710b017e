"""Results of an archive on disk: Parquet, one row per bag."""

import json
import uuid
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lpv_campaign.execution.partial_parquet import PartsFolder, write_whole
from lpv_campaign.execution.run_metrics import COUNTS, FLAGS, FLOATS, LISTS, TEXTS
from lpv_campaign.fleet.archive import FleetSettings
from lpv_campaign.fleet.find import FoundBag
from lpv_campaign.fleet.tally import STATES
from lpv_core.observer.sampled_observer import Counters
from lpv_core.support.errors import ConfigError

_FLEET, _BAGS = 'fleet.json', 'bags.parquet'
_MOST_BYTES = 16 << 20
ALARM = pa.struct(
    [
        ('sensor', pa.string()),
        ('kind', pa.string()),
        ('count', pa.int64()),
        ('onset', pa.float64()),
        ('detected', pa.float64()),
        ('size', pa.float64()),
        ('bound', pa.float64()),
    ]
)
"""Alarms of one sensor and kind; times since the first measurement."""
_EACH = (
    'score',
    'fault_largest',
    'fault_mean',
    'fault_rms',
    'threshold_mean',
    'reference_error',
    *(f'time_{name}' for name in STATES),
)


def _schema() -> pa.Schema:
    text, whole, number, flag = pa.string(), pa.int64(), pa.float64(), pa.bool_()
    columns = {
        'bag': text,
        'unit': text,
        'error': text,
        'fingerprint': text,
        'topic': text,
        'warnings': text,
        'start': whole,
        'duration': number,
        'observed': number,
        'measurements': whole,
        'rejected': whole,
        'recorder_lost': whole,
    }
    columns.update(dict.fromkeys(Counters.__dataclass_fields__, whole))
    columns.update(dict.fromkeys(('alarms', 'alarms_1', 'alarms_2'), whole))
    columns.update(
        alarm_list=pa.list_(ALARM),
        inconsistent_time=number,
        untrusted_time=number,
        has_truth=flag,
        has_reference=flag,
    )
    columns.update({f'{name}_{i}': number for name in _EACH for i in (1, 2)})
    columns.update(seed=whole, kind=text, sensor=text)
    for group, kind in (
        (FLOATS, number),
        (TEXTS, text),
        (COUNTS, whole),
        (FLAGS, flag),
        (LISTS, pa.list_(number)),
    ):
        columns.update({name: kind for name in group})
    return pa.schema(list(columns.items()))


SCHEMA = _schema()
"""Columns of the results; meaning and units in docs/fleet.md."""


class FleetFolder(PartsFolder):
    """Folder of the results of one archive.

    Parameters
    ----------
    path : str or pathlib.Path
        The folder; made when something is written.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path, _BAGS, 'bag')

    def begin(self, settings: FleetSettings) -> None:
        """Keep the settings, so that it can be resumed."""
        file = self.path / _FLEET
        if file.exists():
            if _stored_key(file) != settings.key:
                raise ConfigError(
                    '--out',
                    'holds results with another arm, gains or options: '
                    'take another folder, or remove it',
                    str(self.path),
                )
            return
        if self.path.exists() and any(self.path.iterdir()):
            raise ConfigError(
                '--out', 'exists already and holds no results of bags', str(self.path)
            )
        self.make()
        text = json.dumps({'key': settings.key, 'settings': json.loads(settings.to_json())})
        write_whole(file, lambda part: part.write_text(text, encoding='utf-8'))

    def add(self, rows: list[dict[str, Any]]) -> None:
        """Write a part; it is there as a whole or not at all."""
        self.make()
        self.write_part(pa.Table.from_pylist(rows, schema=SCHEMA), uuid.uuid4().hex)

    def rows(self, bags: list[FoundBag]) -> pa.Table:
        """Results of an archive as it is now."""
        now = {bag.name: bag.fingerprint for bag in bags}
        kept = {}
        for file in self._files():
            try:
                table = pq.read_table(file, schema=SCHEMA)
            except (pa.ArrowInvalid, pa.ArrowTypeError, OSError) as error:
                raise ConfigError(
                    'results',
                    f'cannot be read ({error}); remove the file to repeat its bags',
                    str(file),
                ) from error
            for row in table.to_pylist():
                # One that could be read is worth more than one that could not.
                if now.get(row['bag']) == row['fingerprint'] and not (
                    row['error'] and row['bag'] in kept
                ):
                    kept[row['bag']] = row
        return pa.Table.from_pylist([kept[name] for name in sorted(kept)], schema=SCHEMA)


def _stored_key(file: Path) -> str:
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise ValueError('too large')
        return json.loads(file.read_text(encoding='utf-8'))['key']
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError('fleet', f'cannot be read ({error})', str(file)) from error
