"""Brakes that stop a moving arm with a torque nobody measures, and rates that only look like it."""

from dataclasses import replace

import numpy as np
import pytest
from parts import Swing

from lpv_core.monitoring.monitor import SensorMonitor
from lpv_core.simulation.closed_loop import Stall, Transport, run_closed_loop

DT, START = 0.002, 1_000_000_000


def chatter(arm, gains, scenario, period, duration):
    """Commands that stay away for a moment again and again: the drives brake each time."""
    stalls = tuple(Stall('commands', t, duration) for t in np.arange(3.0, 14.0, period))
    healthy = replace(scenario, faults=(), duration=15.0)
    return run_closed_loop(arm, gains, healthy, transport=Transport(stalls=stalls))


@pytest.mark.parametrize(('period', 'duration'), [(0.3, 0.07), (0.5, 0.1), (0.9, 0.07)])
def test_given_brakes_that_chatter_when_the_arm_is_healthy_then_nothing_contradicts(
    paper_arm, paper_gains, two_faults, period, duration
):
    run = chatter(paper_arm, paper_gains, two_faults, period, duration)
    assert run.braked[1500:].mean() > 0.1
    assert not run.inconsistent.any() and run.trustworthy.all() and run.alarms == []


def test_given_an_arm_that_is_braked_when_it_rests_then_the_stop_leaves_no_fault_estimate(
    paper_arm, paper_gains, two_faults
):
    run = chatter(paper_arm, paper_gains, two_faults, 100.0, 0.3)
    braked = np.flatnonzero(run.braked[1500:]) + 1500
    assert np.abs(run.velocity[braked[0]]).max() > 0.2
    before = run.fault_estimate[braked[0] - 25 : braked[0]].mean(0)
    np.testing.assert_allclose(run.fault_estimate[braked[-25:]].mean(0), before, atol=0.002)


def swing(arm, duration, seed=0):
    """Positions, rates and efforts of a healthy arm in motion."""
    motion, rng = Swing(arm), np.random.default_rng(seed)
    samples = [motion.sample(DT * k, DT) for k in range(round(duration / DT))]
    position, velocity, effort = (np.array(v) for v in zip(*samples))
    noise = rng.standard_normal((2, len(position), 2))
    return (
        position + arm.position_noise * noise[0],
        velocity + arm.velocity_noise * noise[1],
        effort,
    )


@pytest.mark.parametrize('begin', [2.6, 2.9, 3.2])
def test_given_rates_that_read_nothing_when_the_arm_moves_on_then_that_is_no_stop(
    paper_arm, paper_gains, begin
):
    position, velocity, effort = swing(paper_arm, 5.0)
    first = round(begin / DT)
    assert np.abs(velocity[first]).max() > 0.3
    velocity[first:] = 0.0
    stamps = START + round(1e9 * DT) * np.arange(len(position))
    monitor = SensorMonitor('test', paper_arm, paper_gains)
    answers = monitor.take_many(stamps, position, velocity, effort)
    assert not answers.inconsistent[:first].any()
    assert answers.inconsistent[first : first + 75].any(), 'within 0.15 s'
