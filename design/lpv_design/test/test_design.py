from dataclasses import replace
from functools import cache
from itertools import product
from types import SimpleNamespace

import cvxpy as cp
import numpy as np
import pytest
from planar_formulas import weights
from scipy.linalg import solve_continuous_are, solve_continuous_lyapunov, solve_discrete_lyapunov
from serial_bags import ball_joint

from lpv import ConfigError, load_arm
from lpv.core.serial_arm.certificate.loop_inequality import LoopNumbers, motion_matrix
from lpv.core.serial_arm.description import LinkInertia, Uncertainty
from lpv.core.serial_arm.two_links import two_link_arm
from lpv.core.support import inequalities, resources
from lpv.core.uio.certificate import conditions, error_system, lmi
from lpv.core.uio.certificate.conditions import observer_margin
from lpv.core.uio.certificate.gains import load_gains
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_descriptor, sinc_box, vertex_matrices
from lpv.core.uio.observer.paper_observer import decoupling
from lpv.identify.estimation.assembly import with_joint_values
from lpv_design import controller, design_flow, exact_observer, main, serial_loop
from lpv_design.corner_lyapunov import corner_lyapunov
from lpv_design.paper_observer import PaperRequirement, solve_paper, undetectable_point
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError, NotDetectableError, solve, symmetric_below

PUBLISHED = np.array([
    [-4426.747411, -0.001668, -420.832109, -0.000786, 13268.9910017, -0.0171864],
    [0.003075, -1440.412948, -0.000361, -145.310838, -0.0312571, 3932.6833916],
])  # fmt: skip
"""(M1, M2) of section 5 of the paper."""


@cache
def designed(name):
    """Gains of a shipped requirement; tests of other packages take the shipped ones."""
    return design_flow.design(load_arm(name), load_requirement(name)).gains


def common_lyapunov(loop, m, alpha):
    """Find Q for given gains: is there a common Lyapunov matrix with decay alpha?"""
    # Published gains have poles from -5 to -204; modal coordinates of one vertex balance them.
    closed = [a + b @ m for a, b in zip(*loop)]
    _, vectors = np.linalg.eig(closed[0])
    basis = np.linalg.cholesky(np.real(vectors @ vectors.conj().T))
    inverse = np.linalg.inv(basis)
    q, t = cp.Variable((6, 6), symmetric=True), cp.Variable()
    constraints = [q >> np.eye(6), q << 1e4 * np.eye(6), t <= 1.0]
    for a in closed:
        scaled = inverse @ a @ basis
        slack = 2 * alpha * q + t * np.eye(6)
        constraints.append(symmetric_below(scaled @ q + q @ scaled.T + slack))
    solve(-t, constraints)
    return None if q.value is None else basis @ q.value @ basis.T


@pytest.mark.parametrize('s_min', [-0.2, 0.0, 1e-3, 0.5, 0.96])
def test_given_boxes_then_just_those_with_zero_hold_a_point_that_is_undetectable(planar, s_min):
    """By the test of Popov, Belevitch and Hautus, in which output injection K changes nothing."""
    lost, box = undetectable_point(planar, s_min), sinc_box(s_min)
    assert (lost is None) == (s_min > 0.0)
    d = paper_descriptor(planar, box)
    t1, _ = decoupling(d.e, d.c)

    def pencil(phi, eigenvalue):
        model = t1 @ np.tensordot(weights(phi, box), d.a, 1)
        return np.vstack([model - eigenvalue * np.eye(6), d.c]), np.linalg.eigvals(model)

    if lost is not None:
        phi, vector = lost
        assert np.all(box[:, 0] <= phi) and np.all(phi <= box[:, 1])
        assert 0.0 in phi[1:] and np.abs(vector).max() == 1.0
        np.testing.assert_allclose(pencil(phi, 0.0)[0] @ vector, 0.0, atol=1e-9)
    # All else is observable, on the border of the box and inside; zero at the other points, too.
    inside = np.random.default_rng(2).uniform(*box.T, (50, 3))
    for phi in (*product(*box), *inside):
        if np.abs(phi[1:]).min() > 0.0:
            for eigenvalue in (0.0, *pencil(phi, 0.0)[1]):
                assert np.linalg.svd(pencil(phi, eigenvalue)[0])[1][-1] > 1e-9


