"""Mistakes of a set-up that a recording shows: hypotheses on what differs from the file.

Each hypothesis changes the data or gravity, all parameters are fitted again, and the logarithm of
its evidence is compared: how well torques are explained, and how far parameters must leave what
the file says for that.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations

import numpy as np

from lpv.core.monitoring.alarm_text import ALMOST_ALL, other_unit
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import N_INERTIAL, SerialArm
from lpv.core.serial_arm.diagnosis.parameter_error import model_error, usual_load
from lpv.core.serial_arm.dynamics.payload import payload_parameters
from lpv.core.serial_arm.rate_independence import other_rates
from lpv.identify.estimation.robust import HUBER, predicted, robust_fit, solve_normal
from lpv.identify.model.friction import SLOPE, friction_columns, join_columns, least_viscous
from lpv.identify.model.prior import Prior, base_prior
from lpv.identify.model.rigid_body import RigidBody, find_base_parameters
from lpv.identify.recordings.filters import derivative, low_pass, shifted
from lpv.identify.recordings.motion import Segment, check_efforts, find_bandwidths, moving, split
from lpv.identify.recordings.recording import Recording

_SURE = 10.0  # logarithm of a Bayes factor from which a mistake is named, against none or others
_COST = 2.0  # logarithm of how much less likely a mistake is than none, of a joint in a recording
_MISSED = 0.01  # share of the torques that models of healthy arms miss, at least
_FREE = 1e-6  # information on friction before the data
_LATE = 0.01  # usual delay of efforts, at least that of a sample [s]
_LEAST_ANGLE = np.radians(1.5)  # of a base's tilt, or of a reading's error, that is a mistake
_LEAST_LOAD = 0.1  # share of the usual load that is a change of it
_CHANGES = np.linspace(0.1, 0.9, 17)  # moments at which the load may change, of the duration
_FARTHEST = 0.5  # that gravity turns, or a reading is off, in a step of a search [rad]
_STEPS = 10  # of the search for a reading's error: half a turn, what is then left is its cube
_SCALE = 0.2  # standard deviation of the logarithm of the arm's torques, as the file gives them
_APART = 6  # most between joints whose signals are swapped: all pairs of seven
_FACTOR = 2.0  # within which efforts may be N m
_DELAYS = (-0.05, *np.arange(0.03, 0.11, 0.01))  # what filters of drivers do is no mistake [s]
_MOST_SAMPLES = 1500  # that mistakes are tried on: each is a fit of its own
_Tried = Iterator[tuple[str, '_Setup']]


@dataclass(frozen=True)
class Mistake:
    """What differs from what the file says."""

    # 'angle', 'rates', 'gravity', 'weight', 'load', 'change', 'sign', 'names', 'delay', 'unit' or
    # 'reading'
    kind: str
    text: str  # one sentence for the user
    evidence: float  # logarithm of the Bayes factor against the set-up as it is said to be


@dataclass(frozen=True)
class _Setup:
    """Slow signals of all segments, one after the other, and the gravity that is assumed."""

    ends: np.ndarray  # rows at which one segment ends and the next one begins
    steps: Sequence[float]  # sample time of each segment [s]
    time: np.ndarray  # since the start of the segment, shape (samples,) [s]
    position: np.ndarray  # shape (samples, n) [rad]
    velocity: np.ndarray  # shape (samples, n) [rad/s]
    effort: np.ndarray  # shape (samples, n)
    gravity: np.ndarray  # in the base's frame [m/s2]
    rigid: np.ndarray  # regressor of the base parameters
    # Where joints do, as friction at rest is unknown, shape (samples, n): whatever is changed, or
    # likelihoods would be of different samples.
    moves: np.ndarray
    # torques of the segments per unit of the recorded efforts, shape (n,)
    gain: float | np.ndarray = 1.0
    loaded: bool = False  # whether any load may be at the tip, whatever the file says
    pulls: list[np.ndarray] = field(default_factory=list)  # once they were asked for

    def each(
        self, change: Callable[[np.ndarray, float], np.ndarray], signal: np.ndarray
    ) -> np.ndarray:
        """A signal of all segments, changed in each of them."""
        parts = zip(np.split(signal, self.ends), self.steps)
        return np.concatenate([change(part, step) for part, step in parts])


def find_mistakes(arm: SerialArm, recordings: Sequence[Recording]) -> list[Mistake]:
    """What is most evidently wrong in a set-up by healthy motion; none if it fits.

    After efforts without the weight, which an identification finds by itself, another mistake.
    Where there are several recordings, one alone may have another load or other readings.
    """
    positions = np.concatenate([one.position for one in recordings])
    if text := other_unit(arm, *np.nanquantile(positions, ALMOST_ALL, axis=0)):
        return [Mistake('angle', text, np.inf)]  # all else would follow from it
    for one in recordings:
        if text := other_rates(arm, one.stamps, one.position, one.rates):
            return [Mistake('rates', text, np.inf)]
    parts = [split(one) for one in recordings]
    segments = [segment for part in parts for segment in part]
    check_efforts(segments, arm.joint_names)
    slow = _slow(arm, segments)
    sources = [one.source for one, part in zip(recordings, parts) for _ in part]
    judge = _Judge(arm, slow, np.repeat(sources, [len(s.time) for s in slow]))
    gravity = arm.gravity_vector() if arm.effort_includes_gravity else np.zeros(3)
    setup = judge.setup(slow, gravity)
    found: list[Mistake] = []
    before = judge.evidence(setup)
    # No other ones: a mistake may be named for want of a better one, and the next one undo it.
    while not found or found[-1].kind == 'weight':
        tried: list[tuple[Mistake, _Evidence, _Setup]] = []
        known = {m.kind for m in found}
        for kind, hypotheses in judge.hypotheses(setup, before):
            if kind in known:
                continue
            values = [(judge.evidence(other), text, other) for text, other in hypotheses]
            if values:
                likeliest, text, other = max(values, key=lambda one: one[0].total)
                value = likeliest.over(before) - judge.cost
                tried.append((Mistake(kind, text, value), likeliest, other))
        best, likeliest, other = max(tried, key=lambda one: one[0].evidence)
        if best.evidence < _SURE:
            break
        alike = [m.text for m, *_ in tried if m.evidence > best.evidence - _SURE]
        alike.remove(best.text)
        found.append(replace(best, text='; or: '.join([best.text, *alike])))
        setup, before = other, likeliest
    return found


def _slow(arm: SerialArm, segments: Sequence[Segment]) -> tuple[Segment, ...]:
    """Torques below the bandwidth of the analysis, in no more samples than that needs."""
    gain = np.array(arm.torque_gain)
    delay = np.array([joint.effort_delay for joint in arm.joints])
    bands = find_bandwidths(list(segments))
    total = sum(len(s.time) for s in segments)
    result = []
    for one in segments:
        every = max(bands.thinning(one.step), total // _MOST_SAMPLES)
        cutoff = min(bands.analysis, 0.25 / (every * one.step))
        torque = shifted(one.effort * gain, -delay, one.step)
        position, effort = (low_pass(x, cutoff, one.step) for x in (one.position, torque))
        signals = one.time, position, derivative(position, one.step), effort
        cut = slice(every, len(one.time) - every, every)
        result.append(Segment(every * one.step, *(signal[cut] for signal in signals)))
    return tuple(result)


@dataclass(frozen=True)
class _Evidence:
    """How well a set-up explains the torques."""

    fits: np.ndarray  # logarithm of the likelihood of each stretch of time
    leaves: float  # how far parameters leave the file: less of the evidence's logarithm
    beta: np.ndarray  # base parameters
    extra: np.ndarray  # other parameters that were asked for

    @property
    def total(self) -> float:
        """Logarithm of the evidence, as if the model missed nothing of its own."""
        return float(self.fits.sum()) - self.leaves

    def over(self, other: '_Evidence') -> float:
        """Logarithm of the Bayes factor, no more than its scatter over time allows.

        What a model misses of its own gains by chance: then the gain is about normal with mean 0,
        its variance twice what stretches fall short of the mean, as few gain much from any change;
        the logarithm of the likelihood ratio is that of Student's t.
        """
        gains = self.fits - other.fits
        gain, count = float(gains.sum()), len(gains)
        short = np.minimum(gains - gains.mean(), 0.0)
        sure = 0.5 * count * np.log1p(gain**2 / (2.0 * count * float(short @ short) + 1e-12))
        return min(gain, sure) + other.leaves - self.leaves


class _Judge:
    """Evidence of set-ups of one arm."""

    def __init__(self, arm: SerialArm, segments: Sequence[Segment], sources: np.ndarray):
        self._arm, self._model = arm, RigidBody(arm)
        # Samples of each recording; of each that may differ from the others.
        self._parts = {name: sources == name for name in np.unique(sources)}
        self._of_one = self._parts if len(self._parts) > 1 else {}
        self._base = find_base_parameters(self._model)
        self._size = size = self._base.size
        prior = base_prior(arm, self._base, geared=True)
        self._mean, self._known = prior.mean[:size], prior.information[:size, :size]
        self._load = np.zeros(11 * len(arm.joints))
        last = slice(N_INERTIAL * (len(arm.joints) - 1), N_INERTIAL * len(arm.joints))
        self._load[last] = payload_parameters(compile_chain(arm), 1.0)
        self._load = self._base.combination @ self._load
        # As the file says, and any load that the arm could carry.
        self._loads = usual_load(arm), sum(joint.link.mass for joint in arm.joints)
        self._information = [self._with_load(sigma) for sigma in self._loads]
        duration = sum(s.time[-1] - s.time[0] for s in segments)
        self._band = find_bandwidths(list(segments)).test
        samples = 2.0 * self._band * duration
        self._share = samples / sum(len(s.time) for s in segments)  # that is independent
        self._of_drive = _FREE, model_error(arm) ** -2, max(_LATE, arm.sample_time) ** -2
        self._fastest = np.array(arm.velocity_limit)
        # What a model misses lasts as long as a pose: half a period of the fastest motion.
        self._stretches = max(3, int(self._band * duration))
        self.cost = _COST + np.log(len(arm.joints) * len(self._parts))

    def _with_load(self, sigma: float) -> np.ndarray:
        """Information on the base parameters where a mass at the tip is known within sigma [kg]."""
        pull = self._known @ self._load
        return self._known - sigma**2 * np.outer(pull, pull) / (1.0 + sigma**2 * pull @ self._load)

    def setup(self, segments: Sequence[Segment], gravity: np.ndarray) -> _Setup:
        """A set-up with its regressors."""
        parts = [(s.time - s.time[0], s.position, s.velocity, s.effort) for s in segments]
        time, position, velocity, effort = (np.concatenate(part) for part in zip(*parts))
        ends = np.cumsum([len(s.time) for s in segments])[:-1]
        steps = [s.step for s in segments]
        rates = zip(np.split(velocity, ends), steps)
        moves = np.concatenate([moving(v, step, self._arm.scales()) for v, step in rates])
        signals = time, position, velocity, effort
        setup = _Setup(ends, steps, *signals, gravity, rigid=effort, moves=moves)
        # Filters bring friction at rest to where joints move.
        seen = self._filtered(setup, moves.astype(float)) > 1.0 - _MISSED
        return self._moved(replace(setup, moves=moves & seen), position, velocity)

    def _moved(self, setup: _Setup, position: np.ndarray, velocity: np.ndarray) -> _Setup:
        """The set-up with another motion."""
        other = replace(setup, position=position, velocity=velocity, pulls=[])
        return replace(other, rigid=self._filtered(other, self._unfiltered(other)))

    def _unfiltered(self, setup: _Setup) -> np.ndarray:
        """The regressor before filters, of a set-up whose own may be that of another motion."""
        parts = []
        motion = np.split(setup.position, setup.ends), np.split(setup.velocity, setup.ends)
        for q, v, step in zip(*motion, setup.steps):
            full = self._model.regressor(q, v, derivative(v, step), setup.gravity)
            parts.append(np.take(full, self._base.columns, axis=2))
        return np.concatenate(parts)

    def _filtered(self, setup: _Setup, signal: np.ndarray) -> np.ndarray:
        """What the motion excites of a signal of all segments."""
        return setup.each(lambda part, step: low_pass(part, self._band, step), signal)

    def _pulls(self, setup: _Setup) -> list[np.ndarray]:
        """What the regressor changes by per unit of gravity along x, y, z."""
        if not setup.pulls:
            still = replace(setup, velocity=np.zeros_like(setup.velocity))
            parts = (self._unfiltered(replace(still, gravity=axis)) for axis in np.eye(3))
            setup.pulls.extend(self._filtered(setup, part) for part in parts)
        return setup.pulls

    def _under(self, setup: _Setup, gravity: np.ndarray) -> _Setup:
        """The set-up with other gravity."""
        parts = zip(gravity - setup.gravity, self._pulls(setup))
        rigid = setup.rigid + sum(change * part for change, part in parts)
        return replace(setup, gravity=gravity, rigid=rigid)

    def evidence(self, setup: _Setup, more: np.ndarray | None = None) -> '_Evidence':
        """Of a set-up, whose torques may have ``more`` columns, shape (samples, n, parameters)."""
        regressor = setup.rigid
        columns = regressor if more is None else np.concatenate([regressor, more], axis=2)
        design, prior, passive = self._design(setup, columns, predicted(regressor, self._mean))
        # Huber's estimate of all parameters with the prior; residuals, scale of each joint.
        effort = self._filtered(setup, setup.effort)
        spread = np.std(effort, axis=0)
        least = _MISSED * spread + 1e-9
        solution, residual, _, scale = robust_fit(
            *(design, effort, setup.moves.astype(float), np.maximum(spread, least), prior),
            rounds=4, share=self._share, least=least, solve=partial(solve_normal, positive=passive),
        )  # fmt: skip
        beta, off = solution[: self._size], solution - prior.mean
        # Single parameters may be far off, hardly the torques of the whole arm, offsets apart.
        torques = (predicted(regressor, b) for b in (beta, self._mean))
        sizes = [float(np.linalg.norm(np.std(t, axis=0))) + 1e-9 for t in torques]
        common = float(np.log(sizes[0] / sizes[1])) / _SCALE
        loss = 0.5 * np.minimum(np.abs(residual / scale), HUBER) ** 2  # contacts decide nothing
        logs = np.sum((-np.log(scale / setup.gain) - loss) * setup.moves, axis=1)
        counted = np.cumsum(setup.moves.sum(axis=1))
        edges = np.searchsorted(counted, counted[-1] * np.arange(self._stretches) / self._stretches)
        return _Evidence(
            self._share * np.add.reduceat(logs, edges),
            0.5 * float(off @ prior.information @ off) + 0.5 * common**2,
            beta,
            solution[self._size : columns.shape[2]],
        )

    def _design(
        self, setup: _Setup, columns: np.ndarray, torque: np.ndarray
    ) -> tuple[np.ndarray, Prior, np.ndarray]:
        """Columns with those of all drives, their prior, and which may not be negative.

        Drives have friction, which dissipates at all rates, of each recording, as temperatures
        differ; an offset; a gain and delay that are about as the file says; ``torque``, shape
        (samples, n), is what it expects.
        """
        rates, (_, n, size) = setup.velocity, columns.shape
        slope = np.full(n, SLOPE)
        friction = friction_columns(rates, slope, np.zeros_like(rates))[:, :, [0, 1, 3]]
        friction[:, :, 1] += friction[:, :, 0] * least_viscous(slope, self._fastest)
        drives = np.stack([torque, setup.each(derivative, torque)], axis=2)
        friction = self._filtered(setup, friction)
        own = [friction[:, :, :2] * part[:, None, None] for part in self._parts.values()]
        terms = np.concatenate([*own, friction[:, :, 2:], drives], axis=2)
        known = np.append(np.full(2 * len(own), _FREE), self._of_drive)
        information = np.diag(np.append(np.zeros(size), np.tile(known, n)))
        information[: self._size, : self._size] = self._information[setup.loaded]
        mean = np.append(self._mean, np.zeros(len(information) - self._size))
        signs = [True, True] * len(own) + [False, False, False]
        passive = np.append(np.zeros(size, bool), np.tile(signs, n))
        return join_columns(columns, terms), Prior(mean, information), passive

    def hypotheses(self, setup: _Setup, now: _Evidence) -> Iterator[tuple[str, _Tried]]:
        """Kinds of mistakes, and what is tried of each: the most evident one of it counts."""
        yield 'gravity', self._gravities(setup, now)
        yield 'weight', self._weight(setup)
        yield 'load', self._loaded(setup)
        yield 'change', self._load_changes(setup)
        yield 'sign', self._signs(setup)
        yield 'names', self._swaps(setup)
        yield 'delay', self._delays(setup)
        yield 'unit', self._units(setup)
        yield 'angle', self._degrees(setup)
        for j in range(len(self._arm.joints)):
            yield 'reading', self._readings(j, setup, now)

    def _degrees(self, setup: _Setup) -> _Tried:
        """Joints without limits in degrees, one or all; `other_unit` finds others."""
        endless = [joint.is_endless for joint in self._arm.joints]
        for chosen in (endless, *np.diag(endless)):
            if not any(chosen):
                continue
            names = [name for name, turns in zip(self._arm.joint_names, chosen) if turns]
            scale = np.where(chosen, np.pi / 180.0, 1.0)
            other = self._moved(setup, scale * setup.position, scale * setup.velocity)
            yield f'positions of {", ".join(names)} are in another unit: degrees?', other

    def _readings(self, j: int, setup: _Setup, now: _Evidence) -> _Tried:
        """Readings of a joint that are off in proportion to something, or turned round."""
        joint = self._arm.joints[j]
        elapsed, position, length = setup.time, setup.position[:, j], joint.units[0]
        courses = [
            (np.ones(len(position)), f'{{:+.2g}} {length} all the time: is its zero right?', ''),
            (position, '{:+.1%} of what they are: is its ratio right?', ''),
            (elapsed, f'{{:+.2g}} {length}/s more and more: its encoder drifts or slips', ''),
        ]
        for name, part in self._of_one.items():
            courses.append((part.astype(float), f'{{:+.2g}} {length} in {{}} alone', name))
        for course, text, where in courses:
            size, least, other = self._sought(j, setup, now, course)
            if least < abs(size) and not (course is position and size > 1.0):  # it turns them round
                yield f'readings of {joint.name} are off by about {text.format(size, where)}', other
        sign = np.where(np.arange(len(self._arm.joints)) == j, -1.0, 1.0)
        turned = self._moved(setup, sign * setup.position, sign * setup.velocity)
        axis = replace(turned, effort=sign * setup.effort)
        # Friction tells whether efforts are turned as well, whatever the zero is.
        ways = [
            (self.evidence(turned), 'readings', 'encoder', turned),
            (self.evidence(axis), 'readings and efforts', 'axis', axis),
        ]
        before, what, part, other = max(ways, key=lambda one: one[0].total)
        size, least, other = self._sought(j, other, before, courses[0][0])
        zero = f' and are off by about {-size:+.2g} {length}' if abs(size) > least else ''
        way = f'{what} of {joint.name} count the other way round{zero}'
        yield f'{way}: is the direction of its {part} right?', other

    def _sought(
        self, j: int, setup: _Setup, before: _Evidence, course: np.ndarray
    ) -> tuple[float, float, _Setup]:
        """Size of an error of readings along a course, the least that is one, and without it."""
        usual = self._arm.joints[j].scale / max(float(np.max(np.abs(course))), 1e-9)
        unit = np.outer(course, np.eye(len(self._arm.joints))[j])
        size, left, other = 0.0, np.inf, setup
        for _ in range(_STEPS):
            position, velocity = self._shifted(setup, (-size - 1e-3 * usual) * unit)
            ahead = replace(setup, position=position, velocity=velocity)
            torque = self._filtered(setup, predicted(self._unfiltered(ahead), before.beta))
            change = (torque - predicted(other.rigid, before.beta)) / 1e-3
            found = self.evidence(other, _halves(change, setup.time, course != 0.0))
            left = usual * float(np.max(np.abs(found.extra)))
            if found.over(before) - self.cost < (0.0 if size else _SURE):
                break
            size += float(np.clip(found.extra.mean(), -_FARTHEST, _FARTHEST)) * usual
            other = self._moved(setup, *self._shifted(setup, -size * unit))
            before = self.evidence(other)
        return size, max(left, _LEAST_ANGLE * usual), other

    def _shifted(self, setup: _Setup, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions that are other ones by a change of shape (samples, n), and their rates."""
        return setup.position + change, setup.velocity + setup.each(derivative, change)

    def _gravities(self, setup: _Setup, now: _Evidence) -> _Tried:
        size = self._arm.gravity
        if not size > 0.0:
            return
        starts = [setup.gravity] if setup.gravity.any() else []
        axes = [sign * size * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
        best = max(axes, key=lambda g: self.evidence(self._under(setup, g)).over(now))
        said = self._arm.gravity_vector()
        for start in (*starts, best):
            found = self._turned(self._under(setup, start))
            cross = np.cross(found.gravity, said) / size**2
            angle = float(np.arctan2(np.linalg.norm(cross), found.gravity @ said / size**2))
            if angle < _LEAST_ANGLE:
                continue
            x, y, z = -found.gravity / size
            rpy = np.arctan2(y, z), np.arcsin(np.clip(-x, -1.0, 1.0))
            yield (
                f'gravity points elsewhere than the file says: {_turn(cross, angle)}; the '
                f'base is mounted with --base-rpy {rpy[0]:.3f} {rpy[1]:.3f} 0',
                found,
            )

    def _weight(self, setup: _Setup) -> _Tried:
        if setup.gravity.any():
            text = 'efforts do not contain the torque that holds the weight (--without-gravity)'
            yield text, self._under(setup, np.zeros(3))
        else:
            text = 'efforts contain the torque that holds the weight (--with-gravity)'
            yield text, self._under(setup, self._arm.gravity_vector())

    def _loaded(self, setup: _Setup) -> _Tried:
        if self._arm.uncertainty.payload is None:
            return  # any load is as the file says
        loaded = replace(setup, loaded=True)
        off = self.evidence(loaded).beta - self._mean
        pull = self._known @ self._load
        mass = float(pull @ off / (pull @ self._load + self._loads[1] ** -2))
        yield (
            f'the tip carries about {abs(mass):.2g} kg {"more" if mass > 0.0 else "less"} than the '
            'file says (lpv identify --payload; uncertainty.payload)',
            loaded,
        )

    def _load_changes(self, setup: _Setup) -> _Tried:
        elapsed, pull = setup.time, setup.rigid @ self._load
        parts = [(elapsed > m, f'after {m:.0f} s') for m in _CHANGES * elapsed.max()]
        parts += [(part, f'in {name}') for name, part in self._of_one.items()]
        for part, when in parts:
            other = pull * part[:, None]
            halves = self.evidence(setup, _halves(other, elapsed, part)).extra
            mass = float(halves.mean())
            if abs(mass) < max(float(np.ptp(halves)), _LEAST_LOAD * self._loads[0]):
                continue
            yield (
                f'the load at the tip changes by about {mass:+.2g} kg {when}: '
                'identify from recordings with one load',
                replace(setup, effort=setup.effort - mass * other),
            )

    def _turned(self, setup: _Setup) -> _Setup:
        """Gravity whose direction fits best, by Gauss-Newton together with all parameters."""
        size = float(np.linalg.norm(setup.gravity))
        for _ in range(6):
            beta = self.evidence(setup).beta
            down = setup.gravity / size
            across = np.linalg.svd(down[None])[2][1:]  # two directions that turn it
            pulls = np.stack([predicted(part, beta) for part in self._pulls(setup)], axis=2)
            found = self.evidence(setup, size * pulls @ across.T).extra
            turn = np.clip(found, -_FARTHEST, _FARTHEST) @ across
            setup = self._under(setup, size * (down + turn) / np.linalg.norm(down + turn))
            if np.linalg.norm(turn) < 1e-4:
                break
        return setup

    def _signs(self, setup: _Setup) -> _Tried:
        names = self._arm.joint_names
        for j, name in enumerate((*names, None)):
            sign = np.where(np.arange(len(names)) == j, -1.0, 1.0) if name else -1.0
            who = f'of {name}' if name else 'of all joints'
            yield (
                f'efforts {who} count against the motion: their sign is wrong (--gain)',
                replace(setup, effort=sign * setup.effort),
            )

    def _swaps(self, setup: _Setup) -> _Tried:
        names, spread = self._arm.joint_names, np.std(setup.effort, axis=0) + 1e-9
        for j, k in combinations(range(len(names)), 2):
            if k > j + _APART:
                continue
            order = np.arange(len(names))
            order[[j, k]] = k, j
            motion = (x[:, order] for x in (setup.position, setup.velocity))
            text = f'{{}} of {names[j]} and {names[k]} are swapped: their names are wrong'
            effort, moves = setup.effort[:, order], setup.moves[:, order]
            swapped = self._moved(setup, *motion)
            yield text.format('signals'), replace(swapped, effort=effort, moves=moves)
            # Errors count as shares: joints may move for unlike times.
            gain = setup.gain * spread[order] / spread
            yield text.format('efforts'), replace(setup, effort=effort, gain=gain)

    def _delays(self, setup: _Setup) -> _Tried:
        for delay in _DELAYS:
            how = 'late' if delay > 0.0 else 'early'
            text = f'efforts come about {1e3 * abs(delay):.0f} ms too {how} against the motion'
            yield text, replace(setup, effort=setup.each(partial(_earlier, delay), setup.effort))

    def _units(self, setup: _Setup) -> _Tried:
        expected = np.std(predicted(setup.rigid, self._mean), axis=0)
        measured = np.std(setup.effort, axis=0)
        carries = expected > 0.1 * expected.max()
        gain = expected / np.maximum(measured, 1e-12)
        small, large = carries & (gain > _FACTOR), carries & (gain < 1.0 / _FACTOR)
        if not any(np.array_equal(off, carries) for off in (small, large)):
            for j in np.flatnonzero(small | large):
                one = np.where(np.arange(len(gain)) == j, gain[j], 1.0)
                yield (
                    f'efforts of {self._arm.joint_names[j]} are in another unit: about '
                    f'{gain[j]:.2g} times as large would fit (--gain)',
                    replace(setup, effort=setup.effort * one, gain=setup.gain * one),
                )
            return
        gain = np.where(carries, gain, float(np.median(gain[carries])))
        yield (
            'efforts are no torques in N m: currents? About '
            + ', '.join(f'{g:.3g}' for g in gain)
            + ' N m a unit would fit (--effort-unit A finds gains)',
            replace(setup, effort=setup.effort * gain, gain=setup.gain * gain),
        )


def _earlier(delay: float, signal: np.ndarray, step: float) -> np.ndarray:
    return shifted(signal, -delay, step)


def _halves(columns: np.ndarray, time: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Columns for each half of a part: what is off for long is so in both, shape (..., 2)."""
    inside = time[part] if part.any() else time
    early = (time < 0.5 * (inside.min() + inside.max()))[:, None]
    return np.stack([columns * early, columns * ~early], axis=2)


def _turn(direction: np.ndarray, angle: float) -> str:
    """A turn of the base as text, about one of its axes where it is one."""
    unit = direction / max(float(np.linalg.norm(direction)), 1e-12)
    k = int(np.argmax(np.abs(unit)))
    if abs(unit[k]) > 0.95:
        return f'about {"xyz"[k]} by {np.degrees(np.copysign(angle, unit[k])):.1f} deg'
    return f'about ({", ".join(f"{u:.2f}" for u in unit)}) by {np.degrees(angle):.1f} deg'
