"""What a report says, as plain values for its template."""

import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lpv_bag.run.streams import RunRecord
from lpv_core.serial_arm.any_arm import Arm
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.timestamps import NANOSECONDS
from lpv_report.guarantees.detectability import Detectability, summary
from lpv_report.guarantees.examination import Certificate
from lpv_report.guarantees.gains_source import UsedGains
from lpv_report.guarantees.loop_certificate import LoopCertificate
from lpv_report.guarantees.reproduction import Reproduction
from lpv_report.history.episodes import Episode, Interval, episodes, missed_faults
from lpv_report.history.motion import Motion
from lpv_report.history.phases import (
    BRAKED,
    INCONSISTENT,
    SAFE_STOP,
    TOO_FAST,
    UNSAFE,
    Phase,
    listed,
)
from lpv_report.run.table import PAPER, Row
from lpv_report.run.terms import TERMS
from lpv_report.run.versions import installed_versions

_CALENDAR = 946684800 * NANOSECONDS
"""Stamps after the year 2000 are dates, others count from the start of something [ns]."""


class Tile(NamedTuple):
    """A figure on top of the page."""

    name: str  # what it is
    value: str  # the figure
    note: str = ''  # a remark
    look: str = ''  # '', good, bad or warn


@dataclass(frozen=True)
class Findings:
    """All that a report is made of."""

    record: RunRecord  # the run
    arm: Arm  # its arm
    title: str  # heading
    table: list[Row]  # of `lpv_report.run.table.make_table`
    used: UsedGains  # gains of the run, or why they are not known
    certificate: Certificate | None  # of the gains
    reproduction: Reproduction | None  # whether the gains give the recorded estimates
    detectable: Detectability | None  # what could be detected
    phases: list[Phase]  # intervals without an answer, stops, speeds above the limits
    motion: Motion  # extremes of the motion
    loop: LoopCertificate | None = None  # of a serial arm's tracking loop


def content(findings: Findings) -> dict[str, Any]:
    """Values for the template."""
    record, arm, certificate = findings.record, findings.arm, findings.certificate
    found, able = findings.phases, findings.detectable
    alarms = episodes(record)
    names = record.sensor_names or arm.sensor_names
    missed = missed_faults(record, alarms)
    truth = 'ground_truth' in record.streams
    shown, rests = listed(found)
    return {
        'title': findings.title,
        'duration': record.time[-1],
        'samples': len(record.time),
        'period': _period(record),
        'begin': _begin(record),
        'warnings': record.warnings,
        'verdict': _verdict(findings, alarms, missed),
        'ran_away': findings.motion.fastest > 1.0,
        'tiles': _tiles(findings, alarms, missed),
        'episodes': alarms,
        'missed': [(names[m.sensor_index], m) for m in missed],
        'have_truth': truth,
        'phases': shown,
        'rests': rests,
        'from_reports': (INCONSISTENT, UNSAFE),
        'have_diagnostics': any(t.endswith('/diagnostics') for t in record.counts),
        'table': findings.table,
        'compare': any(row.paper is not None for row in findings.table),
        'errors': any(row.signal in PAPER for row in findings.table),
        'statistical': isinstance(arm, SerialArm),
        'detectable': summary(able, arm.sensor_names) if able is not None else [],
        'resting': able is not None and able.gains is not None,
        'certificate': certificate,
        'loop': findings.loop,
        'no_gains': findings.used.problem,
        'reproduction': findings.reproduction,
        'no_design': (
            'The gains are not known.'
            if certificate is None
            else 'The certificate does not hold: nothing is guaranteed at rest.'
        ),
        'versions': installed_versions(),
        'counts': sorted(record.counts.items()),
        'arm_facts': _arm_facts(arm),
        'terms': TERMS,
    }


def _period(record: RunRecord) -> str:
    stamps = record.stamps['joint_states']
    return f'{np.median(np.diff(stamps)) / 1e6:.3g}' if len(stamps) > 1 else ''


