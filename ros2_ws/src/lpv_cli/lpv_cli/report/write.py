"""Puts figures and table into one self-contained HTML file."""

import base64
from dataclasses import dataclass
from pathlib import Path

import jinja2

from lpv_bag.run_record import load_run
from lpv_cli.report.episodes import episodes, missed_faults
from lpv_cli.report.figures import draw_all
from lpv_cli.report.style import png
from lpv_cli.report.table import make_table

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
    record = load_run(bag, joint_names=arm.joint_names)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    pictures, sections = [], []
    for name, figure in draw_all(record, arm, path):
        data = png(figure)
        pictures.append(out / f'{name}.png')
        pictures[-1].write_bytes(data)
        sections.append({'caption': _CAPTIONS[name], 'data': base64.b64encode(data).decode()})
    table = make_table(record, arm)
    html = out / 'report.html'
    html.write_text(_render(record, arm, title, table, sections), encoding='utf-8')
    return ReportResult(html, pictures, table)


def _render(record, arm, title, table, sections):
    found = episodes(record)
    names = record.sensor_names or arm.sensor_names
    missed = [(names[m.sensor_index], m) for m in missed_faults(record, found)]
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined,
        loader=jinja2.FileSystemLoader(Path(__file__).parent))
    return environment.get_template('report.html').render(
        title=title, duration=record.time[-1], episodes=found, missed=missed, table=table,
        have_truth='ground_truth' in record.streams, sections=sections,
        counts=sorted(record.counts.items()),
        compare=any(row.paper is not None for row in table))
