from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from fault_injection import with_joints, with_sensors
from places import BRINGUP
from serial_arms import middle, mixed_arm, scara, shoulder_arm, ur10_on_rail, with_rates

from lpv import AlarmEvent, ConfigError, Fault, Scenario, load_arm, load_scenario
from lpv.campaign.plan.random_paths import random_path
from lpv.core.control.estimate_check import FADING, CorrectionLimit
from lpv.core.control.path_follower import PathFollower
from lpv.core.control.tracking import TrackingController
from lpv.core.control.watchdog import BrakeReason, StopReason, TrackerLimits, TrackerWatchdog
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.simulation import closed_loop
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.simulation.closed_loop import run_closed_loop
from lpv.core.simulation.scenario import parse_scenario
from lpv.core.simulation.transport import Stall, Transport
from lpv.core.support import jit

pytestmark = pytest.mark.slow
SCENARIO = Scenario(
    name='test', duration=4.0, seed=1, plant='nonlinear', parameter_error=0.05, payload=0.3,
    friction_factor=1.1, noise=True, noise_factor=1.0, times=(0.2, 2.0, 4.0), faults=(),
    waypoints=((0.0, 0.5, -1.0), (0.5, 0.9, -1.5), (-0.2, 0.4, -0.8)))  # fmt: skip
STEP = Fault('encoder2', 'bias', 1.0, size=0.1)
DT, JOINT, SIZE = 0.002, 1, 0.5
ONSET = 2.5  # of the wrong correction, when the shoulder moves [s]
CORRECTIONS = {
    'appears': lambda t: SIZE * (t >= ONSET),
    'disappears': lambda t: SIZE * (t < ONSET),
    'comes and goes': lambda t: SIZE * (t >= ONSET and int((t - ONSET) / 0.02) % 2 == 0),
    'drifts': lambda t: min(SIZE, 0.25 * max(0.0, t - ONSET)),
    'drifts fast': lambda t: min(SIZE, 3.0 * max(0.0, t - ONSET)),
    'swings': lambda t: SIZE * np.sin(4.0 * max(0.0, t - ONSET)),
}


def simulate(*faults, rates='independent', transport=None, compensation='confirmed', **changes):
    """A run of the loop with faults and other changes of the scenario."""
    scenario = replace(SCENARIO, faults=faults, **changes)
    arm, transport = shoulder_arm(rates), transport or Transport()
    return run_closed_loop(arm, scenario, compensation=compensation, transport=transport)


def test_given_a_wrong_model_when_an_encoder_fails_then_the_arm_follows_or_is_stopped():
    healthy = simulate()
    assert np.abs(healthy.position - healthy.reference).max() < 0.02
    assert healthy.alarms == [] and not healthy.alarm.any()
    assert not healthy.stop_reason.any() and not healthy.brake_reason.any()
    faulty, off = simulate(STEP), simulate(STEP, compensation='off')
    first = faulty.alarms[0]
    assert (first.sensor, first.kind) == ('encoder2', 'bias')
    assert first.size == pytest.approx(0.1, abs=2e-3) and first.detected < 1_020_000_000
    assert np.abs(faulty.position - faulty.reference).max() < 0.06
    assert np.abs(off.position[-200:, 1] - off.reference[-200:, 1]).min() > 0.08
    run = simulate(replace(STEP, size=2.0, sensor='encoder1'), compensation='off', duration=2.0)
    last = run.stop_reason[-1], run.brake_reason[-1]
    assert StopReason(last[0]) in (StopReason.TRACKING_ERROR, StopReason.OVERSPEED)
    assert BrakeReason(last[1]) in (BrakeReason.SAFE_STOP, BrakeReason.OVERSPEED)
    assert np.ptp(run.position[-100:], axis=0).max() == 0.0


def test_given_spikes_when_rates_are_differences_then_the_arm_stays_on_its_path():
    run = simulate(Fault('encoder2', 'spike', 1.0, size=0.3, rate=2.0), rates='derived')
    assert np.abs(run.measured - run.position).max() > 0.25
    assert np.abs(run.position - run.reference).max() < 0.02
    assert np.abs(run.estimated_velocity - run.velocity).max() < 0.5  # of differences: 150 rad/s