@pytest.mark.parametrize(('lmi_name', 's_min', 'gamma'), [
    ('55', -0.2, 1.0), ('55', -0.2, None), ('55', -0.2, 1000.0), ('54+disc', -0.2, 1.0),
    # Less than the smallest gamma of a smaller box.
    ('55', 0.95, 0.98), ('55', 0.5, 100.0), ('54+disc', 0.8, 0.26),
])  # fmt: skip
def test_given_no_solution_when_solved_then_nothing_passes(paper_model, lmi_name, s_min, gamma):
    wanted = PaperRequirement(lmi_name, s_min, gamma or 1.0)
    found, status = solve_paper(paper_model, wanted, minimise=gamma is None)
    assert found is None or observer_margin(paper_model, found) >= 0.0
    assert s_min > 0.0 or status != 'optimal'


# (55) literally, and (54) with the disc as a separate inequality; see docs/paper-notes.md.
@pytest.mark.parametrize(('lmi_name', 's_min', 'expected'), [
    ('55', 1.0, 0.82), ('55', 0.95, 1.01), ('55', 0.8, 3.8),
    ('54+disc', 1.0, 0.165), ('54+disc', 0.8, 0.28),
])  # fmt: skip
def test_given_a_smaller_box_then_gamma_is_as_known(paper_model, lmi_name, s_min, expected):
    found, _ = solve_paper(paper_model, PaperRequirement(lmi_name, s_min), minimise=True)
    assert found.gamma == pytest.approx(expected, rel=0.02)
    # The figure stands on the rebuilt inequalities, and they are sharp.
    assert observer_margin(paper_model, replace(found, gamma=1.001 * found.gamma)) < 0.0
    assert observer_margin(paper_model, replace(found, gamma=0.97 * found.gamma)) > 0.0


def test_given_no_lyapunov_matrix_or_wrong_poles_when_checked_then_they_are_refused(paper_model):
    # Room to spare: gamma 1.2 on the box of 0.97.
    found, _ = solve_paper(paper_model, PaperRequirement('55', 0.96, 1.2))
    d, names = paper_descriptor(paper_model, found.box), ('55', '54+disc')

    def margin(lmi_name, **spoilt):
        return observer_margin(paper_model, replace(found, lmi=lmi_name, **spoilt))

    assert margin('55') < 0.0
    for a_i, k_i in zip(d.a, found.k):
        poles = np.linalg.eigvals(found.t1 @ a_i + k_i @ d.c)
        assert np.abs(poles + 20.0).max() < 15.0
    for shift in (-40.0, 40.0):  # N + shift*I on one vertex: faster than 35/s, or unstable
        bad = found.k.copy()
        bad[3] += shift * np.linalg.pinv(d.c)
        poles = np.linalg.eigvals(found.t1 @ d.a[3] + bad[3] @ d.c)
        assert np.abs(poles + 20.0).max() > 15.0
        assert all(margin(name, k=bad) > 0.0 for name in names)
    assert all(margin(name, lyapunov=-found.lyapunov) > 0.0 for name in names)
    assert all(margin(name, lyapunov=0.0 * found.lyapunov) >= 0.0 for name in names)


def schur_system():
    rng = np.random.default_rng(6)
    n = rng.normal(size=(6, 6))
    n -= (np.linalg.eigvals(n).real.max() + 1.5) * np.eye(6)
    return n, rng.normal(size=(6, 1)), rng.normal(size=(6, 2))


def test_given_a_system_when_54_is_solved_by_its_riccati_equation_then_gamma_is_the_norm():
    """(54) holds for some P exactly if the H-infinity norm from [d f] to e is below gamma."""
    n, b_d, b_f = schur_system()
    b, frequencies = np.hstack([b_d, b_f]), np.linspace(0.0, 20.0, 4001)
    response = np.linalg.solve(1j * frequencies[:, None, None] * np.eye(6) - n, b)
    norm = np.linalg.norm(response, 2, axis=(1, 2)).max()
    gamma = 1.02 * norm
    # sym(P N) + P B B^T P / gamma^2 + 1.0001 I = 0
    p = solve_continuous_are(n, b, 1.0001 * np.eye(6), -(gamma**2) * np.eye(3))
    for bound, holds in ((gamma, True), (0.9 * norm, False)):
        block = lmi.bounded_real(p @ n + n.T @ p, p @ b, bound**2)
        assert (inequalities.largest_eigenvalue(block) < 0.0) == holds


