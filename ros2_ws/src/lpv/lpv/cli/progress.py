"""What a long command does, and how much of it is done."""

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from lpv.core.support.limits import PATIENCE, QUIET

if TYPE_CHECKING:
    from rich.console import Console

_bars = 0


@contextmanager
def announced(text: str) -> Iterator[None]:
    """Say what a command does if it takes long, and then that it goes on."""
    done = threading.Event()
    thread = threading.Thread(target=_announce, args=(text, done), daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def _announce(text: str, done: threading.Event) -> None:
    begin = time.monotonic()
    if done.wait(QUIET) or _bars:
        return
    print(f'{text} ...', file=sys.stderr, flush=True)
    while not done.wait(2.0 * PATIENCE):
        if not _bars:
            print(f'  {time.monotonic() - begin:.0f} s', file=sys.stderr, flush=True)


@contextmanager
def bar(
    console: 'Console', name: str, total: float, done: float = 0, unit: str = ''
) -> Iterator[Callable[..., None]]:
    """Bar of a work; yields a function that sets what is done and the note behind it."""
    global _bars
    from rich import progress as rich

    count = '{:.1f}/{:.1f} ' + unit if unit else '{:.0f}/{:.0f}'
    _bars += 1
    said = time.monotonic()
    columns = [
        rich.TextColumn('{task.description}', markup=False), rich.BarColumn(),
        rich.TextColumn('{task.fields[count]}'), rich.TimeElapsedColumn(),
        rich.TextColumn('left'), rich.TimeRemainingColumn(), rich.TextColumn('{task.fields[note]}'),
    ]  # fmt: skip
    with rich.Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=total, note='', count='')

        def show(completed: float, note: str = '') -> None:
            nonlocal said
            text = count.format(completed, total)
            progress.update(task, completed=completed, note=note, count=text)
            if not console.is_terminal and time.monotonic() - said > PATIENCE:
                said = time.monotonic()
                line = f'  {name}: {text.replace("/", " of ")}  {note}'
                console.print(line.rstrip(), highlight=False)

        try:
            show(done)
            yield show
        except KeyboardInterrupt:
            if not unit:
                console.print('finished work is kept; run the same command again to resume')
            raise
        finally:
            _bars -= 1
