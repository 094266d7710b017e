"""Results on disk: Parquet, one row per run, in parts while the campaign runs."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa

from lpv_campaign.execution.partial_parquet import PartsFolder, write_whole
from lpv_campaign.execution.run_metrics import columns_of
from lpv_campaign.plan.campaign import Campaign
from lpv_campaign.plan.spec import DEFAULTS
from lpv_core.support.errors import ConfigError

_CAMPAIGN, _RUNS = 'campaign.json', 'runs.parquet'
_MOST_BYTES = 64 << 20
"""Largest campaign.json that is read."""
_TEXT_FACTORS = ('design', 'path', 'plant', 'compensation', 'fault.kind', 'fault.sensor')


class CampaignFolder(PartsFolder):
    """Folder of one campaign.

    Parameters
    ----------
    path : str or pathlib.Path
        The folder; made when something is written.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(path, _RUNS, 'number')

    @property
    def runs_file(self) -> Path:
        """Parquet file of a finished campaign."""
        return self.whole_file

    def load(self) -> Campaign | None:
        """The campaign that was begun here.

        Returns
        -------
        Campaign or None
            None if there is none.

        Raises
        ------
        ConfigError
            If what is there cannot be read.
        """
        file = self.path / _CAMPAIGN
        if not file.exists():
            return None
        try:
            if file.stat().st_size > _MOST_BYTES:
                raise ValueError('too large')
            return Campaign(file.read_text(encoding='utf-8'))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError('campaign', f'cannot be read ({error})', str(file)) from error

    def holds_another(self, campaign: Campaign) -> bool:
        """Whether another campaign was begun here."""
        begun = self.load()
        return begun is not None and begun.key != campaign.key

    def begin(self, campaign: Campaign) -> None:
        """Keep the campaign, so that it can be resumed after a crash."""
        self.make()
        write_whole(self.path / _CAMPAIGN, lambda part: part.write_text(campaign.text))

    def add(self, campaign: Campaign, rows: list[dict[str, Any]]) -> None:
        """Write a part; it is there as a whole or not at all."""
        table = pa.Table.from_pylist(rows, schema=schema(campaign, rows))
        self.write_part(table, f'{rows[0]["number"]:08d}-{rows[-1]["number"]:08d}')


def schema(campaign: Campaign, rows: list[dict[str, Any]]) -> pa.Schema:
    """Columns of the results."""
    names = [*DEFAULTS, *(n for n in campaign.spec.factors if n not in DEFAULTS)]
    columns = [
        ('number', pa.int64()),
        ('seed', pa.int64()),
        ('kind', pa.string()),
        ('sensor', pa.string()),
    ]
    columns += [(name, pa.string() if name in _TEXT_FACTORS else pa.float64()) for name in names]
    figures = columns_of(len(campaign.arm.sensor_names))
    for group, kind in (
        (figures.floats, pa.float64()),
        (figures.texts, pa.string()),
        (figures.counts, pa.int64()),
        (figures.flags, pa.bool_()),
        (figures.lists, pa.list_(pa.float64())),
    ):
        columns += [(name, kind) for name in group]
    known = {name for name, _ in columns}
    extra = sorted({name for row in rows for name in row if name not in known})
    columns += [(name, pa.float64()) for name in extra]
    return pa.schema(columns, metadata={'campaign': json.dumps(campaign.spec.name)})
