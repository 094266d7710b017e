"""Healthy streams of arms, recorded and simulated, faults injected into them, and what is found.

A stream is what a driver delivers: rows of stamp, positions, rates and efforts.  Faults are
injected as hardware makes them: where rates are differences of the encoder they fail with it.  A
monitor gets the rows through its public `take_many`; only its answers and alarm events are judged.
"""

import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lpv import Gains, load_arm, load_gains
from lpv.core.monitoring.answers import Answers
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import Chain, body_parameters, compile_chain
from lpv.core.serial_arm.description import (
    JointFriction,
    JointLimits,
    JointSensors,
    LinkInertia,
    SerialArm,
    SerialJoint,
    Uncertainty,
)
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.serial_arm.sensor_map import map_rows
from lpv.core.serial_arm.two_links import Link, two_link_arm
from lpv.core.uio.planar import planar_model
from lpv.identify.recordings.recording import read_recording

ROOT = Path(__file__).resolve().parents[1]
FILES = Path(__file__).resolve().parent / 'arms'
"""Arms of the recordings of UR10 and Panda, identified on their first halves; gains of A0, C0."""
DATA = Path(os.environ.get('LPV_RECORDINGS', ROOT.parent / 'shared' / 'data'))
"""Recordings of real arms, for benchmarks and tests; not part of the repository."""
LEAD = 4.0
"""Healthy time before an onset; less where a recording is too short [s]."""
SHORTEST_LEAD = 2.0
PAUSE = 3.0
"""From the end of a fault to the next one, and the longest time until an alarm clears [s]."""
JUDGED = 2.0
"""Time after the onset at which the estimated size is judged [s]."""
CLOSE = 0.1
"""An estimate within is right [rad]."""
MOVES = 0.2
"""Rate from which on a joint moves [rad/s]."""
STEP = 2.0 * np.pi / 2**16
"""Rounding of readings by an encoder of 16 bits [rad]."""
ROUNDING = 1e-3
"""Error of a recorded reading itself [rad]."""


@dataclass(frozen=True)
class Kind:
    """A line of the matrix: what is injected, and when it has to be named."""

    name: str
    kind: str
    size: float
    limit: float  # [s]
    names: tuple[str, ...] = ()  # kinds of alarms that are right
    duration: float = 2.5  # [s]
    from_start: bool = False
    level: bool = False  # only on joints whose level gravity shows
    rates: tuple[str, ...] = ('independent', 'derived')
    samples: int = 0  # the limit is at least so many samples
    lead: float = LEAD  # healthy time before the onset [s]

    @property
    def healthy(self) -> bool:
        """Whether no encoder may be blamed."""
        return not self.names


KINDS = (
    Kind('offset 0.2', 'bias', 0.2, 4.0, ('bias',), 4.5, from_start=True, level=True),
    Kind('offset 0.5', 'bias', 0.5, 4.0, ('bias',), 4.5, from_start=True, level=True),
    Kind('step 0.02', 'bias', 0.02, 0.02, ('bias',), samples=3),
    Kind('step 0.1', 'bias', 0.1, 0.02, ('bias',), samples=3),
    Kind('drift 0.02', 'drift', 0.02, 5.0, ('drift',), 5.5, level=True),
    Kind('drift 0.05', 'drift', 0.05, 5.0, ('drift',), 5.5, level=True),
    Kind('drift 0.1', 'drift', 0.1, 2.5, ('drift',), 3.0, level=True),
    Kind('drift 0.3', 'drift', 0.3, 1.0, ('drift',), level=True),
    Kind('short drift', 'drift', 0.3, 0.8, ('drift',), 0.8),
    Kind('scale 20 %', 'scale', 0.2, 2.0, ('scale',), level=True),
    Kind('stuck', 'stuck', 0.0, 0.3, ('stuck',)),
    Kind('noise 0.02', 'noise', 0.02, 0.2, ('noise',)),
    Kind('dropout', 'dropout', 0.0, 0.1, ('dropout',)),
    Kind('rate bias 0.1', 'rate_bias', 0.1, 5.0, ('rate_bias',), 5.5, rates=('independent',)),
    Kind('rates wrap', 'wrap', 0.6, 1.0, ('rate_bias', 'rate_wrap', 'rate')),
    Kind('push', 'push', 0.0, 0.0),
    Kind('payload', 'payload', 0.0, 0.0),
    Kind('healthy', 'none', 0.0, 0.0),
    Kind('stamps off', 'stamps', 0.0, 0.0),
    Kind('stamps off differenced', 'stamps', 1.0, 0.0, rates=('derived',)),
    Kind('bursts', 'bursts', 0.2, 0.0),
    Kind('repeated', 'repeated', 0.0, 0.0),
    Kind('gaps', 'gaps', 0.0, 0.0),
    Kind('rest 0.1 mrad', 'rest', 1e-4, 0.0),
    Kind('rest 1 mrad', 'rest', 1e-3, 0.0),
)
BY_NAME = {kind.name: kind for kind in KINDS}
RATE_FAULTS = ('rate_bias', 'wrap')
"""Kinds of faults of published rates alone."""


@dataclass(frozen=True)
class Stream:
    """What a healthy arm delivers."""

    stamps: np.ndarray  # [ns], shape (N,)
    samples: np.ndarray  # positions, rates, efforts of the joints, shape (N, 3, n)

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.stamps[-1] - self.stamps[0]) * 1e-9

    def index(self, seconds: float) -> int:
        """First sample at or after a time from the first sample [s]."""
        return int(np.searchsorted(self.stamps, self.stamps[0] + seconds * 1e9))

    def part(self, begin: float, end: float) -> 'Stream':
        """Samples from a time to another [s]."""
        rows = slice(self.index(begin), self.index(end))
        return Stream(self.stamps[rows], self.samples[rows])


