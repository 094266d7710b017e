from dataclasses import asdict, replace

import numpy as np
import pytest
from fault_injection import with_joints, with_sensors

from lpv import ConfigError, load_arm
from lpv.campaign.falsify.attack import Attacker, effort_of
from lpv.campaign.falsify.healthy_run import CENTRE, PHASE, PUSH, RATE_SCALE, SPEED, SWING
from lpv.campaign.falsify.search import BAG, SCENARIO, read_attack, repeat, search, write_worst
from lpv.core.serial_arm.arm_file import save_arm
from lpv.core.serial_arm.description import TorqueTolerance, Uncertainty
from lpv.core.serial_arm.diagnosis.estimator import STRAIGHT
from lpv.core.serial_arm.diagnosis.healthy_set import offsets_beside
from lpv.core.support.config import read_yaml
from lpv.core.uio.planar import planar_model
from lpv.identify.sensors import noise_deviation

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def ur10():
    return replace(load_arm('ur10'), uncertainty=Uncertainty(2.0, 0.1, 0.05))


def attacks(attacker, count):
    rng = np.random.default_rng(3)
    return [attacker.attack(rng.uniform(-1.5, 1.5, attacker.numbers), k) for k in range(count)]


def test_given_any_candidate_when_made_an_attack_then_it_is_within_the_arm_file(arm, gains_of):
    attacker, planar = Attacker(arm, 1.0, gains_of[arm.name]), planar_model(arm)
    center = planar.zero_angle - (0.0 if planar.sign > 0 else np.pi)
    for attack in attacks(attacker, 50):
        rows = np.array(attack.joints)
        assert np.abs(attack.shares).max() <= 1.0
        away = np.abs(rows[CENTRE] + center)
        assert np.all(away + rows[SWING] <= np.arccos(planar.cos_min))
        assert (rows[SWING] * rows[SPEED]).sum() <= 0.5 * min(arm.velocity_limit) + 1e-12
        assert abs(attack.disturbance) <= abs(planar.disturbance_mean)
        assert np.all(np.abs(rows[RATE_SCALE]) <= planar.velocity_error)


def test_given_a_nominal_healthy_run_when_simulated_then_samples_obey_the_file(arm, gains_of):
    """Readings follow the motion; rates are their derivative, but for noise and stated errors."""
    attacker = Attacker(arm, 2.0, gains_of[arm.name])
    assert attacker.simulate(attacker.attack(np.zeros(attacker.numbers), 1))
    position, rate = attacker.samples[:, 0], attacker.samples[:, 1]
    slope = np.gradient(position, arm.sample_time, axis=0)
    mean = [np.convolve(column, np.ones(50) / 50, 'valid') for column in (slope - rate).T]
    noise = arm.joints[0].sensors.position_noise / (50 * arm.sample_time)
    assert np.abs(mean).max() < 0.1 + 2.0 * noise


def test_given_sensors_of_sums_when_simulated_then_each_has_its_stated_noise(paper_arm):
    attacker = Attacker(paper_arm, 4.0)
    assert attacker.simulate(attacker.attack(np.zeros(attacker.numbers), 1))
    readings = attacker.samples[:, 0] @ paper_arm.joints_to_sensors().T
    stated = [joint.sensors.position_noise for joint in paper_arm.joints]
    assert noise_deviation([readings]) == pytest.approx(stated, rel=0.1)


def test_given_efforts_in_amperes_when_simulated_then_they_are_measured_so(ur10):
    both = Attacker(ur10, 0.2), Attacker(with_joints(ur10, torque_gain=4.0), 0.2)
    torque, current = (one.samples[:, 2] for one in both)
    assert all(one.simulate(one.attack(np.zeros(one.numbers), 1)) for one in both)
    assert torque.any() and current * 4.0 == pytest.approx(torque)


