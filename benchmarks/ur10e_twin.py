"""A UR10e as its driver shows it: 100 Hz, rounded readings, filtered rates, currents, rests.

The arm moves from pose to pose and rests between; every recording begins with a rest.  Drives have
gains 5 % off the file's, friction is 20 % off, that at rest anything up to it, and a load of 0 to
5 kg hangs at the tip, unknown.
"""

from dataclasses import replace
from functools import cache, lru_cache

import numpy as np
from fault_injection import Stream, Subject, moves_and_rests

from lpv import SerialArm, load_arm
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import Uncertainty
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.identify.estimation.identification import identify
from lpv.identify.recordings.recording import Recording

PERIOD = 0.01
STEP = 1e-4
"""Rounding of readings [rad]."""
NOISE = 3e-5
"""Of readings, before they are rounded [rad]."""
FILTER = 0.4
"""Share of the newest difference in a rate: a low pass of first order, 8 Hz."""
PAYLOAD = 5.0
"""Largest load [kg]."""
GAINS = (13.3, 13.3, 11.2, 9.4, 9.4, 9.4)
"""Of the drives [N m/A]."""
HOME = np.array([0.0, -1.4, 1.4, -1.5, -1.5, 0.0])
REACH = np.array([1.5, 0.8, 0.8, 1.2, 1.2, 1.5])
FASTEST = np.full(6, 1.5)
"""[rad/s]."""
DURATION = 60.0
"""Of a recording [s]."""


@cache
def ur10e() -> SerialArm:
    """The arm as its file describes it."""
    arm = load_arm('ur10')
    joints = []
    for joint, gain in zip(arm.joints, GAINS):
        sensors = replace(joint.sensors, rates='derived', position_noise=NOISE, quantization=STEP)
        joints.append(replace(joint, torque_gain=gain, sensors=sensors))
    return replace(
        arm, name='ur10e', joints=tuple(joints), sample_time=PERIOD, effort_unit='A',
        uncertainty=Uncertainty(PAYLOAD, 0.2, 0.05),
    )  # fmt: skip


def drive(stream: Stream, step: float = STEP) -> Stream:
    """What the driver makes of readings: rounded ones, and filtered differences of them."""
    samples = stream.samples.copy()
    position = step * np.round(samples[:, 0] / step)
    samples[:, 0] = position
    rate = np.zeros(position.shape[1])
    last = position[0]
    for k, row in enumerate(position):
        rate = rate + FILTER * ((row - last) / PERIOD - rate)
        samples[k, 1], last = rate, row
    return Stream(stream.stamps, samples)


def held(rates: np.ndarray, coulomb: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Friction of joints that rest: another one in each rest, anything up to Coulomb's."""
    rests = (rates == 0.0).all(1)
    number = np.cumsum(np.diff(rests, prepend=False) & rests)
    values = rng.uniform(-1.0, 1.0, (number[-1] + 1, len(coulomb))) * coulomb
    return values[number] * rests[:, None]


@lru_cache(maxsize=32)
def healthy(
    seed: int, load: float | None = None, duration: float = DURATION, robot: int | None = None
) -> Stream:
    """A recording before the driver: readings with noise, currents; load drawn if not given.

    Each is of another arm, or of one ``robot``, whose friction is within 10 % of its usual one.
    """
    arm, rng = ur10e(), np.random.default_rng([27, seed])
    own = rng if robot is None else np.random.default_rng([28, robot])
    time = PERIOD * np.arange(round(duration / PERIOD))
    q, v, a = moves_and_rests((HOME, REACH, FASTEST), rng, time)
    chain, n = compile_chain(arm), len(arm.joints)
    friction = chain.friction.copy()
    friction[:, :2] *= own.uniform(0.8, 1.2, (n, 2))
    if robot is not None:
        friction[:, :2] *= rng.uniform(0.9, 1.1, (n, 2))
    load = rng.uniform(0.0, PAYLOAD) if load is None else load
    model = SerialModel(with_payload(chain._replace(friction=friction), load))
    torque = model.torque(q, v, a)
    torque += held(v, friction[:, 1], rng)
    torque += 0.01 * torque.std(0) * rng.normal(size=torque.shape)
    current = torque / (np.array(GAINS) * own.choice([0.95, 1.05], n))
    samples = np.stack([q + NOISE * rng.normal(size=q.shape), v, current], axis=1)
    return Stream(np.round(time * 1e9).astype(np.int64), samples)


def twin(arm: SerialArm | None = None, step: float = STEP, load: float | None = None) -> Subject:
    """The twin for `fault_injection.run`; its file may say otherwise than `ur10e`."""
    return Subject(
        'ur10e', 'simulated', arm or ur10e(), lambda k: healthy(k, load), (1, 2, 3),
        driver=lambda stream, _: drive(stream, step),
    )  # fmt: skip


def recording(
    seed: int, load: float = 0.0, duration: float = DURATION, robot: int | None = None
) -> Recording:
    """What `lpv identify` reads."""
    stream = drive(healthy(seed, load, duration, robot))
    return Recording('twin', stream.stamps * 1e-9, *np.moveaxis(stream.samples, 1, 0))


def identified(robot: int) -> Subject:
    """One arm, with the file that `lpv identify` makes of two recordings of it without a load."""
    arm = identify(ur10e(), [recording(10**6 + k, robot=robot) for k in range(2)]).arm
    arm = replace(arm, uncertainty=replace(arm.uncertainty, payload=PAYLOAD))
    return replace(twin(arm), streams=lambda k: healthy(k, robot=robot))
