"""Campaigns on a cluster: the results are those of one process, whoever dies."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from campaign_files import SMALL, assert_same, rows_of, written

from lpv.campaign.execution.execute import WorkerError, chunks_of, worker_pool
from lpv.cli.main import main

pytestmark = pytest.mark.slow


class Cluster:
    """A scheduler and workers, each a process of its own, on the loopback address."""

    def __init__(self, folder):
        self._folder, self._workers, self._started = folder, [], 0
        self._scheduler = self._start('scheduler', '--port', '0')
        self.address = self.said('scheduler', r'(tcp://127\.0\.0\.1:\d+)')

    def _start(self, name, *arguments):
        program = 'dask_scheduler' if name == 'scheduler' else 'dask_worker'
        line = [sys.executable, '-m', f'distributed.cli.{program}', *arguments]
        with open(self._folder / f'{name}.log', 'w') as log:
            return subprocess.Popen(
                [*line, '--host', '127.0.0.1', '--no-dashboard'],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                start_new_session=True,
            )

    def workers(self, count):
        """So many living workers that the scheduler knows; those of the test before are kept."""
        self._workers = [one for one in self._workers if one.poll() is None]
        for one in self._workers[count:]:
            kill(one)
        del self._workers[count:]
        while len(self._workers) < count:
            self._started += 1
            name = f'worker{self._started}'
            options = ('--nworkers', '1', '--nthreads', '1', '--no-nanny')
            places = ('--local-directory', str(self._folder / f'{name}.tmp'))
            self._workers.append(self._start(name, self.address, *options, *places))
            self.said(name, r'(Registered to:)')
        return list(self._workers)

    def said(self, name, pattern):
        deadline = time.monotonic() + 600.0
        while time.monotonic() < deadline:
            found = re.search(pattern, (self._folder / f'{name}.log').read_text())
            if found:
                return found[1]
            time.sleep(0.05)
        raise AssertionError((self._folder / f'{name}.log').read_text())

    def close(self):
        self.workers(0)
        kill(self._scheduler)


def kill(process):
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()


@pytest.fixture(scope='module')
def cluster(tmp_path_factory):
    cluster = Cluster(tmp_path_factory.mktemp('cluster'))
    yield cluster
    cluster.close()


def execute(campaign, workers=None, scheduler=None, size=8):
    """Rows chunk by chunk."""
    with worker_pool(workers, scheduler) as do:
        for _, rows in do(campaign, chunks_of(campaign, size)):
            yield rows


def in_order(rows):
    return sorted(rows, key=lambda row: row['number'])


def test_given_two_workers_when_one_is_killed_then_no_result_is_lost_or_different(
    cluster, small, serial, tmp_path
):
    first, _ = cluster.workers(2)
    rows = []
    for part in execute(small, scheduler=cluster.address, size=2):
        rows += part
        if len(rows) == 2:
            kill(first)
    assert_same(in_order(rows), serial)
    # The other one did what the dead one had in hand, and is there for the next command.
    few = {**SMALL, 'plan': {'method': 'random', 'runs': 10}}
    file, out = written(tmp_path / 'few.yaml', few), tmp_path / 'out'
    line = ['campaign', str(file), '--out', str(out), '--scheduler', cluster.address]
    assert main([*line, '--no-report']) == 0
    assert_same(rows_of(out), serial[:10])


def test_given_a_worker_of_another_version_when_run_then_its_results_are_refused(
    cluster, small, monkeypatch
):
    cluster.workers(1)
    monkeypatch.setattr('lpv.campaign.execution.execute.software', lambda: 'another')
    with pytest.raises(WorkerError, match='another version'):
        list(execute(small, scheduler=cluster.address))


def test_given_the_last_worker_when_it_dies_then_the_campaign_ends_and_goes_on_with_a_new_one(
    cluster, small, monkeypatch
):
    monkeypatch.setattr('lpv.campaign.execution.execute._NO_WORKER_TIMEOUT', 2.0)
    (worker,) = cluster.workers(1)
    found = execute(small, scheduler=cluster.address, size=2)
    next(found)
    kill(worker)
    with pytest.raises(WorkerError, match='no worker has been left'):
        list(found)
    with pytest.raises(WorkerError, match='has no workers'):
        next(execute(small, scheduler=cluster.address))
    cluster.workers(1)
    assert len(next(execute(small, scheduler=cluster.address))) == 8


def test_given_no_scheduler_when_run_then_one_line_says_so(tmp_path, refused):
    line = ['campaign', written(tmp_path / 'many.yaml', SMALL), '--out', tmp_path / 'out']
    for address in ('tcp://127.0.0.1:1', 'nonsense://x'):
        assert refused('does not answer', *line, '--scheduler', address)
    assert refused('--workers', *line, '--workers', -1)


def test_given_processes_of_its_own_when_run_then_the_results_are_those_of_one_process(
    small, serial
):
    rows = [row for part in execute(small, workers=2, size=6) for row in part]
    assert_same(in_order(rows), serial)
