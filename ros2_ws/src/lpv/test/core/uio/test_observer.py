import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_formulas import inertia, inverse_dynamics, scheduling, weights

from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.support import records, timestamps
from lpv.core.uio.bound import zonotope
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_descriptor, sinc_box
from lpv.core.uio.observer import paper_observer, sampled_observer
from lpv.core.uio.unknown_input_observer import UnknownInputObserver, uio_step

TS = 2_000_000  # sample time of both arms [ns]


class Swing:
    """A smooth motion about the vertical as joint-space samples with their exact torques."""

    def __init__(self, arm):
        self.joints, self.c = JointMap(arm), arm.constants()
        self.rest = 0.0 if arm.orientation == 'upright' else math.pi

    def absolute(self, t):
        """Angles, rates and accelerations of both links."""
        size, pace = np.array([0.5, 0.3]), np.array([1.1, 1.7])
        sine, cosine = size * np.sin(pace * t), size * np.cos(pace * t)
        return self.rest + sine, pace * cosine, -(pace**2) * sine

    def torque(self, t):
        """Of both links, such that the arm moves as it does."""
        return inverse_dynamics(*self.absolute(t), self.c)

    def outputs(self, t, fault=(0.0, 0.0)):
        """Readings and rates of both sensors."""
        theta, rate, _ = self.absolute(t)
        s = self.joints.sensor_matrix
        return np.concatenate([s @ theta + fault, s @ rate])

    def sample(self, t, dt=0.002, fault=(0.0, 0.0)):
        """Positions, rates and efforts of the joints; the effort acted over the interval before."""
        theta, rate, _ = self.absolute(t)
        position = theta + np.linalg.solve(self.joints.sensor_matrix, fault)
        effort = self.joints.joint_torque(self.torque(t - dt / 2))
        return self.joints.joint_position(position), self.joints.joint_velocity(rate), effort

    def position(self, t):
        return self.joints.joint_position(self.absolute(t)[0])


class Exact:
    """The recursion of method exact, started anywhere, and a motion to follow."""

    def __init__(self, arm, gains):
        self.gains, self.s, self.dt = gains.observer, JointMap(arm).sensor_matrix, arm.sample_time
        self.kappa, self.constants = arm.sign * gains.observer.kappa, arm.constants()
        self.recursion = sampled_observer.observer_constants(arm, gains.observer)
        self.motion = Swing(arm)
        self.state = records.new_record(sampled_observer.OBSERVER_STATE)

    def step(self, y_old, y_new, torque, dt=None):
        self.state.y[:], self.state.after[:], self.state.torque[:] = y_old, y_new, torque
        sampled_observer.advance(self.recursion, self.state, dt or self.dt)
        return self.state.x.copy()

    def truth(self, t, bias=(0.0, 0.0)):
        return np.concatenate([*self.motion.absolute(t)[:2], bias])

    def follow(self, count, faults, wrong=(0.0, 0.0)):
        y = self.motion.outputs(0.0, faults[0])
        start = self.truth(0.0, faults[0])
        start[:2] += wrong
        start[4:] -= self.s @ wrong
        self.state.x[:] = start
        for k in range(count):
            y_new = self.motion.outputs((k + 1) * self.dt, faults[(k + 1) % len(faults)])
            yield self.step(y, y_new, self.motion.torque((k + 0.5) * self.dt))
            y = y_new


@pytest.fixture
def swing(planar):
    return Swing(planar)


@pytest.fixture
def exact(planar, gains):
    return Exact(planar, gains)


