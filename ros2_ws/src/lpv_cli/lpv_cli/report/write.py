"""Puts figures and table into one self-contained HTML file."""

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import jinja2
import matplotlib.pyplot as plt

from lpv_bag.run_record import load_run
from lpv_cli.report import figures
from lpv_cli.report.table import make_table
from lpv_core.diagnosis import AlarmEvent

_CAPTIONS = {
    'path': 'Path of the tip in the plane of the arm (cf. Fig. 4 of the paper).',
    'faults': 'Faults of the physical position sensors and their estimates (cf. Fig. 5). Grey: a '
              'healthy arm stays inside. Shaded: confirmed alarm. Hatched: not diagnosable.',
    'measured': 'Joint positions as measured, with faults, and their references (cf. Fig. 6).',
    'states': 'Joint positions and rates with their estimates (cf. Fig. 7).',
    'torques': 'Joint torques (cf. Fig. 8).',
}


@dataclass(frozen=True)
class ReportResult:
    """What was written.

    Attributes
    ----------
    html : pathlib.Path
        The report.
    pictures : list of pathlib.Path
        PNG files.
    table : list of Row
        Its table.
    """

    html: Path
    pictures: list
    table: list


def write_report(bag, out, arm, path=None, title='Run'):
    """Write the report of a bag.

    Parameters
    ----------
    bag : str or pathlib.Path
        Recorded run.
    out : str or pathlib.Path
        Folder for ``report.html`` and the PNG files.
    arm : ArmParameters
        The arm.
    path : CartesianPath, optional
        Reference path with its obstacle.
    title : str, optional
        Heading.

    Returns
    -------
    ReportResult
        What was written.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    record = load_run(bag)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    drawn = {'path': figures.cartesian(record, arm, path),
             'faults': figures.faults(record, arm.sensor_names),
             'measured': figures.measured(record), 'states': figures.states(record),
             'torques': figures.torques(record)}
    pictures, sections = [], []
    for name, figure in drawn.items():
        if figure is None:
            continue
        pictures.append(out / f'{name}.png')
        sections.append({'caption': _CAPTIONS[name], 'data': _save(figure, pictures[-1])})
    table = make_table(record, arm)
    html = out / 'report.html'
    html.write_text(_render(record, title, table, sections), encoding='utf-8')
    return ReportResult(html, pictures, table)


def _save(figure, path):
    buffer = io.BytesIO()
    figure.savefig(buffer, format='png', dpi=130)
    plt.close(figure)
    path.write_bytes(buffer.getvalue())
    return base64.b64encode(buffer.getvalue()).decode('ascii')


def _render(record, title, table, sections):
    start = record.stamps['joint_states'][0]
    alarms = [{**a, 'at': (a['stamp'] - start) / 1e9, 'since': (a['onset'] - start) / 1e9,
               'what': AlarmEvent(a['event']).name.lower()} for a in record.alarms]
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True,
                                     loader=jinja2.FileSystemLoader(Path(__file__).parent))
    return environment.get_template('report.html').render(
        title=title, duration=record.time[-1], alarms=alarms, counts=sorted(record.counts.items()),
        table=table, sections=sections, compare=any(r.paper is not None for r in table))
