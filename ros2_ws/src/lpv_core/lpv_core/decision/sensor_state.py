"""What is known of one position sensor: constants, the present sample, and the state of its alarm.

The functions of `lpv_core.decision.sensor_decision`, `lpv_core.residual.onset_estimation` and `lpv_core.decision.fault_magnitude` work
on them: ``c`` (`SENSOR_CONSTANTS`), ``s`` (`SENSOR_STATE`), and the sensor's past, ``stamps`` and
``values`` (`lpv_core.residual.sample_buffer`).
"""

from lpv_core.decision.fault_classification import UNCLASSIFIED
from lpv_core.decision.scale_filter import SCALE_FILTER
from lpv_core.residual.change_detection import CHANGE_TEST
from lpv_core.residual.rate_sensor_test import RATE_TEST
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type
from lpv_core.support.timestamps import NEVER

SPIKES = 3
"""So many excursions shorter than the dwell, close together, are a fault of kind spike."""
UNMEASURED, MEASURED, IMPOSSIBLE = range(3)
"""Whether the height of a step is known."""

SENSOR_CONSTANTS = record_type(
    ('changes', CHANGE_TEST),
    ('rates', RATE_TEST),
    ('noise', 'f8'),
    ('step', 'f8'),
    ('dwell', 'i8'),
    ('clear_dwell', 'i8'),
    ('hysteresis', 'f8'),
    ('latch', '?'),
    ('decay', 'f8'),
)
"""Limits of changes; test for faults of the rates; standard deviation of readings, and of what
noise of the rates adds to the residual in one sample time [rad]; dwells [ns]; the next two as in
`DiagnosisParameters`; decay rate of the level's errors [1/s]."""

SAMPLE = record_type(
    ('stamp', 'i8'),
    ('fault', 'f8'),
    ('residual', 'f8'),
    ('reading', 'f8'),
    ('threshold', 'f8'),
    ('allowance', 'f8'),
    ('innovation', 'f8'),
    ('missing', '?'),
    ('lost', '?'),
    ('inconsistent', '?'),
)
"""What is known of one sensor at one sample.

stamp [ns]; f^, r, y_p [rad]; the level that a healthy estimate stays below [rad]; allowance of r
(`lpv_core.residual.dead_reckoning`) [rad]; estimated less measured rate of the sensor [rad/s]; no reading;
gravity does not renew the estimate, its level is no evidence; rates, torques and model contradict
each other.
"""

SENSOR_STATE = record_type(
    # The alarm: whether there is one, its kind (index into KINDS), first and deciding sample [ns],
    # amount: change since the onset, or level [rad]; whether it rests on a change, and on a jump;
    # whether it may be a rate sensor's, and whether it is one's for certain.
    ('alarm', '?'),
    ('kind', 'i8'),
    ('onset', 'i8'),
    ('detected', 'i8'),
    ('amount', 'f8'),
    ('by_change', '?'),
    ('stepped', '?'),
    ('is_ambiguous', '?'),
    ('rate_implicated', '?'),
    ('reported', 'f8'),
    ('peak', 'f8'),
    # Before the fault: r (zero for an alarm by level), f^ and allowance [rad].
    ('baseline', 'f8'),
    ('level_before', 'f8'),
    ('allowance_before', 'f8'),
    # Evidence that is not confirmed: since when, over which window, r and allowance before [rad].
    ('since', 'i8'),
    ('window', 'i8'),
    ('before', 'f8'),
    ('allowed', 'f8'),
    # What f^ would be if a rate sensor had moved r: its value, and stamp [ns] and r of the last.
    ('rate_pull', 'f8'),
    ('rate_pull_stamp', 'i8'),
    ('last_residual', 'f8'),
    # Times [ns]: no reading since, the alarm's condition gone since, next look, until when the
    # sensor is the first suspect, latest excursions and how many; rows of the past in use.
    ('missing_since', 'i8'),
    ('below_since', 'i8'),
    ('next_check', 'i8'),
    ('recent_fault_until', 'i8'),
    ('spikes', 'i8', (SPIKES,)),
    ('spike_count', 'i8'),
    ('end', 'i8'),
    # A step: whether its height is known, its height, and what r differs from it by in the mean
    # [rad]; a scale error; mean and standard deviation of a noisy reading [rad].
    ('measured', 'i8'),
    ('height', 'f8'),
    ('rest', 'f8'),
    ('filter', SCALE_FILTER),
    ('average', 'f8'),
    ('scatter', 'f8'),
    ('last_allowance', 'f8'),
    ('sample', SAMPLE),
)


@njit
def reset_sensor(state) -> None:
    """Clear alarm and past."""
    state.end = 0
    state.alarm, state.kind, state.by_change, state.stepped = False, UNCLASSIFIED, False, False
    state.is_ambiguous = state.rate_implicated = False
    state.onset = state.detected = 0
    state.amount = state.reported = state.peak = state.baseline = state.average = 0.0
    state.level_before = state.allowance_before = state.last_allowance = state.scatter = 0.0
    state.measured = UNMEASURED
    forget(state)


@njit
def forget(state) -> None:
    """Drop evidence that is not confirmed yet, and what depends on old stamps."""
    state.since = state.below_since = state.missing_since = state.next_check = (
        state.recent_fault_until
    ) = NEVER
    state.window, state.before, state.allowed, state.spike_count = -1, 0.0, 0.0, 0
    state.rate_pull, state.rate_pull_stamp = 0.0, NEVER


@njit
def restart_sensor(state) -> None:
    """Time started anew: stamps of before mean nothing; an alarm stays."""
    state.end = 0
    forget(state)
