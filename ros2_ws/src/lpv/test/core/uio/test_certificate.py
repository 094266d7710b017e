import re
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from nested import changed, numbers, places
from places import BRINGUP, ROOT
from scipy.linalg import expm

from lpv import ConfigError, DiagnosisParameters
from lpv.core.serial_arm.certificate.certified import judged
from lpv.core.serial_arm.two_links import arm_from_json, two_link_arm
from lpv.core.support.inequalities import is_positive_definite
from lpv.core.uio.certificate import conditions, error_system, sampled_motion
from lpv.core.uio.certificate.error_system import exact_fault_sigma
from lpv.core.uio.certificate.gains import Gains, load_certified, load_gains
from lpv.core.uio.model.polytope import sinc_box
from lpv_design.exact_observer import design_exact, torque_gains
from lpv_design.guarantee import guarantee
from lpv_design.requirement import load_requirement
from lpv_design.solve import InfeasibleError

REQUIREMENTS, SLOW = BRINGUP / 'requirements', pytest.mark.slow
GAINS = BRINGUP / 'gains' / 'paper.yaml'


@given(st.lists(st.lists(st.integers(-5, 5), min_size=4, max_size=4), min_size=4, max_size=4))
def test_given_a_gram_matrix_when_tested_then_only_the_identity_makes_it_positive_definite(rows):
    factor = np.array(rows[:3])  # rank 3 at most
    gram = factor.T @ factor
    assert is_positive_definite(gram + np.eye(4, dtype=int))
    assert not is_positive_definite(gram)
    assert not is_positive_definite(-gram)


def test_given_a_violation_below_rounding_when_tested_then_exact_arithmetic_sees_it():
    tiny = 2.0**-60
    singular = np.array([[1.0, 1.0 + 2.0**-52], [1.0 + 2.0**-52, 1.0 + 2.0**-51]])
    # Eigenvalues in floats say nothing here; the determinant is -2^-104.
    assert not is_positive_definite(singular)
    assert is_positive_definite([[1.0, 0.0], [0.0, tiny]])
    assert not is_positive_definite([[1.0, 0.0], [0.0, -tiny]])
    assert not is_positive_definite([[1.0, tiny], [0.0, 1.0]])  # not symmetric
    assert not is_positive_definite([[Fraction(1, 3), Fraction(1, 3)]] * 2)


def test_given_a_matrix_that_is_no_number_then_its_inequality_does_not_hold_whatever_others_do():
    good, bad = -np.eye(2), np.full((2, 2), np.nan)
    for matrices in ([good, bad], [bad, good]):
        assert [check.holds for check in judged([('any', matrices)])] == [False]
    loop = np.stack([-np.eye(6), np.full((6, 6), np.nan)]), np.zeros((2, 6, 2))
    assert np.isnan(conditions.decay_margin(loop, np.zeros((2, 6)), np.eye(6), 0.5))


def test_given_shipped_designs_then_all_is_proved(paper_arm, real_arm, gains_of, literal_gains):
    designs = zip((paper_arm, real_arm, paper_arm), (*gains_of.values(), literal_gains))
    for proved in (gains.prove(arm) for arm, gains in designs):
        assert len(proved) >= 4 and all(proved.values()), proved


def spoilt(gains, part, **changes):
    return replace(gains, **{part: replace(getattr(gains, part), **changes)})


