from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from serial_arms import floats, scara, shoulder_arm, simulated, with_rates
from simulated_runs import Push

from lpv import Fault, load_arm
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.chain import compile_chain, moved_body
from lpv.core.serial_arm.description import LinkInertia, Uncertainty, rotation_from_rpy
from lpv.core.serial_arm.diagnosis.parameter_error import typical_torque

MIRROR = np.diag([-1.0, 1.0, 1.0])


@cache
def recorded(name):
    """An arm with a faulty sensor, and what its driver delivers."""
    if name == 'paper':
        arm = with_rates(load_arm('paper'), 'derived')
        run = simulated(arm, Fault('link2_angle', 'bias', 0.0, size=0.5), seed=2, duration=4.0)
    elif name == 'pushed':
        arm = shoulder_arm('independent', Uncertainty(payload=0.0, friction=0.3))
        push = Push(3.0, 4.5, (0.0, 24.0, 0.0))
        drift = Fault('encoder3', 'drift', 5.0, rate=0.3)
        run = simulated(arm, drift, pushes=(push,), duration=6.0)
    else:
        arm = scara()
        arm = replace(arm, uncertainty=replace(arm.uncertainty, payload=0.0))
        run = simulated(arm, Fault('lift_encoder', 'drift', 4.0, rate=0.01), duration=6.0)
        run.stamps[500::70] += 800_000  # that are wrong
    return arm, run.stamps, run.samples


@cache
def answered(name):
    return answers_to(*recorded(name))


def answers_to(arm, stamps, samples):
    before = samples.copy()
    answers = SerialSensorMonitor('/uio', arm).take_many(stamps, *samples.transpose(1, 0, 2))
    np.testing.assert_array_equal(samples, before)  # efforts are scaled in a copy
    return answers


def rpy(matrix):
    return floats(Rotation.from_matrix(matrix).as_euler('xyz'))


def link_of(link, turn, mass=1.0, length=1.0):
    """A link in a turned frame, its mass and its lengths times factors."""
    factors = mass * np.repeat([1.0, length, length**2], [1, 3, 6])
    return LinkInertia.from_vector(factors * moved_body(link.to_vector(), turn, np.zeros(3)))


def each(arm, change):
    return replace(arm, joints=tuple(change(joint) for joint in arm.joints))


def times(part, **factors):
    """A part of a description with some of its numbers times factors."""
    return replace(part, **{name: by * getattr(part, name) for name, by in factors.items()})


def in_units(joint, position, torque):
    """A joint whose positions and torques are so many times as large."""
    by, inertia = position, torque / position
    friction = {'offset': torque, 'viscous': inertia, 'coulomb': torque, 'coulomb_slope': 1.0 / by}
    limits = times(joint.limits, lower=by, upper=by, velocity=by, torque=torque)
    sensors = times(joint.sensors, position_noise=by, velocity_noise=by)
    joint = replace(joint, friction=times(joint.friction, **friction), sensors=sensors)
    return times(replace(joint, limits=limits), rotor_inertia=inertia)


def turned(arm, stamps, samples):
    """The base's frame is another one."""
    turn, first = Rotation.from_euler('xyz', [0.4, -1.1, 2.0]).as_matrix(), arm.joints[0]
    place = floats(turn.T @ np.array(first.position) + 3.0)
    orientation = rpy(turn.T @ rotation_from_rpy(first.orientation))
    first = replace(first, position=place, orientation=orientation)
    base = rpy(rotation_from_rpy(arm.base_orientation) @ turn)
    return replace(arm, base_orientation=base, joints=(first, *arm.joints[1:])), stamps, samples


def mirrored(arm, stamps, samples):
    """Left is right: axes of turns are pseudovectors."""

    def change(joint):
        axis = floats((1.0 if joint.is_prismatic else -1.0) * MIRROR @ np.array(joint.axis))
        place = floats(MIRROR @ np.array(joint.position))
        orientation = rpy(MIRROR @ rotation_from_rpy(joint.orientation) @ MIRROR)
        joint = replace(joint, position=place, orientation=orientation, axis=axis)
        return replace(joint, link=link_of(joint.link, MIRROR))

    base = rpy(MIRROR @ rotation_from_rpy(arm.base_orientation) @ MIRROR)
    other = replace(each(arm, change), base_orientation=base, tip=floats(MIRROR @ arm.tip))
    return other, stamps, samples


def heavy(factor):
    """All masses, friction and torques times a factor."""

    def change(arm, stamps, samples):
        def heavier(joint):
            link = link_of(joint.link, np.eye(3), factor)
            return replace(in_units(joint, 1.0, factor), link=link)

        return each(arm, heavier), stamps, samples * np.array([1.0, 1.0, factor])[:, None]

    return change


