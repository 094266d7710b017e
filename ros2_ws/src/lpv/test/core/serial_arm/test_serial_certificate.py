"""The certificate of a serial arm's loop: it holds, forgeries and attacks fail."""

from dataclasses import replace

import numpy as np
import pytest
from places import BRINGUP
from scipy.linalg import eigh

from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.certificate.conditions import error_bound, require_loop, verify_loop
from lpv.core.serial_arm.certificate.disturbance import MotionRange, missed_torque
from lpv.core.serial_arm.certificate.exact_proof import prove_loop
from lpv.core.serial_arm.certificate.loop_gains import (
    load_loop_gains,
    loop_checksum,
    loop_to_dict,
    parse_loop,
    save_loop_gains,
)
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.support.errors import ConfigError


@pytest.fixture(scope='module', params=['ur10', 'panda'])
def shipped(request):
    """A shipped arm and its certificate."""
    return files_of(request.param)


@pytest.fixture(scope='module')
def ur10():
    return files_of('ur10')


def files_of(name):
    arm = load_arm(BRINGUP / 'arms' / f'{name}.yaml')
    return arm, load_loop_gains(BRINGUP / 'gains' / f'{name}.yaml')


def corner_arm(arm, gains, rng):
    """A true arm at a corner of the stated errors: each link's inertia, payload, friction."""
    chain, n = compile_chain(arm), len(arm.joints)
    factors = 1.0 + gains.model_error * rng.choice([-1.0, 1.0], n)
    friction = chain.friction.copy()
    friction[:, :3] *= 1.0 + arm.uncertainty.friction * rng.choice([-1.0, 1.0])
    chain = chain._replace(inertial=chain.inertial * factors[:, None], friction=friction)
    load = arm.uncertainty.payload * rng.choice([0.0, 1.0])
    return with_payload(chain, load) if load else chain


def growth(model, q, v):
    """M' by central differences."""
    step = 1e-6
    return (model.mass_matrix(q + step * v) - model.mass_matrix(q - step * v)) / (2.0 * step)


def slowest_decay(arm, gains, chain, q, v):
    """Decay of sqrt(V) in the worst direction of (eps, e, e'), with a true arm at (q, v)."""
    model, w, n = SerialModel(compile_chain(arm)), gains.bandwidth, len(q)
    mass, true = model.mass_matrix(q), SerialModel(chain).mass_matrix(q)
    gain, drag = np.linalg.solve(true, mass), np.linalg.solve(true, np.diag(chain.friction[:, 0]))
    eye, zero = np.eye(n), np.zeros((n, n))
    last = [-w * gain, -3 * w * gain, -3 * w * gain - drag]
    loop = np.block([[zero, w * eye, zero], [zero, zero, w * eye], last])
    weight = np.kron(gains.motion.lyapunov, mass)
    change = weight @ loop + loop.T @ weight
    change += np.kron(gains.motion.lyapunov, growth(model, q, v))
    return -0.5 * eigh(change, weight, eigvals_only=True)[-1]


def largest_ratio(arm, gains, chain, q, v):
    """V after over V before one sample, torque one sample late, in the worst direction."""
    model, w, n, h = SerialModel(compile_chain(arm)), gains.bandwidth, len(q), arm.sample_time
    before, mass = model.mass_matrix(q), model.mass_matrix(q + h * v)
    true = SerialModel(chain).mass_matrix(q + h * v)
    eye, zero, h = np.eye(n), np.zeros((n, n)), h * w
    drag = np.linalg.solve(true, np.diag(chain.friction[:, 0])) / w
    driven = np.hstack([zero, zero, drag, np.linalg.solve(true, before)])
    integral, error, rate = np.hsplit(np.eye(4 * n)[:, : 3 * n], 3)
    error_next = error.T + h * rate.T - h * h / 2 * driven
    command = np.hstack([eye, 3 * eye, 3 * eye, zero])
    after = np.vstack([integral.T + h * error_next, error_next, rate.T - h * driven, command])
    p = gains.sampled.lyapunov
    return eigh(after.T @ np.kron(p, mass) @ after, np.kron(p, before), eigvals_only=True)[-1]


def corners(arm, gains, seed, count):
    """True arms at corners of the stated errors: parameters, position, rates at their limits."""
    rng, limits = np.random.default_rng(seed), gains.rate_share * np.array(arm.velocity_limit)
    for q in rng.uniform(-np.pi, np.pi, (count, len(limits))):
        v = limits * rng.choice([-1.0, 1.0], len(limits))
        yield corner_arm(arm, gains, rng), q, v


def test_given_true_arms_at_corners_when_in_motion_sampled_or_late_then_the_energy_decays(shipped):
    arm, gains = shipped
    ratios = [largest_ratio(arm, gains, *one) for one in corners(arm, gains, 3, 200)]
    assert max(ratios) < 1.0 - 2.0 * gains.sampled.decay * arm.sample_time
    decays = [slowest_decay(arm, gains, *one) for one in corners(arm, gains, 1, 300)]
    assert min(decays) > gains.motion.decay


