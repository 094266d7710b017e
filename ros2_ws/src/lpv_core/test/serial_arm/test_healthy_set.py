"""Guaranteed thresholds: no arm of the file crosses them, arms beyond it and faults do."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm

from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.description import TorqueTolerance, Uncertainty
from lpv_core.serial_arm.diagnosis.monitor import SerialMonitor
from lpv_core.serial_arm.diagnosis.parameter_set import member, parameter_set, payload_generator
from lpv_core.serial_arm.simulation import EncoderFault, SerialSimulator

STATED = Uncertainty(payload=0.5, friction=0.3, model_error=0.05)


def stated_arm(rates='independent', **changes):
    return replace(shoulder_arm(rates), uncertainty=STATED, **changes)


def watched(arm, plant=None, faults=(), seed=1, duration=5.0, stated=None):
    """The guarantee of a run; what the monitor's file states may differ from the arm's."""
    run = SerialSimulator(arm, plant, seed).run(duration, faults)
    monitor = SerialMonitor(arm if stated is None else replace(arm, uncertainty=stated))
    monitor.update_many(run.stamps, run.samples)
    return monitor, run


def worst_member(arm, guarantee, joint):
    """The arm of the file whose parameters push the estimate of a joint the most."""
    chain = compile_chain(arm)
    return member(chain, parameter_set(arm, chain), np.sign(guarantee.effects[joint]))


@pytest.mark.parametrize('rates', ['independent', 'derived'])
@pytest.mark.parametrize('joint', [1, 2])
def test_given_the_worst_arm_of_the_file_when_healthy_then_near_its_threshold_not_across(
    rates, joint
):
    arm = stated_arm(rates)
    guarantee = watched(arm)[0].healthy.evaluate()
    monitor, _ = watched(arm, worst_member(arm, guarantee, joint))
    worst = monitor.healthy.evaluate()
    ratio = np.abs(worst.estimate[joint]) / worst.threshold[joint]
    assert 0.5 < ratio < 1.0


@pytest.mark.parametrize('joint', [1, 2])
def test_given_a_file_that_states_too_little_when_healthy_then_the_threshold_is_crossed(joint):
    arm = stated_arm()
    guarantee = watched(arm)[0].healthy.evaluate()
    forged = Uncertainty(payload=0.1, friction=0.1, model_error=0.01)
    monitor, _ = watched(arm, worst_member(arm, guarantee, joint), stated=forged)
    assert monitor.healthy.evaluate().exceeded[joint]


@pytest.mark.parametrize('joint', [1, 2])
def test_given_an_offset_that_is_surely_found_when_present_then_no_healthy_arm_explains_it(joint):
    arm = stated_arm()
    size = float(watched(arm)[0].healthy.evaluate().smallest_found[joint])
    monitor, _ = watched(arm, faults=[EncoderFault(joint, 'bias', 0.0, 1.2 * size)])
    assert monitor.healthy.evaluate().exceeded[joint]


def test_given_an_upright_arm_when_moved_then_nothing_is_claimed_of_its_base():
    guarantee = watched(stated_arm())[0].healthy.evaluate()
    assert guarantee.response[0] == pytest.approx(0.0, abs=1e-6)
    assert not guarantee.exceeded[0]
    assert guarantee.smallest_found[0] == np.inf


def test_given_motion_when_it_goes_on_then_thresholds_shrink_with_what_is_learned():
    run = SerialSimulator(stated_arm(), seed=1).run(6.0)
    monitor = SerialMonitor(stated_arm())
    monitor.update_many(run.stamps[:300], run.samples[:300])
    early = monitor.healthy.evaluate().threshold[1]
    monitor.update_many(run.stamps[300:], run.samples[300:])
    assert monitor.healthy.evaluate().threshold[1] < 0.6 * early


def test_given_no_stated_range_when_watched_then_nothing_is_guaranteed():
    assert watched(shoulder_arm(), duration=0.5)[0].healthy is None


def test_given_a_torque_tolerance_when_stated_then_it_widens_the_threshold():
    arm = stated_arm()
    joints = [replace(one, torque_tolerance=TorqueTolerance((0.0,), (1.0,))) for one in arm.joints]
    loose = replace(arm, joints=tuple(joints))
    tight, wide = (watched(one)[0].healthy.evaluate() for one in (arm, loose))
    assert np.all(wide.slack[1:] > 5.0 * tight.slack[1:])


def test_given_a_long_run_with_a_gap_when_remembered_then_the_estimate_is_still_explained():
    """The set follows horizon, memory and restart as the estimator does, number by number."""
    arm = stated_arm()
    run = SerialSimulator(arm, seed=1).run(14.0)
    monitor = SerialMonitor(arm)
    run.stamps[6500:] += 10**9
    monitor.update_many(run.stamps, run.samples)
    guarantee = monitor.healthy.evaluate()
    assert np.abs(guarantee.rest).max() < 1e-6
    assert not guarantee.exceeded.any()


@pytest.mark.parametrize('joint', [1, 2])
@pytest.mark.parametrize('mass', [0.0, 0.3, 0.5])
def test_given_any_payload_of_the_file_when_learned_then_the_interval_holds_it(mass, joint):
    arm = stated_arm()
    guarantee = watched(arm)[0].healthy.evaluate()
    chain = compile_chain(arm)
    sizes = parameter_set(arm, chain)
    shares = np.sign(guarantee.effects[joint])
    at_tip = payload_generator(sizes, 0.5)
    shares[at_tip : len(sizes.inertial)] = 0.0
    shares[at_tip] = mass / 0.5
    monitor, _ = watched(arm, member(chain, sizes, shares), duration=8.0)
    low, high = monitor.healthy.evaluate().payload
    assert low <= mass <= high


def test_given_an_exact_arm_when_moved_long_then_its_payload_is_known_better_than_stated():
    low, high = watched(stated_arm(), duration=8.0)[0].healthy.evaluate().payload
    assert low == 0.0
    assert high < 0.45


def test_given_a_fault_of_another_sensor_when_present_then_this_one_stays_below_its_threshold():
    monitor, _ = watched(stated_arm(), faults=[EncoderFault(1, 'bias', 0.0, 0.3)])
    assert monitor.healthy.evaluate().exceeded.tolist() == [False, True, False]
