"""When and how a residual began to change, and how well a scale error is known from motion."""

import math

import numpy as np
import pytest
from parts import History, SensorDecision

from lpv_core.decision.diagnosis import DiagnosisParameters
from lpv_core.decision.fault_magnitude import removable
from lpv_core.decision.sensor_state import SENSOR_STATE
from lpv_core.residual.onset_estimation import fit_step_or_ramp
from lpv_core.support.records import new_record

TS, SIGMA = 2_000_000, 1e-3


def fit(course, seed=0, baseline=0.0):
    """What the courses before and after sample 600 look like, with noise."""
    history, noise = History(2000), np.random.default_rng(seed).standard_normal(len(course))
    for k, value in enumerate(course[:-1]):
        history.add(k * TS, value + SIGMA * noise[k], 0.0)
    state = new_record(SENSOR_STATE)
    state.before.residual = baseline
    state.sample.stamp = (len(course) - 1) * TS
    state.sample.residual = course[-1] + SIGMA * noise[-1]
    stepped, speed, onset = fit_step_or_ramp(state, history.buffer, 0)
    return stepped, speed, onset / TS


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('after', [1, 6, 200])
@pytest.mark.parametrize('height', [0.01, -0.3])
def test_given_a_jump_when_fitted_then_it_is_a_step_of_its_own_sample(height, after, seed):
    stepped, _, onset = fit(0.05 + np.repeat([0.0, height], [600, after]), seed, baseline=0.05)
    assert stepped
    assert onset == pytest.approx(600, abs=0 if abs(height) > 0.1 else 1)


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize(
    ('speed', 'after'), [(0.02, 250), (-0.04, 150), (0.2, 30), (1.0, 10), (-1.0, 200)]
)
def test_given_a_slow_change_when_fitted_then_speed_and_onset_are_known(speed, after, seed):
    moved = speed * 0.002 * np.arange(1, after + 1)
    stepped, found, onset = fit(np.concatenate([np.zeros(600), moved]), seed)
    assert not stepped
    hidden = SIGMA / abs(speed) / 0.002  # samples in which it moves one standard deviation
    assert onset == pytest.approx(600, abs=2.0 + 2.0 * hidden)
    assert found == pytest.approx(speed, rel=0.2)


# ------------------------------------------------------------------ scale errors


class Moving:
    """A sensor of an arm that swings, with the noise of encoder and rates."""

    def __init__(self, arm, gains, seed=0):
        self.decision = SensorDecision(arm, gains, DiagnosisParameters())
        self.arm, self.rng, self.k, self.astray = arm, np.random.default_rng(seed), 0, 0.0

    def swing(self, samples, fault):
        """Feed samples; errors of the reading less what is removed from it, without noise [rad]."""
        errors = []
        for _ in range(samples):
            angle = 0.6 + 0.5 * math.sin(0.006 * self.k)
            wrong = fault(angle, self.k)
            noise = self.arm.position_noise * self.rng.standard_normal()
            self.astray += (
                self.arm.velocity_noise * self.arm.sample_time * self.rng.standard_normal()
            )
            self.decision.update(
                stamp=self.k * TS,
                fault=wrong + noise,
                residual=wrong + noise + self.astray,
                reading=angle + wrong + noise,
                threshold=0.1,
                allowance=0.0,
                innovation=0.0,
                missing=False,
                lost=False,
                inconsistent=False,
            )
            removed = removable(self.decision.state) if self.decision.alarm else 0.0
            errors.append(wrong + noise - removed)
            self.k += 1
        return np.array(errors)


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('scale', [0.3, -0.25])
def test_given_a_scale_error_when_the_arm_moves_then_the_angle_does_not_go_astray_with_the_rates(
    paper_arm, paper_gains, scale, seed
):
    moving = Moving(paper_arm, paper_gains, seed)
    moving.swing(500, lambda angle, k: 0.0)
    before = moving.astray
    moving.swing(4500, lambda angle, k: scale * angle)
    errors = moving.swing(5000, lambda angle, k: scale * angle)
    assert moving.decision.kind == 'scale'
    assert moving.decision.state.scale.scale == pytest.approx(scale, abs=0.002)
    assert np.sqrt(np.mean(errors**2)) < 0.0012
    # Dead reckoning alone would have this error by now.
    assert moving.decision.state.scale.walk == pytest.approx(moving.astray - before, abs=0.0012)


def test_given_a_fault_that_is_no_scale_error_any_more_when_followed_then_the_filter_gives_up(
    paper_arm, paper_gains
):
    moving = Moving(paper_arm, paper_gains)
    moving.swing(500, lambda angle, k: 0.0)
    moving.swing(1500, lambda angle, k: 0.3 * angle)
    assert moving.decision.state.scale.used
    errors = moving.swing(1000, lambda angle, k: 0.3 * angle + 0.0001 * (k - 2000))
    assert not moving.decision.state.scale.used
    assert np.abs(errors[-500:]).max() < 0.006


def test_given_an_onset_at_the_oldest_sample_when_a_step_is_confirmed_then_it_is_measured(
    paper_arm, paper_gains
):
    decision = SensorDecision(paper_arm, paper_gains, DiagnosisParameters())
    moving = Moving(paper_arm, paper_gains)
    moving.decision = decision
    moving.swing(8, lambda angle, k: 0.0)
    moving.swing(20, lambda angle, k: 0.3)
    assert decision.alarm
    assert decision.amount == pytest.approx(0.3, abs=0.005)
