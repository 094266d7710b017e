"""Gathers all numbers of a campaign, draws them, writes ``report.html`` and ``report.json``."""

import json
import math
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import yaml
from rich.console import Console

from lpv.campaign.plan.campaign import Campaign
from lpv.campaign.plan.spec import BOTH, NO_FAULT, Choice
from lpv.campaign.report import figures
from lpv.campaign.report.statistics import (
    DOSES,
    Results,
    found_from,
    poisson_rate,
    proportion,
    share,
    spread,
    trends,
)
from lpv.core.simulation.faults import KINDS
from lpv.core.support.config import write_whole
from lpv.core.support.formatting import number, seconds
from lpv.report.page import Tile, finite, write_page
from lpv.report.table import print_grid

_CAPTIONS = {
    figures.detection: 'Above: how often a fault of a size is detected, with 95% intervals. Below: '
    'delay from onset to alarm, with 5 to 95%.',
    figures.trends: 'Mean fault estimates of the arms that change clearly.',
}
_CLASSES, _LEVELS = 8, 12
"""Classes of sizes, and values of a factor, that a table or figure has room for."""
_MOST = 10
"""Rows of tables that are examples; all are in the Parquet file."""
_ALONE = 'no alarm of another sensor'
_MOST_BAGS = 500
"""Rows of a table of bags; all are in the Parquet file."""


def write_report(
    work: Any, table: pa.Table, folder: Path, planned: int, healthy: bool = False
) -> dict[str, Any]:
    """Write ``report.html`` and ``report.json``; its numbers. ``healthy``: all alarms are false."""
    numbers = report_numbers(work, table, folder, planned, healthy)
    content = {**numbers, 'title': numbers['head']['name'], 'text': _TEXT}
    write_page(folder / 'report.html', Path(__file__).parent, _CAPTIONS, numbers, content)
    write_whole(folder / 'report.json', json.dumps(numbers, allow_nan=False, indent=1))
    return numbers


def report_numbers(
    work: Any, table: pa.Table, folder: Path, planned: int, healthy: bool = False
) -> dict[str, Any]:
    """All numbers of the report; None in place of what is not finite."""
    units = dict(zip(work.arm.sensor_names, work.arm.position_units))
    results = Results(table, units)
    bags = not isinstance(work, Campaign)
    failed = results.text('error') != ''
    failures = [row for row, bad in zip(table.to_pylist(), failed) if bad]
    if failures:
        results = Results(table.filter(pa.array(~failed)), units)
    faulty, kinds = results.faulty, (*KINDS, NO_FAULT)
    sensors = (*results.sensors, BOTH, NO_FAULT)
    said = [results.text(f'said_{name}', NO_FAULT)[faulty] for name in ('kind', 'sensor')]
    isolation = {  # of kinds and sensors in runs with a fault; alarms in runs without one
        'kind': confusion(results.kind[faulty], said[0], kinds),
        'sensor': confusion(results.sensor[faulty], said[1], sensors),
        'healthy': share(results.number('false_alarms') > 0.0, results.kind == NO_FAULT),
    }
    numbers: dict[str, Any] = {
        'head': _head(work, results, planned, len(failures)),
        'overall': _overall(results),
        'alarms': _alarms(results, bags, healthy),
        'detection': _detection(results),
        'isolation': isolation,
        'estimates': _estimates(results),
        'groups': _groups(work, results),
        'stops': _stops(results),
        'worst': [] if bags else _worst(results, folder),
        'bags': _ranking(results)[:_MOST_BAGS] if bags else [],
        'failures': [{name: row[name] for name in ('bag', 'error')} for row in failures],
        'trends': trends(results) if bags else [],
    }
    numbers['tiles'] = _tiles(numbers, bags)
    return finite(numbers)


def _head(work: Any, results: Results, planned: int, failed: int) -> dict[str, Any]:
    head = {
        'arm': work.arm.name,
        'arm_sha256': work.arm.sha256(),
        'unit': results.unit(BOTH),
        'count': results.count,
        'planned': planned,
        'missing': max(planned - results.count - failed, 0),
        'failed': failed,
        'hours': float(np.nansum(results.number('observed'))) / 3600.0,
        'software': work.software,
    }
    if not isinstance(work, Campaign):
        name = f'Bags of {work.root.name}'
        return {**head, 'name': name, 'what': 'bags', 'spec': '', 'gains': {}}
    gains = {
        name: {'method': data['observer']['method'], 'decay': data['observer'].get('decay')}
        for name, data in work.content['gains'].items()
    }
    spec = yaml.safe_dump(work.content['spec'], sort_keys=False, allow_unicode=True, width=90)
    name = f'Campaign {work.spec.name}'
    return {**head, 'name': name, 'what': 'runs', 'spec': spec, 'gains': gains}


