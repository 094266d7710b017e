from dataclasses import replace

import numpy as np
import pytest
from fault_injection import BY_NAME, cells, draw, with_joints, with_sensors
from serial_arms import answered, shoulder_arm, watch
from simulated_runs import Push, simulated_run
from watched import Watched

from lpv import Fault, load_arm
from lpv.campaign.falsify.attack import Attack, Attacker
from lpv.core.monitoring import alarm_text, message_fields
from lpv.core.serial_arm import description, simulation
from lpv.core.serial_arm.certificate.jump_bound import NET_TORQUE, jump_bound
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.diagnosis.alarms import GUARANTEED, STATISTICAL, Alarm, AlarmEvent
from lpv.core.serial_arm.diagnosis.healthy_balance import generator_count
from lpv.core.serial_arm.diagnosis.healthy_set import LEAST_RESPONSE
from lpv.core.serial_arm.diagnosis.parameter_set import member, parameter_set, payload_generator
from lpv.core.serial_arm.dynamics.model import SerialModel

STATED = description.Uncertainty(payload=0.5, friction=0.3, model_error=0.05)
UNSTATED = description.Uncertainty(0.5, 0.3)
ARM = shoulder_arm('independent', STATED)
LEVEL = pytest.mark.parametrize('joint', [1, 2])
RATES = pytest.mark.parametrize('rates', ['independent', 'derived'])


def watched(arm=ARM, plant=None, *faults, duration=5.0, stated=None):
    """The guarantee after a run; what the monitor's file states may differ from the arm's."""
    run = simulated_run(arm, duration, *faults, plant=plant)
    healthy = watch(replace(arm, uncertainty=stated or arm.uncertainty), run).healthy
    return healthy and healthy.evaluate()


@pytest.fixture(scope='module')
def exact():
    """The guarantee of an arm that is its model."""
    return watched()


def worst_member(arm, guarantee, joint):
    """The arm of the file whose parameters push the estimate of a joint the most."""
    chain = compile_chain(arm)
    return member(chain, parameter_set(arm, chain), np.sign(guarantee.effects[joint]))


@RATES
def test_given_the_worst_arm_of_the_file_when_healthy_then_it_nears_its_threshold(rates):
    arm = shoulder_arm(rates, STATED)
    own = watched(arm)
    for joint in (1, 2):
        worst = watched(arm, worst_member(arm, own, joint))
        assert 0.5 < np.abs(worst.estimate[joint]) / worst.threshold[joint] < 1.0


@LEVEL
def test_given_too_little_stated_or_an_offset_then_no_arm_of_the_file_explains_it(exact, joint):
    forged = description.Uncertainty(payload=0.1, friction=0.1, model_error=0.01)
    run = simulated_run(ARM, 5.0, plant=worst_member(ARM, exact, joint))
    monitor, exceeded = Watched(replace(ARM, uncertainty=forged)), False
    for stamps, samples in zip(np.split(run.stamps, 10), np.split(run.samples, 10)):
        monitor.take(stamps, samples)
        exceeded |= monitor.healthy.evaluate().exceeded[joint]
    assert exceeded
    size = 1.2 * float(exact.smallest_found[joint])
    found = watched(ARM, None, Fault(f'encoder{joint + 1}', 'bias', 0.0, size=size))
    assert found.exceeded.tolist() == [False, joint == 1, joint == 2]


def test_given_motion_then_payload_is_known_and_thresholds_shrink_but_of_an_upright_base(exact):
    assert exact.response[0] == pytest.approx(0.0, abs=1e-6)
    assert not exact.exceeded[0] and exact.smallest_found[0] == np.inf
    assert exact.threshold[1] < 0.6 * watched(duration=0.6).threshold[1]
    assert watched(shoulder_arm(), duration=0.5) is None  # no stated range
    tolerant = with_joints(ARM, torque_tolerance=description.TorqueTolerance((0.0,), (1.0,)))
    assert np.all(watched(tolerant).slack[1:] > 5.0 * exact.slack[1:])
    low, high = watched(duration=6.0).payload
    assert low == 0.0 and high < 0.3