def test_given_a_serial_arm_when_attacked_then_only_a_monitor_told_too_little_is_crossed(ur10):
    lower = np.array([max(joint.limits.lower, -np.pi) for joint in ur10.joints])
    for attack in attacks(Attacker(ur10, 0.5), 5):
        rows = np.array(attack.joints)
        assert np.all(rows[CENTRE] - rows[SWING] >= lower - 1e-9)
        assert np.all(rows[SWING] * rows[SPEED] <= ur10.velocity_limit)
        assert np.abs(attack.shares).max() <= 1.0
        assert np.abs(attack.offsets).max() <= STRAIGHT and 0.0 in attack.offsets
    # A search comes near and never across, unless the monitor is told too little.
    worst = search(Attacker(ur10, 2.0), 20)[0]
    assert 0.4 < worst.ratio < 1.0 and worst.thresholds[worst.sensor] < 1.5
    told = replace(ur10, uncertainty=Uncertainty(0.2, 0.05, 0.01))
    assert search(Attacker(ur10, 2.0, monitored=told), 24)[0].ratio > 1.0


@pytest.mark.parametrize('payload', [2.0, 20.0])
def test_given_any_load_when_attacked_then_offsets_beside_have_the_sum_that_thresholds_hold(
    ur10, payload
):
    arm = replace(ur10, uncertainty=Uncertainty(payload, 0.1, 0.05))
    sums = [np.abs(attack.offsets).sum() for attack in attacks(Attacker(arm, 0.2), 10)]
    assert 0.05 < max(sums) <= offsets_beside(arm)[0] + 1e-9


def three_joints(**changes):
    """The UR10's first joints, their model exact but for what a test says."""
    arm = with_joints(load_arm('ur10'), **changes)
    return replace(arm, joints=arm.joints[:3], uncertainty=Uncertainty(0.0, 0.0, 0.0))


LATE, TOLERANT = {'effort_delay': 0.02}, {'torque_tolerance': TorqueTolerance((0, 0.5), (2, 10))}


@pytest.mark.parametrize('stated', [LATE, TOLERANT])
def test_given_late_efforts_or_missed_torques_when_searched_then_they_are_tried(stated):
    arm, told = three_joints(**stated), three_joints()
    assert search(Attacker(arm, 2.0, monitored=told), 24)[0].ratio > 1.0
    assert 0.5 < search(Attacker(arm, 2.0), 24)[0].ratio < 1.0


def test_given_efforts_that_are_late_when_joints_brake_then_thresholds_hold_before_they_tell():
    """Such efforts show the torque of the last balances when these are long complete."""
    attacker = Attacker(three_joints(effort_delay=0.05), 0.6)
    attack = attacker.attack(np.zeros(attacker.numbers), 1)
    attack.joints[CENTRE], attack.joints[PHASE] = [0.6, 2.8, 2.9], [2.0, -0.6, -2.3]
    attack.joints[SWING], attack.joints[SPEED] = [0.7, 0.17, 0.14], [1.6, 1.8, 0.4]
    late = [1.0] * attacker.range.count
    assert 0.5 < attacker.run(replace(attack, rest=0.48, shares=late, signs=[])).ratio < 1.0


@pytest.mark.parametrize(('lost', 'seed'), [(3, 0), (4, 1), (6, 1)])
def test_given_lost_samples_when_joints_move_then_thresholds_hold_what_they_hide(lost, seed):
    attacker = Attacker(replace(three_joints(), sample_time=0.02), 1.0)
    attack = attacker.attack(np.zeros(attacker.numbers), seed)
    attack.joints[CENTRE], attack.joints[PHASE] = [1.2, 2.1, -0.9], [0.7, -1.6, -2.5]
    attack.joints[SWING], attack.joints[SPEED] = [1.3, 0.8, 1.4], [1.1, 1.8, 1.6]
    nominal = replace(attack, rest=9.0, shares=[0.0] * attacker.range.count, signs=[], lost=lost)
    found = attacker.run(nominal)
    assert 0.5 < found.ratio < 1.0 and found.thresholds[found.sensor] < 0.8
    stamps, samples = attacker.received(nominal)
    assert len(stamps) == len(samples) < 0.9 * len(attacker.samples)