@dataclass(frozen=True)
class Subject:
    """An arm as the diagnosis knows it, and healthy streams of it."""

    name: str
    part: str  # simulated, tuned or untouched
    arm: SerialArm
    streams: Callable[[int], Stream]  # by number
    level: tuple[int, ...]  # joints whose level gravity shows
    gains: Gains | None = None  # of the unknown-input observer, where one was designed
    # simulated alone: other streams, by the kind of the cell
    others: Mapping[str, Callable[[int], Stream]] = field(default_factory=dict)
    # what a driver makes of readings, faults included, for a source of rates: rounding, rates
    driver: Callable[[Stream, str], Stream] | None = None
    derives: bool = False  # whether the recorded driver makes rates of the readings

    def has(self, kind: Kind) -> bool:
        """Whether the arm can show a kind."""
        needs = ('rest', 'payload')
        return (kind.kind not in needs or kind.kind in self.others) and (
            bool(self.level) or not kind.from_start
        )

    def with_rates(self, rates: str) -> 'Subject':
        """The same arm with rates from another source."""
        return replace(self, arm=with_sensors(self.arm, rates=rates))

    def monitor(self) -> SerialSensorMonitor:
        """A fresh monitor."""
        return SerialSensorMonitor('matrix', self.arm, gains=self.gains)

    def answers(self, stream: Stream) -> Answers:
        """Of a fresh monitor to all samples of a stream."""
        return self.monitor().take_many(stream.stamps, *np.moveaxis(stream.samples, 1, 0))


# --- healthy streams --------------------------------------------------------------------------


def csv_stream(file: Path) -> Stream:
    rows = np.genfromtxt(file, delimiter=',', names=True)
    fields = [[rows[f'{name}{i}'] for i in (1, 2)] for name in ('pos_meas', 'vel_meas', 'tau_meas')]
    time = rows['time'] - rows['time'][0]
    return Stream(np.round(time * 1e9).astype(np.int64), np.moveaxis(np.array(fields), 2, 0))


def _bag(file: Path, names: Sequence[str]) -> Stream:
    one = read_recording(file, names)
    samples = np.stack([one.position, one.velocity, one.effort], axis=1)
    return Stream(np.round((one.time - one.time[0]) * 1e9).astype(np.int64), samples)


def sines(
    centre: np.ndarray, reach: np.ndarray, rate: np.ndarray, rng: np.random.Generator
) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A smooth path that stays within ``reach`` of a centre and below ``rate``."""
    n, harmonics = len(centre), 3
    frequency = rng.uniform(0.5, 3.0, (n, harmonics))
    share = rng.dirichlet(np.ones(harmonics), n)
    amplitude = share * rate[:, None] / frequency
    amplitude *= np.minimum(1.0, reach / amplitude.sum(1))[:, None]

    def path(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        phase = frequency * time[:, None, None]
        return (
            centre + (amplitude * np.sin(phase)).sum(2),
            (amplitude * frequency * np.cos(phase)).sum(2),
            -(amplitude * frequency**2 * np.sin(phase)).sum(2),
        )

    return path


def minimum_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share of a way after a share x of its time, and its first two derivatives by x."""
    return (
        10 * x**3 - 15 * x**4 + 6 * x**5,
        30 * x**2 - 60 * x**3 + 30 * x**4,
        60 * x - 180 * x**2 + 120 * x**3,
    )


def moves_and_rests(
    motion: Sequence[np.ndarray], rng: np.random.Generator, time: np.ndarray
) -> np.ndarray:
    """Positions, rates and accelerations from pose to pose, shape (3, N, n); some joints stay."""
    centre, reach, rate = motion
    course = np.zeros((3, len(time), len(centre)))
    course[0] = place = centre + reach * rng.uniform(-1.0, 1.0, len(centre))
    begin = rng.uniform(0.3, 3.0)
    while begin < time[-1]:
        goal = centre + reach * rng.uniform(-1.0, 1.0, len(centre))
        goal = np.where(rng.random(len(centre)) < 0.2, place, goal)
        way = goal - place
        span = max(1.9 * np.abs(way / rate).max() / rng.uniform(0.4, 1.0), 0.5)
        share, slope, bend = minimum_jerk(np.clip((time - begin) / span, 0.0, 1.0)[:, None])
        course[0] += way * share
        course[1] += way / span * slope
        course[2] += way / span**2 * bend
        place, begin = goal, begin + span + rng.choice([0.0, 1.0]) * rng.uniform(0.3, 3.0)
    return course


def rounded(stream: Stream, rates: str, step: float) -> Stream:
    """Readings rounded to a step [rad], and rates made of these."""
    samples = stream.samples.copy()
    samples[:, 0] = step * np.round(samples[:, 0] / step)
    one = Stream(stream.stamps, samples)
    return derived(one) if rates == 'derived' else one


def wrong_chain(arm: SerialArm, rng: np.random.Generator) -> Chain:
    """The arm as it is: masses 5 %, centres of mass 2.5 %, friction 30 % off the file."""
    chain, n = compile_chain(arm), len(arm.joints)
    inertial, friction = chain.inertial.copy(), chain.friction.copy()
    inertial *= rng.uniform(0.95, 1.05, (n, 1))
    inertial[:, 1:4] *= rng.uniform(0.975, 1.025, (n, 1))
    friction[:, :2] *= rng.uniform(0.7, 1.3, (n, 2))
    return chain._replace(inertial=inertial, friction=friction)


