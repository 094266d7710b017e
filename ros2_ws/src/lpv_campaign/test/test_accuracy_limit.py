"""Limits of accuracy: Cramer-Rao bounds, smoother, Kalman peers, figures of a run."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from lpv_campaign.limit.accuracy import NAMES, limit_figures
from lpv_campaign.limit.arm_prior import known_exactly, known_within_priors
from lpv_campaign.limit.cramer_rao_bound import accuracy_limit
from lpv_campaign.limit.fault_prior import anything, known_shape, random_walks
from lpv_campaign.limit.kalman_smoother import both_passes
from lpv_campaign.limit.linearisation import LinearSystem, linearise, measurements
from lpv_campaign.limit.problem import Problem
from lpv_campaign.limit.smoother import filter_adaptively, smooth
from lpv_core.model.joints import JointMap
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.simulation.closed_loop import Transport, run_closed_loop
from lpv_core.simulation.faults import Fault
from lpv_core.support.errors import ConfigError, LpvError

pytestmark = pytest.mark.slow

BIAS = Fault('link1_angle', 'bias', 0.4, 0.0, 0.2)
FAULTS = (
    BIAS,
    Fault('link2_angle', 'drift', 0.3, 0.0, 0.05, 0.2),
    Fault('link1_angle', 'scale', 0.3, 0.4, 0.2),
    Fault('link2_angle', 'stuck', 0.3, 0.4),
    Fault('link1_angle', 'noise', 0.3, 0.4, 0.02),
    Fault('link2_angle', 'spike', 0.3, 0.4, 0.2, 20.0),
    Fault('link2_angle', 'dropout', 0.3, 0.4),
    Fault('link1_angle', 'rate_bias', 0.3, 0.4, 0.1),
)
UNKNOWN_ARM = {'model_error': 0.05, 'payload': 0.2, 'viscous': (0.5, 0.3), 'coulomb': (1.0, 0.5)}


@pytest.fixture(scope='module')
def rough_arm(paper_arm):
    """The paper's arm with friction and an unknown payload, so that every parameter matters."""
    return replace(paper_arm, **UNKNOWN_ARM)


@pytest.fixture(scope='module')
def rough_gains(paper_gains, rough_arm):
    """Gains of the paper's arm for the other one: only their accuracy is measured here."""
    return replace(paper_gains, arm_sha256=rough_arm.sha256())


def short(scenario, **changes):
    return replace(scenario, **{'duration': 1.0, 'faults': (BIAS,), **changes})


# ------------------------------------------------------------------ both passes


@pytest.fixture(scope='module')
def linear():
    """A made-up linear system with missing readings, a constant and a forgetful state."""
    rng, n, size = np.random.default_rng(0), 12, 7
    f = 0.3 * rng.standard_normal((n, 4, 6)) + np.eye(4, 6)
    r = rng.uniform(0.01, 0.1, (n, 6))
    r[rng.random((n, 6)) < 0.3] = math.inf
    moved = np.zeros((n, 4))
    return LinearSystem(
        moved,
        f,
        rng.standard_normal((n, 4)),
        0.0,
        rng.uniform(0.1, 1.0, n),
        np.array([0, 0, 0, 0, 1.0, 1.0, 0.0]),
        np.array([0, 0, 0, 0, 0.0, 0.1, 2.0]),
        rng.standard_normal((n, 6, size)),
        np.zeros((n, 6)),
        r,
        rng.standard_normal((n, 2, size)),
        np.zeros(size),
        rng.uniform(0.5, 1.0, size),
    )


def whole(system, k):
    """Transition and noise of all states."""
    f = np.diag(system.memory)
    f[:4] = 0.0
    f[:4, : system.f.shape[2]] = system.f[k]
    g = np.concatenate([system.g[k], np.zeros(len(f) - 4)])
    return f, system.push[k] * np.outer(g, g) + np.diag(system.growth)


