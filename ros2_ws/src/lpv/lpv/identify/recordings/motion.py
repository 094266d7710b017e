"""From samples to motion on a uniform grid: segments, bandwidths, smoothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_opening
from scipy.signal import welch

from lpv.core.support.limits import MAX_GAP, MOST_SAMPLES, SMALL
from lpv.identify.errors import IdentificationError
from lpv.identify.recordings.filters import derivative, low_pass, shifted
from lpv.identify.recordings.recording import Recording

MIN_DURATION = 5.0
"""Shortest recording that is used [s]."""
MIN_RATE = 1.0 / MAX_GAP
"""Slowest sampling that is used [Hz]."""
_MIN_SEGMENT = 2.0  # time without a gap that is used [s]
_FIT_BAND = 6.0  # bandwidth of the fit, over that of the motion
_STILL = 0.01  # rate below which a joint may rest [rad/s]
_REST = 0.2  # time for which it does so in a rest, not where it reverses [s]
_ORDER = 4  # of the filters of positions and rates: motion passes unchanged
_SLOWEST = 1.0  # least bandwidth of motion [Hz]


@dataclass(frozen=True)
class Segment:
    """A stretch without gaps, on a uniform grid of sample time ``step``."""

    step: float  # [s]
    time: np.ndarray  # of the samples, shape (samples,) [s]
    position: np.ndarray  # raw, shape (samples, n) [rad]
    velocity: np.ndarray | None  # raw, shape (samples, n) [rad/s]
    effort: np.ndarray  # raw, shape (samples, n) [unit of the driver]


@dataclass(frozen=True)
class Bandwidths:
    """Cutoffs of filters, zero-phase but for the last one's [Hz]."""

    position: float  # below it positions stand out of their noise
    velocity: float  # the same, of rates
    analysis: float  # of the regression, both sides: well above what the motion excites
    test: float  # of the figures, causal: what the motion excites
    effort: float = np.inf  # of the effort sensor, applied to the model only

    def thinning(self, step: float) -> int:
        """Of so many samples [s] one is kept in the regression."""
        return max(1, int(1.0 / (8.0 * self.analysis * step)))


@dataclass(frozen=True)
class Motion(Segment):
    """Smoothed motion of a segment; the efforts are raw."""

    velocity: np.ndarray  # shape (samples, n) [rad/s]


def split(recording: Recording) -> list[Segment]:
    """Segments resampled to the median sample time, at least one; IdentificationError if unfit."""
    time = recording.time
    if len(time) < 20 or recording.duration < MIN_DURATION:
        length = recording.duration if len(time) else 0.0
        raise IdentificationError(
            f'{recording.source}: {length:.1f} s are too short to identify an arm; record at '
            f'least {MIN_DURATION:g} s, better 20 to 60 s, in which every joint moves'
        )
    step = max(1e-9, round(float(np.median(np.diff(time))), 9))  # stamps count nanoseconds
    if 1.0 / step < MIN_RATE:
        raise IdentificationError(
            f'{recording.source}: {1.0 / step:.2g} Hz is too slow, accelerations need at least '
            f'{MIN_RATE:g} Hz; is the time in another unit?'
        )
    if recording.duration / step > MOST_SAMPLES:
        raise IdentificationError(
            f'{recording.source}: has more than {MOST_SAMPLES} samples of {step:g} s; cut it'
        )
    breaks = np.flatnonzero(np.diff(time) > max(MAX_GAP, 3.5 * step)) + 1
    parts = np.split(np.arange(len(time)), breaks)
    parts = [p for p in parts if len(p) > 8 and time[p[-1]] - time[p[0]] >= _MIN_SEGMENT]
    if not parts:
        raise IdentificationError(
            f'{recording.source}: stamps jitter or samples are missing so '
            f'that no {_MIN_SEGMENT:g} s are without a gap of {MAX_GAP:g} s'
        )
    return [_resample(recording, part, step) for part in parts]


def _resample(recording: Recording, part: np.ndarray, step: float) -> Segment:
    recording = recording.rows(part)
    time = recording.time
    grid = time[0] + step * np.arange(int(np.floor((time[-1] - time[0]) / step + 1e-6)) + 1)

    steady = np.max(np.abs(np.diff(time) - step)) < 1e-3 * step and len(grid) == len(time)

    def put(values: np.ndarray) -> np.ndarray:
        if steady:  # nothing to interpolate
            return values
        return np.stack([np.interp(grid, time, column) for column in values.T], axis=1)

    position = put(recording.position)
    if not steady:
        position = CubicSpline(time, recording.position, axis=0)(grid)
    velocity = None if recording.velocity is None else put(recording.velocity)
    return Segment(step, grid, position, velocity, put(recording.effort))


