"""The sampled observer: start, steps, intervals of any length, and what is not finite."""

import math

import numpy as np
import pytest
from parts import Swing

from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.support.timestamps import NANOSECONDS
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.unknown_input_observer import UnknownInputObserver, uio_step

TS = 2_000_000
"""Sample time of both arms [ns]."""
VECTORS = ('position', 'velocity', 'fault', 'absolute_position')


@pytest.fixture
def swing(arm):
    return Swing(arm)


@pytest.fixture
def observer(request, arm, gains_of):
    serial = request.getfixturevalue('paper_arm' if arm.name == 'paper' else 'real_arm')
    return UnknownInputObserver(serial, gains_of[arm.name])


def update(observer, stamp, *measured):
    """Estimate at one measurement, None if there is none."""
    state = observer.parts.state[0]
    uio_step(observer.parts.constants[0], state, stamp, *(np.array(one, float) for one in measured))
    return state.estimate.copy() if state.valid else None


def follow(observer, swing, first, last, fault=(0.0, 0.0), every=1):
    """Feed samples first..last and return the last estimate."""
    estimate = None
    for k in range(first, last + 1, every):
        estimate = update(observer, k * TS, *swing.sample(k * 0.002, every * 0.002, fault))
    return estimate


def test_given_the_first_sample_when_taken_then_it_is_believed_and_called_initialising(
    observer, swing
):
    estimate = update(observer, 5 * TS, *swing.sample(0.01))
    assert (estimate.mode, estimate.interval) == (Mode.INITIALISING, 0.0)
    np.testing.assert_allclose(estimate.position, swing.position(0.01), atol=1e-14)
    np.testing.assert_array_equal(estimate.fault, 0.0)
    assert update(observer, 6 * TS, *swing.sample(0.012)).mode == Mode.OBSERVING


def test_given_noise_at_rest_when_started_on_many_samples_then_the_start_value_is_their_mean(
    paper_arm, paper_gains
):
    noise = np.random.default_rng(4).normal(scale=0.02, size=(100, 2))
    noise[0] = 0.06  # a bad first sample must not decide alone
    observer, modes = UnknownInputObserver(paper_arm, paper_gains, initial_samples=99), []
    for k in range(100):
        q = np.array([math.pi / 2, 0.0]) + noise[k]
        estimate = update(observer, k * TS, q, (0.0, 0.0), (0.0, 0.0))
        modes.append(estimate.mode)
    np.testing.assert_allclose(estimate.absolute_position, np.cumsum(noise.mean(axis=0)), atol=5e-3)
    assert modes == [Mode.INITIALISING] * 99 + [Mode.OBSERVING]


def test_given_a_link_outside_the_region_when_observed_then_the_mode_is_holding(
    paper_arm, paper_model, paper_gains
):
    observer = UnknownInputObserver(paper_arm, paper_gains)
    q = JointMap(paper_model).joint_position([1.4, 0.0])
    update(observer, 0, q, (0, 0), (0, 0))
    estimate = update(observer, TS, q, (0, 0), (0, 0))
    assert (estimate.mode, estimate.held.tolist()) == (Mode.HOLDING, [True, False])


@pytest.mark.parametrize('every', [2, 20])
def test_given_lost_samples_when_the_next_one_comes_then_the_interval_is_integrated_in_steps(
    observer, swing, every
):
    estimate = follow(observer, swing, 0, 400, every=every)
    # Torque held and rates interpolated over up to 40 ms: second order in the interval.
    np.testing.assert_allclose(estimate.position, swing.position(0.8), atol=5e-3)
    np.testing.assert_allclose(estimate.fault, 0.0, atol=5e-3)


def test_given_jitter_below_half_a_sample_when_taken_then_the_states_follow(observer, swing):
    stamps = np.arange(500) * TS
    stamps[1:] += np.random.default_rng(8).integers(-400_000, 400_000, 499)
    for step, stamp in zip(np.diff(stamps, prepend=0), stamps):
        t = stamp / NANOSECONDS
        estimate = update(observer, int(stamp), *swing.sample(t, step / NANOSECONDS))
    np.testing.assert_allclose(estimate.position, swing.position(t), atol=5e-4)


@pytest.mark.parametrize('gap', [0.11, 30.0])
def test_given_a_gap_when_it_ends_then_the_encoder_increment_moves_the_state_and_holds_the_fault(
    observer, swing, gap
):
    fault = np.array([0.2, -0.15])
    follow(observer, swing, 0, 250)
    before = follow(observer, swing, 251, 500, fault)
    t = 1.0 + gap
    measured = swing.sample(t, fault=fault)
    estimate = update(observer, 500 * TS + round(gap * NANOSECONDS), *measured)
    assert estimate.interval == pytest.approx(gap)
    np.testing.assert_allclose(estimate.fault, before.fault, atol=1e-12)
    np.testing.assert_allclose(estimate.position, swing.position(t), atol=1e-3)
    np.testing.assert_allclose(estimate.velocity, measured[1], atol=1e-12)


def test_given_an_interval_of_max_gap_when_taken_then_it_is_still_integrated(observer, swing):
    follow(observer, swing, 0, 100)
    end = 100 * TS + NANOSECONDS // 10
    assert not update(observer, end, *swing.sample(0.3, 0.1)).bridged
    assert update(observer, end + NANOSECONDS // 10 + 1, *swing.sample(0.4, 0.1)).bridged


@pytest.mark.parametrize('size', [1e100, -1e308])
def test_given_a_rate_that_no_arm_has_when_taken_then_no_estimate_is_made_up(observer, swing, size):
    for k in range(60):
        position, velocity, effort = swing.sample(k * 0.002)
        estimate = update(observer, k * TS, position, velocity + [size * (k == 20), 0.0], effort)
        assert estimate is None or all(np.isfinite(estimate[name]).all() for name in VECTORS)