def test_given_a_linear_system_when_filtered_then_the_limit_is_the_covariance_of_filterpys_filter(
    linear,
):
    passes = both_passes(linear)
    kalman = KalmanFilter(7, 6)
    kalman.P = np.diag(linear.deviation**2)
    for k in range(len(linear.f)):
        there = np.isfinite(linear.r[k])
        kalman.dim_z = there.sum()
        kalman.update(np.zeros(there.sum()), np.diag(linear.r[k][there]), linear.h[k][there])
        assert np.allclose(passes.covariances[k], kalman.P, rtol=1e-9, atol=1e-12)
        expected = np.einsum('qi,ij,qj->q', linear.fault[k], kalman.P, linear.fault[k])
        assert np.allclose(passes.filtered_variances[k, :2], expected)
        f, q = whole(linear, k)
        kalman.predict(F=f, Q=q)


def test_given_a_linear_system_when_smoothed_then_it_is_the_posterior_of_all_states_at_once(linear):
    rng, n, size = np.random.default_rng(1), len(linear.f), 7
    residual, start = rng.standard_normal((n, 6)), rng.standard_normal(size)
    defect = np.zeros((n, size))
    defect[:, :4] = rng.standard_normal((n, 4))
    # Prior of the whole course, then all readings at once.
    mean, cov, f_all = np.zeros(n * size), np.zeros((n * size, n * size)), np.eye(n * size)
    mean[:size], cov[:size, :size] = start, np.diag(linear.deviation**2)
    for k in range(n - 1):
        a, b = slice(k * size, (k + 1) * size), slice((k + 1) * size, (k + 2) * size)
        f, q = whole(linear, k)
        f_all[b] = 0.0
        mean[b] = f @ mean[a] + defect[k]
        cov[b] = f @ cov[a]
        cov[:, b] = cov[b].T
        cov[b, b] = f @ cov[a, a] @ f.T + q
    there = np.isfinite(linear.r).ravel()
    h = np.zeros((n * 6, n * size))
    for k in range(n):
        h[k * 6 : (k + 1) * 6, k * size : (k + 1) * size] = linear.h[k]
    h = h[there]
    gain = np.linalg.solve(h @ cov @ h.T + np.diag(linear.r.ravel()[there]), h @ cov).T
    mean = mean + gain @ (residual.ravel()[there] - h @ mean)
    cov = cov - gain @ h @ cov
    passes = both_passes(linear, residual, defect, start)
    assert np.allclose(passes.smoothed.ravel(), mean, rtol=1e-7, atol=1e-9)
    assert np.allclose(passes.smoothed[-1], passes.means[-1])
    for k in range(n):
        part = cov[k * size : (k + 1) * size, k * size : (k + 1) * size]
        expected = np.einsum('qi,ij,qj->q', linear.fault[k], part, linear.fault[k])
        assert np.allclose(
            passes.smoothed_variances[k], [*expected, part[0, 0], part[1, 1]], rtol=1e-6, atol=1e-10
        )


# ------------------------------------------------------------------ linearisation