def test_given_a_long_run_then_thresholds_do_not_grow():
    early, late = watched(duration=10.0), watched(duration=30.0)
    assert np.all(late.threshold <= 1.1 * early.threshold)


@pytest.mark.parametrize('size', [0.1, -0.1])
def test_given_an_offset_of_another_sensor_when_a_load_is_unknown_then_slack_holds_what_it_does(
    size,
):
    """The load's torques are those of another pose than the readings'."""
    arm = replace(ARM, uncertainty=description.Uncertainty(5.0, 0.1, 0.05))
    chain = compile_chain(arm)
    sizes, shares = parameter_set(arm, chain), np.zeros(generator_count(parameter_set(arm, chain)))
    shares[payload_generator(sizes, 5.0)] = 1.0
    plant = member(chain, sizes, shares)
    beside = watched(arm, plant, Fault('encoder2', 'bias', 0.0, size=size))
    change = (beside.estimate - watched(arm, plant).estimate)[2]
    assert 0.5 * beside.slack[2] < abs(change) < beside.slack[2]


@pytest.mark.parametrize(('faults', 'pushes'), [
    ((), (Push(6.0, 7.0, (0.0, 30.0, 0.0)),)),
    ((Fault('encoder2', 'drift', 6.0, 2.0, rate=0.3),), ()),
    ((Fault('encoder1', 'rate_bias', 6.0, 2.0, size=0.3),), ()),
], ids=['push', 'drift', 'rate bias'])  # fmt: skip
def test_given_what_no_healthy_arm_does_when_it_has_left_the_horizon_then_thresholds_are_back(
    faults, pushes
):
    run, monitor, known = simulated_run(ARM, 22.0, *faults, pushes=pushes), Watched(ARM), []
    for stamps, samples in zip(np.split(run.stamps, 44), np.split(run.samples, 44)):
        monitor.take(stamps, samples)
        known.append(monitor.healthy is not None)
    assert all(known[:12]) and not any(known[16:32]) and all(known[-4:])


def test_given_a_long_run_with_a_gap_when_remembered_then_the_estimate_is_still_explained():
    """The set follows horizon, memory and restart as the estimator does, number by number."""
    run = simulated_run(ARM, 14.0)
    run.stamps[6500:] += 10**9
    guarantee = watch(ARM, run).healthy.evaluate()
    assert np.abs(guarantee.rest).max() < 1e-6
    assert not guarantee.exceeded.any()


@LEVEL
@pytest.mark.parametrize('mass', [0.0, 0.3, 0.5])
def test_given_any_payload_of_the_file_when_learned_then_the_interval_holds_it(exact, mass, joint):
    chain = compile_chain(ARM)
    sizes, shares = parameter_set(ARM, chain), np.sign(exact.effects[joint])
    at_tip = payload_generator(sizes, 0.5)
    shares[at_tip : len(sizes.inertial)] = 0.0
    shares[at_tip] = mass / 0.5
    low, high = watched(ARM, member(chain, sizes, shares), duration=8.0).payload
    assert low <= mass <= high


QUIET = {'position_noise': 1e-6, 'velocity_noise': 1e-5}
CLOSE = replace(ARM, uncertainty=description.Uncertainty(0.0, 0.0, 0.001))
CLOSE = with_joints(CLOSE, sensors=QUIET, friction={'coulomb': 0.0})
"""An arm that its file states closely, but for what a test says of drives and sensors."""


