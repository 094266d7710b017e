"""The decision about one position sensor: when a fault is confirmed, of which kind, and when over.

Three kinds of evidence count: the level of the fault estimate against its guaranteed bound, its
change over several windows (`lpv_core.change_test`), and missing data.  Evidence must last for the
dwell; shorter excursions are spikes.
"""

from dataclasses import dataclass

import numpy as np

from lpv_core.change_test import WINDOWS
from lpv_core.fault_kind import classify, is_stuck, noise_level
from lpv_core.history import History

NANOSECONDS = 1_000_000_000
_SPIKES = 3
"""So many excursions shorter than the dwell within `_SPIKE_TIME` are a fault of kind spike."""
_SPIKE_TIME = 1.0
_COURSES = ('unclassified', 'bias', 'drift', 'scale')
"""Kinds that wrong rates, torques or a wrong model can feign, as long as there is no step."""
_DECIDED = 1.0
"""The kind is settled so long after the alarm [s]."""
_LOOK = 0.05
"""Interval of classification and of the test for noise and stuck readings [s]."""


@dataclass
class Sample:
    """What is known of one sensor at one sample.

    Attributes
    ----------
    stamp : int
        [ns].
    fault, reading, expected : float
        f^, y_p, S theta^ [rad].
    threshold : float
        Level that a healthy estimate stays below [rad].
    speed : float
        Bound on the speed of the estimate's healthy error [rad/s].
    missing : bool
        No reading.
    lost : bool
        Gravity does not renew the estimate: its level is no evidence.
    inconsistent : bool
        Rates, torques and model contradict each other.
    """

    stamp: int
    fault: float
    reading: float
    expected: float
    threshold: float
    speed: float
    missing: bool
    lost: bool
    inconsistent: bool


