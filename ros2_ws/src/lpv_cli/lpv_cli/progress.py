"""Progress of long commands: how much is done, and how long the rest takes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def counted(console: Console, name: str, total: int, done: int) -> Iterator[Callable[[int], None]]:
    """Bar of a work whose finished part is kept when it is interrupted."""
    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn('left'),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=total, completed=done)
        try:
            yield lambda count: progress.advance(task, count)
        except KeyboardInterrupt:
            console.print('finished work is kept; run the same command again to resume')
            raise