def _begin(record: RunRecord) -> str:
    stamp = int(record.stamps['joint_states'][0])
    if stamp < _CALENDAR:
        return ''
    return time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime(stamp // NANOSECONDS))


def _count(number: int, one: str, many: str) -> str:
    return f'{number or "no"} {one if number == 1 else many}'


def _verdict(findings: Findings, alarms: list[Episode], missed: list[Interval]) -> str:
    """The answer in a sentence or two; a run that ran away is called that first."""
    record, found = findings.record, findings.phases
    recorded = 'fault_alarm' in record.topics
    sensors = sorted({alarm.sensor for alarm in alarms})
    text = _count(len(alarms), 'alarm', 'alarms') if recorded else 'alarms were not recorded'
    parts = [text[0].upper() + text[1:] + (f', of {" and ".join(sensors)}' if sensors else '')]
    if 'ground_truth' in record.streams and recorded:
        wrong = sum(alarm.false_alarm for alarm in alarms)
        parts.append(
            f'{_count(wrong, "false alarm", "false alarms")}, '
            f'{_count(len(missed), "fault", "faults")} missed'
        )
    stops = sum(phase.what == SAFE_STOP for phase in found)
    odd = sum(phase.what == INCONSISTENT for phase in found)
    brakes = [phase for phase in found if phase.what == BRAKED]
    if brakes:
        reasons = ', '.join(dict.fromkeys(phase.note for phase in brakes))
        times = _count(len(brakes), 'time', 'times')
        parts.append(f'the drives braked {times} ({reasons})')
    parts.append(
        f'{_count(stops, "safe stop", "safe stops")}, '
        f'{_count(odd, "inconsistent phase", "inconsistent phases")}.'
    )
    move, words = findings.motion, '; '.join(parts)
    if move.fastest <= 1.0:
        return words
    lasted = sum(phase.duration for phase in found if phase.what == TOO_FAST)
    return (
        f'The arm exceeded its speed limit for {lasted:.3f} s ({move.joint}: '
        f'{move.speed:.3g} rad/s {move.source}, limit {move.limit:g} rad/s). {words}'
    )


def _tiles(findings: Findings, alarms: list[Episode], missed: list[Interval]) -> list[Tile]:
    record, move = findings.record, findings.motion
    tiles = [Tile('alarms', str(len(alarms)), _ongoing(alarms))]
    if 'ground_truth' in record.streams:
        false = sum(alarm.false_alarm for alarm in alarms)
        delays = [alarm.delay for alarm in alarms if alarm.delay is not None]
        tiles += [
            Tile('false alarms', str(false), look='bad' if false else 'good'),
            Tile('missed faults', str(len(missed)), look='bad' if missed else 'good'),
        ]
        if delays:
            tiles.append(Tile('slowest alarm', f'{max(delays):.3f} s', 'after the fault'))
    stopped = sum(p.duration for p in findings.phases if p.what == SAFE_STOP)
    if 'torque_command' in record.streams:
        tiles.append(Tile('stopped', f'{stopped:.1f} s', look='warn' if stopped else ''))
    limit = f'limit {move.limit:g}, {move.joint}, {move.source}'
    look = 'bad' if move.fastest > 1.0 else ''
    tiles.append(Tile('fastest joint', f'{move.speed:.3g} rad/s', limit, look))
    if move.path_error is not None:
        tiles.append(Tile('farthest from path', f'{move.path_error:.3g} m', 'true tip'))
    if isinstance(findings.arm, SerialArm):
        return [*tiles, Tile('bounds', 'statistical'), _loop_tile(findings.loop)]
    return [*tiles, _certificate_tile(findings.certificate, findings.reproduction)]


def _ongoing(alarms: list[Episode]) -> str:
    active = sum(alarm.cleared is None for alarm in alarms)
    return f'{active} to the end' if active else ''


def _loop_tile(loop: LoopCertificate | None) -> Tile:
    if loop is None or not loop.checks:
        return Tile('certificate of the loop', 'none')
    word, look = ('holds', 'good') if loop.holds else ('fails', 'bad')
    return Tile('certificate of the loop', word, f'{len(loop.checks)} checks', look)


def _certificate_tile(certificate: Certificate | None, again: Reproduction | None) -> Tile:
    if certificate is None:
        return Tile('certificate of the gains', 'unknown', look='warn')
    if certificate.holds and again is not None and not again.same:
        return Tile('certificate of the gains', 'holds', 'the run may have had others', 'warn')
    if certificate.holds:
        return Tile(
            'certificate of the gains', 'holds', f'{len(certificate.checks)} checks', 'good'
        )
    word = 'changed' if not (certificate.problem or certificate.failed) else 'fails'
    return Tile('certificate of the gains', word, look='bad')


def _arm_facts(arm: Arm) -> list[tuple[str, str]]:
    facts = [('name', arm.name), ('SHA-256', arm.sha256()), ('joints', ', '.join(arm.joint_names))]
    if isinstance(arm, SerialArm):
        rates = sorted({joint.sensors.rates for joint in arm.joints})
        return facts + [
            ('position sensors', f'{", ".join(arm.sensor_names)} (of the joints)'),
            ('rates', ', '.join(rates)),
            ('unknown payload', f'up to {arm.uncertainty.payload:g} kg'),
            ('sample time', f'{1000.0 * arm.sample_time:g} ms'),
        ]
    return facts + [
        ('position sensors', f'{", ".join(arm.sensor_names)} ({arm.arrangement} angles)'),
        ('stated model error, payload', f'{100.0 * arm.model_error:g} %, {arm.payload:g} kg'),
        ('sample time', f'{1000.0 * arm.sample_time:g} ms'),
    ]