def check_efforts(segments: Sequence[Segment], names: tuple[str, ...]) -> None:
    """IdentificationError for joints that were moved without efforts: all else would look wrong."""
    way = np.ptp(np.concatenate([s.position for s in segments]), axis=0)
    span = np.ptp(np.concatenate([s.effort for s in segments]), axis=0)
    if constant := [name for name, idle in zip(names, (span == 0.0) & (way > SMALL)) if idle]:
        raise IdentificationError(
            f'efforts of {", ".join(constant)} never change, as without a sensor; torques or '
            'currents of all motors must be recorded'
        )


def check_motion(segments: list[Segment], names: tuple[str, ...]) -> list[str]:
    """Remarks on joints that hardly move; IdentificationError if none does, or without efforts."""
    check_efforts(segments, names)
    travel = np.max([np.ptp(s.position, axis=0) for s in segments], axis=0)
    still = [name for name, way in zip(names, travel) if way < SMALL]
    if len(still) == len(names):
        raise IdentificationError(
            'no joint moves: inertias and friction act in motion only; '
            'record one that lpv excite plans'
        )
    return [f'{name} does not move: its friction and inertia are not determined' for name in still]


def moving(velocity: np.ndarray, step: float, scale: np.ndarray) -> np.ndarray:
    """Where joints do not rest; booleans, shape (samples, n).

    Friction of a joint that rests may be anything up to Coulomb's.  ``scale``, shape (n,), is that
    of `SerialJoint.scale`.
    """
    still = np.abs(velocity) < _STILL * scale
    return ~binary_opening(still, np.ones((max(1, round(_REST / step)), 1), bool))


def find_bandwidths(segments: list[Segment]) -> Bandwidths:
    """Cutoffs for `smooth` and for the regression, from the spectra of positions and rates."""
    rated = [segment for segment in segments if segment.velocity is not None]
    longest = max(rated or segments, key=lambda s: len(s.time))
    step = longest.step
    highest = 0.4 * 0.5 / step
    position = _clip(1.5 * _noise_corner(longest.position, step), _SLOWEST, highest)
    rates = derivative(low_pass(longest.position, position, step, order=_ORDER), step)
    velocity = position
    if longest.velocity is not None:
        velocity = _clip(1.5 * _noise_corner(longest.velocity, step), _SLOWEST, highest)
        rates = low_pass(longest.velocity, velocity, step, order=_ORDER)
    content = _content(rates, step)
    analysis = _clip(_FIT_BAND * content, 4.0, highest)
    return Bandwidths(position, velocity, analysis, _clip(2.0 * content, 1.5, highest))


def _clip(value: float, low: float, high: float) -> float:
    return float(min(max(value, min(low, high)), high))


def _spectrum(signal: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    length = min(len(signal), int(round(10.0 / step)))
    return welch(
        signal, 1.0 / step, window='blackmanharris', nperseg=length, axis=0, detrend='linear'
    )


def _noise_corner(signal: np.ndarray, step: float) -> float:
    """Highest frequency, over all joints, below which the signal stands out of white noise."""
    frequency, power = _spectrum(signal[:, np.ptp(signal, axis=0) > 0.0], step)
    buried = power[3:] < 10.0 * np.median(power[frequency > 0.3 / step], axis=0)
    corners = np.where(buried.any(axis=0), frequency[3 + buried.argmax(axis=0)], frequency[-1])
    return float(corners.max(initial=0.0))  # readings that never change say nothing


def _content(rates: np.ndarray, step: float) -> float:
    """Frequency below which 99 % of the rates' power is, the highest of all joints."""
    frequency, power = _spectrum(rates, step)
    share = np.cumsum(power, axis=0) / np.maximum(power.sum(axis=0), 1e-300)
    moving = power.sum(axis=0) > 1e-4 * power.sum(axis=0).max()
    return float(np.max(frequency[np.argmax(share > 0.99, axis=0)], where=moving, initial=0.0))


def smooth(
    segment: Segment,
    bands: Bandwidths,
    use_rates: bool,  # as measured, in place of derivatives of the positions
    rate_delay: np.ndarray,  # shape (n,) [s]
    effort_delay: np.ndarray,  # shape (n,) [s]
) -> Motion:
    """Motion of a segment without noise above the bandwidths and without delays [s]."""
    step = segment.step
    position = low_pass(segment.position, bands.position, step, order=_ORDER)
    velocity = derivative(position, step)
    if use_rates and segment.velocity is not None:
        rates = low_pass(segment.velocity, bands.velocity, step, order=_ORDER)
        velocity = shifted(rates, -rate_delay, step)
    effort = shifted(segment.effort, -effort_delay, step)
    return Motion(step, segment.time, position, velocity, effort)