@pytest.mark.parametrize(('size', 'duration'), [(0.04, 0.5), (0.075, 2.0), (0.04, 0.014)])
@pytest.mark.parametrize('rates', ['derived', 'independent'])
def test_given_a_noisy_reading_in_the_loop_then_the_arm_stays_on_its_path(rates, size, duration):
    noise = Fault('encoder2', 'noise', 1.0, duration=duration, size=size)
    run = simulate(noise, rates=rates)
    assert np.abs(run.position - run.reference).max() < 0.1
    burst = (run.time >= 1.0) & (run.time < 1.0 + duration)
    error, raw = (part - run.position for part in (run.compensated, run.measured))
    assert np.sqrt((error[burst, 1] ** 2).mean()) < 0.5 * np.sqrt((raw[burst, 1] ** 2).mean())


@pytest.mark.parametrize(('seed', 'onset', 'size', 'duration'), [
    (46, 4.7703, 0.04, 0.014), (46, 4.7703, 0.04, 0.5), (43, 4.6532, 0.2, 0.5),
])  # fmt: skip
def test_given_noise_that_begins_below_a_jump_then_no_arm_is_thrown(seed, onset, size, duration):
    """The first difference of readings would be a rate of 15 rad/s, at which it is carried on."""
    scenario = load_scenario(BRINGUP / 'scenarios' / 'real_arm.yaml')
    noise = Fault('joint2_encoder', 'noise', onset, duration, size)
    scenario = replace(scenario, duration=6.0, seed=seed, parameter_error=0.05, faults=(noise,))
    run = run_closed_loop(load_arm(BRINGUP / 'arms' / 'real_arm.yaml'), scenario)
    assert np.abs(run.compensated - run.position).max() < 0.3
    assert np.abs(run.position - run.reference).max() < 0.35
    assert not run.stop_reason[run.time > 1.0].any()


@pytest.mark.parametrize(('joint', 'seed', 'onset', 'size', 'duration'), [
    (6, 96, 7.0686, 0.04, 0.5),  # drives brake, and the noise ends while balances hold the stop
    (1, 94, 7.2604, 0.2, 3.0),  # of a base whose turning pulls at the shoulder
])  # fmt: skip
def test_given_a_noisy_reading_in_the_loop_then_no_other_is_blamed(
    joint, seed, onset, size, duration
):
    noise = Fault(f'joint{joint}_encoder', 'noise', onset, duration, size)
    scenario = replace(load_scenario('panda'), seed=seed, parameter_error=0.05, faults=(noise,))
    arm = with_sensors(load_arm('panda'), rates='derived')
    run = run_closed_loop(arm, replace(scenario, duration=9.0))
    assert {one.sensor for one in run.alarms} == {noise.sensor}


def test_given_no_readings_for_less_than_50_ms_when_the_arm_moves_then_it_is_not_stopped():
    faults = (Fault(f'encoder{i}', 'dropout', 1.0, duration=0.04) for i in (1, 2, 3))
    run = simulate(*faults, duration=2.0)
    assert np.isnan(run.measured).all(1).sum() == 20
    assert not run.stop_reason.any() and np.abs(run.position - run.reference).max() < 0.02


ROUNDED = [with_sensors(shoulder_arm(r), quantization=1e-3) for r in ('derived', 'independent')]


@pytest.mark.parametrize(('arm', 'seed'), [
    *((with_rates(scara(), 'derived'), seed) for seed in (6, 11)),
    # Rounded readings of all joints stop at once, as if each of them froze.
    *((arm, seed) for arm in ROUNDED for seed in (3, 6)),
])  # fmt: skip
def test_given_drives_that_brake_in_motion_when_healthy_then_no_encoder_is_blamed(arm, seed):
    path = random_path(arm, np.random.default_rng(seed), 6.0)
    scenario = {'name': 'test', 'duration': 6.0, 'seed': seed, 'path': path, 'disturbance': False}
    scenario = parse_scenario({**scenario, 'plant': {'parameter_error': 0.05}})
    run = run_closed_loop(arm, scenario, transport=Transport(stalls=(Stall('commands', 4.5, 0.3),)))
    assert run.braked[2300:2390].all() and run.alarms == []


