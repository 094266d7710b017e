"""Torques that begin while the arm is watched, and stay: someone leans on the arm."""

from dataclasses import replace

import fault_injection
import numpy as np
import pytest

CASES = [('real_arm', 'derived', 0, 0.3), ('paper', 'independent', 0, -0.3)]
ALIKE = [('real_arm', 'independent', 0, 0.6), ('paper', 'derived', 1, -0.3)]
CASES += [pytest.param(case, marks=pytest.mark.slow) for case in ALIKE]


def answered(name, rates, joint, share):
    """Answers to an arm whose drives give less from 7 s on, by a share of the usual effort."""
    (subject,) = fault_injection.subjects(name, recorded=False)
    subject = subject.with_rates(rates)
    stream = subject.streams(1)
    if rates == 'derived':
        stream = fault_injection.derived(stream)
    samples = stream.samples.copy()
    usual = np.quantile(np.abs(samples[:, 2, joint]), 0.95)
    samples[stream.index(7.0) :, 2, joint] -= share * usual
    return subject.answers(replace(stream, samples=samples))


@pytest.mark.parametrize('case', CASES)
def test_given_a_torque_that_stays_when_watched_then_no_encoder_is_blamed_nor_corrected(case):
    answers = answered(*case)
    state, fault = answers.state, answers.fault
    assert [event for _, event in answers.events if event.sensor] == []
    # Trusted bounds hold healthy sensors, and the loop gets what they read.
    outside = (np.abs(fault.estimate) > fault.bound + 1e-6).any(axis=1)
    assert not (outside & state.trustworthy).any()
    np.testing.assert_array_equal(state.compensated_position, state.measured_position)
    np.testing.assert_array_equal(state.velocity, state.measured_velocity)
