"""Alarm events and counters of samples in the words of an operator."""

from lpv_core.decision.diagnosis import GUARANTEED, STATISTICAL, Alarm, AlarmEvent

_EVENTS = {
    AlarmEvent.RAISED: 'ALARM',
    AlarmEvent.UPDATED: 'alarm updated',
    AlarmEvent.CLEARED: 'alarm cleared',
}
_KINDS = {
    'unclassified': 'kind not known yet',
    'spike': 'single wrong readings (spike)',
    'stuck': 'reading stands still (stuck)',
    'noise': 'too much noise',
    'rate_bias': 'of the rate sensor',
    'torque_offset': 'of the torque sensor',
    'torque_gain': 'of the gain of the torque sensor',
}
_UNITS = {'rate_bias': ' {}/s', 'torque_offset': ' N m', 'torque_gain': ''}
"""Of sizes that are no position errors."""
_CERTAIN = 0.9995
"""Confidence from which on only a lower limit is given."""
COUNTER_TEXT = {
    'duplicates': 'measurements with the stamp of the one before, ignored',
    'out_of_order': 'measurements older than the one before, ignored',
    'restarts': 'restarts because the clock was set back',
    'not_finite': 'measurements with NaN or infinite values',
    'implausible': 'measurements with values that this arm cannot reach',
    'gaps': 'interruptions longer than max_gap',
    'late_steps': 'intervals with missing measurements, bridged',
}
"""Fields of `lpv_core.observer.sampled_observer.Counters`, what they count."""


def describe(event: Alarm) -> str:
    """An alarm event as one line: sensor, error with its bound, kind, confidence."""
    head = f'{_EVENTS[event.event]}, {event.sensor}: '
    unit = _UNITS.get(event.kind, ' {}').format(event.unit)
    error = f'{event.size:+.3f}{unit} (bound {event.bound:.3f}{unit})'
    if event.kind == 'dropout':
        over = ' is over' if event.event == AlarmEvent.CLEARED else ''
        return f'{head}no readings (dropout){over}'
    if event.event == AlarmEvent.CLEARED:
        return f'{head}{event.kind} is over, remaining error {error}'
    sure = f'{event.confidence:.1%}' if event.confidence < _CERTAIN else '> 99.9%'
    if event.kind == 'inconsistent':
        return (
            f'{head}inconsistent, cause unknown: rates, torques and model contradict each other; '
            f'error {error} if it is this sensor, confidence {sure}'
        )
    kind = _KINDS.get(event.kind, event.kind)
    if event.basis == GUARANTEED:
        return f'{head}error {error}, {kind}, guaranteed: no healthy arm inside its file reads this'
    if event.basis == STATISTICAL:
        sure += ' (statistical)'
    return f'{head}error {error}, {kind}, confidence {sure}'