@pytest.mark.parametrize(('name', 'joint', 'onset', 'seed'), [
    ('panda', 5, 5.6, 5), ('ur10', 1, 6.0, 7),
])  # fmt: skip
def test_given_a_frozen_reading_when_drives_brake_then_no_other_is_blamed(name, joint, onset, seed):
    """How fast the joint was that was driven away is not known: arms without rotors are, soon."""
    arm = read_urdf_chain(BRINGUP / 'urdf' / f'{name}.urdf')
    way = np.minimum(0.2 * np.array([np.ptp(one.range) for one in arm.joints]), 0.4)
    places = [middle(arm) + side * way for side in (0.0, 1.0, -1.0)]
    sensor = arm.sensor_names[joint]
    scenario = replace(
        SCENARIO, duration=10.0, seed=seed, payload=0.0, friction_factor=1.0, times=(0.5, 4.0, 8.0),
        waypoints=tuple(map(tuple, places)), faults=(Fault(sensor, 'stuck', onset),))  # fmt: skip
    run = run_closed_loop(arm, scenario)
    assert {one.sensor for one in run.alarms} == {sensor}
    # It was stopped with the others: where it is does not change any more.
    held = run.braked & (run.time > onset + 0.1)
    error = np.abs(run.fault_estimate - run.fault)[held, joint]
    assert held.sum() > 500 and (error < run.threshold[held, joint]).all()


SCALED = {
    'turn_1_encoder': (208, 5.332, (0.5, 4.227, 7.5), (
        (-0.183, 0.483, -0.036, -1.425), (-1.067, 1.115, -0.163, -0.680),
        (1.968, 0.724, -0.075, -1.856))),
    'turn_2_encoder': (98, 5.525, (0.5, 4.546, 7.5), (
        (0.225, -0.226, -0.085, -0.448), (1.616, 1.638, -0.046, -1.780),
        (-1.814, -1.148, -0.089, -0.107))),
}  # fmt: skip
"""By the sensor: seed, onset in motion, and a path."""


@pytest.mark.parametrize('sensor', SCALED)
def test_given_a_scale_error_when_its_reading_jumps_in_motion_then_no_other_is_blamed(sensor):
    """Its rate is off as well, which balances show before it is known to be a scale error."""
    seed, onset, times, places = SCALED[sensor]
    fault, arm = Fault(sensor, 'scale', onset, size=0.2), with_rates(scara(), 'derived')
    scenario = replace(
        SCENARIO, duration=onset + 0.5, seed=seed, payload=0.0, friction_factor=1.0, times=times,
        waypoints=places, faults=(fault,))  # fmt: skip
    run = run_closed_loop(arm, scenario)
    assert [(one.sensor, one.kind) for one in run.alarms] == [(sensor, 'bias')]
    # Drives brake after 0.13 s: until then balances do not decide, and bounds hold both.
    acts, joint = run.time > onset + 0.01, arm.sensor_names.index(sensor)
    assert (np.abs(run.fault_estimate - run.fault) < run.threshold)[acts, joint].all()


@pytest.mark.parametrize(('name', 'joint'), [('panda', 1), ('panda', 3), ('ur10', 2)])
def test_given_slow_joints_when_a_drift_is_named_then_they_are_led_back_without_a_stop(name, joint):
    """Corrections that fade at 0.5 rad/s, and the loop's overshoot, were too fast for them."""
    arm, scenario = with_sensors(load_arm(name), rates='derived'), load_scenario(name)
    arm = with_joints(replace(arm, covariance=None, sample_time=0.01), limits={'velocity': 1.2})
    fault = Fault(arm.sensor_names[joint], 'drift', 5.0, rate=0.15)
    run = run_closed_loop(arm, replace(scenario, duration=9.0, faults=(fault,)))
    assert [(one.sensor, one.kind) for one in run.alarms] == [(fault.sensor, 'drift')]
    error = np.abs(run.position - run.reference)[-50:]
    assert not run.stops and error.max() < 0.025