def test_given_a_system_then_disc_and_covariance_inequalities_hold_just_if_they_should():
    (n, _, _), q = schur_system(), 8.0
    reach = np.abs(np.linalg.eigvals(n) + q).max()
    p = solve_discrete_lyapunov((n + q * np.eye(6)).T / (1.01 * reach), np.eye(6))
    assert inequalities.largest_eigenvalue(lmi.disc(p, p @ n, q, 1.01 * reach)) < 0.0
    for half in np.random.default_rng(1).normal(size=(20, 6, 6)):
        p = half @ half.T
        assert inequalities.largest_eigenvalue(lmi.disc(p, p @ n, q, 0.99 * reach)) > 0.0
    n, b, _ = schur_system()
    gramian = solve_continuous_lyapunov(n, -b @ b.T - 1e-3 * np.eye(6))
    for share, holds in ((1.0, True), (0.9, False)):
        p = np.linalg.inv(share * gramian)
        assert (inequalities.largest_eigenvalue(lmi.covariance(p @ n, p @ b)) < 0.0) == holds
    assert inequalities.largest_eigenvalue([[-1.0, 100.0], [-100.0, -2.0]]) == pytest.approx(-1.0)
    assert inequalities.largest_eigenvalue([[-1.0, 3.0], [3.0, -1.0]]) == pytest.approx(2.0)


@pytest.mark.parametrize(('method', 'vertices'), [
    ('paper', 8), pytest.param('exact', 16, marks=pytest.mark.slow),
])  # fmt: skip
def test_given_both_loops_when_designed_then_67_holds_and_not_if_spoilt(planar, method, vertices):
    wanted = load_requirement(planar.name).controller
    loop = conditions.controller_loop(planar, method)
    assert len(loop[0]) == len(loop[1]) == vertices
    m, p, _ = controller.solve_loop(planar, loop, wanted)
    assert conditions.decay_margin(loop, m, p, wanted.alpha) < 0.0
    for a, b in zip(*loop):
        poles = np.linalg.eigvals(a + b @ m)
        assert poles.real.max() < -wanted.alpha and np.abs(poles).max() < wanted.fastest
    backwards = m * [[1, 1, 1, 1, -1, -1]]  # the integrator the wrong way
    for spoilt in ((-m, p), (backwards, p), (0.0 * m, p), (m, -p), (m, np.eye(6))):
        assert conditions.decay_margin(loop, *spoilt, wanted.alpha) > 0.0


def test_given_the_published_loop_when_augmented_then_eqs_64_and_67_hold(paper_model):
    a, b = vertex_matrices(sinc_box(-0.2), paper_model.constants(coriolis=False))
    loop = a_c, b_c = conditions.controller_loop(paper_model, 'paper')
    for i in range(8):
        whole = np.block([[a[i], np.zeros((4, 2))], [-np.eye(2, 4), np.zeros((2, 2))]])
        np.testing.assert_array_equal(a_c[i], whole)
        np.testing.assert_array_equal(b_c[i], np.vstack([b[i], np.zeros((2, 2))]))
    p = np.linalg.inv(common_lyapunov(loop, PUBLISHED, 2.0))
    assert inequalities.largest_eigenvalue(-p) < 0.0
    assert conditions.decay_margin(loop, PUBLISHED, p, 2.0) < 0.0
    assert conditions.decay_margin(loop, PUBLISHED, p, 20.0) > 0.0


def assert_same_gains(found, wanted):
    """Equal up to what solvers leave open: to the largest element, as small ones may be zeros."""
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-3 * np.abs(wanted).max())


def test_given_requirements_when_designed_then_gains_are_the_shipped_ones(arm):
    found, shipped = designed(arm.name), load_gains(resources.bringup_file('gains', arm.name))
    for part, names in (('observer', ('kappa', 'mu')), ('controller', ('m1', 'm2'))):
        for name in names:
            wanted = getattr(getattr(shipped, part), name)
            assert_same_gains(getattr(getattr(found, part), name), wanted)
    found.require(arm)


