"""``lpv recover``: repair a bag that is cut off or damaged, and say what was lost."""

import argparse
import logging
import os
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from lpv.bag.errors import BagError
from lpv.bag.rosbag.recovery import Recovery, recover
from lpv.core.support.timestamps import NANOSECONDS


def run(arguments: argparse.Namespace) -> int:
    """Recover, and show what was lost: 3 if anything was, 1 if nothing can be read."""
    logging.getLogger('lpv.bag').setLevel(logging.ERROR)  # all of it is in the result
    bag = Path(arguments.bag)
    out = Path(arguments.out) if arguments.out else None
    try:
        if out is None:
            result = recover(bag)
            if result.damages:
                whole = Path(os.path.abspath(bag))  # `.` has no name
                out = whole.with_name(f'{whole.name.removesuffix(".mcap")}_recovered')
        if out is not None:
            result = recover(bag, out, arguments.preset)
    except BagError as error:
        print(f'lpv recover: {error}', file=sys.stderr)
        return 1
    _show(result, out)
    return 0 if result.nothing_lost else 3


def _show(result: Recovery, out: Path | None) -> None:
    console = Console(soft_wrap=True, highlight=False, markup=False)
    table = Table('topic', 'recovered', 'lost', box=None, header_style='')
    for name, topic in sorted(result.topics.items()):
        lost = f'at least {topic.lost}' if result.cut and topic.lost else str(topic.lost)
        table.add_row(name, str(topic.recovered), lost)
    console.print(*(f'  {text}' for text in result.damages), table, sep='\n')
    if result.attachments:
        console.print(f'{result.attachments} attachments were left out')
    if result.end_missing:
        end = f'{result.end / NANOSECONDS:.3f} s'
        console.print(f'the recording was not finished: what came after its first {end} is lost')
    for name in result.cut[: -1 if result.end_missing else None]:
        console.print(f'{name} was cut off: what came between it and the next file is lost')
    if result.nothing_lost:
        console.print('nothing was lost' if result.damages else 'the bag is whole')
    console.print(f'bag  {out}' if out is not None else 'nothing was written')
