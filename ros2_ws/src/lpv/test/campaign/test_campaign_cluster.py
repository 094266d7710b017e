"""Campaigns on a cluster: the results are those of one process, whoever dies."""

import os
import re
import signal
import subprocess
import sys
import time

import pyarrow.parquet as pq
import pytest
import yaml

from lpv.campaign.execution.execute import WorkerError, chunks_of, worker_pool
from lpv.campaign.execution.runs import run_one
from lpv.campaign.plan.campaign import resolve
from lpv.cli.main import main
from lpv.core.support.resources import shipped_files

pytestmark = pytest.mark.slow

MANY = {
    'name': 'many',
    'seed': 9,
    'designs': [str(shipped_files('gains')['paper'])],
    'duration': 1.5,
    'plan': {'method': 'random', 'runs': 24},
    'factors': {
        'fault.kind': ['none', 'bias', 'drift', 'noise'],
        'fault.size': 0.3,
        'fault.rate': 0.3,
        'fault.onset': {'low': 0.5, 'high': 1.0},
        'path': 'random',
    },
}


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


@pytest.fixture(scope='module')
def campaign():
    return resolve(MANY, 'many', '.')


@pytest.fixture(scope='module')
def serial(campaign):
    """Rows of all runs, one after the other in this process."""
    return [run_one(campaign, number) for number in range(campaign.spec.runs)]


def execute(campaign, workers=None, scheduler=None, size=8):
    """Rows chunk by chunk."""
    with worker_pool(workers, scheduler) as do:
        for _, rows in do(campaign, chunks_of(campaign, size)):
            yield rows


def assert_same(rows, serial):
    assert repr(sorted(rows, key=lambda row: row['number'])) == repr(serial)


def test_given_two_workers_when_one_is_killed_then_no_result_is_lost_or_different(
    cluster, campaign, serial, tmp_path
):
    first, _ = cluster.workers(2)
    rows, killed = [], False
    for part in execute(campaign, scheduler=cluster.address, size=2):
        rows += part
        if not killed:
            kill(first)
            killed = True
    assert killed
    assert_same(rows, serial)
    # The other one did what the dead one had in hand, and is there for the next command.
    file, out = tmp_path / 'few.yaml', tmp_path / 'out'
    few = {**MANY, 'plan': {'method': 'random', 'runs': 10}}
    file.write_text(yaml.safe_dump(few))
    line = ['campaign', str(file), '--out', str(out), '--scheduler', cluster.address]
    assert main([*line, '--no-report']) == 0
    again = pq.read_table(out / 'runs.parquet').to_pylist()
    assert len(again) == 10
    for row, full in zip(again, serial):
        assert repr([row[name] for name in full]) == repr(list(full.values()))


def test_given_a_worker_of_another_version_when_run_then_its_results_are_refused(
    cluster, campaign, monkeypatch
):
    cluster.workers(1)
    monkeypatch.setattr('lpv.campaign.execution.execute.software', lambda: 'another')
    with pytest.raises(WorkerError, match='another version'):
        list(execute(campaign, scheduler=cluster.address))


def test_given_the_last_worker_when_it_dies_then_the_campaign_ends_and_goes_on_with_a_new_one(
    cluster, campaign, monkeypatch
):
    monkeypatch.setattr('lpv.campaign.execution.execute._NO_WORKER_TIMEOUT', 2.0)
    (worker,) = cluster.workers(1)
    found = execute(campaign, scheduler=cluster.address, size=2)
    next(found)
    kill(worker)
    with pytest.raises(WorkerError, match='no worker has been left'):
        list(found)
    with pytest.raises(WorkerError, match='has no workers'):
        next(execute(campaign, scheduler=cluster.address))
    cluster.workers(1)
    assert len(next(execute(campaign, scheduler=cluster.address))) == 8


def test_given_no_scheduler_when_run_then_one_line_says_so(tmp_path, refused):
    file = tmp_path / 'many.yaml'
    file.write_text(yaml.safe_dump(MANY))
    line = ['campaign', str(file), '--out', str(tmp_path / 'out')]
    for address in ('tcp://127.0.0.1:1', 'nonsense://x'):
        assert refused('does not answer', *line, '--scheduler', address)
    assert refused('--workers', *line, '--workers', -1)


def test_given_processes_of_its_own_when_run_then_the_results_are_those_of_one_process(
    campaign, serial
):
    rows = [row for part in execute(campaign, workers=2, size=6) for row in part]
    assert_same(rows, serial)