@pytest.mark.parametrize('cos_min', [0.3, 0.15, 0.05])
def test_given_a_large_region_when_designed_at_decay_2_then_it_is_certified(paper_model, cos_min):
    arm = replace(paper_model, cos_min=(cos_min, cos_min))
    wanted = replace(load_requirement('paper').observer, decay=2.0, fastest=60.0 * 0.3 / cos_min)
    observer, _ = exact_observer.design_exact(arm, wanted)
    sampled = replace(arm, sample_time=min(0.002, 0.2 / wanted.fastest))
    assert observer_margin(sampled, observer) < 0.0


@pytest.mark.parametrize(('noise', 'cos_min'), [(0.3, 0.3), (0.3, 0.8), (1.0, 0.3)])
def test_given_noisy_rates_when_designed_then_poles_are_real(paper_model, noise, cos_min):
    """Where the least covariance would make those of steep slopes complex."""
    arm = replace(paper_model, velocity_noise=noise, cos_min=(cos_min, cos_min), sample_time=0.008)
    wanted = replace(load_requirement('paper').observer, fastest=55.0)
    observer, _ = exact_observer.design_exact(arm, wanted)
    damping = 4.0 * observer.kappa * arm.constants().gravity / observer.mu**2
    assert 0.9 < damping.max() < 1.0
    assert observer_margin(arm, observer) < 0.0


def test_given_any_slope_when_tried_then_poles_and_deviation_are_as_certified(planar):
    observer, wanted = designed(planar.name).observer, load_requirement(planar.name).observer
    for link, p in zip(error_system.link_errors(planar), observer.lyapunov):
        kappa, mu = observer.kappa[link.index], observer.mu[link.index]
        bound, worst = link.unit**2 * np.linalg.inv(p)[0, 0], 0.0
        gain = -np.array([[kappa * link.inertia], [mu]])
        for slope in np.linspace(*link.slopes, 50):
            closed = link.closed(slope, kappa, mu)
            poles = np.linalg.eigvals(closed)
            assert np.abs(poles.imag).max() == 0.0
            assert -poles.real.max() > observer.decay and np.abs(poles).max() < observer.fastest
            for noise in link.noises(wanted.acceleration_noise, wanted.rate_noise):
                inputs = noise[:2] + gain @ noise[2:]
                worst = max(worst, solve_continuous_lyapunov(closed, -inputs @ inputs.T)[0, 0])
        assert 0.1 * bound < worst <= bound


@pytest.mark.slow
def test_given_too_large_a_sample_time_when_designed_then_the_loop_is_limited(paper_arm):
    requirement = load_requirement('paper')
    slow = replace(paper_arm, sample_time=0.02)
    result = design_flow.design(slow, requirement)
    assert 'instead of 60/s, which the sample time 0.02 s cannot carry' in result.lines[0]
    assert all(check.holds for check in result.gains.verify(slow))
    eager = replace(requirement.controller, alpha=30.0)
    with pytest.raises(InfeasibleError, match='alpha = 30/s is faster than the sample time'):
        design_flow.design(slow, replace(requirement, controller=eager))
    cause = r'leaves a pose by up to 6.4/s: .*; controller: poles .* time 0.05 s cannot carry'
    with pytest.raises(InfeasibleError, match=cause):
        design_flow.design(replace(paper_arm, sample_time=0.05), requirement)


def test_given_a_payload_that_the_designs_lyapunov_matrix_misses_then_another_carries_it(
    paper_model,
):
    arm, wanted = replace(paper_model, payload=1.0), load_requirement('paper').controller
    loop = conditions.controller_loop(arm, 'exact')
    m, p, _ = controller.solve_loop(arm, loop, wanted)

    def margin(lyapunov):
        loops = [conditions.controller_loop(one, 'exact') for one in conditions.corner_arms(arm)]
        return max(conditions.decay_margin(one, m, lyapunov, 0.5 * wanted.alpha) for one in loops)

    assert margin(p) > 0.0
    gains, _ = controller.design_controller(arm, wanted)
    assert margin(gains.lyapunov) < 0.0
    assert all(check.holds for check in conditions.controller_checks(arm, gains))
    light = replace(arm, payload=0.0)
    assert corner_lyapunov(light, loop, m, p, wanted.alpha) is p  # where it carries all, it stays


