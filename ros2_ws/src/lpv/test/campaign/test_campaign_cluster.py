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
    'duration': 2.0,
    'plan': {'method': 'random', 'runs': 160},
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
        self._folder, self._processes = folder, []
        self._start('scheduler', '--host', '127.0.0.1', '--port', '0', '--no-dashboard')
        self.address = self.said('scheduler', r'(tcp://127\.0\.0\.1:\d+)')

    def _start(self, name, *arguments):
        program = 'dask_scheduler' if name == 'scheduler' else 'dask_worker'
        with open(self._folder / f'{name}.log', 'w') as log:
            process = subprocess.Popen(
                [sys.executable, '-m', f'distributed.cli.{program}', *arguments],
                stdout=log,
                stderr=log,
                cwd=self._folder,
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def worker(self, name):
        """Start a worker and wait until the scheduler knows it."""
        process = self._start(
            name,
            self.address,
            '--host',
            '127.0.0.1',
            '--nworkers',
            '1',
            '--nthreads',
            '1',
            '--no-nanny',
            '--no-dashboard',
            '--local-directory',
            str(self._folder / f'{name}.tmp'),
        )
        self.said(name, r'(Registered to:)')
        return process

    def said(self, name, pattern):
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline:
            found = re.search(pattern, (self._folder / f'{name}.log').read_text())
            if found:
                return found[1]
            time.sleep(0.05)
        raise AssertionError((self._folder / f'{name}.log').read_text())

    def close(self):
        for process in reversed(self._processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture
def cluster(tmp_path):
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


def execute(campaign, runs, workers=None, scheduler=None, size=20):
    """Rows of the first runs, chunk by chunk."""
    chunks = {name: part for name, part in chunks_of(campaign, size).items() if part[-1] < runs}
    with worker_pool(workers, scheduler) as do:
        for _, rows in do(campaign, chunks):
            yield rows


def test_given_two_workers_when_one_is_killed_then_no_result_is_lost_or_different(
    cluster, tmp_path
):
    workers = [cluster.worker('one'), cluster.worker('two')]
    campaign = resolve(MANY, 'many', '.')
    rows, killed = [], False
    for part in execute(campaign, 160, scheduler=cluster.address, size=5):
        rows += part
        if not killed and len(rows) >= 40:
            os.killpg(workers[0].pid, signal.SIGKILL)
            killed = True
    assert killed and workers[0].wait() == -signal.SIGKILL
    rows.sort(key=lambda row: row['number'])
    assert [row['number'] for row in rows] == list(range(160))
    assert repr(rows) == repr([run_one(campaign, number) for number in range(160)])
    # The other one did what the dead one had in hand, and is there for the next command.
    file, out = tmp_path / 'few.yaml', tmp_path / 'out'
    few = {**MANY, 'plan': {'method': 'random', 'runs': 30}}
    file.write_text(yaml.safe_dump(few))
    assert main(['campaign', str(file), '--out', str(out), '--scheduler', cluster.address]) == 0
    again = pq.read_table(out / 'runs.parquet').to_pylist()
    for row, full in zip(again, rows):
        assert repr([row[name] for name in full]) == repr(list(full.values()))


def test_given_a_worker_of_another_version_when_run_then_its_results_are_refused(
    cluster, monkeypatch
):
    cluster.worker('one')
    monkeypatch.setattr('lpv.campaign.execution.execute.software', lambda: 'another')
    with pytest.raises(WorkerError, match='another version'):
        list(execute(resolve(MANY, 'many', '.'), 20, scheduler=cluster.address))


def test_given_the_last_worker_when_it_dies_then_the_campaign_ends_and_goes_on_with_a_new_one(
    cluster, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr('lpv.campaign.execution.execute._NO_WORKER_TIMEOUT', 2.0)
    worker, file, out = cluster.worker('one'), tmp_path / 'many.yaml', tmp_path / 'out'
    file.write_text(yaml.safe_dump(MANY))
    command = [
        'campaign',
        str(file),
        '--out',
        str(out),
        '--scheduler',
        cluster.address,
        '--no-report',
    ]
    found = execute(resolve(MANY, 'many', '.'), 160, scheduler=cluster.address, size=5)
    next(found)
    os.killpg(worker.pid, signal.SIGKILL)
    with pytest.raises(WorkerError, match='no worker has been left'):
        list(found)
    cluster.worker('two')
    assert main(command) == 0
    assert pq.read_table(out / 'runs.parquet').num_rows == 160


def test_given_a_scheduler_without_workers_when_run_then_one_line_says_so(cluster):
    with pytest.raises(WorkerError, match='has no workers'):
        next(execute(resolve(MANY, 'many', '.'), 20, scheduler=cluster.address))


def test_given_no_scheduler_when_run_then_one_line_says_so(tmp_path, capsys, monkeypatch):
    file = tmp_path / 'many.yaml'
    file.write_text(yaml.safe_dump(MANY))
    for address in ('tcp://127.0.0.1:1', 'nonsense://x'):
        assert (
            main(['campaign', str(file), '--out', str(tmp_path / 'out'), '--scheduler', address])
            == 2
        )
        assert 'does not answer' in capsys.readouterr().err
    assert main(['campaign', str(file), '--out', str(tmp_path / 'out'), '--workers', '-1']) == 2


def test_given_processes_of_its_own_when_run_then_the_results_are_those_of_one_process():
    campaign = resolve(MANY, 'many', '.')
    rows = [row for part in execute(campaign, 60, workers=2, size=10) for row in part]
    rows.sort(key=lambda row: row['number'])
    assert repr(rows) == repr([run_one(campaign, number) for number in range(60)])