def largest_ratio(arm, swing, speed, late=0.0, missed=0.0, seconds=5.0, late_again=None):
    """Largest estimate of a healthy arm over its threshold in a motion; efforts are late [s].

    Every so many samples, ``late_again``, two in a row are those of a period before.
    """
    rng, sensors = np.random.default_rng(0), arm.joints[0].sensors
    t = arm.sample_time * np.arange(round(seconds / arm.sample_time))
    model = SerialModel(compile_chain(arm))

    def motion(time):
        angle = speed * time[:, None] * [0.7, 1.0, 0.9] + [0.0, 1.0, 2.0]
        q = np.array([0.3, 0.5, 0.4]) + swing * np.sin(angle)
        rate = speed * np.array([0.7, 1.0, 0.9])
        return q, swing * rate * np.cos(angle), -swing * rate**2 * np.sin(angle)

    q, v, _ = motion(t)
    q = q + sensors.position_noise * rng.normal(size=q.shape)
    v = v + sensors.velocity_noise * rng.normal(size=q.shape)
    if sensors.quantization:
        q = sensors.quantization * np.round(q / sensors.quantization)
    samples = np.stack([q, v, model.torque(*motion(t - late)) + missed], axis=1)
    for k in range(late_again or len(t), len(t), late_again or 1):
        samples[k : k + 2] = samples[k - 1 : k + 1].copy()
    monitor, chunk, largest = Watched(arm), round(0.25 / arm.sample_time), 0.0
    for k in range(0, len(t), chunk):
        part = slice(k, k + chunk)
        monitor.take(10**9 + np.round(1e9 * t[part]).astype(int), samples[part])
        if monitor.healthy is None:
            break
        found = monitor.healthy.evaluate()
        shown = np.where(found.response > LEAST_RESPONSE, np.abs(found.estimate), 0.0)
        largest = max(largest, float((shown / np.maximum(found.threshold, 1e-9)).max()))
    return largest


AT_REST = description.TorqueTolerance((0.0, 0.005), (2.0, 0.0))


@pytest.mark.parametrize(('stated', 'motion', 'most'), [
    # Friction grows with the torque that the gear carries, which is not that of the drive.
    *(({'friction': {'coulomb': 1.0, 'load': load}}, (0.6, 2.0), 0.5) for load in (0.1, 0.4)),
    # What a rate reads at rest is not zero, where torques are missed at rest alone.
    *(({'torque_tolerance': AT_REST, 'sensors': {'velocity_noise': 0.02}}, (0.0, 1.0, 0.0, missed),
       1.0) for missed in (-2.0, 2.0)),
    # At rest the error of rounding stays as it is.
    *(({'sensors': {'quantization': step}}, (0.0, 1.0), 1.0) for step in (0.011, 0.07)),
    # What is quadratic in a delay counts, too.
    *(({'effort_delay': abs(late)}, (swing, speed, late, 0.0, 4.0), 1.0)
      for late, swing, speed in ((0.05, 0.2, 3.0), (-0.05, 0.2, 3.0), (0.1, 0.4, 2.0),
                                 (-0.1, 0.4, 2.0))),
])  # fmt: skip
def test_given_what_a_file_states_when_it_is_so_then_thresholds_hold(stated, motion, most):
    assert largest_ratio(with_joints(CLOSE, **stated), *motion) < most


@pytest.mark.parametrize(('load', 'sensors'), [
    (20.0, {}),
    # Momenta change with the pose: each has noise of readings, which their difference hides.
    (5.0, {'position_noise': 0.02, 'velocity_noise': 1e-3}),
])  # fmt: skip
def test_given_an_unknown_load_that_outweighs_links_then_noise_is_that_of_both(load, sensors):
    arm = replace(with_sensors(ARM, **sensors), uncertainty=replace(STATED, payload=load))
    chain = compile_chain(arm)
    sizes = parameter_set(arm, chain)
    shares, largest = np.zeros(generator_count(sizes)), 0.0
    shares[payload_generator(sizes, load)] = 1.0
    for seed in range(6):
        run = simulated_run(arm, 1.0, plant=member(chain, sizes, shares), seed=seed)
        found = watch(arm, run).healthy.evaluate()
        wrong = np.abs(found.estimate - found.effects @ shares)[1:]
        largest = max(largest, float((wrong / found.noise[1:]).max()))
    assert 0.1 < largest < 1.0


def test_given_samples_that_are_late_twice_when_the_next_is_not_then_thresholds_hold():
    """The readings have not gone half their way in two periods: the second was late, too."""
    arm = with_sensors(CLOSE, rates='derived')
    assert largest_ratio(arm, 0.6, 2.0, late_again=60) < 0.5


