"""The falsifier of serial arms: attacks within the file, a search, files that repeat."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_campaign.falsify.result_files import BAG, SCENARIO, read_attack, repeat, write_worst
from lpv_campaign.falsify.search import search
from lpv_campaign.falsify.serial import SerialAttacker
from lpv_cli.main import main
from lpv_core.serial_arm.arm_file import load_serial_arm, save_serial_arm
from lpv_core.serial_arm.description import Uncertainty
from lpv_core.support.errors import ConfigError
from lpv_core.support.resources import bringup_file


@pytest.fixture(scope='module')
def ur10():
    return replace(
        load_serial_arm(bringup_file('arms', 'ur10')), uncertainty=Uncertainty(2.0, 0.1, 0.05)
    )


@pytest.mark.slow
def test_given_any_candidate_when_made_an_attack_then_it_is_within_the_arm_file(ur10):
    attacker, rng = SerialAttacker(ur10, 0.5), np.random.default_rng(3)
    for _ in range(5):
        attack = attacker.attack(rng.uniform(-1.5, 1.5, attacker.numbers), 1)
        centre, swing, speed = np.array(attack.course)[:3]
        lower = [max(joint.limits.lower, -np.pi) for joint in ur10.joints]
        assert np.all(centre - swing >= np.array(lower) - 1e-9)
        assert np.all(swing * speed <= ur10.velocity_limit)
        assert np.abs(attack.shares).max() <= 1.0


@pytest.mark.slow
def test_given_a_short_search_when_run_then_it_comes_near_and_never_across(ur10):
    worst = search(SerialAttacker(ur10, 2.0), 20)
    assert 0.4 < worst.ratio < 1.0
    assert worst.threshold < 1.5


@pytest.mark.slow
def test_given_a_monitor_that_is_told_too_little_when_searched_then_it_is_crossed(ur10):
    told = replace(ur10, uncertainty=Uncertainty(0.2, 0.05, 0.01))
    assert search(SerialAttacker(ur10, 2.0, told), 8).ratio > 1.0


@pytest.mark.slow
def test_given_a_worst_run_when_written_then_the_command_repeats_it_bit_by_bit(
    ur10, tmp_path, capsys
):
    attacker = SerialAttacker(ur10, 0.6)
    worst = search(attacker, 3)
    write_worst(attacker, worst, tmp_path)
    attack, duration = read_attack(tmp_path / SCENARIO)
    assert repeat(SerialAttacker(ur10, duration), attack, tmp_path).ratio == worst.ratio
    assert (tmp_path / BAG / 'metadata.yaml').is_file()
    save_serial_arm(ur10, tmp_path / 'arm.yaml')
    options = ['--arm', str(tmp_path / 'arm.yaml'), '--repeat', str(tmp_path / SCENARIO)]
    assert main(['falsify', *options]) == 0
    assert 'no crossing in 1 runs' in capsys.readouterr().out


def test_given_an_arm_that_states_nothing_when_attacked_then_that_is_said(ur10):
    with pytest.raises(ConfigError, match='model_error'):
        SerialAttacker(replace(ur10, uncertainty=Uncertainty()), 1.0)


def test_given_an_attack_on_another_arm_when_repeated_then_it_is_refused(ur10, tmp_path):
    attacker = SerialAttacker(ur10, 0.5)
    with pytest.raises(ConfigError, match='attack'):
        repeat(attacker, {'course': [[0.0]], 'rest': 1.0}, tmp_path)