FAULTS = {
    **{'none': (), 'step': (STEP,), 'dropout': (Fault('encoder3', 'dropout', 0.5, duration=0.3),)},
    'dropout from the start': (Fault('encoder1', 'dropout', 0.0, duration=0.2),),
    'step in a dropout': (STEP, Fault('encoder2', 'dropout', 0.9, duration=0.3)),
    'stuck': (Fault('encoder3', 'stuck', 0.5, duration=0.3),),
    'spikes': (Fault('encoder3', 'spike', 0.5, duration=0.3, size=0.01, rate=20.0),),
    'noise': (Fault('encoder3', 'noise', 0.5, duration=0.3, size=0.01),),
}
STALLS = Stall('observer', 0.6, 0.1), Stall('tracker', 1.0, 0.02)
WAYS = {'direct': ('derived', Transport()), 'late and lossy': ('independent', Transport(1, 0.1))}
WAYS['stalled'] = 'derived', Transport(stalls=STALLS)


@pytest.mark.parametrize(('faults', 'way'), [
    *((faults, 'direct') for faults in FAULTS), ('step in a dropout', 'late and lossy'),
    ('stuck', 'late and lossy'), ('none', 'stalled'), ('noise', 'stalled'),
])  # fmt: skip
def test_given_a_run_when_a_node_gets_it_then_it_answers_the_same(faults, way):
    rates, transport = WAYS[way]
    run = simulate(*FAULTS[faults], rates=rates, transport=transport, duration=1.4)
    kept = ~run.lost
    stamps = np.round(run.time * 1e9).astype(np.int64)[kept]
    rows = (one[kept] for one in (run.measured, run.measured_velocity, run.effort))
    answers = SerialSensorMonitor('node', shoulder_arm(rates)).take_many(stamps, *rows)
    assert run.alarms == [alarm for _, alarm in answers.events]
    np.testing.assert_array_equal(run.fault_estimate[kept], answers.fault.estimate)
    np.testing.assert_array_equal(run.bound[kept], answers.fault.bound)
    np.testing.assert_array_equal(run.threshold[kept], answers.fault.threshold)
    np.testing.assert_array_equal(run.compensated[kept], answers.state.compensated_position)
    assert np.isfinite(run.torque).all() and np.isfinite(run.compensated).all()
    if (faults, way) == ('dropout', 'direct'):  # raised after 50 ms, cleared at its end
        raised, cleared = run.alarms
        assert {(one.sensor, one.kind) for one in run.alarms} == {('encoder3', 'dropout')}
        assert (raised.event, raised.detected) == (AlarmEvent.RAISED, 552_000_000)
        assert (cleared.event, cleared.detected) == (AlarmEvent.CLEARED, 800_000_000)
        assert raised.onset == 500_000_000


@pytest.mark.parametrize('part', ['observer', 'tracker', 'commands'])
def test_given_a_part_that_stalls_when_it_lasts_then_the_arm_is_stopped_or_braked(part):
    run = simulate(transport=Transport(stalls=(Stall(part, 1.0, 0.5),)), duration=1.6)
    late = run.brake_reason == BrakeReason.LATE
    if part != 'commands':
        late = run.stop_reason == StopReason.SILENCE
        assert late[600:740].any()
    assert late[500:].any() and not late[:500].any()
    assert run.lost.any() == (part == 'observer')


def test_given_a_bandwidth_when_the_samples_are_too_few_for_it_then_it_is_refused():
    arm = shoulder_arm('independent')
    assert TrackingController(arm, bandwidth=10.0).tolerated_latency > 0.02
    with pytest.raises(ConfigError, match='bandwidth: 900 rad/s is unstable'):
        TrackingController(arm, bandwidth=900.0)