def _overall(results: Results) -> dict[str, Any]:
    return {
        'detected': share(results.flag('detected'), results.faulty),
        'isolated': share(results.flag('isolated'), results.faulty),
        'wrong': share(results.number('wrong_alarms') > 0.0, results.faulty),
        'stable': share(results.flag('stable'), np.isfinite(results.number('stable'))),
        'safe_stops': int(np.nansum(results.number('safe_stops'))),
        'stopped': int(np.count_nonzero(results.number('safe_stops') > 0.0)),
    }


def _stops(results: Results) -> list[dict[str, Any]]:
    """Runs with safe stops by their reasons, the most frequent one first."""
    found: dict[str, list[int]] = {}
    for run, reasons in zip(results.number('number'), results.text('stop_reasons')):
        for reason in reasons.split('; ') if reasons else ():
            found.setdefault(reason, []).append(int(run))
    pairs = sorted(found.items(), key=lambda pair: -len(pair[1]))
    return [{'reason': one, 'runs': len(runs), 'numbers': runs[:_MOST]} for one, runs in pairs]


def _alarms(results: Results, bags: bool, healthy: bool) -> list[dict[str, Any]]:
    """Rates of alarms per hour, by what they are."""
    observed = np.nan_to_num(results.number('observed'))
    rates = []
    if bags:
        for i, sensor in enumerate(results.sensors):
            events = np.nansum(results.number(f'alarms_{i + 1}'))
            rates.append(('alarms of ' + sensor, events, observed.sum()))
        rates.append(('alarms of all sensors', np.nansum(results.number('alarms')), observed.sum()))
    false, time = results.number('false_alarms'), results.number('healthy_time')
    if healthy:
        unknown = np.isnan(false)
        false = np.where(unknown, results.number('alarms'), false)
        time = np.where(unknown, observed, time)
    before, early = np.nansum(results.each('alarms_before')), results.number('early_time')
    after = max(np.nansum(results.number('false_alarms')) - before, 0.0)
    rest = np.nansum(results.number('healthy_time') - early)
    rates += [
        ('false alarms', np.nansum(false), np.nansum(time)),
        ('before any fault, or without one', before, np.nansum(early)),
        ('after the end of a fault', after, rest),
    ]
    return [{'name': name, **poisson_rate(n, time / 3600.0)} for name, n, time in rates]


def _detection(results: Results) -> list[dict[str, Any]]:
    """Detection of each kind of fault by each sensor, over its size."""
    entries = []
    found, isolated = results.flag('detected'), results.flag('isolated')
    delay, size = results.number('detection_delay'), results.number('fault_size')
    for kind in results.kinds:
        for sensor in (*results.sensors, BOTH):
            mine = results.several if sensor == BOTH else results.sensor == sensor
            chosen = (results.kind == kind) & mine
            if not chosen.any():
                continue
            known = np.flatnonzero(chosen & (size > 0.0) & (kind in DOSES))
            dose, unit = (part.format(results.unit(sensor)) for part in DOSES.get(kind, ('', '')))
            # Classes of about equal numbers, or one a level where there are few levels.
            levels = np.unique(size[known])
            parts = [known[size[known] == level] for level in levels]
            if len(levels) > _LEVELS:
                order = known[np.argsort(size[known], kind='stable')]
                parts = np.array_split(order, min(_CLASSES, len(order)))
            classes = [(np.median(size[p]), share(found[p]), spread(delay[p])) for p in parts]
            entries.append(
                {
                    **{'kind': kind, 'sensor': sensor, 'dose': dose, 'unit': unit},
                    'detected': share(found, chosen),
                    'isolated': share(isolated, chosen),
                    'delay': spread(delay[chosen]),
                    'size_error': spread(results.number('size_error')[chosen]),
                    **{'sizes': size[known].tolist(), 'delays': delay[known].tolist()},
                    'found_from': found_from(size[known], found[known]),
                    'classes': [
                        {'middle': float(middle), 'detected': rate, 'delay': late}
                        for middle, rate, late in classes
                    ],
                }
            )
    return entries


