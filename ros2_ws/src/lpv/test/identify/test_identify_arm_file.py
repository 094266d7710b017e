"""The arm file of n joints."""

import pytest
from simulated_recordings import is_physical

from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.core.serial_arm.description import JointFriction, LinkInertia

pytestmark = pytest.mark.slow


def test_given_an_identified_arm_when_saved_and_loaded_then_it_is_the_same(result, tmp_path):
    save_arm(result.arm, tmp_path / 'arm.yaml')
    loaded = load_arm(tmp_path / 'arm.yaml')
    assert loaded == result.arm
    assert loaded.sha256() == result.arm.sha256()


def test_given_a_point_mass_when_its_pseudo_inertia_is_formed_then_it_is_physical(arm):
    assert all(is_physical(joint.link) for joint in arm.joints)
    assert not is_physical(LinkInertia(1.0, (1.0, 0.0, 0.0)))


def test_given_falling_friction_when_checked_then_it_may_not_drive_below_the_limit():
    assert JointFriction(viscous=-0.4, coulomb=1.0).is_dissipative(2.0)
    assert not JointFriction(viscous=-0.6, coulomb=1.0).is_dissipative(2.0)
