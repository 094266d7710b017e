"""Alarm events and counters of samples in the words of an operator."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

from lpv.core.serial_arm.description import SerialArm
from lpv.core.serial_arm.diagnosis.alarms import (
    GUARANTEED,
    STATISTICAL,
    Alarm,
    AlarmEvent,
    size_unit,
)
from lpv.core.support.formatting import decimals, sized

_EVENTS = {
    AlarmEvent.RAISED: 'ALARM',
    AlarmEvent.UPDATED: 'alarm updated',
    AlarmEvent.CLEARED: 'alarm cleared',
}
_KINDS = {
    'spike': 'single wrong readings (spike)',
    'stuck': 'reading stands still (stuck)',
    'noise': 'too much noise',
    'rate_bias': 'of the rate sensor',
}
_CERTAIN = 0.9995
"""Confidence from which on only a lower limit is given: with one digit, it is 100.0 %."""
_OF_MANY = re.compile(r's\b')
"""End of the first plural of what is counted."""
UNUSABLE = 'no measurement can be used'
ALMOST_ALL = (0.01, 0.99)
"""Quantiles of positions for `other_unit`: single readings may be anything."""


def _count_of(text: str) -> int:
    """A field that counts what a text says."""
    return field(default=0, metadata={'text': text})


@dataclass
class SampleCounters:
    """How many samples were not usable as they came, with words for an operator."""

    duplicates: int = _count_of('measurements with the stamp of the one before, ignored')
    out_of_order: int = _count_of('measurements older than the one before, ignored')
    restarts: int = _count_of(
        'restarts: the clock was set, or no measurement came for more than 1 s'
    )
    refused_stamps: int = _count_of('measurements whose stamp fits no stream, ignored')
    not_finite: int = _count_of(
        'measurements with NaN or infinite values, or without rates that the arm file calls '
        'independent'
    )
    implausible: int = _count_of('measurements with values that this arm cannot reach')
    gaps: int = _count_of('interruptions after which the balances begin anew')
    unread: int = _count_of(
        'measurements of zeros alone, or of no number, as of a driver that reads no hardware'
    )
    without_effort: int = _count_of('measurements without efforts of all joints')
    repeated: int = _count_of('measurements that the driver repeated while the arm moved')


UNUSED = 'out_of_order', 'refused_stamps', 'not_finite', 'implausible', 'unread', 'repeated'
"""Those that count measurements without use."""


def count_texts(counters: SampleCounters) -> list[str]:
    """What was wrong with samples, and how often."""
    counted = ((getattr(counters, one.name), one.metadata['text']) for one in fields(counters))
    return [f'{count} {text if count > 1 else _OF_MANY.sub("", text, 1)}'
            for count, text in counted if count]  # fmt: skip


def unusable_text(counters: SampleCounters) -> str:
    """That no measurement can be used, and the reasons; empty without any."""
    # The others count times between measurements, and measurements that are used.
    reasons = replace(counters, restarts=0, gaps=0, without_effort=0)
    counts = '; '.join(count_texts(reasons))
    return f'{UNUSABLE}: {counts}' if counts else ''


def other_unit(arm: SerialArm, lowest: Sequence[float], highest: Sequence[float]) -> str:
    """Joint positions that look like degrees or mm, as text; empty if none do."""
    for joint, low, high in zip(arm.joints, lowest, highest):
        if max(-low, high) > joint.farthest:
            unit = 'millimetres' if joint.is_prismatic else 'degrees'
            where = f'{low:.3g} to {high:.3g} {joint.units[0]}, beyond its limits'
            return f'positions of {joint.name} are {where}: {unit}?'
    return ''


def describe(event: Alarm) -> str:
    """An alarm event as one line: sensor, error with its bound, kind, confidence."""
    head = f'{_EVENTS[event.event]}, {event.sensor}: '
    unit, digits = size_unit(event.kind, event.unit), decimals(event.unit)
    error = sized(event.size, event.bound, unit)
    if event.kind == 'dropout':
        over = ' is over' if event.event == AlarmEvent.CLEARED else ''
        return f'{head}no readings (dropout){over}'
    if event.event == AlarmEvent.CLEARED:
        return f'{head}{event.kind} is over, remaining error {error}'
    sure = f'{event.confidence:.1%}' if event.confidence < _CERTAIN else '> 99.9%'
    kind = _KINDS.get(event.kind, event.kind)
    if event.kind == 'drift' and event.rate != 0.0:
        kind += f' of {event.rate:+.{digits}f} {event.unit}/s'
    if event.basis == GUARANTEED:
        return f'{head}error {error}, {kind}, guaranteed: no healthy arm inside its file reads this'
    if event.basis == STATISTICAL:
        sure += ' (statistical)'
    return f'{head}error {error}, {kind}, confidence {sure}'