def confusion(truth: np.ndarray, said: np.ndarray, order: Sequence[str]) -> dict[str, Any]:
    """Counts of what was said of what was there; rates of right answers, of all and of said."""

    def occurring(values: np.ndarray) -> list[str]:
        return [name for name in order if name in values] + sorted(set(values) - set(order))

    rows, columns, pairs = occurring(truth), occurring(said), Counter(zip(truth, said))
    totals = Counter(truth)
    return {
        'rows': rows,
        'columns': columns,
        'counts': [[pairs[row, column] for column in columns] for row in rows],
        'right': [proportion(pairs[row, row], totals[row]) for row in rows],
        'right_if_said': [
            proportion(pairs[row, row], totals[row] - pairs[row, NO_FAULT]) for row in rows
        ],
    }


def _estimates(results: Results) -> list[dict[str, Any]]:
    """RMS error of each sensor's estimate, RMS without truth, and mean threshold."""
    truth = np.isfinite(results.each('error_rms')).any()
    names = ('error_rms', 'mean_threshold') if truth else ('fault_rms', 'threshold_mean')
    values, thresholds = map(results.each, names)
    return [
        {
            'sensor': sensor,
            'unit': results.unit(sensor),
            'what': 'RMS error of estimates' if truth else 'RMS of estimates',
            'error': spread(values[:, i]),
            'threshold': spread(thresholds[:, i]),
        }
        for i, sensor in enumerate(results.sensors)
    ]


def _groups(work: Any, results: Results) -> list[dict[str, Any]]:
    """Figures by kind of fault, and by each value of other factors that take a few."""
    columns = {'kind': [NO_FAULT, *results.kinds]}
    for name, varied in work.spec.factors.items() if isinstance(work, Campaign) else ():
        if not name.startswith('fault.') and isinstance(varied, Choice):
            columns[name] = [str(value) for value in varied.values[:_LEVELS]]
    tables = []
    for factor, values in columns.items():
        groups = []
        for value in values if len(values) > 1 else ():
            chosen = pa.array(results.text(factor) == value)
            part = Results(results.table.filter(chosen), results.units)
            well = part.flag('stable')
            group = {'value': value, 'count': part.count, **_overall(part)}
            group['delay'] = spread(part.number('detection_delay'))
            group['false'] = _alarms(part, False, False)[0]
            for name in ('rms', 'rms_during', 'ratio'):
                group[name.removeprefix('rms_')] = spread(part.number(f'tracking_{name}')[well])
            groups.append(group)
        if groups:
            tables.append({'factor': factor, 'groups': groups})
    return tables


def _worst(results: Results, folder: Path) -> list[dict[str, Any]]:
    """Lists of single runs, each with the command that writes it as a bag."""
    error, size = results.number('tracking_max'), results.number('fault_size')
    # A run that ended in no number at all is the worst.
    lost = np.where(np.isnan(error) & ~results.flag('stable'), math.inf, error)
    relative = np.ones(results.count)
    for kind in results.kinds:
        mine = (results.kind == kind) & np.isfinite(size)
        relative[mine] = size[mine] / size[mine].max(initial=1e-300)
    missed = results.faulty & ~results.flag('detected')
    alarms = results.number('false_alarms')
    lists = (
        ('Largest tracking errors', f'[{results.unit(BOTH)}]', lost),
        ('Undetected, largest faults', 'of the largest', np.where(missed, relative, np.nan)),
        ('Longest delays', '[s]', results.number('detection_delay')),
        ('Most false alarms', '', np.where(alarms > 0.0, alarms, np.nan)),
    )
    numbers = results.number('number')
    found, said = [], results.text('said_kind')
    for title, unit, values in lists:
        order = np.lexsort((numbers, -np.nan_to_num(values, nan=-math.inf)))
        rows = [
            {
                'number': int(numbers[k]),
                'kind': results.kind[k],
                'sensor': results.sensor[k],
                'size': float(size[k]),
                'said': said[k],
                'value': float(values[k]),
                'command': command(folder, int(numbers[k])),
            }
            for k in [k for k in order if not np.isnan(values[k])][:_MOST]
        ]
        found.append({'title': title, 'unit': unit, 'runs': rows})
    return found


def command(folder: str | Path, number: int) -> str:
    """Command that writes a run as a bag."""
    bag = Path(folder) / 'bags' / f'run_{number}'
    return f'lpv campaign {shlex.quote(str(folder))} --run {number} --bag {shlex.quote(str(bag))}'


