from dataclasses import replace

import numpy as np
import pytest
from fault_injection import with_joints
from nested import Missing, changed
from scipy.linalg import eigh
from serial_certificate import corner_arm, decay

from lpv import ConfigError, load_arm
from lpv.core.serial_arm.certificate.disturbance import missed_torque
from lpv.core.serial_arm.certificate.loop_gains import LoopGains
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import JointFriction, LinkInertia, TorqueTolerance
from lpv.core.serial_arm.dynamics.friction import drive_friction
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.dynamics.payload import with_payload
from lpv.core.support.resources import bringup_file
from lpv.core.uio.certificate.gains import load_certified

FILES = {n: (load_arm(n), load_certified(bringup_file('gains', n))) for n in ('ur10', 'panda')}
EACH = pytest.mark.parametrize(('arm', 'gains'), FILES.values(), ids=FILES)


def growth(model, q, v):
    """M' by central differences."""
    step = 1e-6
    return (model.mass_matrix(q + step * v) - model.mass_matrix(q - step * v)) / (2.0 * step)


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


@EACH
def test_given_true_arms_at_corners_then_energy_decays_and_missed_torques_are_bounded(arm, gains):
    ratios = [largest_ratio(arm, gains, *one) for one in corners(arm, gains, 3, 200)]
    assert max(ratios) < 1.0 - 2.0 * gains.sampled.decay * arm.sample_time
    model = SerialModel(compile_chain(arm))
    decays = [decay(model, gains, *one) for one in corners(arm, gains, 1, 300)]
    assert min(decays) > gains.motion.decay
    model, rates = SerialModel(compile_chain(arm)), gains.rate_share * np.array(arm.velocity_limit)
    parts = missed_torque(arm, gains.model, gains.model_error, rates, 2.0)
    for chain, q, v in corners(arm, gains, 2, 300):
        a = 2.0 * np.sign(v * q)
        missed = SerialModel(chain).inverse_dynamics(q, v, a) - model.inverse_dynamics(q, v, a)
        size = np.sqrt(missed @ np.linalg.solve(model.mass_matrix(q), missed))
        assert size < parts['model error'] + parts['payload']


def test_given_rotors_that_are_off_when_driven_then_the_missed_torque_is_bounded():
    """Where they outweigh the links, and nothing else is missed."""
    arm, gains = FILES['ur10']
    link, error = LinkInertia(1e-3, (0.0, 0.0, 0.0), (0.0,) * 6), gains.model_error
    light = replace(with_joints(arm, link=link), gravity=0.0)
    chain = compile_chain(light)
    bounds = replace(gains.model, inertia=np.diag(chain.motor))
    parts = missed_torque(light, bounds, error, np.zeros(6), 2.0)
    q, v, a = np.full(6, 0.5), np.zeros(6), np.full(6, 2.0)
    off = chain._replace(motor=(1.0 + error) * chain.motor)
    model = SerialModel(chain)
    missed = SerialModel(off).inverse_dynamics(q, v, a) - model.inverse_dynamics(q, v, a)
    size = np.sqrt(missed @ np.linalg.solve(model.mass_matrix(q), missed))
    assert 0.9 * parts['model error of rotors'] < size
    assert size < parts['model error'] + parts['model error of rotors']
    assert size > parts['model error']  # which is that of the links


@pytest.mark.parametrize(('friction', 'tolerated'), [
    ({'offset': -8.0}, 0.0), ({}, 7.0), ({'coulomb': 20.0, 'load': 0.5}, 0.0),
], ids=['offset', 'torque_tolerance', 'load'])  # fmt: skip
def test_given_torques_that_the_file_allows_then_the_missed_torque_is_bounded(friction, tolerated):
    (arm, gains), rates = FILES['ur10'], np.full(6, 0.1)
    joint = JointFriction(coulomb_slope=1e6, **friction)
    stated = TorqueTolerance((0.0, 0.05, 0.2), (0.0, tolerated, 0.0))
    arm = with_joints(arm, friction=joint, torque_tolerance=stated)
    chain, drive, change = compile_chain(arm), np.array(arm.torque_limit), arm.uncertainty.friction
    true = chain._replace(friction=chain.friction * [*np.full(4, 1.0 + change), 1.0])
    taken, compensated = np.zeros((2, 6))
    # Friction holds a load with a drive that gives all it can.
    drive_friction(true, -rates, drive, taken)
    drive_friction(chain, rates, -drive, compensated)
    missed = np.abs(taken - compensated) + tolerated
    parts = missed_torque(arm, gains.model, 0.0, rates, 0.0)
    bound = parts['dry friction, opposed at every joint'] + parts['torque_tolerance']
    assert 0.9 * bound < np.sqrt((missed**2 / gains.model.inertia).sum()) < (1.0 + 1e-9) * bound


