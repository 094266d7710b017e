"""The arm file of n joints."""

import pytest
import yaml

from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.core.serial_arm.description import JointFriction, LinkInertia
from lpv.core.serial_arm.urdf_chain import read_urdf_chain

pytestmark = pytest.mark.slow

URDF = """<robot name="r"><link name="base"/><link name="a"><inertial><mass value="2"/>
<origin xyz="0.1 0 0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
</link><link name="plate"><inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0"
ixz="0" iyz="0"/></inertial></link><link name="finger"/>
<joint name="turn" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.5"/></joint>
<joint name="bolt" type="fixed"><parent link="a"/><child link="plate"/><origin xyz="1 0 0"/></joint>
<joint name="slide" type="prismatic"><parent link="plate"/><child link="finger"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def urdf(tmp_path):
    path = tmp_path / 'r.urdf'
    path.write_text(URDF)
    return path


def test_given_an_identified_arm_when_saved_and_loaded_then_it_is_the_same(result, tmp_path):
    save_arm(result.arm, tmp_path / 'arm.yaml')
    loaded = load_arm(tmp_path / 'arm.yaml')
    assert loaded == result.arm
    assert loaded.sha256() == result.arm.sha256()


def test_given_a_urdf_when_read_then_fixed_and_locked_links_are_merged(urdf):
    arm = read_urdf_chain(urdf, {'slide': 0.5})
    (joint,) = arm.joints
    assert joint.position == (0.0, 0.0, 0.5)
    assert joint.link.mass == 3.0
    assert joint.link.first_moment == pytest.approx((1.2, 0.0, 0.0))
    assert arm.locked == (('slide', 0.5),)


def test_given_an_arm_file_with_a_urdf_only_when_loaded_then_joints_come_from_it(urdf, tmp_path):
    (tmp_path / 'arm.yaml').write_text(
        yaml.safe_dump(
            {'kind': 'serial_arm', 'name': 'r', 'urdf': 'r.urdf', 'locked': {'slide': 0.0}}
        )
    )
    assert load_arm(tmp_path / 'arm.yaml').joint_names == ('turn',)


def test_given_a_point_mass_when_its_pseudo_inertia_is_formed_then_it_is_physical(arm):
    assert all(joint.link.is_physical() for joint in arm.joints)
    assert not LinkInertia(1.0, (1.0, 0.0, 0.0)).is_physical()


def test_given_falling_friction_when_checked_then_it_may_not_drive_below_the_limit():
    assert JointFriction(viscous=-0.4, coulomb=1.0).is_dissipative(2.0)
    assert not JointFriction(viscous=-0.6, coulomb=1.0).is_dissipative(2.0)
