"""``lpv fleet``: an archive of bags replayed, and the statistics of the fleet."""

import argparse
from pathlib import Path

from rich.console import Console

from lpv.campaign.execution.archive import Archive, archive_text, find_bags
from lpv.campaign.execution.execute import ResultsFolder
from lpv.cli.commands.campaign import execute
from lpv.cli.observing import arm_and_gains, diagnosis_parameters, reading_options
from lpv.core.support.errors import ConfigError


def run(arguments: argparse.Namespace) -> int:
    """Replay what is left, show and write the statistics; 3 if a bag could not be read."""
    console, root = Console(soft_wrap=True, highlight=False, markup=False), Path(arguments.archive)
    out = arguments.out or Path('out') / 'fleet' / (root.resolve().name or 'root')
    folder = ResultsFolder(out, 'bags')
    chunks = find_bags(root, [folder.path])
    if not chunks:
        raise ConfigError('DIR', 'holds no rosbag2 bag', str(root))
    arm, gains = arm_and_gains(arguments, console)
    diagnosis, sampling = diagnosis_parameters(arguments.parameters)
    options = reading_options(arguments)
    archive = Archive(archive_text(root, arm, gains, diagnosis, options, **sampling))
    failed = execute(arguments, archive, folder, chunks, 'bags', console)
    table = folder.rows(chunks, failed).sort_by('bag')
    folder.finish(table)
    # Only here: bags must not wait for plotting.
    from lpv.campaign.report.write import print_summary, write_report

    numbers = write_report(archive, table, folder.path, len(chunks), arguments.healthy)
    print_summary(numbers, console)
    console.print(f'rows    {folder.file}\nreport  {folder.path / "report.html"}')
    return 3 if failed else 0