def test_given_efforts_of_a_motion_when_delayed_then_they_are_as_late_as_said():
    at = 0.01 * np.arange(3000)
    means = np.sin(at - 0.005)  # of a sample each
    for late in (-1.5, 0.5, 4.0):
        error = effort_of(means, late, 0.0) - np.sin(at - 0.01 * late)
        assert np.abs(error[20:-20]).max() < 1e-4
    assert effort_of(means, 0.5, 100.0)[-1000:].max() == pytest.approx(0.5**0.5, rel=0.02)


def test_given_joints_at_rest_then_friction_takes_up_to_coulombs_of_either_sign():
    arm = three_joints()
    attacker = Attacker(arm, 1.0)
    attack = attacker.attack(np.zeros(attacker.numbers), 1)
    attack.joints[SWING] = [0.0, 0.0, 0.0]
    efforts = []
    for share in (0.0, 1.0, -1.0):
        attack.joints[PUSH] = [share] * 3
        assert attacker.simulate(replace(attack, switch_speed=0.0, signs=[]))
        efforts.append(attacker.samples[-1, 2].copy())
    friction = [joint.friction for joint in arm.joints]
    dry = [one.coulomb + one.load * abs(held) for one, held in zip(friction, efforts[0])]
    assert efforts[0] - efforts[1] == pytest.approx(dry, rel=1e-3)
    assert efforts[2] - efforts[0] == pytest.approx(dry, rel=1e-3)


def test_given_a_short_search_when_run_then_it_comes_near_and_never_across(arm, gains_of):
    found = search(Attacker(arm, 3.0, gains_of[arm.name]), 60)
    assert len(found) == 60 and found == sorted(found, key=lambda one: -one.ratio)
    assert 0.4 < found[0].ratio < 1.0 and not any(one.blamed for one in found)


def test_given_an_arm_whose_horizon_knows_little_then_its_designed_bounds_are_judged(
    real_arm, real_gains
):
    attacker = Attacker(real_arm, 0.2, real_gains)
    finding = attacker.run(attacker.attack(np.zeros(attacker.numbers), 1))
    assert np.all((finding.ratios > 0.0) & (finding.ratios < 1.0))


def planar_attacker(arm, gains, duration, velocity_error=0.0, **changes):
    """Attacker of a planar arm that is its model, without disturbance and, nearly, noise."""
    lpv = replace(arm.lpv, disturbance_mean=0.0, disturbance_variance=0.0)
    lpv = replace(lpv, velocity_error=velocity_error)
    arm = with_sensors(arm, position_noise=1e-6, velocity_noise=1e-5)
    arm = replace(arm, lpv=lpv, uncertainty=Uncertainty(model_error=0.0), **changes)
    quiet = replace(gains.observer, fault_sigma=np.full(2, 1e-6))
    hashed = planar_model(arm).sha256()
    return Attacker(arm, duration, replace(gains, arm_sha256=hashed, observer=quiet))


def test_given_fast_motion_between_few_samples_then_bounds_cover_it(paper_arm, paper_gains):
    attacker = planar_attacker(paper_arm, paper_gains, 3.0, sample_time=0.01)
    for phase in (-0.5, 0.0, 0.5):
        candidate = np.zeros(attacker.numbers)
        candidate[2:6], candidate[7], candidate[8] = 0.9, phase, 1.0
        found = attacker.run(attacker.attack(candidate, 1))
        assert 0.1 < found.ratio < 1.0 and found.thresholds.max() < 0.02


def test_given_rates_that_read_too_little_when_an_arm_moves_at_the_start_then_its_bound_holds(
    real_arm, real_gains
):
    attacker = planar_attacker(real_arm, real_gains, 2.1, velocity_error=0.015)
    attack = attacker.attack(np.zeros(attacker.numbers), 1)
    for centre, swing, speed, phase in (
        ((-0.53, 1.01), (0.79, 0.26), (0.84, 0.58), (0.1, -3.1)),
        ((-0.52, 1.03), (0.69, 0.24), (0.91, 1.89), (0.13, -2.4)),
    ):
        attack.joints[CENTRE], attack.joints[SWING] = list(centre), list(swing)
        attack.joints[SPEED], attack.joints[PHASE] = list(speed), list(phase)
        attack.joints[RATE_SCALE] = [-0.015, -0.015]
        least = [-1.0] * attacker.range.count
        found = attacker.run(replace(attack, rest=9.0, switch_speed=0.0, shares=least))
        assert 0.9 < found.ratio < 1.0


