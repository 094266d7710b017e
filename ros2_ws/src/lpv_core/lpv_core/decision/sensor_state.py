"""What is known of one position sensor: constants, the present sample, and the state of its alarm.

The functions of `lpv_core.decision.sensor_decision`, `lpv_core.residual.onset_estimation` and
`lpv_core.decision.fault_magnitude` work on them, and on the sensor's past
(`lpv_core.residual.sample_buffer`).
"""

import numpy as np

from lpv_core.decision.fault_kinds import NOISE, UNCLASSIFIED
from lpv_core.decision.scale_filter import SCALE_FILTER
from lpv_core.residual.change_detection import CHANGE_TEST, scale_limits
from lpv_core.residual.noise_estimation import NOISE_ESTIMATE, excess, reset_noise, update_noise
from lpv_core.residual.rate_sensor_test import RATE_TEST, scale_rate_test
from lpv_core.residual.sample_buffer import SampleBuffer, clear_buffer
from lpv_core.support.jit import njit
from lpv_core.support.records import record_type
from lpv_core.support.timestamps import NEVER

SPIKES = 3
"""So many excursions shorter than the dwell, close together, are a fault of kind spike."""
UNMEASURED, MEASURED, IMPOSSIBLE = range(3)
"""Whether the height of a step is known."""

SENSOR_LIMITS = record_type(
    ('changes', CHANGE_TEST),  # limits of changes
    ('rates', RATE_TEST),  # test for faults of the rate sensor
    ('noise', 'f8'),  # standard deviation of readings [rad]
    ('scatter', 'f8'),  # of r from sample to sample, with noise of the rates [rad]
    ('step', 'f8'),  # of what noise of the rates adds to r in one sample time [rad]
)
"""What depends on the noise of a sensor."""
SENSOR_CONSTANTS = record_type(
    ('stated', SENSOR_LIMITS),  # for the noise that the arm file states
    ('innovation_noise', 'f8'),  # standard deviation of the innovation's noise [rad/s]
    ('dwell', 'i8'),  # [ns]
    ('clear_dwell', 'i8'),  # [ns]
    ('hysteresis', 'f8'),  # as in `lpv_core.decision.diagnosis.DiagnosisParameters`
    ('latch', '?'),  # as there
    ('decay', 'f8'),  # decay rate of the level's errors [1/s]
)

SAMPLE = record_type(
    ('stamp', 'i8'),  # [ns]
    ('fault', 'f8'),  # f^, the level [rad]
    ('residual', 'f8'),  # r (`lpv_core.residual.dead_reckoning`) [rad]
    ('reading', 'f8'),  # y_p [rad]
    ('threshold', 'f8'),  # a healthy level stays below [rad]
    ('allowance', 'f8'),  # what errors of the rates can have added to r [rad]
    ('innovation', 'f8'),  # estimated less measured rate of the sensor [rad/s]
    ('rate', 'f8'),  # measured rate of the sensor [rad/s]
    ('missing', '?'),  # no reading
    ('lost', '?'),  # gravity does not renew the estimate: its level is no evidence
    ('inconsistent', '?'),  # rates, torques and model contradict each other
)
"""What is known of one sensor at one sample."""