@pytest.mark.parametrize(
    ('joint', 'centers'), [(1, (0.5, 0.0)), (1, (0.5, -0.2)), (0, (-1.5, 0.5))]
)
@pytest.mark.parametrize('requirement', ['paper', 'paper_literal'])
def test_given_no_weight_in_front_of_a_joint_when_designed_then_it_is_told(
    paper_model, joint, centers, requirement
):
    links = [replace(one, center_of_mass=c) for one, c in zip(paper_model.links, centers)]
    arm = two_link_arm(replace(paper_model, links=tuple(links)))
    with pytest.raises(NotDetectableError, match=f"'joint{joint + 1}' .* leave lpv out"):
        design_flow.design(arm, load_requirement(requirement))


def test_given_a_sample_time_that_slows_a_loop_alone_then_no_pole_is_said_to_be_limited(
    paper_model,
):
    slow = replace(paper_model, sample_time=0.007)
    tried = design_flow.within_sampling(slow, load_requirement('paper'))
    assert [len(lines) for _, lines in tried] == [1, 1, 1]
    assert 'poles up to 64.3/s instead of 100/s' in tried[0][1][0]
    assert tried[1][1] == ['controller: alpha 1/s instead of 2/s']


@pytest.mark.parametrize('rates', ['independent', 'derived'])
def test_given_noisy_readings_when_fed_back_then_torques_have_the_noise_that_is_told(planar, rates):
    arm, gains = replace(planar, rates=rates), designed(planar.name).controller
    rng, joints = np.random.default_rng(0), JointMap(arm)
    position = arm.position_noise * rng.normal(size=(20000, 2))
    before = arm.position_noise * rng.normal(size=(20000, 2))
    rate = arm.velocity_noise * rng.normal(size=(20000, 2))
    if rates == 'derived':
        rate = (position - before) / arm.sample_time
    angles = np.linalg.inv(joints.sensor_matrix).T
    torque = joints.joint_torque(np.hstack([position @ angles, rate @ angles]) @ gains.m1.T)
    share = torque.std(axis=0) / arm.torque_limit
    np.testing.assert_allclose(design_flow.noise_of_torques(arm, gains), share, rtol=0.1)


@pytest.mark.parametrize('part', ['observer, link 1', 'observer', 'controller'])
def test_given_an_inequality_that_fails_then_the_word_of_its_own_solver_is_told(part):
    check = inequalities.Check(f'{part}: LMI', 1.0)
    said = design_flow._reason(check, 'of the observer', 'of the controller')
    assert f"solver says 'of the {part.partition(',')[0]}'" in said


@pytest.mark.parametrize('factor', [0.01, 100.0])
def test_given_all_noise_scaled_then_only_deviations_scale(paper_model, factor):
    wanted = load_requirement('paper').observer
    scaled = {n: factor * getattr(paper_model, n) for n in ('position_noise', 'velocity_noise')}
    variance = factor**2 * paper_model.disturbance_variance
    quiet = replace(paper_model, disturbance_variance=variance, **scaled)
    noise = tuple(factor * v for v in wanted.acceleration_noise)
    asked = replace(wanted, acceleration_noise=noise, rate_noise=factor * wanted.rate_noise)
    found, _ = exact_observer.design_exact(quiet, asked)
    shipped = designed('paper').observer
    assert_same_gains(found.kappa, shipped.kappa)
    assert_same_gains(found.fault_sigma, factor * shipped.fault_sigma)