def test_given_the_paper_observer_then_eq_41_is_solved_and_steps_are_the_heun_rule_of_38(planar):
    dt, box, rng = 0.003, sinc_box(0.5), np.random.default_rng(7)
    d = paper_descriptor(planar, box)
    t1, t2 = paper_observer.decoupling(d.e, d.c)
    sigma = np.vstack([d.e, d.c])
    # Smallest: every row lies in the column space of sigma.
    smallest = np.linalg.inv(sigma.T @ sigma) @ sigma.T
    np.testing.assert_allclose(np.hstack([t1, t2]), smallest, atol=1e-14)
    np.testing.assert_allclose(t1 @ d.e + t2 @ d.c, np.eye(6), atol=1e-14)
    np.testing.assert_allclose(t1 @ d.bf, 0.0, atol=1e-14)
    gains = rng.normal(scale=10.0, size=(8, 6, 4))
    feedback = t1 @ d.a + gains @ d.c
    matrices = feedback, feedback @ t2 - gains, t1 @ d.b  # N, L and G of eqs. (51)-(53)
    other = rng.normal(scale=0.3, size=6)
    numbers = t1, t2, gains, np.eye(6), '55', 1.0, 20.0, 15.0, np.zeros(2)
    designed = paper_observer.PaperObserverGains('paper', box, *numbers)
    constants = sampled_observer.observer_constants(planar, designed)
    state = records.new_record(sampled_observer.OBSERVER_STATE)
    x, y_old, y_new, u = state.x, state.y, state.after, state.torque
    y_old[:] = rng.normal(scale=0.3, size=4)
    x[:] = other + t2 @ y_old
    for _ in range(20):
        y_new[:], u[:] = y_old + rng.normal(scale=0.05, size=4), rng.normal(scale=20.0, size=2)
        sampled_observer.advance(constants, state, dt)
        guess = other + t2 @ y_old
        rho = weights(scheduling(guess), box)
        n, ell, g = (np.tensordot(rho, stack, 1) for stack in matrices)
        first = n @ other + ell @ y_old + g @ u
        second = n @ (other + dt * first) + ell @ y_new + g @ u
        other = other + dt / 2 * (first + second)
        np.testing.assert_allclose(x, other + t2 @ y_new, rtol=1e-10, atol=1e-12)
        y_old[:] = y_new


def test_given_any_state_when_differentiated_then_the_momentum_error_is_decoupled(planar, exact):
    """e' = -s kappa m and m' = s Gamma e - mu m + coupling, without any linearisation."""
    h, c, rng = 2e-7, exact.constants, np.random.default_rng(5)
    for t in rng.uniform(0.0, 5.0, 10):
        y, wrong = exact.motion.outputs(t), rng.uniform(-0.2, 0.2, 4)
        theta, rate, acc = exact.motion.absolute(t)
        guess, guess_rate = theta + wrong[:2], rate + wrong[2:]
        exact.state.x[:] = *guess, *guess_rate, 0.0, 0.0
        after = exact.step(y, y, exact.motion.torque(t), h)
        guess_acc = (after[2:4] - guess_rate) / h
        e, m = wrong[:2], inertia(guess, c) @ wrong[2:]
        swirl = -c.coupling * math.sin(guess[0] - guess[1]) * (rate[0] - rate[1])
        m_rate = swirl * wrong[:1:-1] + inertia(guess, c) @ (guess_acc - acc)
        gravity = c.gravity * (np.sin(guess) - np.sin(theta))
        delta = inertia(guess, c) - inertia(theta, c)
        spin = c.coupling * (math.sin(guess[0] - guess[1]) - math.sin(theta[0] - theta[1]))
        coupling = -delta @ acc - spin * np.array([rate[1] ** 2, -(rate[0] ** 2)])
        expected = gravity + coupling - exact.gains.mu * m
        scale = np.abs(np.concatenate([m, expected])).max()
        np.testing.assert_allclose(m_rate, expected, rtol=1e-4, atol=1e-4 * scale)
        e_rate = (after[:2] - guess) / h - rate
        np.testing.assert_allclose(e_rate, -exact.kappa * m, rtol=1e-4, atol=1e-6)
        slope = gravity / e * planar.sign
        assert np.all(slope > 0.0) and np.all(slope <= c.gravity)


@pytest.mark.slow
def test_given_a_wrong_start_when_the_arm_moves_then_errors_die_out(paper_model, paper_gains):
    exact, before, bias = Exact(paper_model, paper_gains), 0.25, (-0.25, 0.2)
    for k, x in enumerate(exact.follow(7500, [bias], wrong=bias)):
        if k % 2500 == 2499:
            error = x - exact.truth((k + 1) * exact.dt, bias)
            after = np.abs(error[[0, 1, 4, 5]]).max()
            # Every 5 s take off what the certified decay promises, down to the Heun rule's error.
            assert after < before * math.exp(-0.25 * 5.0) + 5e-6
            before = after


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=60, max_size=60))
def test_given_any_position_faults_then_the_state_estimate_is_bitwise_same(arms, gains_of, faults):
    faults, none = np.vstack([[0.0, 0.0], faults]), np.zeros((61, 2))
    for arm in arms:
        exact, other = (Exact(arm, gains_of[arm.name]) for _ in range(2))
        *_, found = exact.follow(60, faults, (0.05, 0.05))
        *_, without = other.follow(60, none, (0.05, 0.05))
        np.testing.assert_array_equal(found[:4], without[:4])
        # And the fault estimate follows without delay: f^ = y_p - S theta^.
        y = exact.motion.outputs(60 * arm.sample_time, faults[-1])
        expected = y[:2] - exact.s @ found[:2]
        np.testing.assert_allclose(found[4:], expected, atol=1e-9 + 1e-13 * np.abs(faults).max())