@LEVEL
def test_given_friction_by_load_that_is_half_as_large_again_then_the_worst_arm_stays_below(joint):
    """Such friction changes the load that it grows with."""
    stated = replace(CLOSE, uncertainty=description.Uncertainty(0.0, 0.5, 0.0))
    arm = with_joints(stated, friction={'coulomb': 0.5, 'load': 0.3})
    chain, own = compile_chain(arm), watched(arm, duration=2.0)
    plant = member(chain, parameter_set(arm, chain), np.sign(own.effects[joint]))
    worst = watched(arm, plant, duration=2.0)
    assert 0.3 < np.abs(worst.estimate[joint]) / worst.threshold[joint] < 1.0


@pytest.mark.parametrize(('rates', 'motion'), [
    ('independent', [[3.0, 2.1], [0.1, 0.7], [0.25, 0.4], [1.3, -0.4]]),
    ('derived', [[-2.7, 2.9], [0.35, 0.2], [0.3, 1.1], [0.6, 3.1]]),
])  # fmt: skip
def test_given_noise_of_rates_as_large_as_motion_when_healthy_then_thresholds_hold(rates, motion):
    """Noise that columns and residual share does not average out."""
    attacker = Attacker(with_sensors(load_arm('paper'), rates=rates), 8.0)
    joints, corner = [*motion, *np.zeros((3, 2)).tolist()], [1.0] * attacker.range.count
    attack = Attack(joints, 0.0, 99.0, 0.0, 0.0, 0.0, corner, ['', ''], [0.0, 0.0], seed=2)
    found = attacker.run(attack)
    assert 0.5 < found.ratio < 1.0


def test_given_a_rotor_that_couples_joints_then_its_effect_is_that_of_both():
    stated = replace(CLOSE, uncertainty=description.Uncertainty(0.0, 0.0, 0.05))
    arm = with_joints(stated, 2, rotor_inertia=1.0, rotor_coupling=-0.9)
    chain = compile_chain(arm)
    sizes = parameter_set(arm, chain)
    other = chain.motor + 0.05 * np.array([[0, 0, 0], [0, 0, -0.9], [0, -0.9, 1.0]])
    shares = np.zeros(generator_count(sizes))
    shares[len(sizes.inertial) + 2] = 1.0
    np.testing.assert_allclose(member(chain, sizes, shares).motor, other)
    exact, coupled = (watched(arm, chain._replace(motor=motor)) for motor in (chain.motor, other))
    expected = coupled.effects @ shares
    assert (coupled.estimate - exact.estimate)[2] == pytest.approx(expected[2], rel=0.1)


def answers(*faults, uncertainty=STATED, pushes=(), duration=5.0):
    arm = shoulder_arm('independent', uncertainty)
    found = answered(arm, simulated_run(arm, duration, *faults, pushes=pushes))
    return [event for _, event in found.events], found.reports[-1][1]


@pytest.mark.parametrize('k', [0, 2])
def test_given_an_offset_beyond_its_threshold_when_likelihoods_wait_then_it_is_an_alarm(k):
    (cell,) = cells(['coarse'], [False], ['independent'], [BY_NAME['offset 0.2']])
    subject, window, _ = draw(cell, k, 1)
    (_, alarm), *_ = subject.answers(window.stream).events
    assert (alarm.sensor_index, alarm.basis) == (window.faults[0].sensor, GUARANTEED)
    assert alarm.detected < window.stream.stamps[0] + 2.2e9


@pytest.mark.parametrize(('uncertainty', 'size', 'basis', 'said'), [
    (STATED, 0.4, GUARANTEED, 'no healthy arm'),
    (UNSTATED, 0.4, STATISTICAL, 'statistical'),
    (replace(STATED, model_error=0.2), 0.2, STATISTICAL, 'statistical'),  # below the threshold
])  # fmt: skip
def test_given_an_offset_when_alarmed_then_its_basis_is_said(uncertainty, size, basis, said):
    events, _ = answers(Fault('encoder2', 'bias', 0.0, size=size), uncertainty=uncertainty)
    assert (events[-1].sensor, events[-1].basis) == ('encoder2', basis)
    assert basis == GUARANTEED or {event.basis for event in events} == {STATISTICAL}
    assert said in alarm_text.describe(events[-1])
    assert (events[-1].confidence == 1.0) == (basis == GUARANTEED)


