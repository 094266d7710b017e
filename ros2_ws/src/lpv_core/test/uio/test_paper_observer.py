"""The unknown-input observer, eqs. (38)-(53): algebra, recursion, convergence."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lpv_core.support.records import new_record
from lpv_core.uio.model.dynamics import acceleration, inverse_dynamics
from lpv_core.uio.model.joints import JointMap
from lpv_core.uio.model.polytope import exact_vertices, sinc_box, state_spaces, vertex_matrices
from lpv_core.uio.model.state_space import Descriptor, output_matrices
from lpv_core.uio.observer.paper_observer import (
    PAPER_CONSTANTS,
    PAPER_STATE,
    decoupling,
    paper_step,
)
from lpv_core.uio.observer.sampled_observer import OBSERVER_STATE, advance, observer_constants

pytestmark = pytest.mark.slow


def paper_descriptor(arm, s_min=-0.2):
    a, b = vertex_matrices(sinc_box(s_min), arm.constants(coriolis=False))
    return Descriptor(a, b, arm)


def exact_descriptor(arm):
    return Descriptor(*state_spaces(exact_vertices(arm), arm.constants()), arm)


def fault_feedthrough(c):
    """T1 and T2 of method exact: T2 = [0; I 0], and T1 = [(I - T2 C~) restricted to x, 0].

    Every solution of T1 E + T2 C~ = I has these first two columns of T2, so that no position fault
    reaches z; choosing zeros for the rest keeps the whole torque balance in T1.
    """
    t2 = np.zeros((6, 4))
    t2[4:, :2] = np.eye(2)
    t1 = np.eye(6) - t2 @ c
    t1[:, 4:] = 0.0
    return t1, t2


def observer_matrices(d, t1, t2, k):
    """N_i, L_i and G_i of eqs. (51)-(53)."""
    n = t1 @ d.a + k @ d.c
    return n, n @ t2 - k, t1 @ d.b


def output_injection(theta, rates, kappa, mu, arm, sensor_matrix):
    """K(rho) of method exact in the paper's form z' = T1 (A~ x^ + B~ u) + K (C~ x^ - y).

    Its rows for f keep S theta^ + z_f at zero.
    """
    off = arm.rotor_coupling + arm.coupling * math.cos(theta[0] - theta[1])
    xi = np.array([[arm.inertia[0], off], [off, arm.inertia[1]]])
    turning = -arm.coupling * math.sin(theta[0] - theta[1]) * (rates[0] - rates[1])
    xi_rate = np.array([[0.0, turning], [turning, 0.0]])
    s_inverse = np.linalg.inv(sensor_matrix)
    k = np.zeros((6, 4))
    k[:2, 2:] = -(np.eye(2) + np.diag(kappa) @ xi) @ s_inverse
    k[2:4, 2:] = -np.linalg.solve(xi, np.diag(mu) @ xi + xi_rate) @ s_inverse
    k[4:, 2:] = -sensor_matrix @ k[:2, 2:]
    return k


def both_designs(arm):
    """Descriptor and decoupling of method paper and of method exact."""
    paper, exact = paper_descriptor(arm), exact_descriptor(arm)
    return ((paper, *decoupling(paper.e, paper.c)), (exact, *fault_feedthrough(exact.c)))


class Exact:
    """The recursion of method exact, started anywhere."""

    def __init__(self, arm, gains):
        self.arm, self.gains = arm, gains.observer
        self.s = JointMap(arm).sensor_matrix
        self.constants = arm.constants()
        self.recursion = observer_constants(arm, gains)
        self.state = new_record(OBSERVER_STATE)
        self.held = self.state.held

    def start(self, x):
        self.state.x[:] = x

    def step(self, y_old, y_new, torque, dt):
        advance(
            self.recursion,
            self.state,
            np.asarray(y_old, float),
            np.asarray(y_new, float),
            np.asarray(torque, float),
            dt,
        )
        return self.state.x.copy()

    def injection(self, theta, rates):
        return output_injection(
            theta, rates, self.arm.sign * self.gains.kappa, self.gains.mu, self.constants, self.s
        )


class Motion:
    """A smooth motion in the region with the torques that produce it exactly."""

    def __init__(self, arm):
        self.arm, self.c = arm, arm.constants()
        self.rest = 0.0 if arm.orientation == 'upright' else math.pi
        self.s = JointMap(arm).sensor_matrix

    def angles(self, t):
        return np.array(
            [
                self.rest + 0.3 + 0.3 * math.sin(0.9 * t),
                self.rest - 0.2 + 0.4 * math.sin(1.3 * t + 0.5),
            ]
        )

    def rates(self, t):
        return np.array([0.27 * math.cos(0.9 * t), 0.52 * math.cos(1.3 * t + 0.5)])

    def accelerations(self, t):
        return np.array([-0.243 * math.sin(0.9 * t), -0.676 * math.sin(1.3 * t + 0.5)])

    def torque(self, t):
        return np.array(
            inverse_dynamics(*self.angles(t), *self.rates(t), *self.accelerations(t), self.c)
        )

    def outputs(self, t, fault=(0.0, 0.0)):
        return np.concatenate([self.s @ self.angles(t) + fault, self.s @ self.rates(t)])


# ------------------------------------------------------------------ algebra


def test_given_both_decouplings_when_formed_then_eq_41_holds_and_the_fault_is_decoupled(arm):
    for d, t1, t2 in both_designs(arm):
        np.testing.assert_allclose(t1 @ d.e + t2 @ d.c, np.eye(6), atol=1e-14)
        np.testing.assert_allclose(t1 @ d.bf, 0.0, atol=1e-14)


def test_given_the_pseudo_inverse_when_formed_then_it_is_the_smallest_solution_of_eq_47(arm):
    d = paper_descriptor(arm)
    t1, t2 = decoupling(d.e, d.c)
    sigma, delta = np.vstack([d.e, d.c]), np.hstack([t1, t2])
    np.testing.assert_allclose(delta @ sigma, np.eye(6), atol=1e-14)
    # Smallest: every row lies in the column space of sigma, delta = delta sigma sigma^+.
    np.testing.assert_allclose(delta @ sigma @ np.linalg.pinv(sigma), delta, atol=1e-14)
    np.testing.assert_allclose(delta, np.linalg.inv(sigma.T @ sigma) @ sigma.T, atol=1e-14)


def test_given_the_exact_decoupling_when_formed_then_positions_feed_the_fault_alone(arm):
    d = exact_descriptor(arm)
    t1, t2 = fault_feedthrough(d.c)
    np.testing.assert_array_equal(t2[:4], 0.0)
    np.testing.assert_array_equal(t2[4:], [[1, 0, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_array_equal(t1[:4, :4], np.eye(4))
    assert np.linalg.norm(t1 @ d.bd) > 0.1  # the disturbance is attenuated, not decoupled


def test_given_any_gains_when_n_l_g_are_formed_then_constraints_44_and_45_hold_at_all_vertices(arm):
    rng = np.random.default_rng(11)
    for d, t1, t2 in both_designs(arm):
        k = rng.normal(scale=20.0, size=(len(d.a), 6, 4))
        n, ell, g = observer_matrices(d, t1, t2, k)
        for i in range(len(d.a)):
            scale = np.abs(n[i]).max()
            np.testing.assert_allclose(
                t1 @ d.a[i] - n[i] @ t1 @ d.e - ell[i] @ d.c, 0.0, atol=1e-12 * scale
            )
            np.testing.assert_allclose(t1 @ d.b[i] - g[i], 0.0, atol=1e-14)
            np.testing.assert_allclose(n[i] @ t2 - ell[i], k[i], atol=1e-12 * scale)  # (50)


# ------------------------------------------------------------------ the paper's recursion


def test_given_the_paper_observer_when_stepped_then_it_is_the_heun_rule_of_eq_38(arm):
    s_min, dt, rng = 0.5, 0.003, np.random.default_rng(7)
    box = sinc_box(s_min)
    d = paper_descriptor(arm, s_min)
    t1, t2 = decoupling(d.e, d.c)
    gains = rng.normal(scale=10.0, size=(8, 6, 4))
    n_i, l_i, g_i = observer_matrices(d, t1, t2, gains)
    z = rng.normal(scale=0.3, size=6)
    other = z.copy()
    x = np.zeros(6)
    constants = new_record(PAPER_CONSTANTS, t1=t1, t2=t2, c=d.c, box=box, k=gains, a=d.a, b=d.b)
    state = new_record(PAPER_STATE, z=z)
    y_old = rng.normal(scale=0.3, size=4)
    for _ in range(20):
        y_new, u = y_old + rng.normal(scale=0.05, size=4), rng.normal(scale=20.0, size=2)
        paper_step(constants, state, x, y_old, y_new, u, dt)

        guess = other + t2 @ y_old
        phi = (math.cos(guess[0] - guess[1]), np.sinc(guess[0] / np.pi), np.sinc(guess[1] / np.pi))
        alpha = [min(max((hi - p) / (hi - lo), 0), 1) for p, (lo, hi) in zip(phi, box)]
        rho = [
            np.prod([1 - a if bit else a for a, bit in zip(alpha, (i >> 2 & 1, i >> 1 & 1, i & 1))])
            for i in range(8)
        ]
        n, ell, g = (np.tensordot(rho, stack, 1) for stack in (n_i, l_i, g_i))
        first = n @ other + ell @ y_old + g @ u
        second = n @ (other + dt * first) + ell @ y_new + g @ u
        other = other + dt / 2 * (first + second)

        np.testing.assert_allclose(state.z, other, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(x, other + t2 @ y_new, rtol=1e-10, atol=1e-12)
        y_old = y_new


# ------------------------------------------------------------------ the exact recursion


def test_given_the_exact_observer_when_stepped_then_it_is_the_uio_form_with_its_injection(
    arm, gains_of
):
    observer, motion, h = Exact(arm, gains_of[arm.name]), Motion(arm), 1e-7
    t1, t2 = fault_feedthrough(exact_descriptor(arm).c)
    c = np.hstack(output_matrices(arm))
    for t in (0.0, 0.7, 2.0):
        y = motion.outputs(t, (0.2, -0.1))
        theta, rate = motion.angles(t) + [0.1, -0.05], motion.rates(t) + [0.3, 0.2]
        x = np.concatenate([theta, rate, y[:2] - observer.s @ theta])
        # z' = T1 (model of x^) + K(rho) (C~ x^ - y), eq. (38) in its estimate.
        v = np.linalg.solve(observer.s, y[2:])
        model = np.concatenate(
            [rate, acceleration(*theta, *v, *motion.torque(t), observer.constants), -x[4:]]
        )
        rates = t1 @ model + observer.injection(theta, v) @ (c @ x - y)
        observer.start(x)
        after = observer.step(y, y, motion.torque(t), h)
        np.testing.assert_allclose((after - x - t2 @ (y - y)) / h, rates, rtol=2e-5, atol=2e-5)


def test_given_any_state_when_differentiated_then_the_momentum_error_is_decoupled_link_by_link(
    arm, gains_of
):
    """e' = -s kappa m and m' = s Gamma e - mu m + coupling, without any linearisation."""
    observer, motion, h = Exact(arm, gains_of[arm.name]), Motion(arm), 1e-6
    c, rng = observer.constants, np.random.default_rng(5)

    def inertia(theta):
        off = c.rotor_coupling + c.coupling * math.cos(theta[0] - theta[1])
        return np.array([[c.inertia[0], off], [off, c.inertia[1]]])

    for t in rng.uniform(0.0, 5.0, 10):
        y = motion.outputs(t)
        wrong = rng.uniform(-0.2, 0.2, 4)
        theta, rate, acc = motion.angles(t), motion.rates(t), motion.accelerations(t)
        guess, guess_rate = theta + wrong[:2], rate + wrong[2:]
        observer.start(np.concatenate([guess, guess_rate, np.zeros(2)]))
        after = observer.step(y, y, motion.torque(t), h)
        guess_acc = (after[2:4] - guess_rate) / h
        e, m = wrong[:2], inertia(guess) @ wrong[2:]
        swirl = -c.coupling * math.sin(guess[0] - guess[1]) * (rate[0] - rate[1])
        m_rate = np.array([[0, swirl], [swirl, 0]]) @ wrong[2:] + inertia(guess) @ (guess_acc - acc)
        gravity = c.gravity * (np.sin(guess) - np.sin(theta))
        delta = inertia(guess) - inertia(theta)
        spin = c.coupling * (math.sin(guess[0] - guess[1]) - math.sin(theta[0] - theta[1]))
        coupling = -delta @ acc - spin * np.array([rate[1] ** 2, -(rate[0] ** 2)])
        expected = gravity + coupling - observer.gains.mu * m
        scale = np.abs(np.concatenate([m, expected])).max()
        np.testing.assert_allclose(m_rate, expected, rtol=1e-4, atol=1e-4 * scale)
        np.testing.assert_allclose(
            (after[:2] - guess) / h - rate,
            -arm.sign * observer.gains.kappa * m,
            rtol=1e-4,
            atol=1e-6,
        )
        slope = gravity / e * arm.sign
        assert np.all(slope > 0.0) and np.all(slope <= c.gravity)


def test_given_the_exact_torques_of_a_motion_when_started_right_then_the_observer_stays_on_it(
    arm, gains_of
):
    motion, observer, dt = Motion(arm), Exact(arm, gains_of[arm.name]), arm.sample_time
    y = motion.outputs(0.0)
    observer.start(np.concatenate([motion.angles(0.0), motion.rates(0.0), [0, 0]]))
    worst = 0.0
    for k in range(2000):
        y_new = motion.outputs((k + 1) * dt)
        x = observer.step(y, y_new, motion.torque((k + 0.5) * dt), dt)
        y = y_new
        worst = max(
            worst,
            np.abs(
                x
                - np.concatenate([motion.angles((k + 1) * dt), motion.rates((k + 1) * dt), [0, 0]])
            ).max(),
        )
    # The Heun rule at 2 ms; Coulomb friction turns round within a few samples.
    assert worst < (2e-4 if any(arm.coulomb) else 3e-5)


@pytest.mark.parametrize('bias', [(0.2, -0.1), (-0.25, 0.2)])
def test_given_a_wrong_start_when_the_nonlinear_arm_moves_then_the_error_dies_out(
    paper_model, paper_gains, bias
):
    motion, dt = Motion(paper_model), paper_model.sample_time
    observer = Exact(paper_model, paper_gains)
    y = motion.outputs(0.0, bias)
    observer.start(np.concatenate([motion.angles(0.0) + bias, motion.rates(0.0), [0, 0]]))
    errors = []
    for k in range(15000):
        y_new = motion.outputs((k + 1) * dt, bias)
        x = observer.step(y, y_new, motion.torque((k + 0.5) * dt), dt)
        y = y_new
        if k % 2500 == 2499:
            errors.append(
                np.abs(np.concatenate([x[:2] - motion.angles((k + 1) * dt), x[4:] - bias])).max()
            )
    # Every 5 s take off at least what the certified decay promises, down to the Heun rule's error.
    for before, after in zip([0.25, *errors], errors):
        assert after < before * math.exp(-0.25 * 5.0) + 5e-6


FAULT = st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=60, max_size=60)


@settings(max_examples=40)
@given(FAULT)
def test_given_position_faults_of_any_shape_when_observed_then_the_state_estimate_is_bitwise_same(
    paper_model, real_model, gains_of, faults
):
    for arm in (paper_model, real_model):
        motion, dt = Motion(arm), arm.sample_time
        ends = []
        for shape in (np.zeros((61, 2)), np.vstack([[0.0, 0.0], faults])):
            observer = Exact(arm, gains_of[arm.name])
            y = motion.outputs(0.0)
            observer.start(
                np.concatenate(
                    [motion.angles(0.0) + 0.05, motion.rates(0.0), -observer.s @ [0.05, 0.05]]
                )
            )
            for k in range(60):
                y_new = motion.outputs((k + 1) * dt, shape[k + 1])
                x = observer.step(y, y_new, motion.torque((k + 0.5) * dt), dt)
                y = y_new
            ends.append((x, y))
        np.testing.assert_array_equal(ends[0][0][:4], ends[1][0][:4])
        # And the fault estimate follows without delay: f^ = y_p - S theta^.
        (x, y) = ends[1]
        np.testing.assert_allclose(
            x[4:], y[:2] - observer.s @ x[:2], atol=1e-9 + 1e-13 * np.abs(faults).max()
        )


def outside(arm, link):
    """Angles at which one link is beyond the region, and the other well inside."""
    theta = np.zeros(2) if arm.orientation == 'upright' else np.full(2, math.pi)
    theta[link] += math.acos(arm.cos_min[link]) + 0.1
    return theta


@pytest.mark.parametrize('link', [0, 1])
def test_given_a_link_outside_the_region_when_observed_then_it_is_held_on_the_measured_rate(
    arm, gains_of, link
):
    observer, dt = Exact(arm, gains_of[arm.name]), arm.sample_time
    theta = outside(arm, link)
    true_rate = np.array([0.4, -0.3])
    torque = inverse_dynamics(*theta, *true_rate, 0.0, 0.0, observer.constants)
    y_old = np.concatenate([observer.s @ (theta - 0.2), observer.s @ true_rate])
    y_new = y_old.copy()
    y_new[:2] += dt * observer.s @ true_rate
    # The rate estimate is wrong on purpose: a held angle must follow the measurement instead.
    x = np.concatenate([theta, true_rate + 0.5, observer.s @ [-0.2, -0.2]])
    observer.start(x)
    after = observer.step(y_old, y_new, torque, dt)
    assert observer.held.tolist() == [link == 0, link == 1]
    assert after[link] == pytest.approx(theta[link] + dt * true_rate[link], abs=1e-12)
    other = 1 - link
    assert abs(after[other] - theta[other] - dt * true_rate[other]) > 1e-5  # not held
    np.testing.assert_allclose(after[4:], y_new[:2] - observer.s @ after[:2], atol=1e-12)


def test_given_a_link_on_either_side_of_the_border_when_observed_then_only_outside_is_held(
    arm, gains_of
):
    observer = Exact(arm, gains_of[arm.name])
    rest = 0.0 if arm.orientation == 'upright' else math.pi
    for offset, expected in ((-1e-6, False), (1e-6, True)):
        for side in (1.0, -1.0):
            for link in range(2):
                theta = np.full(2, rest)
                theta[link] += side * (math.acos(arm.cos_min[link]) + offset)
                y = np.concatenate([observer.s @ theta, [0.0, 0.0]])
                observer.start(np.concatenate([theta, np.zeros(4)]))
                observer.step(y, y, np.zeros(2), arm.sample_time)
                assert observer.held[link] == expected
                assert not observer.held[1 - link]


def test_given_the_vertical_when_observed_then_rounding_of_the_cosine_holds_nothing(arm, gains_of):
    observer = Exact(arm, gains_of[arm.name])
    for theta in (np.zeros(2), np.full(2, math.pi), np.array([2 * math.pi, -2 * math.pi])):
        y = np.concatenate([observer.s @ theta, [0.0, 0.0]])
        observer.start(np.concatenate([theta, np.zeros(4)]))
        observer.step(y, y, np.zeros(2), arm.sample_time)
        upright = abs(math.cos(theta[0]) - 1.0) < 1e-9
        assert observer.held.tolist() == [upright != (arm.orientation == 'upright')] * 2