@pytest.mark.parametrize('link', [0, 1])
def test_given_a_link_outside_the_region_then_it_is_held_on_the_measured_rate(planar, exact, link):
    theta, dt, other = np.full(2, exact.motion.rest), exact.dt, 1 - link
    theta[link] += math.acos(planar.cos_min[link]) + 0.1
    true_rate = np.array([0.4, -0.3])
    torque = inverse_dynamics(theta, true_rate, np.zeros(2), exact.constants)
    y_old = np.concatenate([exact.s @ (theta - 0.2), exact.s @ true_rate])
    y_new = y_old + [*dt * exact.s @ true_rate, 0.0, 0.0]
    # The rate estimate is wrong on purpose: a held angle must follow the measurement instead.
    exact.state.x[:] = *theta, *(true_rate + 0.5), *(exact.s @ [-0.2, -0.2])
    after = exact.step(y_old, y_new, torque)
    assert exact.state.held.tolist() == [link == 0, link == 1]
    assert after[link] == pytest.approx(theta[link] + dt * true_rate[link], abs=1e-12)
    assert abs(after[other] - theta[other] - dt * true_rate[other]) > 1e-5  # not held
    np.testing.assert_allclose(after[4:], y_new[:2] - exact.s @ after[:2], atol=1e-12)


def test_given_a_link_on_either_side_of_the_border_then_only_outside_is_held(planar, exact):
    cases = []
    for offset, way, link in product((-1e-6, 1e-6), (1.0, -1.0), range(2)):
        theta = np.full(2, exact.motion.rest)
        theta[link] += way * (math.acos(planar.cos_min[link]) + offset)
        cases.append((theta, [offset > 0.0 and i == link for i in range(2)]))
    # At the vertical, rounding of the cosine holds nothing.
    for turns in ((0, 0), (1, 1), (2, -2)):
        outside = (turns[0] % 2 == 0) != (planar.orientation == 'upright')
        cases.append((math.pi * np.array(turns), [outside] * 2))
    for theta, held in cases:
        y = np.concatenate([exact.s @ theta, [0.0, 0.0]])
        exact.state.x[:] = *theta, 0.0, 0.0, 0.0, 0.0
        exact.step(y, y, np.zeros(2))
        assert exact.state.held.tolist() == held


@pytest.fixture
def observer(arm, gains):
    return UnknownInputObserver(arm, gains)


def update(observer, stamp, *measured):
    """Estimate at one measurement, None if there is none."""
    state = observer.parts.state[0]
    uio_step(observer.parts.constants[0], state, stamp, *(np.array(one, float) for one in measured))
    return state.observer.copy() if state.valid else None


def follow(observer, swing, first, last, fault=(0.0, 0.0), every=1):
    estimate = None
    for k in range(first, last + 1, every):
        estimate = update(observer, k * TS, *swing.sample(k * 0.002, every * 0.002, fault))
    return estimate


def test_given_the_first_sample_then_it_is_believed_and_called_initialising(observer, swing):
    estimate = update(observer, 5 * TS, *swing.sample(0.01))
    assert (estimate.mode, estimate.interval) == (Mode.INITIALISING, 0.0)
    np.testing.assert_allclose(estimate.position, swing.position(0.01), atol=1e-14)
    np.testing.assert_array_equal(estimate.x[4:], 0.0)
    assert update(observer, 6 * TS, *swing.sample(0.012)).mode == Mode.OBSERVING


def test_given_a_link_outside_the_region_when_observed_then_the_mode_is_holding(observer, swing):
    q = swing.joints.joint_position(swing.rest + np.array([1.4, 0.0]))
    for k in range(2):
        estimate = update(observer, k * TS, q, (0, 0), (0, 0))
    assert (estimate.mode, estimate.held.tolist()) == (Mode.HOLDING, [True, False])


