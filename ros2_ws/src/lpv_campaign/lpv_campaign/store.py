"""Results on disk: Parquet, one row a run, in parts while the campaign goes on."""

import json
import os
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from lpv_campaign.campaign import Campaign
from lpv_campaign.figures import COUNTS, FLAGS, FLOATS, LISTS, TEXTS
from lpv_campaign.spec import DEFAULTS
from lpv_core.errors import ConfigError

_CAMPAIGN, _RUNS, _PARTS = 'campaign.json', 'runs.parquet', 'parts'
_MOST_BYTES = 64 << 20
"""Largest campaign.json that is read."""
_TEXT_FACTORS = ('design', 'path', 'plant', 'compensation', 'fault.kind', 'fault.sensor')


class CampaignFolder:
    """Folder of one campaign.

    Parameters
    ----------
    path : str or pathlib.Path
        The folder; made when something is written.
    """

    def __init__(self, path):
        self.path = Path(path)
        self._parts = self.path / _PARTS

    @property
    def runs_file(self):
        """Parquet file of a finished campaign."""
        return self.path / _RUNS

    def load(self):
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

    def begin(self, campaign):
        """Keep the campaign, so that it can go on after a crash.

        Parameters
        ----------
        campaign : Campaign
            What is going to be run.
        """
        self._parts.mkdir(parents=True, exist_ok=True)
        _write_whole(self.path / _CAMPAIGN, lambda part: part.write_text(campaign.text))

    def finished(self):
        """Numbers of the runs whose results are here.

        Returns
        -------
        set of int
            The numbers.
        """
        numbers = set()
        for file in self._files():
            try:
                numbers.update(pq.read_table(file, columns=['number'])['number'].to_pylist())
            except (pa.ArrowInvalid, OSError) as error:
                raise ConfigError('results', f'cannot be read ({error}); remove the file to '
                                  'repeat its runs', str(file)) from error
        return numbers

    def add(self, campaign, rows):
        """Write a part; it is there as a whole or not at all.

        Parameters
        ----------
        campaign : Campaign
            For the columns.
        rows : list of dict
            Results of some runs.
        """
        table = pa.Table.from_pylist(rows, schema=schema(campaign, rows))
        name = f'{rows[0]["number"]:08d}-{rows[-1]["number"]:08d}.parquet'
        _write_whole(self._parts / name, lambda part: pq.write_table(table, part))

    def finish(self):
        """Put all parts into one file, in the order of the runs.

        Returns
        -------
        pyarrow.Table
            All rows.
        """
        table = self.table()
        _write_whole(self.runs_file, lambda part: pq.write_table(table, part))
        for file in self._part_files():
            file.unlink()
        return table

    def table(self):
        """All results so far.

        Returns
        -------
        pyarrow.Table
            Sorted by number.

        Raises
        ------
        ConfigError
            If there are none.
        """
        tables = [pq.read_table(file) for file in self._files()]
        if not tables:
            raise ConfigError('results', 'there are none', str(self.path))
        table = pa.concat_tables(tables, promote_options='default').sort_by('number')
        numbers = table['number'].to_pylist()
        keep = [k for k, n in enumerate(numbers) if k == 0 or n != numbers[k - 1]]
        # A crash between writing the whole and removing the parts leaves both.
        return table if len(keep) == len(numbers) else table.take(keep)

    def _part_files(self):
        return sorted(self._parts.glob('*.parquet')) if self._parts.is_dir() else []

    def _files(self):
        return ([self.runs_file] if self.runs_file.exists() else []) + self._part_files()


def _write_whole(path, write):
    part = path.with_name(path.name + '.part')
    write(part)
    # On disk before it gets its name: a power cut must not leave a name without content.
    with open(part, 'rb') as file:
        os.fsync(file.fileno())
    part.replace(path)


def schema(campaign, rows):
    """Columns of the results.

    Parameters
    ----------
    campaign : Campaign
        For the factors.
    rows : list of dict
        Some results; only they know which figures of the accuracy's limit there are.

    Returns
    -------
    pyarrow.Schema
        Numbers, factors, figures.
    """
    names = [*DEFAULTS, *(n for n in campaign.spec.factors if n not in DEFAULTS)]
    columns = [('number', pa.int64()), ('seed', pa.int64()), ('kind', pa.string()),
               ('sensor', pa.string())]
    columns += [(name, pa.string() if name in _TEXT_FACTORS else pa.float64()) for name in names]
    for group, kind in ((FLOATS, pa.float64()), (TEXTS, pa.string()), (COUNTS, pa.int64()),
                        (FLAGS, pa.bool_()), (LISTS, pa.list_(pa.float64()))):
        columns += [(name, kind) for name in group]
    known = {name for name, _ in columns}
    extra = sorted({name for row in rows for name in row if name not in known})
    columns += [(name, pa.float64()) for name in extra]
    return pa.schema(columns, metadata={'campaign': json.dumps(campaign.spec.name)})