POLES = 'poles between'
LITERAL_LMI = r'observer: LMI \(55\) at 8 vertices'
SPOILT = {
    ('paper', 'observer'): [
        (lambda o: {'kappa': -o.kappa}, POLES), (lambda o: {'fastest': 0.5 * o.fastest}, POLES),
        # Too slow for its decay.
        (lambda o: {'kappa': 0.9 * o.kappa}, POLES), (lambda o: {'decay': 2.0 * o.decay}, POLES),
        (lambda o: {'kappa': o.kappa * [1.0, 0.5]}, 'link 2: poles between'),
        (lambda o: {'mu': 30.0 * o.mu}, 'sampled recursion'),  # too fast for its sample time
        (lambda o: {'kappa': 60.0 * o.kappa}, 'real poles'),
        (lambda o: {'lyapunov': np.stack([np.eye(2)] * 2)}, POLES),
        (lambda o: {'lyapunov': -o.lyapunov}, 'P > 0'),
        (lambda o: {'lyapunov': 20.0 * o.lyapunov}, 'covariance'),
        (lambda o: {'lyapunov': o.lyapunov + [[0.0, 0.1], [0.0, 0.0]]}, 'P > 0 and symmetric'),
        (lambda o: {'lyapunov': np.nan * o.lyapunov}, 'P > 0 and symmetric'),
    ],
    ('literal', 'observer'): [
        (lambda o: {'k': -o.k}, LITERAL_LMI), (lambda o: {'k': 2.0 * o.k}, LITERAL_LMI),
        (lambda o: {'gamma': 0.1}, LITERAL_LMI), (lambda o: {'box': sinc_box(0.5)}, LITERAL_LMI),
        (lambda o: {'t1': o.t1 + 0.01}, 'decoupling'),
        (lambda o: {'lyapunov': -o.lyapunov}, 'P > 0'),
    ],
    ('paper', 'controller'): [
        (lambda c: {'m1': -c.m1}, r'LMI \(67\)'), (lambda c: {'m2': -c.m2}, r'LMI \(67\)'),
        (lambda c: {'decay': 5.0 * c.decay}, r'LMI \(67\)'),
        (lambda c: {'m1': 40.0 * c.m1}, 'one sample of delay'),
        (lambda c: {'lyapunov': -c.lyapunov}, 'controller: P > 0'),
    ],
}  # fmt: skip
"""By gains and part: what is spoilt, and the inequality that fails."""


def failing(arm, gains):
    return [check.name for check in gains.verify(arm) if not check.holds]


@pytest.mark.parametrize('case', [(*key, *row) for key in SPOILT for row in SPOILT[key]])
def test_given_a_spoilt_part_then_what_fails_is_named(request, paper_arm, case):
    design, part, spoil, named = case
    gains = request.getfixturevalue(f'{design}_gains')
    gains = spoilt(gains, part, **spoil(getattr(gains, part)))
    failed = failing(paper_arm, gains)
    assert any(re.search(named, name) for name in failed), failed
    pytest.raises(ConfigError, gains.require, paper_arm).match('certificate does not hold')
    if named != 'one sample of delay':  # of which the exact proof does not speak
        refuted = [name for name, holds in gains.prove(paper_arm).items() if not holds]
        assert any(re.search(named, name) for name in refuted), refuted


@pytest.mark.parametrize('noise', ['velocity_noise', 'disturbance_variance'])
def test_given_more_noise_then_proof_and_floats_refute_the_covariance(planar, gains, noise):
    noisy = replace(planar, **{noise: 3000.0 * getattr(planar, noise)})
    gains = replace(gains, arm_sha256=noisy.sha256())
    arm, names = two_link_arm(noisy), 'covariance under the noise of the arm file'
    proved, checks = gains.prove(arm), [check for check in gains.verify(arm) if names in check.name]
    assert [proved[check.name] for check in checks] == [check.holds for check in checks]
    assert len(checks) == 2 and not all(check.holds for check in checks)


def test_given_slopes_that_change_in_a_sample_then_constant_ones_prove_nothing(planar, gains):
    arm = replace(planar, sample_time=0.1, cos_min=(0.75, 0.75))
    link = error_system.link_errors(arm)[0]
    kappa, unit = 33.2 / link.slopes[1], np.diag([1.0, 3.32 * link.inertia / link.slopes[1]])
    lyapunov = np.stack([unit @ [[0.306, 0.102], [0.102, 4.266]] @ unit] * 2)
    observer = replace(
        gains.observer, kappa=np.full(2, kappa), mu=np.full(2, 12.67), lyapunov=lyapunov
    )
    claims = dict(conditions.observer_inequalities(arm, observer))
    matrices = claims['observer, link 1: sampled recursion contracts']
    inverse = np.linalg.inv(unit)
    worst = [np.linalg.eigvalsh(inverse @ m @ inverse)[-1] for m in matrices]
    assert [one < 0.0 for one in worst] == [True, False, True, True]


