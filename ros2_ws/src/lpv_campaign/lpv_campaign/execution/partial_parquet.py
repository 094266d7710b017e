"""Rows on disk that come in over time: Parquet, in parts at first, in one file at the end."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lpv_core.support.errors import ConfigError

_PARTS = 'parts'


class PartsFolder:
    """Folder of results that are written part by part.

    Parameters
    ----------
    path : str or pathlib.Path
        The folder; made by `make`.
    whole : str
        Name of the Parquet file that holds all rows in the end.
    key : str
        Column that tells rows apart; rows are sorted by it.
    """

    def __init__(self, path: str | Path, whole: str, key: str) -> None:
        self.path, self._whole, self._key = Path(path), whole, key
        self._parts = self.path / _PARTS

    @property
    def whole_file(self) -> Path:
        """Parquet file of all rows."""
        return self.path / self._whole

    def make(self) -> None:
        """Make the folder."""
        self._parts.mkdir(parents=True, exist_ok=True)

    def finished(self) -> set[Any]:
        """Keys of the rows that are here.

        Returns
        -------
        set
            The keys.

        Raises
        ------
        ConfigError
            If a file cannot be read.
        """
        keys = set()
        for file in self._files():
            try:
                keys.update(pq.read_table(file, columns=[self._key])[self._key].to_pylist())
            except (pa.ArrowInvalid, OSError) as error:
                raise ConfigError(
                    'results',
                    f'cannot be read ({error}); remove the file to repeat its runs',
                    str(file),
                ) from error
        return keys

    def write_part(self, table: pa.Table, name: str) -> None:
        """Write a part; it is there as a whole or not at all."""
        write_whole(self._parts / f'{name}.parquet', lambda part: pq.write_table(table, part))

    def finish(self, table: pa.Table | None = None) -> pa.Table:
        """Put all parts into one file."""
        table = self.table() if table is None else table
        write_whole(self.whole_file, lambda part: pq.write_table(table, part))
        for file in self._part_files():
            file.unlink()
        return table

    def table(self) -> pa.Table:
        """All rows so far."""
        tables = [pq.read_table(file) for file in self._files()]
        if not tables:
            raise ConfigError('results', 'there are none', str(self.path))
        table = pa.concat_tables(tables, promote_options='default').sort_by(self._key)
        keys = table[self._key].to_pylist()
        keep = [k for k, n in enumerate(keys) if k == 0 or n != keys[k - 1]]
        # A crash between writing the whole and removing the parts leaves both.
        return table if len(keep) == len(keys) else table.take(keep)

    def _part_files(self) -> list[Path]:
        return sorted(self._parts.glob('*.parquet')) if self._parts.is_dir() else []

    def _files(self) -> list[Path]:
        return ([self.whole_file] if self.whole_file.exists() else []) + self._part_files()


def write_whole(path: Path, write: Callable[..., Any]) -> None:
    """Write a file that is there as a whole or not at all."""
    part = path.with_name(path.name + '.part')
    write(part)
    # On disk before it gets its name: a power cut must not leave a name without content.
    with open(part, 'rb') as file:
        os.fsync(file.fileno())
    part.replace(path)