def sliding(arm, *faults, duration):
    rng = np.random.default_rng(3)
    reach = np.array([0.12 * (joint.range[1] - joint.range[0]) for joint in arm.joints])
    rows = middle(arm) + reach * np.vstack([0.0 * reach, rng.uniform(-1.0, 1.0, (4, len(reach)))])
    if arm.name == 'ur10_on_rail':
        rows[:, 2:4] += [-1.0, 1.0]
    return Scenario(
        name='slides', duration=duration, seed=2, plant='nonlinear', parameter_error=0.03,
        payload=0.2, friction_factor=1.1, noise=True, noise_factor=1.0,
        times=(0.3, 2.5, 5.0, 7.5, 9.8), waypoints=tuple(map(tuple, rows)), faults=faults,
    )  # fmt: skip


@pytest.mark.parametrize('make', [scara, ur10_on_rail, partial(mixed_arm, joints=3)])
def test_given_an_arm_with_slides_when_nothing_fails_then_it_follows_and_nothing_is_said(make):
    run = run_closed_loop(make(), sliding(make(), duration=6.0))
    assert run.alarms == [] and not run.stop_reason.any() and not run.brake_reason.any()
    assert np.abs(run.position - run.reference).max() < 0.03


@pytest.mark.skipif(not jit.COMPILED, reason='without Numba nothing has a type')
def test_given_another_number_of_joints_when_run_then_the_same_compiled_code_runs(monkeypatch):
    entry, called = jit.entry, {1: {}, 3: {}, 4: {}}

    def noted(function, *arguments):
        called[joints][function.py_func] = [*map(function.typeof_pyval, arguments)]
        return entry(function, *arguments)

    for module in (jit, closed_loop):
        monkeypatch.setattr(module, 'entry', noted)
    for joints in called:
        arm = mixed_arm(joints=joints)
        run_closed_loop(arm, sliding(arm, duration=0.1))
        simulator = ArmSimulator(arm, sliding(arm, duration=0.1))
        simulator.read()
        simulator.step(np.zeros(joints))
        simulator.hold()
    assert called[1] == called[3] == called[4] and len(called[1]) > 5


@pytest.mark.parametrize('fault', [
    Fault('rail_encoder', 'bias', 3.0, size=0.03),
    Fault('rail_encoder', 'drift', 3.0, rate=0.05),
    Fault('shoulder_lift_encoder', 'bias', 3.0, size=0.1),
], ids=lambda f: f'{f.sensor}-{f.kind}')  # fmt: skip
def test_given_an_arm_on_a_rail_when_an_encoder_fails_then_its_fault_is_named(fault):
    arm = ur10_on_rail()
    run = run_closed_loop(arm, sliding(arm, fault, duration=10.0))
    first = run.alarms[0]
    assert (first.sensor, first.kind) == (fault.sensor, fault.kind)
    assert first.unit == ('m' if 'rail' in fault.sensor else 'rad')
    assert {alarm.sensor for alarm in run.alarms} == {fault.sensor}


@pytest.mark.parametrize(('size', 'onset'), [(0.2, 3.0), (-0.25, 3.5)])
def test_given_an_offset_when_it_makes_the_loop_brake_then_it_is_no_scale_error(size, onset):
    fault = Fault('rail_encoder', 'bias', onset, size=size, duration=4.0)
    arm = ur10_on_rail()
    run = run_closed_loop(arm, sliding(arm, fault, duration=9.5), compensation='off')
    assert run.brake_reason.any() and len(run.alarms) == 2
    assert {(alarm.sensor, alarm.kind) for alarm in run.alarms} == {('rail_encoder', 'bias')}