def with_rests(path: Any, start: float) -> Any:
    """The path with rests: it moves from 3 s to 8.5 s alone, from a place of it on."""

    def place(time: np.ndarray) -> tuple[np.ndarray, ...]:
        up, down = np.clip(2.0 * (time - 3.0), 0.0, 1.0), np.clip(2.0 * (time - 8.0), 0.0, 1.0)
        speed = up**2 * (3.0 - 2.0 * up) - down**2 * (3.0 - 2.0 * down)
        change = 12.0 * (up * (1.0 - up) - down * (1.0 - down))
        step = np.diff(time, prepend=time[0])
        s = start + np.cumsum(speed * step) - 0.5 * speed * step
        return s, speed[:, None], change[:, None]

    def rested(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        s, speed, change = place(time)
        q, v, a = path(s)
        return q, v * speed, a * speed**2 + v * change

    return rested


def simulate(
    arm: SerialArm,
    motion: Sequence[np.ndarray],
    seed: int,
    rests: bool = False,
    pauses: bool = False,
    payload: float = 0.0,
    duration: float = 20.0,  # [s]
) -> Stream:
    """An arm that differs from its file follows a path; noise of sensors and 1 % of torques.

    Rates are those of a sensor of their own; `derived` makes differences of them.  From some moment
    on the arm carries 0.3 to 1 times the payload [kg].  It rests at both ends, or pauses at poses.
    """
    rng, n = np.random.default_rng([7, seed]), len(arm.joints)
    time = arm.sample_time * np.arange(round((11.0 if rests else duration) / arm.sample_time))
    path, chain = sines(*motion, rng), wrong_chain(arm, rng)
    path = with_rests(path, rng.uniform(1.0, 5.0)) if rests else path
    q, v, a = moves_and_rests(motion, rng, time) if pauses else path(time)
    torque = SerialModel(chain).torque(q, v, a)
    if payload > 0.0:
        loaded = SerialModel(with_payload(chain, payload * rng.uniform(0.3, 1.0)))
        later = time > rng.uniform(3.0, 15.0)
        torque[later] = loaded.torque(q[later], v[later], a[later])
    samples = np.stack([q, v, torque], axis=1)
    noise = np.array([[j.sensors.position_noise, j.sensors.velocity_noise] for j in arm.joints]).T
    samples[:, :2] += noise * rng.normal(size=(len(time), 2, n))
    samples[:, 2] += 0.01 * torque.std(0) * rng.normal(size=torque.shape)
    return Stream(np.round(time * 1e9).astype(np.int64), samples)


def with_noise(stream: Stream, arm: SerialArm, rng: np.random.Generator) -> Stream:
    """The stream with rates that have noise of their own: faults of the readings are not in them.

    It is that of the arm file, or as large as that of the readings' differences.
    """
    samples, stated = stream.samples.copy(), [j.sensors.velocity_noise for j in arm.joints]
    rough = np.diff(samples[:, 1], 4, axis=0).std(0) / np.sqrt(70.0)  # 1 + 16 + 36 + 16 + 1
    samples[:, 1] += np.maximum(stated, rough) * rng.normal(size=samples[:, 1].shape)
    return Stream(stream.stamps, samples)


def derived(stream: Stream) -> Stream:
    """The stream with rates that are differences of the positions."""
    samples = stream.samples.copy()
    time = np.diff(stream.stamps)[:, None] * 1e-9
    # A sample that comes twice has the rate of the one before.
    kept = np.maximum.accumulate(np.where(time[:, 0] > 0.0, np.arange(len(time)), 0))
    samples[1:, 1] = np.diff(samples[:, 0], axis=0)[kept] / time[kept]
    samples[0, 1] = samples[1, 1]
    return Stream(stream.stamps, samples)


# --- subjects ---------------------------------------------------------------------------------


def with_joints(arm: SerialArm, *which: int, **changes: Any) -> SerialArm:
    """The arm some of whose joints, or all, are others; mappings are changes of their parts."""

    def changed(joint: SerialJoint) -> SerialJoint:
        parts = {name: replace(getattr(joint, name), **value) if isinstance(value, dict) else value
                 for name, value in changes.items()}  # fmt: skip
        return replace(joint, **parts)

    joints = [one if which and i not in which else changed(one) for i, one in enumerate(arm.joints)]
    return replace(arm, joints=tuple(joints))


def with_sensors(arm: SerialArm, **changes: Any) -> SerialArm:
    """The arm with other sensors."""
    return with_joints(arm, sensors=changes)


def shoulder_arm(position_noise: float = 1e-4, quantization: float = 0.0) -> SerialArm:
    """Three joints: the base turns about the vertical, shoulder and elbow lift."""
    length, turned = 0.4, (np.pi / 2, 0.0, 0.0)
    places = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.2), turned),
              ((length, 0.0, 0.0), (0.0, 0.0, 0.0))]  # fmt: skip
    joints = []
    for i, (mass, limit) in enumerate(zip((4.0, 5.0, 3.0), (60.0, 80.0, 40.0))):
        inertia = mass * length**2 / 3.0
        moment = (0.5 * mass * length, 0.0, 0.0)
        link = LinkInertia(mass, moment, (0.1, 0.0, inertia, 0.0, 0.0, inertia))
        joints.append(SerialJoint(
            f'joint{i + 1}', places[i][0], places[i][1], (0.0, 0.0, 1.0), link,
            JointFriction(viscous=0.3, coulomb=0.3, coulomb_slope=50.0), rotor_inertia=0.05,
            limits=JointLimits(-2.5, 2.5, 2.5, limit),
            sensors=JointSensors(
                f'encoder{i + 1}', position_noise, quantization, 'derived', 5e-3)))  # fmt: skip
    return SerialArm(
        'chain3', tuple(joints), tip=(length, 0.0, 0.0), uncertainty=Uncertainty(0.0, 0.3, 0.05)
    )