@pytest.mark.parametrize('direction', [(0.7, 0.0), (0.7, 2.0), (0.7, -2.0)])
def test_given_one_disturbance_of_both_axes_then_deviation_is_as_certified(paper_model, direction):
    quiet = {'velocity_noise': 1e-3, 'position_noise': 1e-5, 'disturbance_variance': 30.0}
    arm = replace(paper_model, disturbance_direction=direction, **quiet)
    observer, _ = exact_observer.design_exact(arm, load_requirement('paper').observer)
    gains = replace(designed('paper'), arm_sha256=arm.sha256(), observer=observer)
    proved = gains.prove(two_link_arm(arm))
    push = np.array(direction) * np.sqrt(arm.disturbance_variance * arm.sample_time)
    for link in error_system.link_errors(arm):
        i = link.index
        assert proved[f'observer, link {i + 1}: covariance under the noise of the arm file']
        most = link.unit * np.sqrt(np.linalg.inv(gains.observer.lyapunov[i])[0, 0])
        for slope, inputs in product(link.slopes, link.inputs):
            n = link.closed(slope, gains.observer.kappa[i], gains.observer.mu[i])
            b = inputs[:2, 2:] @ push[:, None]
            assert np.sqrt(solve_continuous_lyapunov(n, -b @ b.T)[0, 0]) < most


@pytest.mark.slow
def test_given_all_masses_scaled_when_designed_then_so_are_gains(paper_model):
    factor = 1e-3
    shipped, wanted = designed('paper'), load_requirement('paper')
    heavy = paper_model.scaled((factor, factor), (factor, factor))
    observer, _ = exact_observer.design_exact(heavy, wanted.observer)
    found, _ = controller.design_controller(heavy, wanted.controller)
    assert_same_gains(factor * observer.kappa, shipped.observer.kappa)
    expected, limit = factor * shipped.controller.m1, np.abs(shipped.controller.m1).max()
    np.testing.assert_allclose(found.m1, expected, rtol=1e-2, atol=1e-3 * factor * limit)


def test_given_the_literal_requirement_then_it_is_the_papers_and_sharp(paper_arm, literal_gains):
    literal_gains.require(paper_arm)
    requirement = load_requirement('paper_literal')
    assert (requirement.observer.lmi, requirement.observer.gamma) == ('55', 1.0)
    assert (requirement.observer.q, requirement.observer.r) == (20.0, 15.0)
    assert requirement.controller.alpha == 2.0
    assert isinstance(load_requirement('paper').observer, exact_observer.ExactRequirement)
    pytest.raises(ConfigError, load_requirement, 'nothing').match('paper, paper_literal, real_arm')
    wanted = replace(load_requirement('paper_literal'), observer=PaperRequirement(sinc_min=0.9))
    with pytest.raises(
        InfeasibleError, match=r'LMI \(55\) with gamma = 1 has no solution .* larger disc'
    ):
        design_flow.design(paper_arm, wanted)


@pytest.fixture(scope='module')
def short():
    """The first three joints of the UR10, which carry a load at the elbow's end."""
    whole = load_arm('ur10')
    return replace(whole, name='short', joints=whole.joints[:3], tip=(-0.57, 0.0, 0.0))


@pytest.fixture(scope='module')
def found(short):
    return serial_loop.certify_loop(short, serial_loop.LoopRequest())


@pytest.mark.slow
def test_given_an_arm_when_designed_then_what_is_certified_follows_payload_and_region(short, found):
    gains, lines = found
    gains.require(short)
    assert any('what limits it' in line for line in lines)
    lighter = replace(short, uncertainty=replace(short.uncertainty, payload=1.0))
    ratio = serial_loop.model_bounds(lighter).payload / gains.model.payload
    assert ratio == pytest.approx(0.5, rel=0.01)
    slow = serial_loop.certify_loop(short, serial_loop.LoopRequest(rate_share=0.2))[0]
    assert slow.rate_share == 0.2 and slow.motion.decay > gains.motion.decay


@pytest.mark.slow
def test_given_much_friction_when_designed_then_the_error_of_a_slow_loop_is_bounded(short):
    thick = [replace(one.friction, viscous=12.0 * one.friction.viscous) for one in short.joints]
    unloaded = replace(short.uncertainty, payload=0.0)
    arm = replace(with_joint_values(short, friction=thick), uncertainty=unloaded)
    gains, _ = serial_loop.certify_loop(arm, serial_loop.LoopRequest())
    gains.require(arm)
    assert gains.motion.decay < 0.1 and gains.error.bound.max() < 10.0


