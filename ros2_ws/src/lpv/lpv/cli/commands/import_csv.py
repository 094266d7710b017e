"""``lpv import-csv``: a CSV recording of an arm becomes a bag."""

import argparse
import sys
from pathlib import Path

from lpv.bag.run.csv_import import import_csv, load_column_map
from lpv.core.support.resources import bringup_file


def run(arguments: argparse.Namespace) -> int:
    """Import."""
    columns = load_column_map(bringup_file('columns', arguments.columns))
    out = Path(arguments.out)
    count, warnings = import_csv(arguments.csv, columns, out, arguments.topic, arguments.delimiter)
    for text in warnings:
        print(f'warning: {text}', file=sys.stderr)
    print(f'{count} samples of {", ".join(columns.joints)} written to {out}')
    return 0
