"""Progress of long commands: how much is done, and how long the rest takes."""

from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def counted(console, name: str, total: int, done: int):
    """Bar of a work whose finished part is kept when it is interrupted.

    Parameters
    ----------
    console : rich.console.Console
        Where to.
    name : str
        Of the work.
    total, done : int
        Pieces in all, and those that were done before.

    Yields
    ------
    callable
        Takes the number of pieces that have been done since the last call.
    """
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
            console.print('what is finished is kept; the same command goes on')
            raise