ALARM = record_type(
    ('active', '?'),
    ('kind', 'i8'),  # of `lpv_core.decision.fault_kinds.FaultKind`
    ('onset', 'i8'),  # first sample of the fault [ns]
    ('detected', 'i8'),  # sample of the decision [ns]
    ('amount', 'f8'),  # change since the onset, or level [rad]
    ('reported', 'f8'),  # amount at the last event [rad]
    ('peak', 'f8'),  # largest size so far [rad]
    ('by_change', '?'),  # rests on a change of r, not on the level
    ('stepped', '?'),  # began with a jump
    ('is_ambiguous', '?'),  # may be the rate sensor's
    ('rate_implicated', '?'),  # is the rate sensor's for certain
)
BASELINE = record_type(
    ('residual', 'f8'),  # r_0; zero for an alarm by level [rad]
    ('level', 'f8'),  # f^ [rad]
    ('allowance', 'f8'),  # [rad]
)
"""What was before a fault."""
EVIDENCE = record_type(
    ('since', 'i8'),  # [ns]
    ('window', 'i8'),  # over which r has changed; -1 for a level
    ('residual', 'f8'),  # r before [rad]
    ('allowance', 'f8'),  # and its allowance [rad]
)
"""Evidence that is not confirmed yet."""
RATE_PULL = record_type(
    ('level', 'f8'),  # [rad]
    ('stamp', 'i8'),  # of the last sample [ns]
    ('residual', 'f8'),  # of the last sample [rad]
)
"""What f^ would be if a rate sensor had moved r."""
STEP = record_type(
    ('measured', 'i8'),  # `UNMEASURED`, `MEASURED` or `IMPOSSIBLE`
    ('height', 'f8'),  # [rad]
    ('rest', 'f8'),  # what r differs from it by in the mean [rad]
)
SCATTER = record_type(
    ('average', 'f8'),  # mean of a noisy reading's error [rad]
    ('deviation', 'f8'),  # its standard deviation [rad]
)
EXCURSIONS = record_type(
    ('stamps', 'i8', (SPIKES,)),  # latest ones [ns]
    ('count', 'i8'),
)

SENSOR_STATE = record_type(
    ('sample', SAMPLE),  # the present one
    ('noise', NOISE_ESTIMATE),
    ('limits', SENSOR_LIMITS),  # for the noise as it is
    ('last_allowance', 'f8'),  # of the last sample [rad]
    ('evidence', EVIDENCE),
    ('alarm', ALARM),
    ('before', BASELINE),
    ('rate_pull', RATE_PULL),
    ('step', STEP),
    ('scale', SCALE_FILTER),
    ('scatter', SCATTER),
    ('spikes', EXCURSIONS),
    ('missing_since', 'i8'),  # no reading since [ns]
    ('below_since', 'i8'),  # the alarm's condition is gone since [ns]
    ('next_check', 'i8'),  # of the kind, or for noise and standstill [ns]
    ('recent_fault_until', 'i8'),  # until then the sensor is suspected before its rate sensor [ns]
)


@njit
def update_limits(params: np.record, state: np.record, buffer: SampleBuffer) -> None:
    """Limits grow with noise that is larger than stated; a noise fault does not count as such."""
    stated, limits, noise = params.stated, state.limits, state.noise
    if not (state.alarm.active and state.alarm.kind == NOISE):
        update_noise(noise, buffer, stated.scatter, params.innovation_noise)
    reading, rate = excess(noise.reading, noise.windows), excess(noise.rate, noise.windows)
    scale_limits(stated.changes, reading, rate, limits.changes)
    scale_rate_test(stated.rates, reading, rate, limits.rates)
    limits.noise, limits.step = reading * stated.noise, rate * stated.step
    limits.scatter = reading * stated.scatter


@njit
def reset_sensor(state: np.record, buffer: SampleBuffer) -> None:
    """Clear alarm and past."""
    alarm, before = state.alarm, state.before
    alarm.active, alarm.kind, alarm.by_change, alarm.stepped = False, UNCLASSIFIED, False, False
    alarm.is_ambiguous = alarm.rate_implicated = False
    alarm.onset = alarm.detected = 0
    alarm.amount = alarm.reported = alarm.peak = 0.0
    before.residual = before.level = before.allowance = 0.0
    state.scatter.average = state.scatter.deviation = state.last_allowance = 0.0
    state.step.measured = UNMEASURED
    reset_noise(state.noise)
    restart_sensor(state, buffer)


@njit
def restart_sensor(state: np.record, buffer: SampleBuffer) -> None:
    """The clock was set back: earlier stamps mean nothing; an alarm stays."""
    clear_buffer(buffer)
    evidence = state.evidence
    evidence.since, evidence.window, evidence.residual, evidence.allowance = NEVER, -1, 0.0, 0.0
    state.below_since = state.missing_since = state.next_check = state.recent_fault_until = NEVER
    state.spikes.count = 0
    state.rate_pull.level, state.rate_pull.stamp = 0.0, NEVER
