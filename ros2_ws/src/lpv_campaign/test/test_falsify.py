"""The falsifier: attacks within the arm file, a search, files that repeat."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_campaign.falsify.attack import NUMBERS, attack_as_dict, attack_from_dict, make_attack
from lpv_campaign.falsify.result_files import BAG, SCENARIO, read_attack, repeat, write_worst
from lpv_campaign.falsify.search import search
from lpv_campaign.falsify.two_link import TwoLinkAttacker
from lpv_core.support.errors import ConfigError

pytestmark = pytest.mark.slow


def test_given_any_candidate_when_made_an_attack_then_it_is_within_the_arm_file(arm):
    rng = np.random.default_rng(3)
    nominal = arm.constants()
    for _ in range(50):
        attack = make_attack(arm, rng.uniform(-1.5, 1.5, len(NUMBERS)), 1)
        reach = np.arccos(arm.cos_min)
        middle = 0.0 if arm.sign > 0 else np.pi
        assert np.all(np.abs(attack.centre - middle) + attack.swing <= reach)
        assert abs(attack.disturbance) <= abs(arm.disturbance_mean)
        assert np.all(np.abs(attack.rate_scale) <= arm.velocity_error)
        most = 1.0 + arm.model_error + 1e-9
        assert np.all(attack.true_arm.gravity <= most * nominal.gravity)


def test_given_an_attack_when_stored_and_read_then_it_is_the_same(paper_arm):
    attack = make_attack(paper_arm, np.linspace(-1.0, 1.0, len(NUMBERS)), 5)
    assert attack_from_dict(attack_as_dict(attack)) == attack


def test_given_a_short_search_when_run_then_it_comes_near_and_never_across(arm, gains_of):
    attacker = TwoLinkAttacker(arm, gains_of[arm.name], 4.0)
    worst = search(attacker, 150)
    assert 0.45 < worst.ratio < 1.0


def test_given_an_arm_beyond_its_file_when_searched_then_the_threshold_is_crossed(
    paper_arm, paper_gains
):
    """The search finds what is there to be found: the bound of one arm, a worse one simulated."""
    attacker = TwoLinkAttacker(paper_arm, paper_gains, 4.0)
    attacker.arm = replace(paper_arm, model_error=0.2, disturbance_mean=1.0)
    assert search(attacker, 100).ratio > 1.0


def test_given_a_worst_run_when_written_then_it_repeats_bit_by_bit(
    paper_arm, paper_gains, tmp_path
):
    attacker = TwoLinkAttacker(paper_arm, paper_gains, 1.0)
    worst = search(attacker, 5)
    write_worst(attacker, worst, tmp_path)
    attack, duration = read_attack(tmp_path / SCENARIO)
    again = TwoLinkAttacker(paper_arm, paper_gains, duration)
    assert repeat(again, attack, tmp_path).ratio == worst.ratio
    assert (tmp_path / BAG / 'metadata.yaml').is_file()


@pytest.mark.parametrize('text', ['{}', 'attack: 3', 'attack: {centre: x}'])
def test_given_no_attack_when_read_then_it_is_refused_by_name(
    tmp_path, text, paper_arm, paper_gains
):
    path = tmp_path / 'a.yaml'
    path.write_text(f'duration: 1.0\n{text}' if 'attack' in text else text)
    with pytest.raises(ConfigError, match='attack'):
        repeat(TwoLinkAttacker(paper_arm, paper_gains, 1.0), read_attack(path)[0], path)
