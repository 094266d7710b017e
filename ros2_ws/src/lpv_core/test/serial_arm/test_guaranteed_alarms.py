"""Alarms of serial arms say whether they are guaranteed or statistical."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm

from lpv_core.monitoring.alarm_text import describe
from lpv_core.monitoring.message_fields import alarm_fields
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.serial_arm.certificate.jump_bound import jump_bound
from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.description import Uncertainty
from lpv_core.serial_arm.diagnosis.alarms import GUARANTEED, STATISTICAL
from lpv_core.serial_arm.simulation import (
    EncoderFault,
    Push,
    SerialSimulator,
    integration_step,
    plant_scratch,
    plant_step,
)

STATED = Uncertainty(payload=0.5, friction=0.3, model_error=0.05)
FROM_START = EncoderFault(1, 'bias', 0.0, 0.4)


def answers(uncertainty=STATED, faults=(), pushes=(), duration=5.0):
    arm = replace(shoulder_arm('independent'), uncertainty=uncertainty)
    run = SerialSimulator(arm, seed=1).run(duration, faults, pushes)
    monitor = SerialSensorMonitor('uio', arm)
    found = monitor.take_many(run.stamps + 1, *(run.samples[:, k] for k in range(3)))
    return [event for _, event in found.events], found.reports[-1][1]


@pytest.mark.parametrize(
    ('uncertainty', 'basis', 'said'),
    [(STATED, GUARANTEED, 'no healthy arm'), (Uncertainty(0.5, 0.3), STATISTICAL, 'statistical')],
)
def test_given_an_offset_when_alarmed_then_its_basis_is_said(uncertainty, basis, said):
    last = answers(uncertainty, [FROM_START])[0][-1]
    assert (last.sensor, last.basis) == ('encoder2', basis)
    assert said in describe(last)
    assert (last.confidence == 1.0) == (basis == GUARANTEED)


def test_given_an_alarm_when_published_then_the_message_has_its_old_fields():
    event = answers(faults=[FROM_START])[0][0]
    assert 'basis' not in alarm_fields(event)


def test_given_an_offset_below_the_threshold_when_alarmed_then_it_is_statistical():
    wide = Uncertainty(payload=0.5, friction=0.3, model_error=0.2)
    events, _ = answers(wide, [EncoderFault(1, 'bias', 0.0, 0.2)])
    assert events
    assert {event.basis for event in events} == {STATISTICAL}


def test_given_ranges_when_reported_then_thresholds_of_every_sensor_are_on_diagnostics():
    observer, base, shoulder, elbow = answers()[1]
    assert 'payload up to 0.5 kg' in observer['values']['guarantee']
    assert 'none' in base['values']['guaranteed threshold [rad]']
    for status in (shoulder, elbow):
        threshold, found = (
            float(status['values'][key])
            for key in ('guaranteed threshold [rad]', 'surely found beyond [rad]')
        )
        assert 0.0 < 2.0 * threshold <= found + 1e-3


def test_given_no_ranges_when_reported_then_nothing_is_claimed():
    observer, *sensors = answers(Uncertainty(0.5, 0.3), duration=2.0)[1]
    assert observer['values']['guarantee'].startswith('none stated')
    assert all('guaranteed threshold [rad]' not in one['values'] for one in sensors)


def test_given_a_push_when_reported_then_nothing_is_claimed_until_reset():
    observer = answers(pushes=[Push(4.0, 4.6, (0.0, 25.0, 12.0))], duration=7.0)[1][0]
    assert 'none of offsets' in observer['values']['guarantee']


@pytest.mark.parametrize('rates', ['independent', 'derived'])
def test_given_torques_that_switch_at_their_limits_when_healthy_then_no_jump_is_near_its_bound(
    rates,
):
    arm = shoulder_arm(rates)
    chain, rng = compile_chain(arm), np.random.default_rng(0)
    n, bound, period = 3, jump_bound(arm), arm.sample_time
    step, count = integration_step(chain, period)
    state, scratch, matrix = np.zeros((2, n)), plant_scratch(chain), np.empty((n, n))
    y, v = np.zeros((2000, n)), np.zeros((2000, n))
    for k in range(2000):
        y[k] = state[0] + 1e-4 * rng.normal(size=n)
        before = y[k - 1] if k else y[0]
        v[k] = (y[k] - before) / period
        if rates == 'independent':
            v[k] = state[1] + 5e-3 * rng.normal(size=n)
        torque = np.array(arm.torque_limit) * np.where(state[1] > 0, -1.0, 1.0)
        plant_step(chain, state, torque * rng.choice([1.0, 1.0, -1.0], n), step, count,
                   scratch, matrix)  # fmt: skip
    jumps = y[1:-1] - y[:-2] - 0.5 * period * (v[:-2] + v[2:])
    ratio = np.abs(jumps[3:]).max(0) / bound
    assert np.all(ratio < 1.0)
    assert ratio.max() > 0.05  # it holds in every configuration: some are reached by none


def test_given_a_step_beyond_the_jump_bound_when_found_then_it_is_guaranteed():
    events, _ = answers(faults=[EncoderFault(2, 'bias', 2.0, 0.05)], duration=2.5)
    assert [(event.sensor, event.basis) for event in events] == [('encoder3', GUARANTEED)]