@RATES
def test_given_a_noisy_reading_then_nothing_is_guaranteed_of_any_sensor(rates):
    """Noise beyond the file's is in the balances of all joints."""
    noise = Fault('encoder2', 'noise', 3.0, size=0.02)
    assert watched(shoulder_arm(rates, STATED), None, noise, duration=4.0) is None


def test_given_no_payload_in_the_file_when_told_then_guarantees_hold_without_a_load():
    observer = answers(uncertainty=replace(STATED, payload=None), duration=2.5)[1][0]
    assert 'payload up to 0 kg' in observer['values']['guarantee']


SURE, OVER = ', confidence 90.0% (statistical)', {'event': AlarmEvent.CLEARED}


@pytest.mark.parametrize(('changes', 'told'), [
    ({}, f'ALARM, lift: error +0.0004 m (bound 0.0001 m), bias{SURE}'),
    ({'bound': np.inf}, f'ALARM, lift: error of unknown size, bias{SURE}'),
    *(({'kind': kind, 'bound': np.inf}, f'ALARM, lift: error of unknown size, {word}{SURE}')
      for kind, word in (('stuck', 'reading stands still (stuck)'), ('noise', 'too much noise'),
                         ('spike', 'single wrong readings (spike)'))),
    # No bound is not a perfect estimate, nor is a small one.
    ({'bound': 0.0}, f'ALARM, lift: error +0.0004 m, bias{SURE}'),
    ({'bound': 4e-5}, f'ALARM, lift: error +0.0004 m (bound 0.0001 m), bias{SURE}'),
    ({'bound': 1.01e-4}, f'ALARM, lift: error +0.0004 m (bound 0.0002 m), bias{SURE}'),
    ({'event': AlarmEvent.UPDATED, 'kind': 'drift', 'rate': 0.07, 'unit': 'rad',
      'confidence': 0.9994}, 'alarm updated, lift: error +0.000 rad (bound 0.001 rad), '
     'drift of +0.070 rad/s, confidence 99.9% (statistical)'),
    ({'kind': 'rate_bias', 'unit': 'rad', 'size': -0.05, 'confidence': 0.9996},
     'ALARM, lift: error -0.050 rad/s (bound 0.001 rad/s), of the rate sensor, '
     'confidence > 99.9% (statistical)'),
    ({'basis': GUARANTEED}, 'ALARM, lift: error +0.0004 m (bound 0.0001 m), bias, '
     'guaranteed: no healthy arm inside its file reads this'),
    (OVER, 'alarm cleared, lift: bias is over, remaining error +0.0004 m (bound 0.0001 m)'),
    ({'kind': 'dropout'}, 'ALARM, lift: no readings (dropout)'),
    ({'kind': 'dropout', **OVER}, 'alarm cleared, lift: no readings (dropout) is over'),
])  # fmt: skip
def test_given_an_alarm_when_told_then_an_operator_reads_what_how_much_and_how_sure(changes, told):
    event = Alarm(AlarmEvent.RAISED, 0, 'lift', 0, 0, 4e-4, 1e-4, 'bias', 0.9, unit='m')
    assert alarm_text.describe(replace(event, **changes)) == told


def test_given_faults_or_ranges_when_told_then_rate_basis_and_thresholds_are_said():
    event = answers(Fault('encoder2', 'drift', 2.0, rate=0.1))[0][0]
    assert event.rate == pytest.approx(0.1, abs=0.03)
    assert f'drift of {event.rate:+.3f} rad/s' in alarm_text.describe(event)
    assert not {'basis', 'unit', 'rate'} & set(message_fields.alarm_fields(event))
    events, _ = answers(Fault('encoder3', 'bias', 2.0, size=0.05), duration=2.5)
    assert [(event.sensor, event.basis) for event in events] == [('encoder3', GUARANTEED)]
    observer, base, *others = answers()[1]
    assert 'payload up to 0.5 kg' in observer['values']['guarantee']
    assert 'none' in base['values']['guaranteed threshold [rad]']
    for status in others:
        values = status['values']
        threshold = float(values['guaranteed threshold [rad]'])
        assert 0.0 < 2.0 * threshold <= float(values['surely found beyond [rad]']) + 1e-3
    observer, *sensors = answers(uncertainty=UNSTATED, duration=2.0)[1]
    assert observer['values']['guarantee'].startswith('none stated')
    assert all('guaranteed threshold [rad]' not in one['values'] for one in sensors)
    pushed = answers(pushes=[Push(4.0, 4.6, (0.0, 25.0, 12.0))], duration=7.0)[1][0]
    assert 'none of offsets' in pushed['values']['guarantee']