@EACH
def test_given_the_shipped_files_when_verified_or_proved_then_all_inequalities_hold(arm, gains):
    assert all(check.holds for check in gains.verify(arm))
    assert sum(gains.error_bound(arm).values()) == pytest.approx(gains.error.bound, rel=1e-9)
    assert arm.name == 'panda' or all(gains.prove(arm).values())


@EACH
def test_given_random_configurations_then_the_mass_matrix_keeps_its_bounds(arm, gains):
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


@pytest.mark.parametrize('joint', [4, 5])
def test_given_rotors_that_couple_joints_when_verified_then_false_bounds_are_found(joint):
    """M(q) of such an arm falls below what the rotors' inertias alone promise."""
    plain, gains = FILES['ur10']
    one, before = plain.joints[joint], plain.joints[joint - 1]
    coupling = -0.8 * (one.rotor_inertia * before.rotor_inertia) ** 0.5
    arm = with_joints(plain, joint, rotor_coupling=coupling)
    mass = SerialModel(compile_chain(arm)).mass_matrix(np.zeros(6))
    assert 0.0 < np.linalg.eigvalsh(mass)[0] < 0.5 * gains.model.inertia.min()
    checks = replace(gains, arm_sha256=arm.sha256(), checksum='').verify(arm)
    failed = [check.name for check in checks if not check.holds]
    assert any('M(q) >= diag(c)' in name for name in failed)
    assert any('viscous friction' in name for name in failed)


FORGED = {
    0.0: 'sampled.multipliers', 0.8: 'bandwidth', 1.3: 'rate_share', 'none': 'motion.lyapunov',
    0.9: 'model.payload model.damping model.growth error.level error.bound',
    1.6: 'motion.decay sampled.decay', 2.0: 'model.inertia error.acceleration model_error',
}  # fmt: skip


@pytest.mark.parametrize(('by', 'name'), [(by, n) for by in FORGED for n in FORGED[by].split()])
def test_given_forged_numbers_and_checksums_when_verified_then_it_is_told(by, name):
    def forged(value):
        return np.eye(3).ravel().tolist() if by == 'none' else (by * np.array(value)).tolist()

    arm, gains = FILES['ur10']
    other = LoopGains.parse(changed(gains.mapping(), name, forged))
    with pytest.raises(ConfigError, match='the certificate does not hold'):
        replace(other, checksum=other.mapping()['checksum']).require(arm)


def test_given_any_changed_number_when_verified_then_the_checksum_tells(tmp_path):
    arm, gains = FILES['ur10']
    other = replace(gains, rate_share=0.9 * gains.rate_share)  # a weaker claim, true as well
    pytest.raises(ConfigError, other.require, arm).match('numbers are those of the design')
    other.save(tmp_path / 'gains.yaml')
    assert load_certified(tmp_path / 'gains.yaml').rate_share == other.rate_share


@pytest.mark.parametrize('change', [{'lyapunov': [1.0]}, {'decay': -1.0}, {'more': 1.0}])
def test_given_a_damaged_proof_or_none_when_read_then_the_field_is_named(tmp_path, change):
    data = FILES['ur10'][1].mapping()
    with pytest.raises(ConfigError, match=next(iter(change))):
        LoopGains.parse({**data, 'motion': {**data['motion'], **change}})
    with pytest.raises(ConfigError, match='loop.model_error: is missing'):
        LoopGains.parse(changed(data, 'model_error', Missing))
    path = tmp_path / 'gains.yaml'
    path.write_text('/**: {ros__parameters: {bandwidth: 10.0}}\n', encoding='utf-8')
    pytest.raises(ConfigError, load_certified, path).match('no certificate')