@pytest.mark.slow
def test_given_light_links_with_much_friction_when_errors_are_bounded_then_bounds_are_proved(found):
    """The solver ends just outside of its constraints where friction is large."""
    numbers = LoopNumbers(
        growth=0.09184083840948684, damping=6.499513020493472,
        low=0.9514747859181732, high=1.0 / 0.95, step=0.02)  # fmt: skip
    proved = 0
    for decay in np.geomspace(0.02, 0.8, 12).tolist():
        one = serial_loop._error_proof(found[0], numbers, decay)
        if one is not None:
            left = motion_matrix(one.lyapunov, one.multipliers, numbers, decay, one.level)
            assert inequalities.largest_eigenvalue(left) < 0.0
            proved += 1
    assert proved > 0


@pytest.mark.parametrize(('asked', 'payload', 'told'), [
    ({'bandwidth': 3.0, 'rate_share': 1.0}, None, 'cannot be certified, .* can'),
    ({}, 500.0, 'payload 500 kg'), ({'bandwidth': float('nan')}, None, 'must be finite'),
    ({'model_error': 0.9}, None, 'must lie within'),
])  # fmt: skip
def test_given_what_cannot_be_certified_when_designed_then_it_is_told(short, asked, payload, told):
    arm = replace(short, uncertainty=Uncertainty(payload=payload)) if payload else short
    with pytest.raises(ConfigError if told.startswith('must') else InfeasibleError, match=told):
        serial_loop.certify_loop(arm, serial_loop.LoopRequest(**asked))


def test_given_no_payload_and_viscous_friction_when_bounded_then_no_solver_is_asked(monkeypatch):
    arm, asked = load_arm('ur10'), []
    light = [LinkInertia.from_vector(1e-3 * joint.link.to_vector()) for joint in arm.joints]
    smooth = [replace(joint.friction, viscous=0.0) for joint in arm.joints]
    arm = with_joint_values(arm, link=light, friction=smooth, rotor_inertia=[1e-2] * len(light))
    arm = replace(arm, uncertainty=Uncertainty())
    best = serial_loop._best_value
    monkeypatch.setattr(serial_loop, 'solve', lambda *_: asked.append(1) or 'solver_error')
    assert [best(serial_loop.chain_numbers(arm), one) for one in ('payload', 'damping')] == [0, 0]
    assert not asked
    monkeypatch.undo()
    found = serial_loop.model_bounds(arm)  # a solver fails at an optimum of zero
    assert found.payload == found.damping == 1e-3 and found.inertia.min() > 0.0


def test_given_no_inertia_left_when_bounded_then_the_joint_is_named(short, monkeypatch):
    best = serial_loop._best_value
    # As the solver says of a light wrist without a rotor.
    left = np.array([0.07, 0.5, -1e-5])
    monkeypatch.setattr(
        serial_loop, '_best_value', lambda *of: left if of[1] == 'inertia' else best(*of)
    )
    with pytest.raises(InfeasibleError, match='for elbow_joint: state its rotor_inertia'):
        serial_loop.model_bounds(short)


def test_given_joints_with_nothing_between_them_when_designed_then_they_are_named():
    with pytest.raises(InfeasibleError, match='joints a, c turn .* their rotor_inertia'):
        serial_loop.certify_loop(ball_joint(), serial_loop.LoopRequest())


def test_given_a_serial_arm_when_verified_or_designed_then_all_is_told(call, refused, tmp_path):
    gains = resources.bringup_file('gains', 'ur10')
    out = call('verify', gains).out
    assert call('verify', 'ur10').out == out
    assert 'the certificate holds' in out and 'region: every position, joint rates to' in out
    for other in ('panda', 'paper'):
        assert refused('designed for another arm', 'verify', gains, '--arm', other)
    options = '--arm', 'ur10', '--requirement', 'paper', '--out', tmp_path / 'gains.yaml'
    assert refused('--requirement', 'design', *options)


def test_given_gains_that_are_refuted_when_proved_then_they_are_not_written(capsys):
    gains = SimpleNamespace(prove=lambda _arm: {'poles': False}, save=pytest.fail)
    arguments = SimpleNamespace(arm=None, proof=True, out='gains.yaml')
    assert main._finish(arguments, gains, [], []) == main.EXIT_INFEASIBLE
    assert 'REFUTED: poles' in capsys.readouterr().out
