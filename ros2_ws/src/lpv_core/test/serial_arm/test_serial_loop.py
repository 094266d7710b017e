"""The loop of a serial arm: simulator, diagnosis and computed torque."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm

from lpv_core.control.computed_torque import ComputedTorqueController
from lpv_core.control.watchdog import BrakeReason, StopReason
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.diagnosis.alarms import AlarmEvent
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.closed_loop import run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.simulation.scenario import Scenario
from lpv_core.simulation.transport import Stall, Transport
from lpv_core.support.errors import ConfigError

pytestmark = pytest.mark.slow

SCENARIO = Scenario(
    name='test',
    duration=4.0,
    seed=1,
    plant='nonlinear',
    parameter_error=0.05,
    payload=0.3,
    friction_factor=1.1,
    noise=True,
    noise_factor=1.0,
    times=(0.2, 2.0, 4.0),
    waypoints=((0.0, 0.5, -1.0), (0.5, 0.9, -1.5), (-0.2, 0.4, -0.8)),
    faults=(),
)
STEP = Fault('encoder2', 'bias', 1.0, size=0.1)


@pytest.fixture(scope='module')
def arm():
    return shoulder_arm('independent')


@pytest.fixture(scope='module')
def healthy(arm):
    return run_closed_loop(arm, SCENARIO)


@pytest.fixture(scope='module')
def faulty(arm):
    return run_closed_loop(arm, replace(SCENARIO, faults=(STEP,)))


def test_given_a_wrong_model_when_nothing_fails_then_the_arm_follows_and_nothing_is_said(healthy):
    assert np.abs(healthy.position - healthy.reference).max() < 0.02
    assert healthy.alarms == [] and not healthy.alarm.any()
    assert not healthy.stop_reason.any() and not healthy.brake_reason.any()


def test_given_a_step_when_it_comes_then_its_sensor_is_named_within_20_ms(faulty):
    first = faulty.alarms[0]
    assert (first.sensor, first.kind) == ('encoder2', 'bias')
    assert first.size == pytest.approx(0.1, abs=2e-3) and first.detected < 1_020_000_000


def test_given_a_step_when_compensated_then_the_true_arm_stays_on_its_path(arm, faulty):
    assert np.abs(faulty.position - faulty.reference).max() < 0.06
    off = run_closed_loop(arm, replace(SCENARIO, faults=(STEP,)), compensation='off')
    assert np.abs(off.position[-200:, 1] - off.reference[-200:, 1]).min() > 0.08


def test_given_one_seed_when_run_twice_then_every_number_is_the_same(arm, healthy):
    again = run_closed_loop(arm, SCENARIO)
    np.testing.assert_array_equal(again.torque, healthy.torque)
    other = run_closed_loop(arm, replace(SCENARIO, seed=2))
    assert np.abs(other.torque - healthy.torque).max() > 0.1


def test_given_a_fault_beyond_all_limits_when_fed_back_then_the_arm_is_stopped_for_good(arm):
    wild = replace(STEP, size=2.0, sensor='encoder1')
    run = run_closed_loop(arm, replace(SCENARIO, faults=(wild,)), compensation='off')
    last = run.stop_reason[-1], run.brake_reason[-1]
    assert StopReason(last[0]) in (StopReason.TRACKING_ERROR, StopReason.OVERSPEED)
    assert BrakeReason(last[1]) in (BrakeReason.SAFE_STOP, BrakeReason.OVERSPEED)
    assert np.ptp(run.position[-100:], axis=0).max() == 0.0


FAULTS = {
    'none': (),
    'step': (STEP,),
    'dropout': (Fault('encoder3', 'dropout', 0.5, duration=0.3),),
    'dropout from the start': (Fault('encoder1', 'dropout', 0.0, duration=0.2),),
    'step in a dropout': (STEP, Fault('encoder2', 'dropout', 0.9, duration=0.3)),
    'stuck': (Fault('encoder3', 'stuck', 0.5, duration=0.3),),
    'spikes': (Fault('encoder3', 'spike', 0.5, duration=0.3, size=0.01, rate=20.0),),
    'noise': (Fault('encoder3', 'noise', 0.5, duration=0.3, size=0.01),),
}
TRANSPORTS = {
    'direct': Transport(),
    'late and lossy': Transport(1, 0.1),
    'stalled': Transport(stalls=(Stall('observer', 0.6, 0.1), Stall('tracker', 1.0, 0.02))),
}


@pytest.mark.parametrize('rates', ['independent', 'derived'])
@pytest.mark.parametrize('faults', FAULTS)
@pytest.mark.parametrize('transport', TRANSPORTS)
def test_given_a_run_when_the_node_gets_its_samples_then_it_answers_the_same(
    rates, faults, transport
):
    scenario = replace(SCENARIO, duration=1.6, faults=FAULTS[faults])
    arm = shoulder_arm(rates)
    run = run_closed_loop(arm, scenario, transport=TRANSPORTS[transport])
    stamps = np.round(run.time * 1e9).astype(np.int64)[~run.lost]
    rows = (one[~run.lost] for one in (run.measured, run.measured_velocity, run.effort))
    answers = SerialSensorMonitor('node', arm).take_many(stamps, *rows)
    assert run.alarms == [alarm for _, alarm in answers.events]
    np.testing.assert_array_equal(run.fault_estimate[~run.lost], answers.fault.estimate)
    np.testing.assert_array_equal(run.threshold[~run.lost], answers.fault.threshold)
    np.testing.assert_array_equal(run.compensated[~run.lost], answers.state.compensated_position)
    assert np.isfinite(run.torque).all() and np.isfinite(run.compensated).all()


def test_given_a_dropout_when_it_lasts_then_it_is_raised_after_50_ms_and_cleared_at_its_end(arm):
    run = run_closed_loop(arm, replace(SCENARIO, duration=1.2, faults=FAULTS['dropout']))
    told = [(one.event, one.sensor, one.kind, one.detected) for one in run.alarms]
    assert told == [
        (AlarmEvent.RAISED, 'encoder3', 'dropout', 552_000_000),
        (AlarmEvent.CLEARED, 'encoder3', 'dropout', 800_000_000),
    ]


@pytest.mark.parametrize('part', ['observer', 'tracker'])
def test_given_a_part_that_stalls_when_it_lasts_then_the_tracker_stops_for_silence(arm, part):
    stall = Transport(stalls=(Stall(part, 1.0, 0.5),))
    run = run_closed_loop(arm, replace(SCENARIO, duration=1.6), transport=stall)
    silent = run.stop_reason == StopReason.SILENCE
    assert silent[600:740].any() and not silent[:500].any()
    assert run.lost.any() == (part == 'observer')


def test_given_commands_that_stall_when_they_are_late_then_the_drives_brake(arm):
    stall = Transport(stalls=(Stall('commands', 1.0, 0.5),))
    run = run_closed_loop(arm, replace(SCENARIO, duration=1.6), transport=stall)
    assert (run.brake_reason[500:] == BrakeReason.LATE).any()
    assert not run.brake_reason[:500].any()


@pytest.mark.parametrize(('rates', 'jump'), [('derived', 50.0), ('independent', 0.0)])
def test_given_a_derived_rate_when_its_encoder_jumps_then_it_jumps_too(rates, jump):
    scenario = replace(SCENARIO, faults=(replace(STEP, onset=0.01),))
    simulator = ArmSimulator(shoulder_arm(rates), scenario)
    readings = [simulator.sense()[0]]
    for _ in range(5):
        simulator.hold()
        readings.append(simulator.sense()[0])
    rates_read = np.array([reading.velocity[1] for reading in readings])
    assert np.abs(np.diff(rates_read)).max() == pytest.approx(jump, abs=1.0)


def test_given_brakes_when_they_hold_then_the_arm_stands_and_efforts_carry_it(arm):
    simulator = ArmSimulator(arm, SCENARIO)
    simulator.hold()
    measurement, truth = simulator.sense()
    np.testing.assert_array_equal(truth.velocity, 0.0)
    assert abs(measurement.effort[1]) > 10.0


def test_given_a_torque_beyond_the_limit_when_applied_then_it_is_clipped(arm):
    simulator = ArmSimulator(arm, SCENARIO)
    simulator.step([1e3, -1e3, 0.0])
    np.testing.assert_array_equal(simulator.sense()[0].effort, [60.0, -80.0, 0.0])
    with pytest.raises(ValueError, match='3 finite numbers'):
        simulator.step([0.0, np.nan, 0.0])


def test_given_a_bandwidth_when_the_samples_are_too_few_for_it_then_it_is_refused(arm):
    assert ComputedTorqueController(arm, 10.0).tolerated_latency > 0.02
    with pytest.raises(ConfigError, match='bandwidth: 900 rad/s is unstable'):
        ComputedTorqueController(arm, 900.0)


def test_given_mujoco_as_the_plant_when_run_then_it_agrees_with_the_built_in_one(arm, healthy):
    pytest.importorskip('mujoco')
    other = run_closed_loop(arm, replace(SCENARIO, plant='mujoco', duration=1.0))
    np.testing.assert_allclose(other.position, healthy.position[:501], atol=1e-6)