def long(factor):
    """All lengths and gravity times a factor, as by another unit of length for all but masses."""

    def change(arm, stamps, samples):
        def longer(joint):
            position, torque = (factor, factor) if joint.is_prismatic else (1.0, factor**2)
            place = floats(factor * np.array(joint.position))
            link = link_of(joint.link, np.eye(3), 1.0, factor)
            return replace(in_units(joint, position, torque), position=place, link=link)

        scale = np.array([factor if joint.is_prismatic else 1.0 for joint in arm.joints])
        torque = np.where(scale == factor, factor, factor**2)
        tip = floats(factor * np.array(arm.tip))
        other = times(replace(each(arm, longer), tip=tip), gravity=factor)
        return other, stamps, samples * np.stack([scale, scale, torque])

    return change


def other_efforts(arm, stamps, samples):
    other = each(arm, lambda joint: replace(joint, torque_gain=0.037))
    return other, stamps, samples / np.array([1.0, 1.0, 0.037])[:, None]


def strong(arm, stamps, samples):
    stronger = each(arm, lambda joint: replace(joint, limits=times(joint.limits, torque=10.0)))
    return stronger, stamps, samples


def later(arm, stamps, samples):
    return arm, stamps + 1_700_000_000 * 10**9, samples


def renamed(arm, stamps, samples):
    def change(joint):
        sensors = replace(joint.sensors, name=f'{joint.sensors.name[::-1]}:1')
        return replace(joint, name=joint.name[::-1], sensors=sensors)

    return replace(each(arm, change), name='other'), stamps, samples


def swapped(arm, stamps, samples):
    """The first two sensors are described one after the other, or the other way round."""
    order = [1, 0, *range(2, len(arm.joints))]
    joints = (replace(a, sensors=arm.joints[i].sensors) for a, i in zip(arm.joints, order))
    matrix = tuple(map(floats, arm.joints_to_sensors()[order]))
    return replace(arm, joints=tuple(joints), sensor_matrix=matrix), stamps, samples


def one_after_the_other(*changes):
    def change(*described):
        for one in changes:
            described = one(*described)
        return described

    return change


DESCRIPTIONS = {
    'placed and named otherwise': one_after_the_other(turned, mirrored, renamed, later),
    'large units': one_after_the_other(heavy(4.0), long(3.0), other_efforts, strong),
    'small units': one_after_the_other(heavy(0.01), long(0.1), swapped),
}


def events(answers, begin, order):
    return [(row, one.event, order[one.sensor_index], one.kind, one.onset - begin, one.basis)
            for row, one in answers.events]  # fmt: skip


@pytest.mark.parametrize('name', ['paper', 'pushed', 'scara'])
@pytest.mark.parametrize('description', DESCRIPTIONS)
def test_given_another_description_of_the_same_then_answers_are_the_same(description, name):
    arm, stamps, samples = recorded(name)
    other, *delivered = DESCRIPTIONS[description](arm, stamps, samples)
    expected, found = answered(name), answers_to(other, *delivered)
    order = np.argmax(other.joints_to_sensors() @ arm.sensors_to_joints(), axis=1)
    known = events(expected, stamps[0], range(len(order)))
    assert known and events(found, delivered[0][0], order) == known
    np.testing.assert_array_equal(found.fault.state[:, order], expected.fault.state)
    np.testing.assert_array_equal(found.state.trustworthy, expected.state.trustworthy)
    scale = other.scales() / arm.scales()
    about = {'rtol': 1e-5, 'atol': 1e-7}
    for field in ('estimate', 'bound', 'threshold'):
        answer = (found.fault[field] / scale)[:, order]
        np.testing.assert_allclose(answer, expected.fault[field], **about)
    for field in ('position', 'velocity', 'compensated_position'):
        np.testing.assert_allclose(found.state[field] / scale, expected.state[field], **about)


def test_given_a_pause_of_any_length_when_samples_return_then_answers_are_the_same():
    arm, stamps, samples = recorded('pushed')
    short, long = (
        answers_to(arm, stamps + pause * (np.arange(len(stamps)) >= 700), samples)
        for pause in (200_000_000, 500_000_000)
    )
    told = [[(row, one.sensor, one.kind) for row, one in found.events] for found in (short, long)]
    assert told[0] == told[1]
    for field in ('state', 'estimate', 'bound'):
        np.testing.assert_allclose(long.fault[field], short.fault[field], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('name', ['real_arm', 'ur10', 'panda'])
def test_given_joints_that_count_the_other_way_then_usual_torques_are_the_same(name):
    arm = load_arm(name)
    other = each(arm, lambda joint: replace(joint, axis=floats(-np.array(joint.axis))))
    one, two = (typical_torque(compile_chain(each), each.scales()) for each in (arm, other))
    np.testing.assert_allclose(two, one, rtol=0.03)