def test_given_the_shipped_files_when_verified_then_every_inequality_holds(shipped):
    arm, gains = shipped
    assert all(check.holds for check in verify_loop(arm, gains))
    assert sum(error_bound(arm, gains).values()) == pytest.approx(gains.error.bound, rel=1e-9)


def test_given_the_shipped_file_when_proved_in_exact_arithmetic_then_nothing_is_refuted(ur10):
    assert all(prove_loop(*ur10).values())


def test_given_random_configurations_when_compared_then_the_mass_matrix_keeps_its_bounds(shipped):
    arm, gains = shipped
    chain, rng, worst = compile_chain(arm), np.random.default_rng(0), np.zeros(4)
    model, loaded = SerialModel(chain), SerialModel(with_payload(chain, arm.uncertainty.payload))
    limits, viscous = np.array(arm.velocity_limit), np.diag(chain.friction[:, 0])
    for q in rng.uniform(-np.pi, np.pi, (400, len(limits))):
        mass, v = model.mass_matrix(q), limits * rng.choice([-1.0, 1.0], len(limits))
        least = np.diag(gains.model.inertia)
        forms = loaded.mass_matrix(q) - mass, viscous, growth(model, q, v), least
        worst = np.maximum(worst, [eigh(form, mass, eigvals_only=True)[-1] for form in forms])
    bounds = np.array([gains.model.payload, gains.model.damping, gains.model.growth, 1.0])
    assert (worst < bounds * (1.0 + 1e-6)).all()
    assert (worst > 0.75 * bounds).all()  # they are not idle either


def test_given_true_arms_at_corners_when_they_move_then_torques_that_are_missed_stay_bounded(
    shipped,
):
    arm, gains = shipped
    model, rates = SerialModel(compile_chain(arm)), gains.rate_share * np.array(arm.velocity_limit)
    parts = missed_torque(arm, gains.model, gains.model_error, MotionRange(rates, 2.0))
    for chain, q, v in corners(arm, gains, 2, 300):
        a = 2.0 * np.sign(v * q)
        missed = SerialModel(chain).inverse_dynamics(q, v, a) - model.inverse_dynamics(q, v, a)
        size = np.sqrt(missed @ np.linalg.solve(model.mass_matrix(q), missed))
        assert size < parts['model error'] + parts['payload']


def doubled(value):
    return (2.0 * np.asarray(value)).tolist() if isinstance(value, list) else 2.0 * value


@pytest.mark.parametrize(
    ('part', 'name', 'forged'),
    [
        ('model', 'payload', lambda value: 0.9 * value),
        ('model', 'damping', lambda value: 0.9 * value),
        ('model', 'growth', lambda value: 0.9 * value),
        ('model', 'inertia', doubled),
        ('motion', 'decay', lambda value: 1.6 * value),
        ('motion', 'lyapunov', lambda value: np.eye(3).ravel().tolist()),
        ('sampled', 'decay', lambda value: 1.6 * value),
        ('sampled', 'multipliers', lambda value: [0.0, 0.0]),
        ('error', 'level', lambda value: 0.9 * value),
        ('error', 'bound', lambda value: (0.9 * np.asarray(value)).tolist()),
        ('error', 'acceleration', doubled),
        ('', 'rate_share', lambda value: 1.3 * value),
        ('', 'model_error', doubled),
        ('', 'bandwidth', lambda value: 0.8 * value),
    ],
)
def test_given_a_forged_number_with_a_new_checksum_when_verified_then_it_is_refused(
    ur10, part, name, forged
):
    arm, gains = ur10
    data = loop_to_dict(gains)
    level = data[part] if part else data
    level[name] = forged(level[name])
    changed = parse_loop(data)
    with pytest.raises(ConfigError, match='the certificate does not hold'):
        require_loop(arm, replace(changed, checksum=loop_checksum(changed)))


def test_given_any_changed_number_when_verified_then_the_checksum_tells(ur10, tmp_path):
    arm, gains = ur10
    changed = replace(gains, rate_share=0.9 * gains.rate_share)  # a weaker claim, true as well
    with pytest.raises(ConfigError, match='numbers are those of the design'):
        require_loop(arm, changed)
    save_loop_gains(changed, tmp_path / 'gains.yaml')
    assert load_loop_gains(tmp_path / 'gains.yaml').rate_share == changed.rate_share


def test_given_a_file_with_a_bandwidth_only_when_loaded_then_it_says_what_is_missing(tmp_path):
    path = tmp_path / 'gains.yaml'
    path.write_text('/**: {ros__parameters: {bandwidth: 10.0}}\n', encoding='utf-8')
    with pytest.raises(ConfigError, match='no certificate'):
        load_loop_gains(path)


@pytest.mark.parametrize('change', [{'lyapunov': [1.0]}, {'decay': -1.0}, {'more': 1.0}])
def test_given_a_damaged_proof_when_parsed_then_the_field_is_named(ur10, change):
    _, gains = ur10
    data = loop_to_dict(gains)
    data['motion'] = {**data['motion'], **change}
    with pytest.raises(ConfigError, match=next(iter(change))):
        parse_loop(data)