def test_given_the_proof_when_compared_with_floats_then_constants_and_vertices_agree(planar):
    numbers, constants = planar.numbers(Fraction), planar.constants()
    for name, value in numbers._asdict().items():
        np.testing.assert_allclose(np.array(value, float), constants[name], rtol=1e-14)
    for method in ('paper', 'exact'):
        exact = conditions.controller_loop(planar, method, number=Fraction)
        for floats, fractions in zip(conditions.controller_loop(planar, method), exact):
            assert all(isinstance(value, (Fraction, int)) for value in fractions.flat)
            np.testing.assert_allclose(fractions.astype(float), floats, rtol=1e-13)


def test_given_a_sampled_integrator_when_its_torque_is_late_then_the_radius_is_the_textbooks():
    m, sampled = np.array([[-2.0]]), conditions.discretised(np.zeros((1, 1)), np.ones((1, 1)), 0.1)
    # x+ = x + dt u, u = -2 x one sample late: z^2 - z + 0.2 = 0.
    expected = np.abs(np.roots([1.0, -1.0, 0.2])).max()
    assert conditions.delayed_radius(*sampled, m) == pytest.approx(expected, rel=1e-12)
    assert conditions.delayed_radius(*sampled, 6.0 * m) > 1.0


def test_given_model_error_and_payload_when_at_corners_then_masses_span_the_range(paper_model):
    arms = conditions.corner_arms(replace(paper_model, model_error=0.1, payload=0.5))
    assert len(arms) == 32
    masses = np.array([[link.mass for link in a.links] for a in arms])
    np.testing.assert_allclose([masses.min(axis=0), masses.max(axis=0)], [[9.0, 4.5], [11.0, 6.0]])


def test_given_an_arm_as_json_when_read_back_then_it_is_the_same_arm(planar):
    assert arm_from_json(planar.to_json()) == planar
    for text in ('', '{}', '[]', '{"links": 3}', planar.to_json().replace('"name"', '"nome"')):
        pytest.raises(ConfigError, arm_from_json, text)


def test_given_a_design_when_mapped_then_thresholds_grow_with_errors(paper_model, paper_gains):
    found, middle = guarantee(paper_model, paper_gains, points=9), 4
    for values in (found.bound[:, middle, 0], found.bound[middle, :, 1]):
        assert np.isfinite(values[middle]) and np.all(np.diff(values[middle:]) >= 0.0)
        np.testing.assert_allclose(values, values[::-1], rtol=1e-9)
    assert np.isinf(found.bound[[0, -1], middle, 0]).all()  # 72 deg: leaves gravity's reach
    assert np.isfinite(found.bound[0, middle, 1])  # which is no matter of link 2's sensor
    smallest = DiagnosisParameters().minimum_threshold
    np.testing.assert_array_equal(found.threshold, np.maximum(found.bound, smallest))
    np.testing.assert_array_equal(found.detectable, found.threshold + found.bound)
    base = guarantee(paper_model, paper_gains, points=5).bound
    for change in ({'model_error': 0.1}, {'payload': 0.3}, {'coulomb': (0.5, 0.5)}):
        other = replace(paper_model, **change)
        larger = guarantee(other, replace(paper_gains, arm_sha256=other.sha256()), points=5).bound
        assert np.all(larger[1:4, 1:4] >= base[1:4, 1:4])
        assert np.all(larger[1, 3] > base[1, 3])  # 36 deg to both sides