class Loop:
    """The tracking law of the node on a simulated UR10; a correction is put on the true reading."""

    def __init__(self, correction, corrects_rates=False):
        self.arm, scenario = load_arm('ur10'), load_scenario('ur10')
        self.simulator = ArmSimulator(self.arm, scenario)
        self.follower = PathFollower(scenario.path(self.arm))
        self.law, self.limit = TrackingController(self.arm), CorrectionLimit(self.arm)
        self.watchdog = TrackerWatchdog(self.arm, TrackerLimits())
        self.correction, self.corrects_rates = correction, corrects_rates
        self.reason, self.speeds, self.torques, self.errors = StopReason.NONE, [], [], []

    def step(self, k):
        stamp, sensed = 10**9 + k * 2_000_000, self.simulator.sense()
        measured, rate = sensed['measured_position'], sensed['measured_velocity']
        position, velocity = measured.copy(), rate.copy()
        now, before = self.correction(k * DT), self.correction((k - 1) * DT)
        position[JOINT] -= now
        if self.corrects_rates and abs(now - before) < 0.02:  # a jump is no rate
            velocity[JOINT] -= (now - before) / DT
        rates = velocity, rate
        self.reason = self.watchdog.check_estimate(stamp, 0, int(Mode.OBSERVING), True, *rates)
        if self.reason is StopReason.NONE:
            reference = self.follower.reference(stamp, position)
            self.reason = self.watchdog.check_motion(stamp, reference.position, position, measured)
        if self.reason is not StopReason.NONE:
            self.simulator.hold()
            return
        self.limit.take(stamp, position, velocity)
        feedback, span = self.limit.position, DT if k else 0.0
        motion = np.array([reference.position, reference.velocity, reference.acceleration])
        self.law.answer(motion, feedback, self.limit.velocity, feedback, span)
        self.simulator.step(self.law.torque)
        self.speeds.append(np.abs(self.simulator.state.motion[1]))
        self.torques.append(self.law.torque.copy())
        self.errors.append(feedback - position)

    def run(self, seconds):
        for k in range(round(seconds / DT)):
            self.step(k)
            if self.reason is not StopReason.NONE:
                break
        return self


@cache
def loop_with(name, corrects_rates):
    return Loop(CORRECTIONS[name], corrects_rates).run(ONSET + 2.5)


@pytest.mark.parametrize(('name', 'corrects_rates'), [
    *((name, False) for name in CORRECTIONS),
    *((name, True) for name in ('drifts', 'drifts fast', 'swings')),  # a jump is no rate
])  # fmt: skip
def test_given_a_wrong_correction_when_it_changes_then_no_joint_is_too_fast(name, corrects_rates):
    loop = loop_with(name, corrects_rates)
    limit, fastest = np.array(loop.arm.velocity_limit), np.max(loop.speeds, axis=0)
    # The stop comes 0.02 s after a joint is too fast: until then it stays below its own limit.
    assert np.all(fastest < limit)
    if loop.reason is not StopReason.OVERSPEED:
        assert np.all(fastest < 1.2 * TrackerLimits.speed * limit)
    assert np.abs(np.diff(loop.torques, axis=0)).max() < 0.6 * max(loop.arm.torque_limit)
    if name in ('drifts fast', 'swings') and corrects_rates:
        assert loop.reason is StopReason.OVERSPEED


@pytest.mark.parametrize('name', ['appears', 'disappears'])
def test_given_a_correction_that_jumps_when_followed_then_torques_do_not_and_it_is_faded_in(name):
    loop, onset = loop_with(name, False), round(ONSET / DT)
    jump = np.abs(np.diff(loop.torques, axis=0))
    assert jump[onset - 1 :].max() < 2.0 * jump[10 : onset - 1].max() + 5.0
    errors = np.abs(np.array(loop.errors)[:, JOINT])
    assert errors[onset] == pytest.approx(SIZE, abs=0.01) and errors[: onset - 1].max() == 0.0
    assert np.abs(np.diff(errors[onset:])).max() <= FADING * DT * 1.001
    assert errors[-1] == 0.0


def test_given_no_correction_when_started_then_from_rest_and_the_limit_changes_nothing():
    loop = Loop(lambda t: 0.0)
    loop.simulator.state.motion[1, 3] = 0.5
    loop.step(0)
    assert loop.reason is StopReason.MOVING
    loop.step(1)
    assert loop.reason is StopReason.NONE
    loop = Loop(lambda t: 0.0).run(3.0)
    assert loop.reason is StopReason.NONE and not np.any(loop.errors)