def test_given_another_state_or_arm_when_simulated_then_it_moves_as_the_jacobian_says(
    rough_arm, rough_gains, two_faults
):
    scenario = short(two_faults, faults=(), noise=False, duration=0.2)
    arm = replace(rough_arm, disturbance_variance=0.0)
    run = run_closed_loop(rough_arm, rough_gains, scenario)
    knowledge = known_within_priors(arm, scenario)
    problem = Problem(arm, scenario, run, knowledge, [])
    states = problem.true_states()
    system = linearise(problem, states)
    assert knowledge.names == ('mass 1', 'inertia 1', 'mass 2', 'inertia 2', 'payload', 'friction')

    def after(k, state, changed=scenario, mean=arm.disturbance_mean):
        plant = ArmSimulator(replace(arm, disturbance_mean=mean), changed)
        plant.state.state[:] = state
        plant.step(run.torque[k])
        return plant.state.state.copy()

    changes = [
        lambda e: {'mass_factors': (1.0 + e, 1.0)},
        lambda e: {'inertia_factors': (1.0 + e, 1.0)},
        lambda e: {'mass_factors': (1.0, 1.0 + e)},
        lambda e: {'inertia_factors': (1.0, 1.0 + e)},
        lambda e: {'payload': e},
        lambda e: {'friction_factor': 1.0 + e},
    ]
    for k in (20, 60, 90):
        state, e = states[k, :4], 2e-6
        assert np.allclose(system.moved[k], after(k, state), rtol=0.0, atol=1e-15)
        for j in range(4):
            step = e * np.eye(4)[j]
            found = (after(k, state + step) - after(k, state - step)) / (2.0 * e)
            assert np.allclose(system.f[k][:, j], found, rtol=1e-6, atol=1e-8)
        for j, change in enumerate(changes):
            ends = [after(k, state, replace(scenario, **change(s))) for s in (e, -e)]
            found = (ends[0] - ends[1]) / (2.0 * e)
            assert np.allclose(system.f[k][:, 4 + j], found, rtol=1e-5, atol=1e-10)
        mean = arm.disturbance_mean
        found = (after(k, state, mean=mean + e) - after(k, state, mean=mean - e)) / (2.0 * e)
        assert np.allclose(system.g[k], found, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize('fault', FAULTS, ids=lambda fault: fault.kind)
def test_given_a_fault_and_no_noise_when_linearised_at_the_truth_then_readings_are_explained(
    paper_arm, paper_gains, two_faults, fault
):
    scenario = short(two_faults, faults=(fault,), noise=False)
    run = run_closed_loop(paper_arm, paper_gains, scenario, transport=Transport(3, 0.1))
    knowledge, faults = known_exactly(paper_arm, scenario), known_shape(paper_arm, scenario, run)
    problem = Problem(paper_arm, scenario, run, knowledge, faults)
    states = problem.true_states()
    if fault.kind in ('bias', 'drift', 'rate_bias'):
        states[:, 4] = fault.rate if fault.kind == 'drift' else fault.size
    elif fault.kind in ('stuck', 'noise', 'spike'):
        states[:, 4] = run.fault[:, paper_arm.sensor_names.index(fault.sensor)]
    system = linearise(problem, states)
    there = np.isfinite(system.r)
    assert there[:, 4:].any() and not there[run.lost].any()
    assert np.allclose(measurements(paper_arm, run)[there], system.readings[there], atol=1e-9)
    # And the sensors' Jacobian is the derivative of what they read.
    for j in range(states.shape[1]):
        step = np.zeros_like(states)
        step[:, j] = 1e-6
        moved = [linearise(problem, states + s).readings for s in (step, -step)]
        assert np.allclose((moved[0] - moved[1]) / 2e-6, system.h[:, :, j], atol=1e-6)


def test_given_a_run_when_the_truth_moves_then_only_the_disturbance_is_not_explained(
    paper_arm, paper_gains, two_faults
):
    scenario = short(two_faults, mass_factors=(1.04, 0.97), disturbance_factor=1.5)
    run = run_closed_loop(paper_arm, paper_gains, scenario, transport=Transport(2))
    knowledge = known_exactly(paper_arm, scenario)
    problem = Problem(paper_arm, scenario, run, knowledge, [])
    states = problem.true_states()
    system = linearise(problem, states)
    left = states[1:] - system.moved[:-1]
    push = left[:, 2] / np.where(system.g[:-1, 2] == 0.0, 1.0, system.g[:-1, 2])
    # Coriolis terms are quadratic in what one push changes.
    assert np.allclose(left, push[:, None] * system.g[:-1], rtol=0.0, atol=2e-7)
    free = ~run.braked[:-1]
    assert np.all(push[~free] == 0.0) and (~free).sum() == 2
    deviation = 1.5 * math.sqrt(paper_arm.disturbance_variance)
    assert abs(push[free].mean()) < 4.0 * deviation / math.sqrt(free.sum())
    assert 0.85 * deviation < push[free].std() < 1.15 * deviation


# ------------------------------------------------------------------ limit and smoother


def normal_arm(arm, scenario, rng):
    """A true arm drawn from the normal distribution that the limit assumes."""
    knowledge = known_within_priors(arm, scenario)
    draw = dict(zip(knowledge.names, knowledge.deviation * rng.standard_normal(6)))
    return replace(
        scenario,
        mass_factors=(1.0 + draw['mass 1'], 1.0 + draw['mass 2']),
        inertia_factors=(1.0 + draw['inertia 1'], 1.0 + draw['inertia 2']),
        payload=draw['payload'],
        friction_factor=1.0 + draw['friction'],
    )


@pytest.mark.parametrize('know', [known_exactly, known_within_priors])
def test_given_many_runs_when_smoothed_then_the_limit_is_reached_and_not_passed(
    rough_arm, rough_gains, two_faults, know
):
    runs, rng, joints = 60, np.random.default_rng(3), JointMap(rough_arm)
    both = (BIAS, Fault('link2_angle', 'bias', 0.4, 0.0, -0.1))
    squares = {'fault': [], 'angle': []}
    for number in range(runs):
        scenario = normal_arm(rough_arm, short(two_faults, faults=both, seed=number), rng)
        run = run_closed_loop(rough_arm, rough_gains, scenario)
        knowledge, faults = know(rough_arm, scenario), known_shape(rough_arm, scenario, run)
        problem = Problem(rough_arm, scenario, run, knowledge, faults)
        best, least = smooth(problem), accuracy_limit(problem)
        assert best.converged
        squares['fault'].append(((best.fault - run.fault)[-1] / least.smoothed_fault[-1]) ** 2)
        angle = best.angle - joints.absolute_position(run.position)
        squares['angle'].append((angle / least.smoothed_angle)[[100, 200, 350, -1]] ** 2)
        assert np.allclose(least.fault[-1], least.smoothed_fault[-1], rtol=1e-3)
    for values in squares.values():
        # A mean of squares of normal numbers, two of them independent in each run.
        assert abs(np.mean(values) - 1.0) < 3.5 * math.sqrt(1.0 / runs)
        assert np.max(values) < 25.0


def test_given_less_knowledge_when_limits_are_compared_then_they_are_ordered(
    rough_arm, rough_gains, two_faults
):
    scenario = short(two_faults, duration=2.0)
    run = run_closed_loop(rough_arm, rough_gains, scenario)
    exact, priors = known_exactly(rough_arm, scenario), known_within_priors(rough_arm, scenario)
    shapes = known_shape(rough_arm, scenario, run)

    def last(knowledge, faults, changed=scenario):
        return accuracy_limit(Problem(rough_arm, changed, run, knowledge, faults)).fault[-1, 0]

    ordered = [
        last(exact, shapes),
        last(priors, shapes),
        last(priors, random_walks(rough_arm, run)),
        last(priors, anything(run)),
    ]
    assert np.all(np.diff(ordered) > 0.0)
    assert last(exact, shapes, replace(scenario, noise_factor=2.0)) > 1.3 * ordered[0]
    # Given anything at all at each sample, a fault is known as well as the angle and the noise.
    free = accuracy_limit(Problem(rough_arm, scenario, run, exact, anything(run)))
    assert np.allclose(
        free.fault[1:, 0], np.hypot(free.angle[1:, 0], rough_arm.position_noise), rtol=1e-3
    )


def test_given_unknown_faults_and_arm_when_filtered_then_the_causal_limit_is_reached_nearly(
    rough_arm, rough_gains, two_faults
):
    joints, squares = JointMap(rough_arm), []
    for number in range(20):
        rng = np.random.default_rng([4, number])
        scenario = normal_arm(rough_arm, short(two_faults, duration=2.0, seed=number), rng)
        run = run_closed_loop(rough_arm, rough_gains, scenario)
        knowledge = known_within_priors(rough_arm, scenario)
        problem = Problem(rough_arm, scenario, run, knowledge, anything(run))
        fault, angle = filter_adaptively(problem)
        least = accuracy_limit(problem)
        error = angle - joints.absolute_position(run.position)
        squares.append((error / least.angle)[[300, 600, -1]] ** 2)
        assert np.allclose(fault, joints.sensor_position(run.measured) - angle, atol=1e-6)
        # Position sensors do not reach the angles, but for what is called arbitrary: 10 rad.
        liar = replace(run, measured=run.measured + np.where(run.time > 0.0, 0.3, 0.0)[:, None])
        told = filter_adaptively(replace(problem, run=liar))[1]
        assert np.allclose(told, angle, atol=1e-4)
    assert 0.6 < np.mean(squares) < 1.8


# ------------------------------------------------------------------ figures of a run


def test_given_a_run_when_asked_twice_then_figures_are_the_same_and_beside_their_limit(
    paper_arm, paper_gains, two_faults
):
    scenario = short(two_faults, duration=3.0, mass_factors=(1.03, 0.97))
    run = run_closed_loop(paper_arm, paper_gains, scenario)
    found = limit_figures(paper_arm, scenario, run)
    assert tuple(found) == NAMES and all(math.isfinite(v) for v in found.values())
    assert found == limit_figures(paper_arm, scenario, run)
    for quantity in ('fault', 'angle'):
        one = {n[6:]: v for n, v in found.items() if n.startswith(quantity)}
        assert one['limit_arm_known'] <= one['limit_within_priors'] < one['ours']
        assert one['smoothed_limit_arm_known'] <= one['smoothed_limit_within_priors']
        assert one['limit_within_priors'] < one['limit_any_fault_within_priors']
        # Ours knows the reading before the onset, which that limit takes for no better than others.
        assert one['limit_any_fault_within_priors'] < min(one['ekf'], one['ukf'])
        assert one['smoother'] < 3.0 * one['smoothed_limit_within_priors']
        assert one['ratio'] == one['ours'] / one['limit_within_priors']


@pytest.mark.parametrize(
    'faults, loss',
    [
        ((), 0.2),
        ((Fault('link2_angle', 'dropout', 0.2),), 0.0),
        ((Fault('link2_angle', 'rate_bias', 0.2, 0.0, 0.1),), 0.0),
        ((Fault('link2_angle', 'bias', 2.5, 0.0, 0.1),), 0.0),
    ],
)
def test_given_runs_without_a_fault_of_a_size_when_measured_then_what_is_not_there_is_nan(
    paper_arm, paper_gains, two_faults, faults, loss
):
    scenario = short(two_faults, duration=2.5, faults=faults)
    run = run_closed_loop(paper_arm, paper_gains, scenario, transport=Transport(loss=loss))
    found = limit_figures(paper_arm, scenario, run)
    for name, value in found.items():
        none = faults and (name.startswith('fault') or faults[0].kind == 'bias')
        assert math.isnan(value) if none else value > 0.0 or name == 'fault_confirmed', name


def test_given_a_plant_or_a_run_without_limit_when_measured_then_it_is_said(
    paper_arm, paper_gains, two_faults
):
    scenario = short(two_faults, duration=0.1)
    run = run_closed_loop(paper_arm, paper_gains, scenario)
    with pytest.raises(ConfigError, match='rigid-body'):
        limit_figures(paper_arm, replace(scenario, plant='lpv'), run)
    with pytest.raises(LpvError, match='not finite'):
        limit_figures(paper_arm, scenario, replace(run, position=run.position * math.nan))
