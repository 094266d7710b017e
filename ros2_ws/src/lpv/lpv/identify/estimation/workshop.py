"""Recordings of an arm, and the choices on the way to its parameters."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from lpv.core.serial_arm.description import SerialArm
from lpv.core.support.limits import MAX_GAP
from lpv.identify.estimation.assembly import (
    consistent_parameters,
    fit_of,
    with_joint_values,
    with_parameters,
)
from lpv.identify.estimation.delays import effort_delays, rate_delays
from lpv.identify.estimation.evaluation import predict
from lpv.identify.estimation.gains import estimate_gains, link_sizes
from lpv.identify.estimation.regression import Fit, Rows, fit_parameters
from lpv.identify.estimation.robust import bounded_squares, predicted
from lpv.identify.model.prior import HELD_LOAD, Prior, base_prior
from lpv.identify.model.rigid_body import RigidBody, find_base_parameters
from lpv.identify.recordings.filters import derivative
from lpv.identify.recordings.motion import (
    Bandwidths,
    Segment,
    check_motion,
    find_bandwidths,
    moving,
    smooth,
    split,
)
from lpv.identify.recordings.recording import Recording
from lpv.identify.sensors import noise_deviation

_PASSIVE = 0.08  # share of the acting torques below which a joint is not driven
HELD = 1e3
"""Strength of the prior where the data leave the scale open."""
_BLOCKS = 4  # of the training data, each of which is predicted from the others
_STRENGTHS = (1e-2, 1e-1, 1.0, 1e1, 1e2)  # of the prior, that are tried
# Bandwidths of the effort sensor that are tried [Hz].
_EFFORT_BANDS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0)
_GAIN = 0.9  # ratio of mean squares below which the richer model is taken
_FAR_OFF = 3.0  # ratio of torques that masses within 30 % do not have
_NOTHING = 1e-5  # share of an effort's power that counts for nothing
_EQUAL = 0.02  # difference of the logarithms of mean squares that counts for nothing
_BETTER = 0.95  # ratio of mean squares below which the other rates are taken


class Workshop:
    """Recordings, and the choices that are made on the way."""

    def __init__(self, arm: SerialArm, recordings: Sequence[Recording], share: float = 1.0):
        self.arm, self.n = arm, len(arm.joints)
        self.share = share  # of each segment that is fitted, its first part
        self.gain = np.array(arm.torque_gain)
        self.segments = [segment for one in recordings for segment in split(one)]
        self.warnings = [text for one in recordings for text in one.warnings]
        self.warnings += check_motion(self.segments, arm.joint_names)
        self.step = max(segment.step for segment in self.segments)
        self.bands = find_bandwidths(self.segments)
        self.model = RigidBody(arm)
        self.base = find_base_parameters(self.model)
        self.prior = base_prior(arm, self.base, load=HELD_LOAD)
        # Measured rates, if they have less noise in the band than derivatives of positions.
        rates = [s.velocity for s in self.segments if s.velocity is not None]
        turning = 2.0 * np.pi * self.bands.analysis / np.sqrt(3.0)
        derived = turning * noise_deviation([s.position for s in self.segments])
        shares = noise_deviation(rates) / np.maximum(derived, 1e-15) if rates else np.inf
        self.use_rates = bool(np.median(shares) < 1.0)
        self.rate_delay, self.effort_delay, self.joint_delays = np.zeros((3, self.n))
        if rates:
            self.rate_delay = rate_delays(self.segments, self.bands)
        self.strength = 1.0
        self.rows: list[Rows] = []
        self._prepare()

    def estimate_gains(self) -> None:
        """Gains of the efforts, if those are currents and no gains are given."""
        if self.arm.effort_unit == 'N m' or np.any(self.gain != 1.0):
            return
        self.gain = estimate_gains(self.train_rows(), self.bands, self.prior)
        self.arm = with_joint_values(self.arm, torque_gain=self.gain.tolist())
        self.warnings.append(
            'the scale of gains and masses is that of the masses given; a tool of known mass '
            'corrects it (--payload --known-mass)'
        )
        self._prepare()

    def change_weight(self) -> None:
        """Efforts contain the weight, or do not, against what the arm's file says."""
        self.arm = replace(self.arm, effort_includes_gravity=not self.arm.effort_includes_gravity)
        self._prepare()

    def _prepare(self) -> None:
        self.rows = [self._rows(segment) for segment in self.segments]

    def _rows(self, segment: Segment) -> Rows:
        scaled = replace(segment, effort=segment.effort * self.gain)
        motion = smooth(scaled, self.bands, self.use_rates, self.rate_delay, self.effort_delay)
        signals = motion.position, motion.velocity, derivative(motion.velocity, motion.step)
        margin = min(int(np.ceil(0.5 / (self.bands.test * self.step))), len(motion.time) // 10)
        return Rows(
            **vars(motion),
            base=self._base(*signals),
            counts=moving(motion.velocity, motion.step, self.arm.scales()),
            speed_limit=1.1 * np.array(self.arm.velocity_limit),
            part=slice(margin, len(motion.time) - margin),
        )

    def _base(
        self, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
    ) -> np.ndarray:
        """Regressor of the base parameters."""
        gravity = None if self.arm.effort_includes_gravity else np.zeros(3)
        full = self.model.regressor(position, velocity, acceleration, gravity)
        return np.take(full, self.base.columns, axis=2)

    def train_rows(self) -> list[Rows]:
        """Rows that are fitted."""
        return [_divided(rows, self.share)[0] for rows in self.rows]

    def test_rows(self, tests: Sequence[Recording]) -> list[Rows]:
        """Rows of other recordings, or of the rest of each segment."""
        if not tests:
            return [_divided(rows, self.share)[1] for rows in self.rows]
        return [self._rows(segment) for one in tests for segment in split(one)]

    def choose(self, report: Callable[[str], None]) -> None:
        """Rates, bandwidth of the efforts, prior, delay: by prediction of training data."""
        report('choosing measured or computed rates')
        if any(segment.velocity is not None for segment in self.segments):
            self._choose_rates()
        report('choosing the bandwidth of the efforts')
        band = _effort_band(self.train_rows(), self.bands, self.prior)
        self.bands = replace(self.bands, effort=band)
        self.prior = base_prior(self.arm, self.base)
        report('choosing the weight of the parameters given')
        errors = self._errors(_STRENGTHS)
        # The largest of those that do equally well.
        self.strength = _STRENGTHS[int(np.flatnonzero(errors < errors.min() + _EQUAL)[-1])]
        report('choosing the delays of the efforts')
        self._choose_delay()

    def consistent_fit(
        self, rows: Sequence[Rows], strength: float, slope: np.ndarray | None = None
    ) -> Fit:
        """Fit whose parameters belong to bodies of positive mass."""
        prior = self.prior.times(strength)
        fit = fit_parameters(rows, self.bands, prior, slope)
        return fit_of(self.arm_of(fit), self.base, fit)

    def _errors(self, strengths: Sequence[float]) -> np.ndarray:
        """Mean logarithms of the joints' mean square errors [(N m)^2], by strength of the prior.

        Of blocks of the training data that are predicted from the others; the error of a joint of
        which nothing counts is 1, whatever the estimate.
        """
        rows, errors = self.train_rows(), []
        slope = self.consistent_fit(rows, self.strength).slope
        for strength in strengths:
            total, count = np.zeros((2, self.n))
            for train, valid in _blocks(rows):
                fit = self.consistent_fit(train, strength, slope)
                for found in (predict(one, fit, self.bands) for one in valid):
                    total += bounded_squares(found.residual_band, found.counts)
                    count += found.counts.sum(axis=0)
            squares = np.divide(total, count, out=np.ones_like(total), where=total > 0.0)
            errors.append(float(np.mean(np.log(squares))))
        return np.array(errors)

    def _choose_rates(self) -> None:
        """Measured rates or derivatives of positions: the other one if that predicts better."""
        before, kept = self._errors([self.strength]), self.rows
        self.use_rates = not self.use_rates
        self._prepare()
        if self._errors([self.strength]) > before + np.log(_BETTER):
            self.use_rates, self.rows = not self.use_rates, kept

    def _choose_delay(self) -> None:
        """Delays of the efforts, if predictions gain from them."""
        # A drive that follows late looks like a negative inertia, which no body has; a prior that
        # is too weak hides this, as masses take the delay's place.
        before, kept = self._errors([self.strength]), self.rows
        for _ in range(2):
            rows = self.train_rows()
            found = self.consistent_fit(rows, self.strength)
            late = self.effort_delay + effort_delays(rows, found, self.bands)
            self.effort_delay = np.clip(late, -MAX_GAP, MAX_GAP)
            self._prepare()
        self.joint_delays = self.effort_delay
        if self._errors([self.strength]) > before - _EQUAL:
            self.effort_delay, self.rows = np.zeros(self.n), kept

    def fit(self, prior: Prior | None = None) -> Fit:
        """Fit with the prior of an earlier one, if given."""
        rows = self.train_rows()
        prior = prior or base_prior(self.arm, self.base).times(self._strength(rows))
        return fit_parameters(rows, self.bands, prior, with_covariance=True)

    def _strength(self, rows: Sequence[Rows]) -> float:
        """Strength of the prior, which is strong where a joint is hardly driven; that is said."""
        # Joints that swing freely: gravity drives them, and their balance holds at any scale.
        beta, rest, pairs = self.prior.mean[: self.base.size], np.zeros((1, self.n)), []
        for r in rows:
            weight = predicted(self._base(r.position, rest, rest), beta)
            acting = np.abs(weight) + np.abs(predicted(r.base, beta) - weight)
            pairs.append((acting[r.part], r.effort[r.part], r.counts[r.part]))
        acting, effort, counts = (np.concatenate(part) for part in zip(*pairs))
        few = np.sum(np.abs(effort) * counts, axis=0) < _PASSIVE * np.sum(acting * counts, axis=0)
        if passive := [name for name, is_few in zip(self.arm.joint_names, few) if is_few]:
            self.warnings.append(
                f'{", ".join(passive)}: hardly driven, or with efforts in another unit, so all '
                'parameters might as well be smaller; the masses given are kept'
            )
            return HELD
        return self.strength

    def check_scale(self, fit: Fit) -> None:
        """Warn of links that are not at all as heavy as those given."""
        rows = self.train_rows()
        given, found = (
            float(np.linalg.norm(link_sizes(rows, values)))
            for values in (fit.prior.mean, fit.parameters)
        )
        if not given / _FAR_OFF < found < given * _FAR_OFF:
            self.warnings.append(
                f'torques of the links are {found / given:.2g} times those of the masses given: '
                f'are efforts in another unit than {self.arm.effort_unit} (--effort-unit, --gain), '
                'or are the masses wrong?'
            )

    def arm_of(self, fit: Fit) -> SerialArm:
        """The arm with the parameters of a fit, physically consistent."""
        return with_parameters(self.arm, consistent_parameters(self.arm, self.base, fit), fit.slope)


def _divided(rows: Rows, share: float) -> tuple[Rows, Rows]:
    """First ``share`` of the counted samples, and the rest."""
    start, stop, _ = rows.part.indices(len(rows.effort))
    middle = start + int(round(share * (stop - start)))
    return replace(rows, part=slice(start, middle)), replace(rows, part=slice(middle, stop))


def _blocks(rows: Sequence[Rows]) -> Iterator[tuple[list[Rows], list[Rows]]]:
    """All but a block of each segment's counted samples, and that block."""
    parts = [one.part.indices(len(one.effort))[:2] for one in rows]
    edges = [np.linspace(*part, _BLOCKS + 1).astype(int) for part in parts]
    for block in range(_BLOCKS):
        train, valid = [], []
        for one, (start, stop), edge in zip(rows, parts, edges):
            rest = slice(start, edge[block]), slice(edge[block + 1], stop)
            train += [replace(one, part=p) for p in rest if p.stop - p.start > 10]
            valid.append(replace(one, part=slice(edge[block], edge[block + 1])))
        yield train, valid


def _effort_band(rows: Sequence[Rows], bands: Bandwidths, prior: Prior) -> float:
    """Bandwidth of the effort sensor, inf if none is seen: drivers filter their torques."""
    errors: dict[float, float] = {}  # mean logarithms
    tried = [b for b in _EFFORT_BANDS[::-1] if b < 0.15 / rows[0].step and _ends(rows, b)]
    for band in (np.inf, *tried):
        trial = replace(bands, effort=band)
        fit = fit_parameters(rows, trial, prior)
        found = [predict(one, fit, trial) for one in rows]
        error, counts = (
            np.concatenate([getattr(p, x) for p in found]) for x in ('residual', 'counts')
        )
        squares = bounded_squares(error, counts)
        errors[band] = float(np.mean(np.log(squares, where=squares > 0.0, out=0.0 * squares)))
        so_far = list(errors.values())
        if len(so_far) > 4 and min(so_far[-3:]) > min(so_far):
            break
    best = min(errors, key=lambda band: errors[band])
    return best if errors[best] - errors[np.inf] < np.log(_GAIN) else np.inf


def _ends(rows: Sequence[Rows], band: float) -> bool:
    """Whether efforts carry next to nothing beyond three times a bandwidth."""
    beyond = 0.0
    for one in rows:
        effort = one.effort[one.part]
        window = np.hanning(len(effort))[:, None]
        power = np.abs(np.fft.rfft((effort - effort.mean(axis=0)) * window, axis=0)) ** 2
        power = power / np.maximum(power.sum(axis=0), 1e-300)
        high = np.fft.rfftfreq(len(effort), one.step) > 3.0 * band
        beyond += float(power[high].sum(axis=0).max())
    return beyond < _NOTHING * len(rows)
