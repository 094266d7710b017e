"""Chunks of work on a Dask cluster: local processes, or the workers of a scheduler."""

import asyncio
import logging
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from lpv_core.support.errors import LpvError

_AHEAD = 3
"""Chunks queued per worker: enough to keep it busy, few enough to hold in memory."""

_CONNECT_TIMEOUT = 5.0
"""How long a scheduler may take to answer, and to have a worker [s]."""

_NO_WORKER_TIMEOUT = 60.0
"""Time without any worker after which a campaign gives up [s]."""


class WorkerError(LpvError):
    """A worker does not run the same software, or died of its work."""


def on_cluster(
    function: Callable[..., Any],
    text: str,
    chunks: Iterable[Any],
    software: str,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Any]:
    """Process chunks; a chunk whose worker is killed is done by another one."""
    with connect(workers, scheduler) as client:
        yield from map_chunks(client, function, text, chunks, software)


def connect(
    workers: int | None = None, scheduler: str | None = None
) -> AbstractContextManager[Any]:
    """Client of a cluster, to be used as a context; a cluster of its own ends with it.

    Gives a ``distributed.Client``.
    """
    from distributed import Client, LocalCluster

    if scheduler is not None:
        return _remote(Client, scheduler)
    with _workers_ignore_sigint():
        cluster = LocalCluster(
            n_workers=workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            host='127.0.0.1',
            dashboard_address='127.0.0.1:0',
            memory_limit=0,
            silence_logs=logging.ERROR,
        )
    return _OwnCluster(cluster)


def _remote(connect: Callable[..., Any], scheduler: str) -> Any:
    try:
        client = connect(scheduler, timeout=_CONNECT_TIMEOUT)
    except (OSError, ValueError, ImportError) as error:
        raise WorkerError(f'scheduler {scheduler!r} does not answer: {error}') from error
    try:
        client.wait_for_workers(1, timeout=_CONNECT_TIMEOUT)
    except asyncio.TimeoutError:  # noqa: UP041 - Python 3.10 has two kinds
        client.close()
        raise WorkerError(f'scheduler {scheduler!r} has no workers') from None
    return client


@contextmanager
def _workers_ignore_sigint() -> Iterator[None]:
    """Processes that are started within ignore Ctrl-C: the one that started them ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _OwnCluster:
    """A cluster that ends with its client."""

    def __init__(self, cluster: Any) -> None:
        from distributed import Client

        self._cluster = cluster
        self._client = Client(cluster)

    def __enter__(self) -> Any:
        return self._client

    def __exit__(self, *_: object) -> None:
        self._client.close()
        self._cluster.close()


def map_chunks(
    client: Any, function: Callable[..., Any], text: str, chunks: Iterable[Any], software: str
) -> Iterator[Any]:
    """`on_cluster` with a client that is kept for other work."""
    from distributed.scheduler import KilledWorker

    waiting = iter(chunks)

    def submit() -> Any:
        part = next(waiting, None)
        if part is None:
            return None
        # Not pure: a key by content would hash the text again for each chunk.
        return client.submit(function, text, part, pure=False)

    pending = {f for f in (submit() for _ in range(_width(client))) if f is not None}
    while pending:
        done = _some_of(client, pending)
        pending -= done
        for future in done:
            try:
                version, result = future.result()
            except KilledWorker as error:
                raise WorkerError(
                    f'workers died of the same work again and again: {error}'
                ) from error
            if version != software:
                raise WorkerError(
                    'a worker runs another version of this software: install the '
                    'same one everywhere'
                )
            another = submit()
            if another is not None:
                pending.add(another)
            yield result


def _some_of(client: Any, pending: set[Any]) -> set[Any]:
    """Those of some futures that are done, at least one; a campaign without workers must not wait
    for ever."""
    from distributed import wait

    seen = time.monotonic()
    while time.monotonic() - seen < _NO_WORKER_TIMEOUT:
        try:
            return wait(
                pending, timeout=0.1 * _NO_WORKER_TIMEOUT, return_when='FIRST_COMPLETED'
            ).done
        except asyncio.TimeoutError:  # noqa: UP041
            if client.nthreads():
                seen = time.monotonic()
    raise WorkerError(
        f'no worker has been left for {_NO_WORKER_TIMEOUT:g} s; finished work is kept: '
        'start workers and run the command again'
    )


def _width(client: Any) -> int:
    return _AHEAD * max(1, sum(client.nthreads().values()))
