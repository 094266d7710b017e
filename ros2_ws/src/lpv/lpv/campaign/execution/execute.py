"""Runs a campaign of simulations or bags by chunks: here, on all cores, or on a cluster."""

import json
import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from lpv.campaign.execution.archive import Archive
from lpv.campaign.execution.runs import run_one
from lpv.campaign.plan.campaign import Campaign, software
from lpv.campaign.plan.spec import TEXTS
from lpv.core.support.config import write_whole
from lpv.core.support.errors import ConfigError, LpvError
from lpv.core.support.limits import MOST_BYTES, MOST_ENTRIES, PATIENCE

CHUNK = 20
"""Runs that a worker gets, and writes, together: seconds of work for milliseconds of sending."""
_NO_WORKER_TIMEOUT = 60.0
"""Time without any worker after which a campaign gives up [s]."""


class WorkerError(LpvError):
    """A worker does not run the same software, or died of its work."""


Work = Campaign | Archive
"""Both have a ``text``, all that a worker needs, a ``key``, a hash of what makes results, and the
``software`` that makes them."""


@lru_cache(maxsize=2)
def work_of(text: str) -> Work:
    """`Campaign` or `Archive` of a text; a worker parses it once."""
    return Archive(text) if 'root' in json.loads(text) else Campaign(text)


def run_chunk(text: str, name: str, tasks: list[Any]) -> tuple[str, list[dict[str, Any]]]:
    """Some tasks, as a worker runs them; name of the chunk, rows."""
    work = work_of(text)
    if work.software != software():
        raise WorkerError(
            'a worker runs another version of this software: install the same one everywhere'
        )
    run = work.row if isinstance(work, Archive) else lambda number: run_one(work, number)
    return name, [run(task) for task in tasks]


def chunks_of(campaign: Campaign, size: int = CHUNK) -> dict[str, list[int]]:
    """Runs of a campaign by the name of their chunk."""
    tasks = range(campaign.spec.runs)
    return {f'{k:08d}': [*tasks[k : k + size]] for k in range(0, len(tasks), size)}


@contextmanager
def worker_pool(
    workers: int | None = None, scheduler: str | None = None
) -> Iterator[Callable[[Work, dict[str, list[Any]]], Iterator[tuple[str, list[dict[str, Any]]]]]]:
    """Workers here (0: this process) or of Dask, as a function from chunks to their rows."""
    if scheduler is None and workers == 0:
        yield lambda work, chunks: (run_chunk(work.text, *chunk) for chunk in chunks.items())
        return
    with ExitStack() as stack:
        client = stack.enter_context(
            _local(workers, stack) if scheduler is None else _remote(scheduler)
        )
        yield lambda work, chunks: _mapped(client, work, chunks)


def _local(workers: int | None, stack: ExitStack) -> Any:
    """A cluster of processes, which leave Ctrl-C to the one that started them."""
    from distributed import Client, LocalCluster

    is_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN) if is_main else None
    try:
        cluster = LocalCluster(
            n_workers=workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            host='127.0.0.1',
            dashboard_address='127.0.0.1:0',
            memory_limit=0,
            silence_logs=logging.ERROR,
        )
    finally:
        if is_main:
            signal.signal(signal.SIGINT, before)
    return Client(stack.enter_context(cluster))


def _remote(scheduler: str) -> Any:
    from distributed import Client

    try:
        client = Client(scheduler, timeout=PATIENCE)
    except (OSError, ValueError, ImportError) as error:
        raise WorkerError(f'scheduler {scheduler!r} does not answer: {error}') from error
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        client.close()
        raise WorkerError(f'scheduler {scheduler!r} has no workers') from None
    return client