def random_arm(joints: int) -> SerialArm:
    """An arm like an industrial one: axes that alternate, links that get lighter."""
    parts = []
    for i in range(joints):
        mass, length = 12.0 * 0.75**i, 0.35
        body = body_parameters(mass, (0.5 * length, 0.0, 0.0), 0.02 * mass * np.eye(3))
        limit = 20.0 * mass
        parts.append(SerialJoint(
            f'joint{i + 1}', (length if i else 0.0, 0.0, 0.0), (np.pi / 2 * (i % 2), 0.0, 0.0),
            (0.0, 0.0, 1.0), LinkInertia.from_vector(body),
            JointFriction(0.0, 0.01 * limit, 0.01 * limit, 50.0), rotor_inertia=0.002 * limit,
            limits=JointLimits(-2.5, 2.5, 3.0, limit),
            sensors=JointSensors(f'encoder{i + 1}', 1e-4, 0.0, 'independent', 1e-2)))  # fmt: skip
    return SerialArm('bench', tuple(parts), uncertainty=Uncertainty(1.0, 0.3), sample_time=0.002)


def two_links(build: str) -> tuple[SerialArm, Gains | None]:
    """A two-link arm, shipped or a build of the recordings, and its gains."""
    if build in ('paper', 'real_arm'):
        return load_arm(build), load_gains(build)
    return _build(load_arm('real_arm'), build), load_gains(FILES / f'{build}_gains.yaml')


def _build(arm: SerialArm, name: str) -> SerialArm:
    """Another build of the real arm, by the parameters that its recordings come with."""
    given = yaml.safe_load((DATA / 'real_arm' / 'more' / f'{name}_parameters.yml').read_text())
    ratio, rotor = given['gr'], given['Ir']
    planar = replace(
        planar_model(arm),
        name=name,
        gravity=given['g'],
        links=tuple(Link(*(given[f'{key}{i}'] for key in ('m', 'l', 'r', 'I'))) for i in (1, 2)),
        rotor=(rotor * (ratio**2 + 1.0), -rotor * ratio, rotor * ratio**2),
        viscous=(given['b1'], given['b2']),
        coulomb=(given['cf1'], given['cf2']),
    )
    return two_link_arm(planar)


def _simulated(
    name: str, arm: SerialArm, centre: Any, reach: Any, rate: Any, level: tuple[int, ...],
    gains: Gains | None = None, pauses: bool = False,
) -> Subject:  # fmt: skip
    n = len(arm.joints)
    motion = [np.broadcast_to(np.asarray(one, float), n) for one in (centre, reach, rate)]

    @lru_cache(maxsize=24)
    def streams(k: int, **options: Any) -> Stream:
        return simulate(arm, motion, k, pauses=pauses, **options)

    if pauses:
        driver = partial(rounded, step=arm.joints[0].sensors.quantization)
        return Subject(name, 'simulated', arm, streams, level, gains, driver=driver)
    most = arm.uncertainty.payload or 0.3 * arm.joints[-1].link.mass
    others = {'rest': partial(streams, rests=True), 'payload': partial(streams, payload=most)}
    return Subject(name, 'simulated', arm, streams, level, gains, others)


def motion_range(arm: SerialArm, speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, reach and largest rates for a path in the middle of the joints' ranges."""
    low = np.array([max(joint.limits.lower, -np.pi) for joint in arm.joints])
    high = np.array([min(joint.limits.upper, np.pi) for joint in arm.joints])
    rate = np.array([min(joint.limits.velocity, 4.0) for joint in arm.joints])
    return 0.5 * (low + high), 0.4 * (high - low), speed * rate


TUNED = {'real_arm': ('run_143601', 'run_144115'), 'A0': ('A0_01', 'A0_03', 'A0_04'),
         'C0': ('C0_01', 'C0_03')}  # fmt: skip
UNTOUCHED = {'A0': ('A0_13', 'A0_swingup'), 'C0': ('C0_06', 'C0_13', 'C0_swingup')}
REAL_FAULT = {'C0_swingup': 12.0}
"""Rates wrap from then on: what is before is healthy [s]."""


def _recorded_two_link(build: str, names: tuple[str, ...], part: str) -> Subject:
    arm, gains = two_links(build)
    folder = DATA / 'real_arm' / ('' if build == 'real_arm' else 'more')

    @lru_cache(maxsize=8)
    def streams(k: int) -> Stream:
        name = names[k % len(names)]
        whole = csv_stream(folder / f'{name}.csv')
        return whole.part(0.0, REAL_FAULT[name]) if name in REAL_FAULT else whole

    return Subject(build, part, arm, streams, (0, 1), gains, derives=True)


def _recorded_half(name: str, level: tuple[int, ...], part: str) -> Subject:
    arm = load_arm(FILES / f'{name}.yaml')

    @lru_cache(maxsize=1)
    def stream() -> Stream:
        whole = _bag(DATA / name / 'exciting.db3', arm.joint_names)
        middle = 0.5 * whole.duration
        return whole.part(*((0.0, middle) if part == 'tuned' else (middle, whole.duration)))

    return Subject(name, part, arm, lambda k: stream(), level, derives=True)


def _recorded_kr300() -> Subject:
    """Link-side encoders beside motor-side rates, an independent pair; torques are not used."""
    joints = tuple(
        SerialJoint(
            f'axis{i}', (0.0, 0.0, 0.3), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0),
            LinkInertia(100.0, (0.0, 0.0, 10.0), (10.0, 0.0, 10.0, 0.0, 0.0, 10.0)),
            sensors=JointSensors(f'link{i}', 1e-5, 0.0, 'independent', 1e-3))
        for i in (1, 2, 3)
    )  # fmt: skip
    arm = SerialArm('kr300', joints, effort_includes_gravity=False, sample_time=0.004)

    @lru_cache(maxsize=3)
    def streams(k: int) -> Stream:
        rows = np.genfromtxt(DATA / 'kr300' / f'{"ABC"[k % 3]}.csv', delimiter=',', names=True)
        y, v = (
            np.stack([rows[f'{name}{i}'] for i in (1, 2, 3)], 1)
            for name in ('link_position', 'motor_velocity')
        )
        time = rows['time'] - rows['time'][0]
        return Stream(np.round(time * 1e9).astype(np.int64), np.stack([y, v, 0.0 * y], 1))

    return Subject('kr300', 'tuned', arm, streams, ())


