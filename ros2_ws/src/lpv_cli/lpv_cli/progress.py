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
def counted(
    console: Console, name: str, total: int, done: int, note: str = ''
) -> Iterator[Callable[..., None]]:
    """Bar of a work whose finished part is kept when it is interrupted.

    Yields a function that advances the bar, by 1 if not said, and may change the note behind it.
    """
    columns = (
        TextColumn('{task.description}'),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn('left'),
        TimeRemainingColumn(),
        TextColumn('{task.fields[note]}'),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=total, completed=done, note=note)

        def advance(count: int = 1, note: str = note) -> None:
            progress.update(task, advance=count, note=note)

        try:
            yield advance
        except KeyboardInterrupt:
            console.print('finished work is kept; run the same command again to resume')
            raise


@contextmanager
def steps(console: Console, name: str, total: int) -> Iterator[Callable[[str], None]]:
    """Bar of a work of a few steps; yields a function that says what is done next."""
    columns = (TextColumn('{task.description}'), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(name, total=total)
        begun = False

        def begin(step: str) -> None:
            nonlocal begun
            progress.update(task, description=f'{name}: {step}', advance=int(begun))
            begun = True
            if not console.is_terminal:
                console.print(f'{name}: {step}')

        yield begin
