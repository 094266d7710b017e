"""Runs a campaign: here, on all cores, or on a cluster; the results are the same."""

import logging
import os
import signal
import threading
from contextlib import contextmanager
from pathlib import Path

import lpv_core
from lpv_campaign.campaign import campaign_of
from lpv_campaign.figures import figures
from lpv_campaign.runs import plan_run
from lpv_core.errors import LpvError
from lpv_core.jit import source_digest

CHUNK = 20
"""Runs that are sent to a worker, and written, together."""
_AHEAD = 3
"""Chunks a worker has in front of it: enough not to wait, few enough to hold in memory."""


class WorkerError(LpvError):
    """A worker does not run the same software, or died of a run."""


def software():
    """Hash of everything that makes the numbers.

    Returns
    -------
    str
        Of the sources of lpv_core and lpv_campaign.
    """
    return '-'.join(source_digest(Path(module).parent) for module in (lpv_core.__file__, __file__))


def run_one(campaign, number):
    """Simulate a run and measure it.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    number : int
        Number of the run.

    Returns
    -------
    dict
        A row of the results.
    """
    try:
        plan = plan_run(campaign, number)
        run = plan.simulate()
        twin = plan.simulate(faults=False) if campaign.spec.twin and plan.scenario.faults else None
    except LpvError as error:
        raise LpvError(f'run {number}: {error}') from error
    return {'number': number, **plan.values, **figures(plan, run, twin)}


def run_chunk(text, numbers):
    """Some runs of a campaign, as a worker does them.

    Parameters
    ----------
    text : str
        `Campaign.text`.
    numbers : list of int
        Runs.

    Returns
    -------
    tuple
        Hash of the worker's software, and a list of rows.
    """
    campaign = campaign_of(text)
    return software(), [run_one(campaign, number) for number in numbers]


def execute(campaign, numbers, workers=None, scheduler=None, chunk=CHUNK):
    """Run a part of a campaign.

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    numbers : sequence of int
        Runs to do.
    workers : int, optional
        Processes of a cluster on this machine; 0: none, all in this process; by default as many as
        there are cores.
    scheduler : str, optional
        Address of a Dask scheduler to use instead.
    chunk : int, optional
        Runs a task.

    Yields
    ------
    list of dict
        Rows, as chunks are done, in any order.

    Raises
    ------
    WorkerError
        If a worker runs other software, or workers die of the same chunk again and again.
    """
    with crew(workers, scheduler) as do:
        yield from do(campaign, numbers, chunk)


@contextmanager
def crew(workers=None, scheduler=None):
    """Workers that stay for more than one campaign.

    Parameters
    ----------
    workers, scheduler
        As in `execute`.

    Yields
    ------
    callable
        Called with a campaign, numbers of runs and, if wanted, the size of a chunk; yields what
        `execute` does.
    """
    if scheduler is None and workers == 0:
        yield _here
        return
    with _client(workers, scheduler) as client:
        yield lambda campaign, numbers, chunk=CHUNK: _on_cluster(
            client, campaign.text, _chunks(numbers, chunk))


def _here(campaign, numbers, chunk=CHUNK):
    for part in _chunks(numbers, chunk):
        yield run_chunk(campaign.text, part)[1]


def _chunks(numbers, chunk):
    return [list(numbers[k:k + chunk]) for k in range(0, len(numbers), chunk)]


def _client(workers, scheduler):
    from distributed import Client, LocalCluster
    if scheduler is not None:
        try:
            return Client(scheduler, timeout=5)
        except (OSError, ValueError, ImportError) as error:
            raise WorkerError(f'scheduler {scheduler!r} does not answer: {error}') from error
    with _deaf_children():
        cluster = LocalCluster(
            n_workers=workers or len(os.sched_getaffinity(0)), threads_per_worker=1,
            host='127.0.0.1', dashboard_address='127.0.0.1:0', memory_limit=0,
            silence_logs=logging.ERROR)
    return _OwnCluster(cluster)


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

    def __init__(self, cluster):
        from distributed import Client
        self._cluster = cluster
        self._client = Client(cluster)

    def __enter__(self):
        return self._client

    def __exit__(self, *_):
        self._client.close()
        self._cluster.close()


def _on_cluster(client, text, chunks):
    from distributed import as_completed
    from distributed.scheduler import KilledWorker
    waiting, mine = iter(chunks), software()

    def submit():
        part = next(waiting, None)
        if part is None:
            return None
        # Not pure: a key by content would hash the text again for each chunk.
        return client.submit(run_chunk, text, part, pure=False)

    first = [f for f in (submit() for _ in range(_width(client))) if f is not None]
    done = as_completed(first)
    for future in done:
        try:
            theirs, rows = future.result()
        except KilledWorker as error:
            raise WorkerError(f'workers died of the same runs again and again: {error}') from error
        if theirs != mine:
            raise WorkerError('a worker runs another version of this software: install the same '
                              'one everywhere')
        another = submit()
        if another is not None:
            done.add(another)
        yield rows


def _width(client):
    return _AHEAD * max(1, sum(client.nthreads().values()))
