"""Chunks of work on a Dask cluster: processes of this machine, or whoever a scheduler has."""

import asyncio
import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import Any

from lpv_core.support.errors import LpvError

_AHEAD = 3
"""Chunks a worker has in front of it: enough not to wait, few enough to hold in memory."""

_PATIENCE = 5.0
"""How long a scheduler may take to answer, and to have a worker [s]."""

_LONELY = 60.0
"""After so long without any worker a campaign gives up [s]."""


class WorkerError(LpvError):
    """A worker does not run the same software, or died of its work."""


def on_cluster(
    function: Callable[..., Any],
    text: str,
    chunks,
    software: str,
    workers: int | None = None,
    scheduler: str | None = None,
):
    """Have chunks done; a chunk whose worker is killed is done by another one.

    Parameters
    ----------
    function : callable
        Of ``text`` and a chunk; returns a hash of the worker's software, and the result.
    text : str
        What all chunks have in common.
    chunks : iterable
        Taken as workers get free.
    software : str
        The hash that is expected.
    workers : int, optional
        Processes of a cluster on this machine; by default as many as there are cores.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.

    Yields
    ------
    object
        Results, as chunks are done, in any order.

    Raises
    ------
    WorkerError
        If a worker runs other software, workers die of the same chunk again and again, or none is
        left for a minute.
    """
    with connect(workers, scheduler) as client:
        yield from map_chunks(client, function, text, chunks, software)


def connect(workers=None, scheduler=None):
    """Client of a cluster, to be used as a context; a cluster of its own ends with it.

    Parameters
    ----------
    workers, scheduler
        As in `on_cluster`.

    Returns
    -------
    context manager
        Gives a ``distributed.Client``.

    Raises
    ------
    WorkerError
        If the scheduler does not answer, or has no workers.
    """
    from distributed import Client, LocalCluster

    if scheduler is not None:
        return _remote(Client, scheduler)
    with _deaf_children():
        cluster = LocalCluster(
            n_workers=workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            host='127.0.0.1',
            dashboard_address='127.0.0.1:0',
            memory_limit=0,
            silence_logs=logging.ERROR,
        )
    return _OwnCluster(cluster)


def _remote(connect, scheduler):
    try:
        client = connect(scheduler, timeout=_PATIENCE)
    except (OSError, ValueError, ImportError) as error:
        raise WorkerError(f'scheduler {scheduler!r} does not answer: {error}') from error
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except asyncio.TimeoutError:  # noqa: UP041 - Python 3.10 has two kinds
        client.close()
        raise WorkerError(f'scheduler {scheduler!r} has no workers') from None
    return client


@contextmanager
def _deaf_children():
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

    def __init__(self, cluster) -> None:
        from distributed import Client

        self._cluster = cluster
        self._client = Client(cluster)

    def __enter__(self):
        return self._client

    def __exit__(self, *_) -> None:
        self._client.close()
        self._cluster.close()


def map_chunks(client, function, text, chunks, software):
    """`on_cluster` with a client that stays for other work.

    Parameters
    ----------
    client : distributed.Client
        Of `connect`.
    function, text, chunks, software
        As in `on_cluster`.

    Yields
    ------
    object
        Results, as chunks are done, in any order.

    Raises
    ------
    WorkerError
        As in `on_cluster`.
    """
    from distributed.scheduler import KilledWorker

    waiting = iter(chunks)

    def submit():
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
                theirs, result = future.result()
            except KilledWorker as error:
                raise WorkerError(
                    f'workers died of the same work again and again: {error}'
                ) from error
            if theirs != software:
                raise WorkerError(
                    'a worker runs another version of this software: install the '
                    'same one everywhere'
                )
            another = submit()
            if another is not None:
                pending.add(another)
            yield result


def _some_of(client, pending):
    """Those of some futures that are done, at least one; a campaign without workers must not wait
    for ever."""
    from distributed import wait

    seen = time.monotonic()
    while time.monotonic() - seen < _LONELY:
        try:
            return wait(pending, timeout=0.1 * _LONELY, return_when='FIRST_COMPLETED').done
        except asyncio.TimeoutError:  # noqa: UP041
            if client.nthreads():
                seen = time.monotonic()
    raise WorkerError(
        f'no worker is left since {_LONELY:g} s; what is done is kept: start workers '
        'and run the command again'
    )


def _width(client):
    return _AHEAD * max(1, sum(client.nthreads().values()))