@pytest.mark.parametrize('lost', [4, 6, 10])
def test_given_lost_samples_when_a_planar_arm_moves_then_the_set_holds_what_they_hide(
    lost, paper_arm, paper_gains
):
    attacker = planar_attacker(paper_arm, paper_gains, 2.0)
    attack = attacker.attack(np.zeros(attacker.numbers), 2)
    attack.joints[CENTRE], attack.joints[PHASE] = [1.876, 2.523], [-0.252, -1.34]
    attack.joints[SWING], attack.joints[SPEED] = [0.847, 0.222], [0.525, 8.0]
    found = attacker.run(replace(attack, rest=9.0, lost=lost))
    assert 0.5 < found.ratio < 1.0 and found.thresholds[found.sensor] < 0.01


@pytest.mark.parametrize('serial', [False, True])
def test_given_a_worst_run_when_written_then_the_command_repeats_it_bit_by_bit(
    serial, ur10, paper_arm, paper_gains, tmp_path, call, refused, monkeypatch
):
    arm, gains = (ur10, None) if serial else (paper_arm, paper_gains)
    attacker = Attacker(arm, 0.6, gains)
    worst = search(attacker, 3)[0]
    write_worst(attacker, worst, tmp_path)
    attack, duration = read_attack(tmp_path / SCENARIO)
    again = repeat(Attacker(arm, duration, gains), attack, tmp_path)
    assert again.ratio == worst.ratio and asdict(again.attack) == asdict(worst.attack)
    assert (tmp_path / BAG / 'metadata.yaml').is_file()
    save_arm(arm, tmp_path / 'arm.yaml')
    options = ['--arm', tmp_path / 'arm.yaml', *([] if serial else ['--gains', 'paper'])]
    said = call('falsify', *options, '--repeat', tmp_path / SCENARIO).out
    assert f'reached {worst.ratio:.3f} of its threshold' in said
    # Another search would be lost in the end.
    assert refused('worst run of another search', 'falsify', *options, '--out', tmp_path)
    monkeypatch.setattr('lpv.cli.commands.falsify.search', None)
    assert refused('File exists', 'falsify', *options, '--out', tmp_path / 'arm.yaml')


def test_given_a_search_when_interrupted_then_its_worst_run_is_written(tmp_path, call, monkeypatch):
    run, runs = Attacker.run, []

    def stopped(attacker, attack):
        runs.append(run(attacker, attack))
        if len(runs) == 3:
            raise KeyboardInterrupt
        return runs[-1]

    monkeypatch.setattr(Attacker, 'run', stopped)
    words = ['--arm', 'paper', '--gains', 'paper', '--duration', 0.6, '--out', tmp_path]
    said = call('falsify', *words, code=130)
    assert 'in 2 runs' in said.out and said.err.endswith('interrupted\n')
    assert read_yaml(tmp_path / SCENARIO)['ratio'] == max(one.ratio for one in runs[:2])
    assert (tmp_path / BAG / 'metadata.yaml').is_file()


def test_given_no_attack_or_guarantee_then_refused(tmp_path, ur10, paper_arm, paper_gains, refused):
    attacker, path = Attacker(paper_arm, 1.0, paper_gains), tmp_path / 'a.yaml'
    for attack in ('3', '{joints: x}', '{joints: [[0.0]], rest: 1.0}', ''):
        path.write_text(f'{{duration: 1.0, attack: {attack}}}' if attack else '{}')
        with pytest.raises(ConfigError, match='attack'):
            repeat(attacker, read_attack(path)[0], path)
    for one in (ur10, paper_arm):
        with pytest.raises(ConfigError, match='model_error'):
            Attacker(replace(one, uncertainty=Uncertainty()), 1.0)
    told = 'ur10: lpv: is missing: gains are designed for its region'
    assert refused(told, 'falsify', '--arm', 'ur10', '--gains', 'paper')
