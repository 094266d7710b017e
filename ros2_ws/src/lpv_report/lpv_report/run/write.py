"""Puts figures, tables and certificate into one self-contained HTML file."""

import base64
from dataclasses import dataclass
from pathlib import Path

from lpv_bag.run.record import load_run
from lpv_bag.run.streams import RunRecord
from lpv_core.control.path import CartesianPath
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_report.guarantees.detectability import Detectability, detectability
from lpv_report.guarantees.examination import Certificate, examine
from lpv_report.guarantees.gains_source import UsedGains, find_used_gains
from lpv_report.guarantees.loop_certificate import examine_loop
from lpv_report.guarantees.reproduction import Reproduction, reproduce
from lpv_report.history.motion import motion, motion_phases
from lpv_report.history.phases import phases
from lpv_report.run.content import Findings, content
from lpv_report.run.drawing import draw_all
from lpv_report.run.run_page import render
from lpv_report.run.table import make_table
from lpv_report.style import png

_CAPTIONS = {
    'timeline': 'What the diagnosis said of each sensor, and when.',
    'path': 'Path of the tip in the plane of the arm (cf. Fig. 4 of the paper).',
    'faults': 'Faults of the physical position sensors and their estimates (cf. Fig. 5). Grey: a '
    'healthy arm stays inside. Shaded: confirmed alarm. Hatched: not diagnosable.',
    'measured': 'Joint positions as measured, with faults, and their references (cf. Fig. 6).',
    'states': 'Joint positions and rates with their estimates (cf. Fig. 7).',
    'torques': 'Joint torques (cf. Fig. 8).',
    'detectability': 'Smallest lasting fault that is detected for certain, over time. A fault '
    'that stays above the thin line is found by its level alone.',
    'map': 'The same over the angles of both links from the vertical, and where the run went. The '
    'region that the certificate covers ends where the hatching begins.',
}


@dataclass(frozen=True)
class ReportResult:
    """What was written."""

    html: Path  # the report
    pictures: list  # PNG files
    table: list  # its table
    certificate: Certificate | None = None  # of the gains; None where they are not known
    reproduction: Reproduction | None = None  # whether the gains give the recorded estimates


def write_report(
    bag: str | Path,
    out: str | Path,
    arm: Arm,
    path: CartesianPath | None = None,
    title: str = 'Run',
    used: UsedGains | None = None,
) -> ReportResult:
    """Write the report of a bag.

    Parameters
    ----------
    bag : str or pathlib.Path
        Recorded run.
    out : str or pathlib.Path
        Folder for ``report.html`` and the PNG files.
    arm : ArmParameters or SerialArm
        The arm.
    path : CartesianPath, optional
        Reference path with its obstacle.
    title : str, optional
        Heading.
    used : UsedGains, optional
        Gains that the run was answered with; those in the bag if not given.

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
    used = used or find_used_gains(bag)
    findings = Findings(
        record,
        arm,
        title,
        make_table(record, arm),
        used,
        *_guarantees(record, arm, used),
        sorted(
            [*phases(record, bag, arm.sensor_names), *motion_phases(record, arm)],
            key=lambda p: (p.start, p.what, p.sensor),
        ),
        motion(record, arm),
        examine_loop(bag, arm) if isinstance(arm, SerialArm) else None,
    )
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    pictures, figures = [], {}
    for name, figure in draw_all(findings, path):
        data = png(figure)
        pictures.append(out / f'{name}.png')
        pictures[-1].write_bytes(data)
        figures[name] = {'caption': _CAPTIONS[name], 'data': base64.b64encode(data).decode()}
    html = out / 'report.html'
    html.write_text(render(content(findings), figures), encoding='utf-8')
    return ReportResult(html, pictures, findings.table, findings.certificate, findings.reproduction)


def _guarantees(
    record: RunRecord, arm: Arm, used: UsedGains
) -> tuple[Certificate | None, Reproduction | None, Detectability | None]:
    """What is certified of a two-link arm's run; nothing of a serial arm's."""
    if isinstance(arm, SerialArm):
        return None, None, None
    certificate = examine(used, arm)
    gains = used.gains if certificate is not None and not certificate.problem else None
    return (
        certificate,
        reproduce(record, arm, gains) if gains is not None else None,
        detectability(record, arm, gains if certificate and certificate.holds else None),
    )