def test_given_noise_when_started_on_many_samples_then_their_mean_counts(paper_arm, paper_gains):
    noise = np.random.default_rng(4).normal(scale=0.02, size=(100, 2))
    noise[0] = 0.06  # a bad first sample must not decide alone
    observer, modes = UnknownInputObserver(paper_arm, paper_gains, initial_samples=99), []
    for k in range(100):
        q = np.array([math.pi / 2, 0.0]) + noise[k]
        estimate = update(observer, k * TS, q, (0.0, 0.0), (0.0, 0.0))
        modes.append(estimate.mode)
    np.testing.assert_allclose(estimate.x[:2], np.cumsum(noise.mean(axis=0)), atol=5e-3)
    assert modes == [Mode.INITIALISING] * 99 + [Mode.OBSERVING]


@pytest.mark.parametrize('every', [2, 20])
def test_given_lost_samples_then_the_interval_is_integrated_in_steps(observer, swing, every):
    estimate = follow(observer, swing, 0, 400, every=every)
    # Torque held and rates interpolated over up to 40 ms: second order in the interval.
    np.testing.assert_allclose(estimate.position, swing.position(0.8), atol=5e-3)
    np.testing.assert_allclose(estimate.x[4:], 0.0, atol=5e-3)


@pytest.mark.parametrize('gap', [0.11, 30.0])
def test_given_a_gap_then_the_encoder_moves_the_state_and_the_fault_is_held(observer, swing, gap):
    fault = np.array([0.2, -0.15])
    follow(observer, swing, 0, 250)
    before = follow(observer, swing, 251, 500, fault)
    t = 1.0 + gap
    measured = swing.sample(t, fault=fault)
    estimate = update(observer, 500 * TS + round(gap * timestamps.NANOSECONDS), *measured)
    assert estimate.interval == pytest.approx(gap)
    np.testing.assert_allclose(estimate.x[4:], before.x[4:], atol=1e-12)
    np.testing.assert_allclose(estimate.position, swing.position(t), atol=1e-3)
    np.testing.assert_allclose(estimate.velocity, measured[1], atol=1e-12)


def test_given_an_interval_of_max_gap_when_taken_then_it_is_still_integrated(observer, swing):
    follow(observer, swing, 0, 100)
    end = 100 * TS + timestamps.NANOSECONDS // 10
    assert not update(observer, end, *swing.sample(0.3, 0.1)).bridged
    assert update(observer, end + timestamps.NANOSECONDS // 10 + 1, *swing.sample(0.4, 0.1)).bridged


@pytest.mark.parametrize('size', [1e100, -1e308])
def test_given_a_rate_that_no_arm_has_when_taken_then_no_estimate_is_made_up(observer, swing, size):
    for k in range(60):
        position, velocity, effort = swing.sample(k * 0.002)
        estimate = update(observer, k * TS, position, velocity + [size * (k == 20), 0.0], effort)
        vectors = [] if estimate is None else [estimate.position, estimate.velocity, estimate.x]
        assert all(np.isfinite(one).all() for one in vectors)


@given(st.integers(zonotope.KEPT, zonotope.COLUMNS), st.integers(0, 10**6), st.integers(0, 6))
def test_given_a_zonotope_when_reduced_then_large_columns_stay_as_wide(count, seed, digits):
    columns = np.zeros((zonotope.SIZE, zonotope.COLUMNS))
    given = np.random.default_rng(seed).normal(size=(zonotope.SIZE, count)).round(digits)
    columns[:, :count] = given  # many of the same size
    scratch = np.zeros(zonotope.COLUMNS), np.zeros(zonotope.SIZE)
    used = zonotope.reduce_columns(columns, count, *scratch)
    largest = np.sort(np.abs(given).sum(axis=0))[-zonotope.KEPT :]
    kept, left = columns[:, : zonotope.KEPT], columns[:, zonotope.KEPT : used]
    np.testing.assert_allclose(np.sort(np.abs(kept).sum(axis=0)), largest, atol=1e-12)
    assert (left == np.diag(np.diag(left))).all()
    wide = np.abs(columns[:, :used]).sum(axis=1)
    np.testing.assert_allclose(wide, np.abs(given).sum(axis=1), atol=1e-12)