def test_given_a_gains_file_when_verified_then_no_solver_is_loaded(paper_model):
    certificate = load_gains(GAINS).certificate
    assert arm_from_json(certificate['arm_json']) == paper_model
    assert max(certificate['margins'].values()) < 0.0
    assert certificate['solver'] == 'CLARABEL'
    assert len(certificate['guarantee']['threshold_1']) == 13 * 13
    assert {'clarabel_version', 'cvxpy_version', 'numpy_version'} <= set(certificate)
    code = f"""if True:
        import sys; from lpv.cli.main import main
        code = main(["verify", {str(GAINS)!r}, "--proof"])
        sys.exit(code or bool({{"cvxpy", "clarabel"}} & set(sys.modules)))"""
    result = subprocess.run([sys.executable, '-c', code], text=True, capture_output=True)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.rstrip().endswith('the certificate holds')
    assert result.stdout.count('proved') == 12


@pytest.mark.parametrize(('field', 'factor'), [('mu', 0.2), ('lyapunov', -1.0), ('decay', 1.001)])
def test_given_tampered_gains_when_verified_then_the_code_is_1(tmp_path, call, field, factor):
    where = f'/**.ros__parameters.gains.observer.{field}'
    data, path = yaml.safe_load(GAINS.read_text()), tmp_path / 'gains.yaml'
    tampered = changed(data, where, lambda values: (factor * np.array(values)).tolist())
    path.write_text(yaml.safe_dump(tampered))
    said = call('verify', path, '--proof', code=1).out
    assert 'FAILS' in said and 'does NOT hold' in said


def asked(folder, old, new, name='paper'):
    text = (REQUIREMENTS / f'{name}.yaml').read_text()
    assert old in text
    (folder / 'asked.yaml').write_text(text.replace(old, new))
    return folder / 'asked.yaml'


@pytest.mark.slow
def test_given_a_design_when_asked_for_then_it_is_made_or_code_and_reason_told(tmp_path, call):
    def design(requirement, *options, code):
        words = '--requirement', requirement, '--out', out, *options
        return call('design', '--arm', 'paper', *words, code=code)

    out, picture = tmp_path / 'g.yaml', tmp_path / 'map.png'
    said = design(REQUIREMENTS / 'paper.yaml', '--map', picture, '--proof', code=0).out
    assert 'REFUTED' not in said and said.count('proved') == 12
    assert 'lasting faults are detected from' in said
    assert load_gains(out).arm_name == 'paper' and picture.exists()
    out = tmp_path / 'none.yaml'
    fast = asked(tmp_path, 'decay: 0.25', 'decay: 55.0')
    assert 'slower decay' in design(fast, code=1).err
    wide = asked(tmp_path, 'sinc_min: 0.96', 'sinc_min: -0.2', 'paper_literal')
    said = design(wide, code=3).err
    assert 'not observable' in said and 'cannot be told apart' in said
    assert 0.94 < float(said.split('phi2, phi3 in [')[1].split(',')[0]) < 0.96
    assert not out.exists()


def test_given_a_torque_gain_that_gravity_exceeds_then_it_is_said(paper_model, tmp_path):
    norm = 1.0 / (24.5 * 0.3)  # link 2 at the border of the region
    gains = (f'  torque_gain: {share * norm}\n  rate_noise' for share in (0.99, 1.01))
    files = (asked(tmp_path, '  rate_noise', gain) for gain in gains)
    impossible, possible = map(load_requirement, files)
    with pytest.raises(InfeasibleError, match='unknown torque .* ask for a smaller region'):
        design_exact(paper_model, impossible.observer)
    gains, _ = design_exact(paper_model, possible.observer)
    # The norm is that of the designed error system, at any slope.
    frequencies = np.logspace(-4, 3, 200)
    for link, limit in zip(error_system.link_errors(paper_model), torque_gains(paper_model)):
        for slope in np.linspace(*link.slopes, 5):
            n = link.closed(slope, gains.kappa[link.index], gains.mu[link.index])
            systems = 1j * frequencies[:, None, None] * np.eye(2) - n
            response = np.linalg.solve(systems, np.array([[0.0], [1.0 / link.inertia]]))[:, 0, 0]
            assert np.abs(response).max() <= limit * (1.0 + 1e-9)


