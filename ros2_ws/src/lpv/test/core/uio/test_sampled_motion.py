"""The certificate of the sampled loop in motion, and attempts to break it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from lpv.core.uio.certificate.conditions import controller_loop, motion_checks
from lpv.core.uio.certificate.gains import gains_to_dict, parse_gains
from lpv.core.uio.certificate.sampled_motion import SIZE, sampled_loop


def corners(arm, controller, rate):
    """Flows of the loop at the corners of gravity and inertia, then of Coriolis torques."""
    swirl, flows = arm.constants().coupling * rate, []
    for a, b in zip(*controller_loop(arm, 'exact')):
        for first, second in product((-swirl, swirl), repeat=2):
            flow = np.zeros((SIZE, SIZE))
            flow[:6, :6], flow[:6, 6:] = a, b
            flow[2:4, 2:4] += b[2:4] @ np.array([[0.0, first], [second, 0.0]])
            flows.append(flow)
    return flows


def feedback(controller):
    return np.hstack([controller.m1, controller.m2])


def transition(flows, step, controller):
    """A sample in which the arm is at one corner after the other."""
    whole = np.eye(SIZE)
    for flow in flows:
        whole = expm(flow * step / len(flows)) @ whole
    whole[6:] = np.hstack([feedback(controller), np.zeros((2, 2))])
    return whole


def test_given_an_arm_that_jumps_between_corners_within_samples_when_run_then_it_contracts(
    arm, gains_of
):
    controller, rng = gains_of[arm.name].controller, np.random.default_rng(3)
    motion = controller.motion
    flows, factor = corners(arm, controller, motion.rate), np.linalg.cholesky(motion.lyapunov).T
    worst = 0.0
    for _ in range(500):
        places = rng.integers(len(flows), size=rng.integers(1, 6))
        sample = transition([flows[i] for i in places], arm.sample_time, controller)
        worst = max(worst, np.linalg.norm(factor @ sample @ np.linalg.inv(factor), 2))
    assert 1.0 - 4.0 * motion.decay * arm.sample_time < worst
    assert worst < np.exp(-motion.decay * arm.sample_time)


@pytest.mark.parametrize('slower', [1.0, 10.0])
def test_given_corners_that_change_within_a_sample_when_compared_then_the_remainder_holds_the_rest(
    arm, gains_of, slower
):
    controller, rng = gains_of[arm.name].controller, np.random.default_rng(4)
    arm, rate = replace(arm, sample_time=slower * arm.sample_time), controller.motion.rate
    flows = corners(arm, controller, rate)
    sampled = sampled_loop(arm, controller_loop(arm, 'exact'), feedback(controller), rate)
    used = 0.0
    for _ in range(300):
        places = rng.integers(len(flows), size=4)
        exact = transition([flows[i] for i in places], arm.sample_time, controller)
        rest = np.abs(exact - sampled.vertices[places].mean(axis=0))
        assert (rest <= sampled.remainder + 1e-12).all()
        bounded = sampled.remainder > 1e-9
        used = max(used, (rest[bounded] / sampled.remainder[bounded]).max())
    assert used > 0.1  # the bound is no formality


@pytest.mark.parametrize(
    'change',
    [
        lambda m: {'decay': 20.0 * m.decay},
        lambda m: {'rate': 100.0 + 30.0 * m.rate},
        lambda m: {'rate': 1e6 * m.rate},
        lambda m: {'lyapunov': -m.lyapunov},
        lambda m: {'lyapunov': m.lyapunov + np.triu(np.ones((SIZE, SIZE)))},
        lambda m: {'lyapunov': m.lyapunov * np.nan},
        lambda m: {'lyapunov': np.eye(SIZE)},
    ],
)
def test_given_claims_that_do_not_hold_when_verified_then_they_are_refused(arm, gains_of, change):
    controller = gains_of[arm.name].controller
    forged = replace(controller.motion, **change(controller.motion))
    for motion, holds in ((controller.motion, True), (forged, False)):
        [check] = motion_checks(arm, replace(controller, motion=motion))
        assert check.holds == holds


def test_given_gains_without_it_when_read_then_nothing_is_claimed(arm, gains_of):
    gains = gains_of[arm.name]
    without = replace(gains, controller=replace(gains.controller, motion=None))
    again = parse_gains(gains_to_dict(without))
    assert again.controller.motion is None and motion_checks(arm, again.controller) == []
    again = parse_gains(gains_to_dict(gains))
    assert np.array_equal(again.controller.motion.lyapunov, gains.controller.motion.lyapunov)