def test_given_rotors_that_couple_joints_when_bounded_then_no_acceleration_is_above_it():
    arm = with_joints(load_arm('ur10'), 5, rotor_coupling=-0.18)
    model, fastest = SerialModel(compile_chain(arm)), np.zeros(6)
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (50, 6)):
        inverse = np.linalg.inv(model.mass_matrix(q))
        fastest = np.maximum(fastest, np.abs(inverse) @ np.array(arm.torque_limit))
    assert np.all(NET_TORQUE * fastest * arm.sample_time**2 < jump_bound(arm))


@RATES
def test_given_torques_that_switch_at_their_limits_then_no_jump_is_near_its_bound(rates):
    arm, rng = shoulder_arm(rates), np.random.default_rng(0)
    chain, bound, period = compile_chain(arm), jump_bound(arm), arm.sample_time
    step, count = simulation.integration_step(chain, period)
    state, scratch, matrix = np.zeros((2, 3)), simulation.plant_scratch(chain), np.empty((3, 3))
    y, v = np.zeros((2000, 3)), np.zeros((2000, 3))
    for k in range(2000):
        y[k] = state[0] + 1e-4 * rng.normal(size=3)
        v[k] = (y[k] - y[max(k - 1, 0)]) / period
        if rates == 'independent':
            v[k] = state[1] + 5e-3 * rng.normal(size=3)
        torque = np.array(arm.torque_limit) * np.where(state[1] > 0, -1.0, 1.0)
        torque *= rng.choice([1.0, 1.0, -1.0], 3)
        simulation.plant_step(chain, state, torque, step, count, scratch, matrix)
    jumps = y[1:-1] - y[:-2] - 0.5 * period * (v[:-2] + v[2:])
    ratio = np.abs(jumps[3:]).max(0) / bound
    assert np.all(ratio < 1.0)
    assert ratio.max() > 0.05  # it holds in every configuration: some are reached by none


@pytest.mark.parametrize(('lost', 'guaranteed'), [(0, True), (7, False)])
def test_given_a_jump_while_samples_are_lost_then_it_is_not_guaranteed(lost, guaranteed):
    arm, rng, rows = shoulder_arm('independent'), np.random.default_rng(0), 1000
    count = np.arange(rows) + lost * (np.arange(rows) >= 800)
    samples = np.zeros((rows, 3, 3))
    samples[:, :2] = np.array([[1e-4], [5e-3]]) * rng.normal(size=(rows, 2, 3))
    # In eight periods a fifth of the largest acceleration, and braking, is enough.
    samples[800:, 0, 1] += 3.0 * jump_bound(arm)[1]
    monitor = Watched(arm)
    monitor.take(10**9 + round(arm.sample_time * 1e9) * count, samples)
    (alarm,) = monitor.alarms
    assert (alarm.kind, alarm.basis == GUARANTEED) == ('bias', guaranteed)


def test_given_counts_of_samples_when_told_then_one_is_no_plural():
    counters = alarm_text.SampleCounters(duplicates=1, restarts=1, gaps=2)
    assert alarm_text.count_texts(counters) == [
        '1 measurement with the stamp of the one before, ignored',
        '1 restart: the clock was set, or no measurement came for more than 1 s',
        '2 interruptions after which the balances begin anew',
    ]


def test_given_counts_that_are_no_reasons_when_nothing_can_be_used_then_they_are_left_out():
    counters = alarm_text.SampleCounters(restarts=1, gaps=2, without_effort=3)
    assert alarm_text.unusable_text(counters) == ''
    counters.duplicates, counters.unread = 5, 4
    same, zeros, *others = alarm_text.unusable_text(counters).split('; ')
    assert 'no measurement can be used: 5 measurements with the stamp of' in same
    assert zeros.startswith('4 measurements of zeros alone') and others == []