def _ranking(results: Results) -> list[dict[str, Any]]:
    """Bags, the most suspicious first: alarms, then contradictions, then how near a threshold."""
    rows = []
    for row in results.table.to_pylist():
        scores = [row[f'score_{i + 1}'] or 0.0 for i in range(len(results.sensors))]
        alarms = [f'{a["count"]} {a["kind"]} of {a["sensor"]}' for a in row['alarm_list']]
        names = ('bag', 'unit', 'observed', 'inconsistent_time', 'warnings', 'alarms')
        found = {name: row[name] for name in names}
        rows.append({**found, 'alarm_text': ', '.join(alarms), 'score': max(scores)})
    return sorted(rows, key=suspicion, reverse=True)


def suspicion(row: dict[str, Any]) -> tuple[Any, ...]:
    """What bags are sorted by."""
    share = row['inconsistent_time'] / row['observed'] if row['observed'] else 0.0
    return row['alarms'] > 0, share > 0.01, row['score'], row['bag']


def _tiles(numbers: dict[str, Any], bags: bool) -> list[Tile]:
    head, overall = numbers['head'], numbers['overall']
    false = next(rate for rate in numbers['alarms'] if rate['name'] == 'false alarms')
    tiles = [
        Tile(head['what'], head['count'], f'{number(head["hours"])} h'),
        Tile('false alarms', false['events'], f'in {number(false["hours"])} h without a fault'),
    ]
    if (found := overall['detected'])['cases']:
        tiles += [
            Tile('faults detected', percent(found), f'of {found["cases"]}'),
            Tile('detected and isolated', percent(overall['isolated']), _ALONE),
        ]
    if overall['stable']['cases']:
        unstable = overall['stable']['cases'] - overall['stable']['hits']
        tiles.append(Tile('unstable runs', unstable, f'safe stops in {overall["stopped"]}'))
    if bags:
        clear = sum(trend['clear'] for trend in numbers['trends'])
        tiles.append(Tile('clear trends', clear, f'{head["failed"]} bags could not be read'))
    return tiles


def percent(share: dict[str, Any]) -> str:
    """A rate as text, or ``-``."""
    return '-' if share['rate'] is None else f'{100.0 * share["rate"]:.1f}%'


def _size(entry: dict[str, Any]) -> str:
    """Smallest size from which on 95 % are detected."""
    unit = '' if entry['unit'] in ('', '1') else f' {entry["unit"]}'
    return '-' if entry['found_from'] is None else f'{entry["found_from"]:.3g}{unit}'


_TEXT = {'number': number, 'percent': percent, 'size': _size}


def print_summary(numbers: dict[str, Any], console: Console) -> None:
    """Show the main figures on the terminal."""
    head, overall = numbers['head'], numbers['overall']
    console.print(f'{head["name"]}: {head["count"]} {head["what"]}, {head["hours"]:.3g} h')
    of_faults = ('>cases', '>found', '>isolated', '>delay', '>(95%)', '>95% from')
    print_grid(console, ('fault', 'sensor', *of_faults), [
        (e['kind'], e['sensor'], str(e['detected']['cases']), percent(e['detected']),
         percent(e['isolated']), seconds(e['delay']['median']), seconds(e['delay']['high']),
         _size(e))
        for e in numbers['detection']
    ])  # fmt: skip
    print_grid(console, ('alarms', '>number', '>hours', '>per hour', '>95% interval'), [
        (rate['name'], str(rate['events']), number(rate['hours']), number(rate['rate']),
         f'{number(rate["low"])} to {number(rate["high"])}')
        for rate in numbers['alarms'] if rate['hours']
    ])  # fmt: skip
    if overall['stable']['cases']:
        stops = f'safe stops {overall["safe_stops"]} in {overall["stopped"]} runs'
        console.print(f'stable: {percent(overall["stable"])}, {stops}')
    print_grid(console, ('reason of safe stops', '>runs', 'first of them'), [
        (row['reason'], str(row['runs']), ', '.join(map(str, row['numbers'])))
        for row in numbers['stops']
    ])  # fmt: skip
    print_grid(console, ('most suspicious', 'arm', 'alarms', '>estimate / threshold'), [
        (row['bag'], row['unit'] or '-', row['alarm_text'] or 'none', number(row['score']))
        for row in numbers['bags'][:_MOST]
    ])  # fmt: skip
    for one in (trend for trend in numbers['trends'] if trend['clear']):
        change = f'{one["slope"]:+.2e} {one["position_unit"]} per day'
        left = f'reaches its threshold in {number(one["days_left"])} days'
        console.print(f'trend   {one["unit"] or "-"}, {one["sensor"]}: {change}, {left}')
    for row in numbers['failures'][:_MOST]:
        console.print(f'failed  {row["bag"]}: {row["error"]}')