ARMS = ('paper', 'real_arm', 'swinging', 'chain3', 'pausing', 'coarse', 'ur10', 'panda', 'kr300')


def subjects(name: str, recorded: bool, untouched: bool = False) -> list[Subject]:
    """Streams of one arm; empty where there is no recording."""
    if not recorded:
        return [] if name == 'kr300' else [_simulated_subject(name)]
    if not DATA.is_dir():
        return []
    part = 'untouched' if untouched else 'tuned'
    if name == 'real_arm':
        files = UNTOUCHED if untouched else TUNED
        return [_recorded_two_link(build, names, part) for build, names in files.items()]
    if name == 'kr300' and not untouched:
        return [_recorded_kr300()]
    if name in ('ur10', 'panda'):
        return [_recorded_half(name, (1, 2) if name == 'ur10' else (1, 3), part)]
    return []


@cache
def _simulated_subject(name: str) -> Subject:
    if name.startswith('ur10e'):
        import ur10e_twin  # which needs this module

        robot = name.removeprefix('ur10e').removeprefix('_')
        return ur10e_twin.identified(int(robot)) if robot else ur10e_twin.twin()
    if name == 'paper':  # stays near the upright, inside the region of its gains
        arm, gains = two_links('paper')
        return _simulated('paper', arm, (np.pi / 2, 0.0), (0.5, 0.6), 0.8, (0, 1), gains)
    if name == 'real_arm':  # hangs down
        arm, gains = two_links('real_arm')
        return _simulated('real_arm', arm, (0.0, 0.0), (0.8, 0.9), 2.5, (0, 1), gains)
    if name == 'swinging':  # the same arm turns over, as fast as it does by itself
        arm, gains = two_links('real_arm')
        return _simulated(name, arm, (0.0, 0.0), (9.0, 9.0), 25.0, (0, 1), gains)
    if name == 'chain3':
        arm = shoulder_arm()
        return _simulated(name, arm, *motion_range(arm, 0.5), (1, 2))
    if name in ('pausing', 'coarse'):
        # From pose to pose, with rests in which rounded readings do not change; in steps of 1 mrad
        # at 100 Hz, too.
        step, period = (STEP, 0.002) if name == 'pausing' else (1e-3, 0.01)
        arm = replace(shoulder_arm(position_noise=1e-5, quantization=step), sample_time=period)
        return _simulated(name, arm, *motion_range(arm, 0.5), (1, 2), pauses=True)
    arm = load_arm(name)
    return _simulated(name, arm, *motion_range(arm, 0.5), (1, 2) if name == 'ur10' else (1, 3))


# --- injection --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Injected:
    """One fault of one sensor in a window."""

    sensor: int
    onset: float  # from the first sample of the window [s]
    end: float  # [s]
    sign: float = 1.0


@dataclass
class Window:
    """A stream with faults, and the truth."""

    stream: Stream
    faults: list[Injected]
    truth: np.ndarray  # error of every sensor's position, NaN in a dropout, shape (N, n) [rad]