@pytest.mark.parametrize('design', ['paper', 'real', pytest.param('literal', marks=SLOW)])
def test_given_any_number_that_is_used_when_forged_then_the_loader_refuses_it(request, design):
    arm = request.getfixturevalue('real_arm' if design == 'real' else 'paper_arm')
    data = request.getfixturevalue(f'{design}_gains').mapping()
    used = [place for place in numbers(data) if not place.startswith('certificate')]
    assert len(used) > 60
    values = dict(places(data))
    for place, x in ((place, values[place]) for place in used):
        for other in (x * 1.001 + 1e-9, -x - 1e-9):  # each changes zeros, too
            with pytest.raises(ConfigError, match='gains'):
                Gains.parse(changed(data, place, other)).require(arm)
    # Numbers for information do not count.
    gains = Gains.parse({**data, 'certificate': {'margins': {'any': 1.0}}})
    assert gains.mapping()['checksum'] == data['checksum']


@pytest.mark.parametrize(('design', 'place', 'value'), [
    ('paper', 'observer.mu[0]', 1e300), ('paper', 'observer.mu[1]', 1e-300),
    ('literal', 'observer.k[3]', 1e300), ('literal', 'observer.gamma', 1e160),
    ('literal', 'observer.box[1]', 1e300),
])  # fmt: skip
def test_given_numbers_beyond_arithmetic_then_all_refuse(request, paper_arm, design, place, value):
    data = request.getfixturevalue(f'{design}_gains').mapping()
    gains = replace(Gains.parse(changed(data, place, value)), checksum='')
    with np.errstate(all='ignore'), pytest.raises(ConfigError, match='gains: .* does not hold'):
        gains.require(paper_arm)


def test_given_forged_hashes_then_inequalities_refuse_them(paper_arm, paper_model, paper_gains):
    heavier = two_link_arm(paper_model.scaled((1.0, 1.5), (1.0, 1.0)))
    pytest.raises(ConfigError, paper_gains.verify, heavier).match('designed for another arm')
    forged = replace(paper_gains, arm_sha256=paper_gains.hash_of(heavier))
    assert any('poles between' in name for name in failing(heavier, forged))
    observer = paper_gains.observer
    for factor in (1e-6, 0.999, 1.001):
        gains = spoilt(paper_gains, 'observer', fault_sigma=factor * observer.fault_sigma)
        pytest.raises(ConfigError, gains.require, paper_arm).match('standard deviation')
    # A matrix that claims less noise, with its own deviation.
    lyapunov = 1e4 * observer.lyapunov
    sigma = exact_fault_sigma(paper_model, lyapunov)
    quiet = spoilt(paper_gains, 'observer', lyapunov=lyapunov, fault_sigma=sigma)
    failed = failing(paper_arm, quiet)
    assert len(failed) == 2 and all('covariance' in name for name in failed)


def corners(arm, rate):
    """Flows of the loop at the corners of gravity and inertia, then of Coriolis torques."""
    swirl, flows = arm.constants().coupling * rate, []
    for a, b in zip(*conditions.controller_loop(arm, 'exact')):
        for first, second in product((-swirl, swirl), repeat=2):
            flow = np.zeros((sampled_motion.SIZE, sampled_motion.SIZE))
            flow[:6, :6], flow[:6, 6:] = a, b
            flow[2:4, 2:4] += b[2:4] @ np.array([[0.0, first], [second, 0.0]])
            flows.append(flow)
    return flows


def transition(flows, step, controller):
    """A sample in which the arm is at one corner after the other."""
    whole = np.eye(sampled_motion.SIZE)
    for flow in flows:
        whole = expm(flow * step / len(flows)) @ whole
    whole[6:] = np.hstack([controller.m1, controller.m2, np.zeros((2, 2))])
    whole[4:6] = np.eye(2, sampled_motion.SIZE, 4) - step * whole[:2]  # as the law sums eps
    return whole


