"""The main figures of a campaign on the terminal."""

from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from lpv_campaign.report.text import percent, rate
from lpv_core.support.formatting import seconds


def print_summary(numbers: dict[str, Any], console: Console | None = None) -> None:
    """Show the main figures."""
    console = console or Console()
    head, stability = numbers['head'], numbers['stability']
    table = Table(
        title=f'{head["name"]}: {head["runs"]} runs, {head["hours"]:.3g} h simulated',
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column('fault', no_wrap=True)
    table.add_column('sensor', no_wrap=True)
    for name in ('runs', 'found', 'isolated', 'delay', '(95%)', '95% found from'):
        table.add_column(name, justify='right', no_wrap=True)
    for entry in numbers['detection']:
        table.add_row(
            entry['kind'],
            entry['sensor'],
            str(entry['detected']['cases']),
            percent(entry['detected']),
            percent(entry['isolated']),
            seconds(entry['delay']['median']),
            seconds(entry['delay']['high']),
            smallest(entry, '0.95'),
        )
    if numbers['detection']:
        console.print(table)
    else:
        console.print(table.title)
    healthy, after = (numbers['false_alarms'][name] for name in ('before', 'after'))
    console.print(
        f'false alarms of healthy arms: {healthy["events"]} in {healthy["hours"]:.3g} h; '
        f'{rate(healthy)}'
    )
    if after['hours']:
        console.print(
            f'alarms after the end of a fault: {after["events"]} in {after["hours"]:.3g} h'
        )
    console.print(
        f'stable: {percent(stability["stable"])}, unstable {stability["unstable"]}, '
        f'safe stops {stability["safe_stops"]} in {stability["stopped"]} runs'
    )


def smallest(entry: dict[str, Any], probability: str) -> str:
    """Smallest size that is detected with some probability, as text.

    Returns with unit; ``-`` where there is no size, ``not reached`` where it is above all of
    them.
    """
    if not entry['cases']['size']:
        return '-'
    if entry['curve'] is None:
        return 'too few runs'
    found = entry['smallest'][probability]
    if found['size'] is None:
        return 'not reached'
    unit = '' if entry['unit'] == '1' else f' {entry["unit"]}'
    return f'{"< " if found["below"] else ""}{found["size"]:.3g}{unit}'