def inject(
    stream: Stream, kind: Kind, faults: Sequence[Injected], is_derived: bool,
    matrix: np.ndarray, rng: np.random.Generator,
) -> Window:  # fmt: skip
    """Add faults to the readings of sensors s = S q."""
    time = (stream.stamps - stream.stamps[0]) * 1e-9
    reading = stream.samples[:, 0] @ matrix.T
    rate = stream.samples[:, 1] @ matrix.T
    error, rate_error = np.zeros_like(reading), np.zeros_like(rate)
    placed = list(faults)
    for k, fault in enumerate(faults):
        i = fault.sensor
        acts = (time >= fault.onset) & (time < fault.end)
        age, size = time[acts] - fault.onset, fault.sign * kind.size
        if kind.kind == 'bias':
            error[acts, i] = size
        elif kind.kind == 'drift':
            error[acts, i] = size * age
        elif kind.kind == 'scale':
            error[acts, i] = size * reading[acts, i]
        elif kind.kind == 'stuck':
            error[acts, i] = reading[acts, i][:1] - reading[acts, i]
        elif kind.kind == 'noise':
            error[acts, i] = kind.size * rng.normal(size=acts.sum())
        elif kind.kind == 'dropout':
            error[acts, i] = np.nan
        elif kind.kind == 'rate_bias':
            rate_error[acts, i] = size
        elif kind.kind == 'wrap':
            # A counter of the rate overflows: at a share of the largest rate that follows.
            limit = wrap_limit(rate[acts, i], kind.size)
            wrapped = (rate[acts, i] + limit) % (2.0 * limit) - limit
            rate_error[acts, i] = wrapped - rate[acts, i]
            begun = time[np.abs(rate_error[:, i]) > 0.5 * limit]
            placed[k] = replace(fault, onset=float(begun[0])) if len(begun) else fault
        if is_derived and kind.kind not in RATE_FAULTS:
            step = np.diff(time)
            change = np.diff(error[:, i]) / np.maximum(step, 0.5 * np.median(step))
            here = np.zeros(len(time), bool)
            here[1:] = acts[1:] | acts[:-1]
            after = np.flatnonzero(here & ~acts)
            rate_error[1:, i] = np.where(here[1:], change, rate_error[1:, i])
            if kind.kind == 'dropout':
                rate_error[after, i] = 0.0
            if kind.kind == 'stuck':  # differences of equal readings are exactly 0
                inner = acts.copy()
                inner[np.argmax(acts)] = False
                rate_error[inner, i] = -rate[inner, i]
    samples, back = stream.samples.copy(), np.linalg.inv(matrix)
    for k in _sent_again(samples):
        error[k], rate_error[k] = error[k - 1], rate_error[k - 1]
    with np.errstate(invalid='ignore'):
        samples[:, 0] += map_rows(back, error)
        samples[:, 1] += map_rows(back, rate_error)
    return Window(Stream(stream.stamps, samples), placed, error)


def _sent_again(samples: np.ndarray) -> np.ndarray:
    """Rows of samples that a late driver sent once more, as they were, though joints moved."""
    same = (samples[1:] == samples[:-1]).all(axis=(1, 2)) & samples[1:, 1].any(axis=1)
    return 1 + np.flatnonzero(same)


def wrap_limit(rate: np.ndarray, share: float) -> float:
    """Rate at which readings wrap."""
    return max(share * float(np.abs(rate).max(initial=0.0)), 1e-3)