def test_given_an_arm_that_jumps_between_corners_when_run_then_it_contracts(planar, gains):
    controller, motion, worst = gains.controller, gains.controller.motion, 0.0
    flows, factor = corners(planar, motion.rate), np.linalg.cholesky(motion.lyapunov).T
    rng = np.random.default_rng(3)
    for _ in range(500):
        places = rng.integers(len(flows), size=rng.integers(1, 6))
        sample = transition([flows[i] for i in places], planar.sample_time, controller)
        worst = max(worst, np.linalg.norm(factor @ sample @ np.linalg.inv(factor), 2))
    assert 1.0 - 4.0 * motion.decay * planar.sample_time < worst
    assert worst < np.exp(-motion.decay * planar.sample_time)


@pytest.mark.parametrize('slower', [1.0, 10.0])
def test_given_corners_that_change_in_a_sample_then_the_remainder_holds(planar, gains, slower):
    controller, rng = gains.controller, np.random.default_rng(4)
    arm, rate = replace(planar, sample_time=slower * planar.sample_time), controller.motion.rate
    flows, used = corners(arm, rate), 0.0
    loop, law = conditions.controller_loop(arm, 'exact'), np.hstack([controller.m1, controller.m2])
    sampled = sampled_motion.sampled_loop(arm, loop, law, rate)
    for _ in range(300):
        places = rng.integers(len(flows), size=4)
        exact = transition([flows[i] for i in places], arm.sample_time, controller)
        rest = np.abs(exact - sampled.vertices[places].mean(axis=0))
        assert (rest <= sampled.remainder + 1e-12).all()
        bounded = sampled.remainder > 1e-9
        used = max(used, (rest[bounded] / sampled.remainder[bounded]).max())
    assert used > 0.1  # the bound is no formality


def test_given_claims_that_do_not_hold_or_none_when_verified_then_they_are_not_made(planar, gains):
    motion, p = gains.controller.motion, gains.controller.motion.lyapunov

    def holds(controller):
        checks = conditions.controller_checks(planar, controller)
        return [check.holds for check in checks if 'in motion' in check.name]

    forged = {
        'decay': [20.0 * motion.decay],
        'rate': [100.0 + 30.0 * motion.rate, 1e6 * motion.rate],
        'lyapunov': [-p, p + np.triu(np.ones_like(p)), p * np.nan, np.eye(sampled_motion.SIZE)],
    }
    for changes in ({name: value} for name, values in forged.items() for value in values):
        other = replace(gains.controller, motion=replace(motion, **changes))
        assert holds(other) == [False]
    assert holds(gains.controller) == [True]
    without = replace(gains, controller=replace(gains.controller, motion=None))
    again = Gains.parse(without.mapping())
    assert again.controller.motion is None
    assert holds(again.controller) == []
    again = Gains.parse(gains.mapping())
    assert np.array_equal(again.controller.motion.lyapunov, gains.controller.motion.lyapunov)


def test_given_the_table_of_claims_when_the_docs_are_read_then_they_claim_the_same():
    said = (ROOT / 'docs' / 'guarantees.md').read_text(encoding='utf-8')
    shipped = (load_certified(BRINGUP / 'gains' / f'{name}.yaml') for name in ('paper', 'ur10'))
    claims = [row for gains in shipped for row in gains.claims()]
    rows = [f'| {claim} | {region} | {evidence} |' for claim, region, evidence in claims]
    rows += ['| Claim | Where | Evidence |', '|---|---|---|']
    assert [row for row in rows if row not in said] == []
    kinds = ('exact arithmetic', 'eigenvalue', 'bound', 'experiment', 'checksum')
    assert len(rows) == 18 and all(any(kind in row[2] for kind in kinds) for row in claims)
