"""Runs a campaign: here, on all cores, or on a cluster; the results are the same."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import lpv_campaign
import lpv_core
from lpv_campaign.execution.cluster import WorkerError, connect, map_chunks
from lpv_campaign.execution.run_metrics import figures
from lpv_campaign.execution.runs import RunPlan, plan_run
from lpv_campaign.limit.accuracy import limit_figures
from lpv_campaign.plan.campaign import Campaign, campaign_of
from lpv_campaign.plan.spec import CampaignSpec
from lpv_core.simulation.closed_loop import Run
from lpv_core.support.errors import LpvError
from lpv_core.support.jit import source_digest

__all__ = [
    'CHUNK',
    'WorkerError',
    'worker_pool',
    'execute',
    'has_limit',
    'run_chunk',
    'run_one',
    'software',
]
CHUNK = 20
"""Runs that are sent to a worker, and written, together."""


def software() -> str:
    """Hash of everything that makes the numbers."""
    return '-'.join(
        source_digest(Path(module).parent) for module in (lpv_core.__file__, lpv_campaign.__file__)
    )


def run_one(campaign: Campaign, number: int) -> dict[str, Any]:
    """Simulate a run and measure it."""
    try:
        plan = plan_run(campaign, number)
        run = plan.simulate()
        twin = plan.simulate(faults=False) if campaign.spec.twin and plan.scenario.faults else None
    except LpvError as error:
        raise LpvError(f'run {number}: {error}') from error
    row = {'number': number, **plan.values, **figures(plan, run, twin)}
    if has_limit(campaign.spec, number) and isinstance(plan, RunPlan) and isinstance(run, Run):
        row.update(_limits(plan, run))
    return row


def _limits(plan: RunPlan, run: Run) -> dict[str, float]:
    if not np.isfinite(run.position).all():
        return {}
    found = limit_figures(plan.arm, plan.scenario, run, substeps=plan.substeps)
    return {f'limit_{name}': value for name, value in found.items()}


def has_limit(spec: CampaignSpec, number: int) -> bool:
    """Whether the estimates of a run are compared with the best possible ones."""
    return (number + 1) * spec.limit // spec.runs > number * spec.limit // spec.runs


def run_chunk(text: str, numbers: list[int]) -> tuple[Any, ...]:
    """Some runs of a campaign, as a worker runs them."""
    campaign = campaign_of(text)
    return software(), [run_one(campaign, number) for number in numbers]


def execute(
    campaign: Campaign,
    numbers: Sequence[int],
    workers: int | None = None,
    scheduler: str | None = None,
    chunk: int = CHUNK,
) -> Iterator[list[dict[str, Any]]]:
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
    with worker_pool(workers, scheduler) as do:
        yield from do(campaign, numbers, chunk)


@contextmanager
def worker_pool(
    workers: int | None = None, scheduler: str | None = None
) -> Iterator[Callable[..., Any]]:
    """Workers that serve several campaigns."""
    if scheduler is None and workers == 0:
        yield _here
        return
    with connect(workers, scheduler) as client:
        yield lambda campaign, numbers, chunk=CHUNK: map_chunks(
            client, run_chunk, campaign.text, _chunks(numbers, chunk), software()
        )


def _here(
    campaign: Campaign, numbers: Sequence[int], chunk: int = CHUNK
) -> Iterator[list[dict[str, Any]]]:
    for part in _chunks(numbers, chunk):
        yield run_chunk(campaign.text, part)[1]


def _chunks(numbers: Sequence[int], chunk: int) -> list[list[int]]:
    return [list(numbers[k : k + chunk]) for k in range(0, len(numbers), chunk)]