def disturb(stream: Stream, kind: Kind, is_derived: bool, rng: np.random.Generator) -> Stream:
    """A healthy stream with what is no fault of an encoder."""
    stamps, samples, n = stream.stamps.copy(), stream.samples.copy(), stream.samples.shape[2]
    time = (stamps - stamps[0]) * 1e-9
    period = float(np.median(np.diff(time)))
    if kind.kind == 'push':
        # The drives give less for the same motion.
        scale = np.quantile(np.abs(samples[:, 2]), 0.95, axis=0)
        begin = rng.uniform(min(3.0, 0.4 * time[-1]), time[-1] - 1.0)
        place = (time - begin) / np.exp(rng.uniform(np.log(0.05), np.log(2.0)))
        inside = (place > 0.0) & (place < 1.0)
        shape = (np.sin(np.pi * place), place, np.ones_like(place))[rng.integers(3)] * inside
        size = scale * np.exp(rng.uniform(np.log(0.05), np.log(1.0))) * rng.uniform(-1, 1, n)
        samples[:, 2] -= shape[:, None] * size * (rng.random(n) < 0.6)
    elif kind.kind == 'stamps':
        # Readings are up to 1.5 samples older or newer than 2 % of the stamps.
        off = (rng.random(len(time)) < 0.02) * rng.uniform(-1.5, 1.5, len(time)) * period
        samples = read_at(stream, time + off)
        if kind.size:  # the driver makes rates of such readings, in place of the drive
            return derived(Stream(stamps, samples))
    elif kind.kind == 'bursts':
        # Faster than stated, one gap in twenty samples; readings off their stamps, rates made of
        # both.
        step = np.where(rng.random(len(time)) < 0.05, 3.0, 0.8) * period
        stamp = np.cumsum(step)[np.cumsum(step) < time[-1] - 2.0 * period]
        samples = read_at(stream, stamp + kind.size * period * rng.normal(size=len(stamp)))
        return derived(Stream(stamps[0] + np.round(stamp * 1e9).astype(np.int64), samples))
    elif kind.kind == 'repeated':
        # A driver that was late gives the reading before once more.
        rows = 1 + np.flatnonzero(rng.random(len(time) - 1) < 0.01)
        samples[rows] = stream.samples[rows - 1]
    elif kind.kind == 'gaps':
        # Some samples are lost; what comes next is off its stamp, some come twice.
        lost, off = np.zeros(len(time), bool), np.zeros(len(time))
        for row in np.flatnonzero(rng.random(len(time)) < 0.004):
            lost[row : row + int(rng.integers(1, 5))] = True
            off[row : row + 6] = rng.uniform(-1.0, 1.0) * period
        samples = read_at(stream, time + off)
        rows = np.flatnonzero(~lost)
        rows = np.sort(np.concatenate([rows, rows[rng.random(len(rows)) < 0.003]]))
        stamps, samples = stamps[rows], samples[rows]
    elif kind.kind == 'rest':
        # Rounded readings, each repeated: the driver is slower than its messages.
        samples[:, 0] = np.round(samples[:, 0] / kind.size) * kind.size
        samples[:, 1] = np.round(samples[:, 1] / 1e-3) * 1e-3
        samples = samples[3 * (np.arange(len(time)) // 3)]
        if is_derived:
            samples[0, 1], samples[1:, 1] = 0.0, np.diff(samples[:, 0], axis=0) / period
    return Stream(stamps, samples)


def read_at(stream: Stream, time: np.ndarray) -> np.ndarray:
    """Samples at other times than their own."""
    own = (stream.stamps - stream.stamps[0]) * 1e-9
    flat = stream.samples.reshape(len(own), -1)
    values = [np.interp(time, own, column) for column in flat.T]
    return np.stack(values, axis=1).reshape(len(time), *stream.samples.shape[1:])


# --- drawing and judging ----------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One cell of the matrix."""

    arm: str
    subjects: tuple[Subject, ...]  # in turn, with the rates of the cell
    kind: Kind
    rates: str

    @property
    def part(self) -> str:
        """Simulated, tuned or untouched."""
        return self.subjects[0].part


@dataclass
class Verdict:
    """What one run showed; None where nothing is to be said."""

    delay: float | None = None  # of the first alarm, if it names the right sensor [s]
    in_time: bool = False
    kind: str = ''  # of the right sensor's last alarm while the fault acts
    kind_right: bool = False
    error: float | None = None  # of the estimate [rad]
    bound: float = 0.0  # of the estimate, as stated [rad]
    trusted: bool = False  # whether the estimate was said to be trustworthy then
    other: bool = False  # whether a healthy sensor was blamed
    events: int = 0
    cleared: bool | None = None
    outside: float | None = None  # share of answers after its end, see `outside_bounds`
    second: bool | None = None  # after the first one's end
    both: bool | None = None  # while the first one acts
    seconds: float = 0.0  # watched
    crash: str = ''  # what the monitor raised
    alarms: list[tuple[float, str, str, str, float]] = field(default_factory=list)


def draw(cell: Cell, k: int, seed: int) -> tuple[Subject, Window, bool]:
    """The k-th run of a cell; and whether both faults act at once."""
    kind, subject = cell.kind, cell.subjects[k % len(cell.subjects)]
    turn = k // len(cell.subjects)
    label = f'{subject.part}/{subject.name}/{cell.rates}/{kind.name}'
    rng = np.random.default_rng([seed, zlib.crc32(label.encode()), k])
    n = len(subject.arm.joints)
    stream = subject.others.get(kind.kind, subject.streams)(turn)
    is_derived = cell.rates == 'derived' and subject.driver is None
    driver = subject.driver or (lambda one, _: one)
    if is_derived and subject.part == 'simulated':
        stream = derived(stream)
    if subject.derives and not is_derived and not kind.healthy:
        stream = with_noise(stream, subject.arm, rng.spawn(1)[0])  # all else is drawn as before
    if kind.healthy:
        healthy = driver(disturb(stream, kind, is_derived, rng), cell.rates)
        return subject, Window(healthy, [], np.zeros((0, n))), False
    limit = second_limit(kind, subject.arm)
    lead, together = kind.lead, bool(turn % 2)
    if kind.from_start:
        lead, together = 0.0, False
    # A second fault begins when the first one has been judged, or after its end.
    later = max(kind.limit + 0.5, JUDGED + 0.1) if together else kind.duration + PAUSE
    wanted = later + limit + 0.2
    if lead:
        lead = float(np.clip(stream.duration - wanted, SHORTEST_LEAD, lead))
    length = min(lead + wanted, stream.duration)
    matrix = subject.arm.joints_to_sensors()
    joints = subject.level if kind.level and subject.level else tuple(range(n))
    if kind.kind == 'dropout':  # of a sensor whose loss leaves all others to be read
        back = np.linalg.inv(matrix)
        joints = tuple(
            j for j in joints if not matrix[np.ix_(np.arange(n) != j, back[:, j] != 0)].any()
        )
    if kind.kind == 'stuck':
        moves = (np.abs(stream.samples[:, 1] @ matrix.T) > MOVES).any(axis=0)
        joints = tuple(j for j in joints if moves[j]) or joints
    i = joints[int(rng.integers(len(joints)))]
    others = [j for j in joints if j != i]
    begin = _begin(stream, kind, (i, matrix), (lead, length), rng)
    window = stream.part(begin, begin + length)
    end = lead + kind.duration
    onset = lead
    faults = [Injected(i, onset, end, rng.choice([-1.0, 1.0]))]
    if kind.kind == 'stuck':  # a frozen reading shows where its joint moves
        rates = window.samples[min(window.index(onset + later), len(window.samples) - 1), 1]
        others = [j for j in others if abs(matrix[j] @ rates) > MOVES]
    if others and onset + later + limit <= window.duration:
        j = others[int(rng.integers(len(others)))]
        sign = rng.choice([-1.0, 1.0])
        stop = window.duration + 1.0
        if together:
            faults[0] = replace(faults[0], end=stop)
        faults.append(Injected(j, onset + later, stop, sign))
    if kind.kind in RATE_FAULTS:  # faults of what the driver publishes
        window = driver(window, cell.rates)
        return subject, inject(window, kind, faults, is_derived, matrix, rng), together
    injected = inject(window, kind, faults, is_derived, matrix, rng)
    return subject, replace(injected, stream=driver(injected.stream, cell.rates)), together


def _begin(
    stream: Stream, kind: Kind, sensor: tuple[int, np.ndarray],
    times: tuple[float, float], rng: np.random.Generator,
) -> float:  # fmt: skip
    """Where a window begins, so that the fault shows: a stuck joint moves, an angle is not 0."""
    i, matrix = sensor
    lead, length = times
    free = max(stream.duration - length, 0.0)
    reading = stream.samples[:, 0] @ matrix[i]
    rate = stream.samples[:, 1] @ matrix[i]
    begin = 0.0
    for _ in range(200):
        begin = float(rng.uniform(0.0, free)) if free else 0.0
        at, later = stream.index(begin + lead), stream.index(begin + lead + max(kind.limit, 0.3))
        if kind.kind == 'stuck':
            shows = abs(rate[at]) > MOVES and np.ptp(reading[at:later]) > 0.03
        elif kind.kind == 'scale':
            # Of a joint that rests it is an offset.
            shows = np.ptp(reading[at:later]) > MOVES * kind.limit / 2.0
            shows = shows and kind.size * np.abs(reading[at:later]).max() > 0.05
        elif kind.kind == 'wrap':
            shows = np.abs(rate[at:later]).max() > 0.7 * np.abs(rate).max()
        else:
            shows = True
        if shows:
            break
    return begin


def second_limit(kind: Kind, arm: SerialArm) -> float:
    """Time in which the second fault has to be named [s]."""
    return 2.0 if kind.from_start else first_limit(kind, arm)


def first_limit(kind: Kind, arm: SerialArm) -> float:
    """Time in which the first fault has to be named [s]."""
    return max(kind.limit, kind.samples * arm.sample_time)


def run(cell: Cell, k: int, seed: int = 1) -> Verdict:
    """One run: draw, watch, judge."""
    subject, window, together = draw(cell, k, seed)
    stream = window.stream
    try:
        answers = subject.answers(stream)
    except Exception as error:  # a monitor may never raise, whatever the rows: this is counted
        return Verdict(seconds=stream.duration, crash=repr(error))
    start = int(stream.stamps[0])
    alarms = [
        (float(alarm.detected - start) * 1e-9, alarm.event.name, alarm.sensor, alarm.kind,
         float(alarm.size)) for _, alarm in answers.events if alarm.sensor
    ]  # fmt: skip
    verdict = Verdict(events=len(alarms), seconds=stream.duration, alarms=alarms)
    if not window.faults:
        verdict.other = any(event == 'RAISED' for _, event, *_ in alarms)
        return verdict
    _judge(verdict, cell, subject.arm, answers, window, together)
    return verdict


def _judge(
    verdict: Verdict, cell: Cell, arm: SerialArm, answers: Answers, window: Window, together: bool
) -> None:
    """What a run with faults showed: of the first one, of its end, of the second one."""
    first = window.faults[0]
    names, stream, slack = arm.sensor_names, window.stream, 1e-6
    name, later = names[first.sensor], window.faults[1:]
    told = [a for a in verdict.alarms if a[1] != 'CLEARED']
    onsets = {names[fault.sensor]: fault.onset for fault in window.faults}
    verdict.other = any(a[0] < onsets.get(a[2], np.inf) - slack for a in told)
    acting = [a for a in told if first.onset - slack <= a[0] < first.end]
    leading = [a for a in acting if not (later and together
               and a[0] >= later[0].onset and a[2] != name)]  # fmt: skip
    if leading and leading[0][2] == name:
        verdict.delay = leading[0][0] - first.onset
        verdict.in_time = verdict.delay <= first_limit(cell.kind, arm) + slack
    own = [a for a in acting if a[2] == name]
    if own:
        verdict.kind = own[-1][3]
        verdict.kind_right = verdict.kind in cell.kind.names
    row = min(stream.index(first.onset + JUDGED), len(stream.stamps) - 1)
    truth = window.truth[row, first.sensor]
    if np.isfinite(truth):
        estimate = float(answers.fault.estimate[row, first.sensor])
        verdict.error = abs(estimate - truth) if np.isfinite(estimate) else np.inf
        verdict.bound = float(answers.fault.bound[row, first.sensor])
        verdict.trusted = bool(answers.state.trustworthy[row])
    if not together:
        # Samples wait for up to 0.1 s until they are used.
        span = first.end + 0.1, later[0].onset if later else np.inf
        verdict.outside = outside_bounds(answers, stream.stamps, window.truth, span)
        until = first.end + PAUSE + slack
        if stream.duration >= first.end + PAUSE - slack:
            state = [a[1] for a in verdict.alarms if a[2] == name and a[0] <= until]
            verdict.cleared = state[-1] == 'CLEARED' if state else None
    for second in later:
        begin, limit = second.onset - slack, second_limit(cell.kind, arm)
        found = any(
            a[2] == names[second.sensor] and begin <= a[0] <= second.onset + limit + slack
            for a in told
        )
        verdict.both, verdict.second = (found, None) if together else (None, found)


def outside_bounds(
    answers: Answers, stamps: np.ndarray, truth: np.ndarray, span: tuple[float, float]
) -> float | None:
    """Share of the answers in a span that are trusted with an estimate outside its bound.

    ``span`` is in seconds from the first sample; None if no answer is in it.
    """
    time = (stamps - stamps[0]) * 1e-9
    rows = (time > span[0]) & (time < span[1])
    error = np.abs(answers.fault.estimate - truth)[rows]
    outside = (error > answers.fault.bound[rows] + ROUNDING).any(axis=1)
    return float((outside & answers.state.trustworthy[rows]).mean()) if rows.any() else None


def cells(
    arms: Sequence[str], recorded: Sequence[bool], rates: Sequence[str], kinds: Sequence[Kind],
    untouched: bool = False,
) -> Iterator[Cell]:  # fmt: skip
    """All cells that exist."""
    for name in arms:
        for is_recorded in recorded:
            found = subjects(name, is_recorded, untouched)
            possible = [one for one in rates if name != 'kr300' or one == 'independent']
            for one in possible if found else ():
                members = tuple(subject.with_rates(one) for subject in found)
                for kind in kinds:
                    if one in kind.rates and members[0].has(kind):
                        yield Cell(name, members, kind, one)
