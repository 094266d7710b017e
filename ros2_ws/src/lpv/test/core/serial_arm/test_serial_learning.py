"""What is learned of a healthy arm, and not learned from a fault."""

from dataclasses import replace

import numpy as np
import pytest
from serial_arms import shoulder_arm, simulated, watch
from simulated_runs import simulated_run

from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import Uncertainty
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.simulation.faults import Fault


def watched(arm, plant, duration=6.0):
    return watch(arm, simulated_run(arm, duration, plant=plant))


def test_payload_that_nobody_stated_is_learned_without_an_alarm():
    arm = replace(shoulder_arm(), uncertainty=Uncertainty(0.0, 0.3))
    monitor = watched(arm, with_payload(compile_chain(arm), 0.3), 5.0)
    assert monitor.alarms == []
    learned = monitor.learned()
    assert learned.payload == pytest.approx(0.3, abs=0.1)
    assert set(learned.values()) >= {'learned_payload', 'learned_viscous', 'learned_noise'}


def test_viscous_friction_that_nobody_stated_is_learned_without_an_alarm():
    arm = shoulder_arm()
    chain = compile_chain(arm)
    friction = chain.friction.copy()
    friction[:, 0] += 0.5
    monitor = watched(arm, chain._replace(friction=friction), 10.0)
    assert monitor.alarms == []
    learned = monitor.learned()
    assert np.all(np.abs(learned.viscous - 0.8) < 4.0 * learned.sigma[1])


@pytest.mark.slow
@pytest.mark.parametrize('rate', [0.003, 0.01, 0.03])
def test_slow_ramp_is_no_arm_that_is_learned(rate):
    arm = replace(shoulder_arm(), uncertainty=Uncertainty(0.0, 0.3))
    monitor = watch(
        arm, simulated(arm, Fault('encoder2', 'drift', 0.0, rate=rate), seed=2, duration=30.0)
    )
    estimate, truth = monitor.estimate(0), rate * 30.0
    assert {alarm.sensor for alarm in monitor.alarms} == {'encoder2'}
    assert abs(estimate.fault[1] - truth) < max(0.03, 4.0 * estimate.sigma[1])
