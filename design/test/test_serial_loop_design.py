"""Certificates of serial arms' loops: what is found, what limits it, what is refused."""

from dataclasses import replace

import pytest
from places import BRINGUP

from lpv.cli.main import main
from lpv import ConfigError, load_arm
from lpv.core.serial_arm.certificate.conditions import require_loop
from lpv.core.serial_arm.description import Uncertainty
from lpv_design.serial_loop import LoopRequest, certify_loop, model_bounds
from lpv_design.solve import InfeasibleError


@pytest.fixture(scope='module')
def arm():
    """The first three joints of the UR10, which carry a load at the elbow's end."""
    whole = load_arm(BRINGUP / 'arms' / 'ur10.yaml')
    return replace(whole, name='short', joints=whole.joints[:3], tip=(-0.57, 0.0, 0.0))


@pytest.fixture(scope='module')
def found(arm):
    return certify_loop(arm, LoopRequest())


def test_given_an_arm_when_designed_then_what_is_certified_follows_payload_and_region(arm, found):
    require_loop(arm, found.gains)
    assert any('what limits it' in line for line in found.lines)
    lighter = replace(arm, uncertainty=replace(arm.uncertainty, payload=1.0))
    ratio = model_bounds(lighter).payload / found.gains.model.payload
    assert ratio == pytest.approx(0.5, rel=0.01)
    slow = certify_loop(arm, LoopRequest(rate_share=0.2)).gains
    assert slow.rate_share == 0.2 and slow.motion.decay > found.gains.motion.decay


@pytest.mark.parametrize(
    ('asked', 'payload', 'told'),
    [
        ({'bandwidth': 3.0, 'rate_share': 1.0}, None, 'cannot be certified, .* can'),
        ({}, 500.0, 'payload 500 kg'),
        ({'bandwidth': float('nan')}, None, 'must be'),
        ({'model_error': 0.9}, None, 'must be'),
    ],
)
def test_given_what_cannot_be_certified_when_designed_then_it_is_told(arm, asked, payload, told):
    loaded = replace(arm, uncertainty=Uncertainty(payload=payload)) if payload else arm
    error = ConfigError if told == 'must be' else InfeasibleError
    with pytest.raises(error, match=told):
        certify_loop(loaded, LoopRequest(**asked))


def test_given_the_shipped_gains_when_verified_by_command_then_all_is_told(capsys, refused):
    gains = str(BRINGUP / 'gains' / 'ur10.yaml')
    assert main(['verify', gains]) == 0
    out = capsys.readouterr().out
    assert 'the certificate holds' in out and 'region: every position, joint rates to' in out
    for other in ('panda', 'paper'):
        assert refused('', 'verify', gains, '--arm', other)


def test_given_a_requirement_when_a_serial_arm_is_designed_then_it_is_refused(tmp_path, refused):
    options = '--arm', 'ur10', '--requirement', 'paper', '--out', tmp_path / 'gains.yaml'
    assert refused('--requirement', 'design', *options)