def _mapped(
    client: Any, work: Work, chunks: dict[str, list[Any]]
) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    from distributed import wait
    from distributed.scheduler import KilledWorker

    left = list(chunks.items())
    pending: set[Any] = set()
    while left or pending:
        names, tasks = zip(*left[:MOST_ENTRIES]) if left and not pending else ((), ())
        left = left[len(names) :]
        # Not pure: a key by content would hash the text again for each chunk.
        pending |= set(client.map(run_chunk, [work.text] * len(names), names, tasks, pure=False))
        try:
            done, pending = wait(pending, _NO_WORKER_TIMEOUT, return_when='FIRST_COMPLETED')
        except TimeoutError:
            if client.nthreads():
                continue
            raise WorkerError(
                f'no worker has been left for {_NO_WORKER_TIMEOUT:g} s; finished work is '
                'kept: start workers and run the command again'
            ) from None
        for future in done:
            try:
                yield future.result()
            except KilledWorker as error:
                raise WorkerError(f'workers died of the same work again: {error}') from error


class ResultsFolder:
    """Results on disk: one Parquet file a chunk, and one of all rows, ``name``, in the end."""

    def __init__(self, path: str | Path, name: str = 'runs') -> None:
        self.path = Path(path)
        self.file, self._chunks = self.path / f'{name}.parquet', self.path / 'chunks'

    def begin(self, work: Work) -> None:
        """Keep what is run, to resume it; ConfigError if something else was begun here."""
        begun = self.load()
        if begun is not None and (begun.key, begun.software) != (work.key, software()):
            raise ConfigError(
                '--out',
                'holds results of another campaign (a file, an option or this software changed): '
                'take another folder, or remove it',
                str(self.path),
            )
        self._chunks.mkdir(parents=True, exist_ok=True)
        write_whole(self.path / 'campaign.json', work.text, sync=True)

    def load(self) -> Work | None:
        """What was begun here; None if nothing was. ConfigError if it cannot be read."""
        file = self.path / 'campaign.json'
        if not file.exists():
            return None
        try:
            if file.stat().st_size > MOST_BYTES:
                raise ValueError('too large')
            return work_of(file.read_text(encoding='utf-8'))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigError('campaign', f'cannot be read ({error})', str(file)) from error

    def missing(self, chunks: dict[str, list[Any]]) -> dict[str, list[Any]]:
        """Chunks that are not here yet."""
        return {name: tasks for name, tasks in chunks.items() if not self._chunk(name).exists()}

    def add(self, name: str, rows: list[dict[str, Any]]) -> None:
        """Write a chunk; it is there as a whole or not at all."""
        _write_table(self._chunk(name), _table(rows))

    def rows(self, chunks: dict[str, list[Any]], others: Sequence[dict[str, Any]] = ()) -> pa.Table:
        """All rows of some chunks that are here, and others that are kept nowhere else."""
        tables = [_table(others)] if others else []
        for file in filter(Path.exists, map(self._chunk, chunks)):
            try:
                tables.append(pq.read_table(file))
            except (pa.ArrowInvalid, OSError) as error:
                raise ConfigError(
                    'results',
                    f'cannot be read ({error}); remove the file to repeat its runs',
                    str(file),
                ) from error
        if not tables:
            raise ConfigError('results', 'there are none', str(self.path))
        table = pa.concat_tables(tables, promote_options='permissive')
        for i, field in enumerate(table.schema):
            if pa.types.is_null(field.type):  # nothing there in any row
                kind = pa.string() if field.name in TEXTS else pa.float64()
                table = table.set_column(i, field.name, table[field.name].cast(kind))
        return table

    def finish(self, table: pa.Table) -> None:
        """Write the file of all rows."""
        _write_table(self.file, table)

    def _chunk(self, name: str) -> Path:
        return self._chunks / f'{name}.parquet'


def _table(rows: Sequence[dict[str, Any]]) -> pa.Table:
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: [row.get(name) for row in rows] for name in names})


def _write_table(path: Path, table: pa.Table) -> None:
    content = pa.BufferOutputStream()
    pq.write_table(table, content)
    # A power cut must not leave a name without content, which would count as done.
    write_whole(path, content.getvalue(), sync=True)