class SensorDecision:
    """Running decision of one sensor.

    Parameters
    ----------
    arm : ArmParameters
        Noise and sample time.
    change_test : ChangeTest
        Limits of healthy changes.
    parameters : DiagnosisParameters
        Dwell, hysteresis and the like.

    Attributes
    ----------
    alarm : bool
        Whether a fault is confirmed.
    kind : str
        Of the present or last alarm.
    onset, detected : int
        Of the present or last alarm [ns].
    size : float
        Fault of the present alarm: change since the onset, or level [rad].
    """

    def __init__(self, arm, change_test, parameters):
        self.parameters, self.changes = parameters, change_test
        self._noise = arm.position_noise
        self._history = History(round(1.5 / arm.sample_time))
        self.reset()

    def reset(self):
        """Clear alarm and past."""
        self._history.clear()
        self.alarm, self.kind = False, 'unclassified'
        self.onset = self.detected = 0
        self.size = self._reported = self._peak = self._baseline = 0.0
        self._by_change = self._stepped = False
        self.forget()

    def forget(self):
        """Drop evidence that is not confirmed yet, and what depends on old stamps."""
        self._since = self._below_since = self._missing_since = self._look_at = None
        self._before, self._level = 0.0, False
        self._spikes = []

    def restart(self):
        """Time started anew: stamps of before mean nothing; an alarm stays."""
        self._history.clear()
        self.forget()

    @property
    def compensable(self):
        """Whether `size` is a fault that may be removed from the reading."""
        return self.alarm and self.kind not in ('dropout', 'inconsistent', 'spike')

    @property
    def by_change(self):
        """Whether the alarm rests on a change, so that its size is known at once."""
        return self._by_change

    def update(self, sample):
        """Decide on one sample.

        Parameters
        ----------
        sample : Sample
            Present data.

        Returns
        -------
        str or None
            'raised', 'updated' or 'cleared' if that happened now.
        """
        if sample.missing:
            return self._silent(sample)
        self._missing_since = None
        if self.alarm and self.kind == 'dropout':
            return self._wait(sample, True)
        decided = self._decide_alarm(sample) if self.alarm else self._decide_healthy(sample)
        self._history.add(sample.stamp, sample.fault, sample.reading, sample.expected)
        return decided

    # -------------------------------------------------------------- no reading

    def _silent(self, sample):
        self._since = self._below_since = None  # what comes next is new evidence
        if self._missing_since is None:
            self._missing_since = sample.stamp
        if self.alarm or not self._lasts(self._missing_since, sample, self.parameters.dwell):
            return None
        self._baseline = sample.fault
        return self._raise(sample, 'dropout', self._missing_since, False)

    # -------------------------------------------------------------- without an alarm

    def _decide_healthy(self, sample):
        if self._since is not None:
            return self._pending(sample)
        found = self.changes.find(self._history, sample.stamp, sample.fault, sample.speed)
        self._level = not sample.lost and abs(sample.fault) > sample.threshold
        if found is None and not self._level:
            return self._look(sample)
        self._since = sample.stamp
        self._window, self._before = found if found is not None else (None, 0.0)
        return self._pending(sample)

    def _pending(self, sample):
        """Evidence since ``_since``: confirm it after the dwell, or drop it."""
        level = not sample.lost and abs(sample.fault) > sample.threshold
        change = (self._window is not None and abs(sample.fault - self._before)
                  > self.changes.limit(self._window, sample.speed))
        if not (level if self._window is None else change or level):
            return self._drop(sample)
        if not self._lasts(self._since, sample, self.parameters.dwell):
            return None
        if not level and abs(sample.fault) < 0.5 * abs(self._before):
            # Back towards zero: more likely the end of a fault that stayed unnoticed than a new
            # one that cancels a healthy error.
            self._since = None
            self._history.clear()
            return None
        self._baseline = self._before if self._window is not None else 0.0
        stepped = self._is_step(sample)
        kind = 'inconsistent' if sample.inconsistent and not stepped else 'unclassified'
        return self._raise(sample, kind, self._since, self._window is not None, stepped)

    def _is_step(self, sample):
        """Whether most of a change came from one sample to the next.

        A reading can jump; what wrong rates, torques or models do to the estimate takes time.
        """
        if self._window is None:
            return False
        start = self._since - round(1.5 * WINDOWS[self._window] * NANOSECONDS)
        _, values = self._history.since(start)
        steps = np.abs(np.diff(values[:, History.FAULT], append=sample.fault))
        return bool(steps.max(initial=0.0) >= 0.5 * abs(sample.fault - self._before))

    def _drop(self, sample):
        """An excursion shorter than the dwell is a spike if it was one of the shortest window."""
        if self._window == 0:
            oldest = sample.stamp - round(_SPIKE_TIME * NANOSECONDS)
            self._spikes = [s for s in self._spikes if s > oldest] + [sample.stamp]
        self._since = None
        if len(self._spikes) >= _SPIKES:
            onset, self._spikes = self._spikes[0], []
            self._baseline = self._before
            return self._raise(sample, 'spike', onset, True)
        return None

    def _look(self, sample):
        """From time to time: readings that stand still, and noise."""
        if not self._due(sample):
            return None
        _, values = self._history.last(50)
        if len(values) < 50:
            return None
        kind = ('stuck' if is_stuck(values, self._noise)
                else 'noise' if noise_level(values) > 3.0 * self._noise else None)
        if kind is None:
            return None
        self._baseline = float(np.median(values[:, History.FAULT]))
        return self._raise(sample, kind, sample.stamp, True)

    def _raise(self, sample, kind, onset, by_change, stepped=False):
        self.alarm, self.kind = True, kind
        self._by_change, self._stepped = by_change, stepped
        self.onset, self.detected = onset, sample.stamp
        self.size = self._reported = sample.fault - self._baseline
        self._peak, self._since, self._below_since = abs(self.size), None, None
        self._look_at = None
        if kind == 'unclassified':
            self._classify(sample)
        return 'raised'

    # -------------------------------------------------------------- with an alarm

    def _decide_alarm(self, sample):
        self.size = sample.fault - self._baseline
        self._peak = max(self._peak, abs(self.size))
        if sample.inconsistent and not self._stepped and self.kind in _COURSES:
            self.kind = 'inconsistent'
            return 'updated'
        if self.kind in ('spike', 'noise', 'stuck'):
            over = self._quiet(sample)
        else:
            # A link without gravity information does not renew a level; a change it still sees.
            known = self._by_change or not sample.lost
            over = known and abs(self.size) <= self._clear_level(sample)
        decided = self._wait(sample, over)
        if over:
            return decided
        if decided is None and self._due(sample):
            decided = self._classify(sample)
        step = max(sample.threshold, 0.5 * abs(self._reported))
        if self.kind in ('spike', 'noise'):
            return decided
        if decided is None and abs(self.size - self._reported) > step:
            decided = 'updated'
        if decided == 'updated':
            self._reported = self.size
        return decided

    def _clear_level(self, sample):
        level = sample.threshold
        if self._by_change:
            level = min(level, max(2.0 * self.changes.limit(0, sample.speed), 0.5 * self._peak))
        return self.parameters.hysteresis * level

    def _quiet(self, sample):
        """Whether a fault without a lasting size is over."""
        _, values = self._history.last(50)
        if len(values) < 10:
            return False
        if self.kind == 'stuck' and np.ptp(values[:, History.READING]) < self._noise:
            return False  # a healthy reading shows its noise even at rest
        calm = noise_level(values) < 2.0 * self._noise
        small = abs(self.size) < max(self.changes.limit(0, sample.speed),
                                     self.parameters.hysteresis * sample.threshold)
        return calm and small and not is_stuck(values, self._noise)

    def _wait(self, sample, over):
        if not over or self.parameters.latch:
            self._below_since = None
            return None
        if self._below_since is None:
            self._below_since = sample.stamp
        if not self._lasts(self._below_since, sample, self.parameters.clear_dwell):
            return None
        self.alarm, self._below_since, self._look_at = False, None, None
        # Changes are counted from here on: the end of a fault is not the start of one.
        self._history.clear()
        return 'cleared'

    def _classify(self, sample):
        """Name the kind anew; 'updated' if it is another one."""
        if self.kind in ('inconsistent', 'dropout', 'stuck'):
            return None
        if self.kind == 'spike':
            _, values = self._history.last(50)
            if noise_level(values) <= 3.0 * self._noise:
                return None
            self.kind = 'noise'
            return 'updated'
        if self.kind != 'unclassified' and self._lasts(self.detected, sample, _DECIDED):
            return None  # what comes later is the course of the arm more than of the fault
        stamps, values = self._history.since(self.onset)
        kind = classify(stamps, values, self.onset, self._baseline, self._noise)
        if kind in (self.kind, 'unclassified'):
            return None
        self.kind = kind
        return 'updated'

    # -------------------------------------------------------------- time

    def _due(self, sample):
        if self._look_at is None or sample.stamp >= self._look_at:
            first = self._look_at is None
            self._look_at = sample.stamp + round(_LOOK * NANOSECONDS)
            return not first
        return False

    @staticmethod
    def _lasts(since, sample, time):
        return sample.stamp - since >= time * NANOSECONDS
