from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from fault_injection import with_joints
from fuzzing import bounded_memory, fuzz, mutate_text, mutate_xml
from serial_arms import URDF, shoulder_arm

from lpv import ConfigError, load_arm
from lpv.core.serial_arm.arm_file import parse_arm, save_arm, to_mapping
from lpv.core.serial_arm.chain import compile_chain
from lpv.core.serial_arm.description import LinkInertia
from lpv.core.serial_arm.dynamics.kinematics import forward_kinematics
from lpv.core.serial_arm.dynamics.model import SerialModel
from lpv.core.serial_arm.urdf_chain import read_urdf_chain

END, LOCKED = '</robot>', {'finger': 0.0}
BOMB = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">' + ''.join(
    f'<!ENTITY {new} "{10 * f"&{old};"}">' for old, new in zip('abcdefgh', 'bcdefghi')
) + ']>'  # fmt: skip
JOINT = '<joint name="j{0}" type="{1}"><parent link="l{0}"/><child link="l{2}"/>{3}</joint>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def assert_same_torques(arm, added):
    """The arm's torques are those of Pinocchio, which holds the same joints of the URDF."""
    full = pinocchio.buildModelFromXML(URDF.replace(END, added))
    places, held = pinocchio.neutral(full), [full.getJointId(name) for name, _ in arm.locked]
    for joint, (_, angle) in zip(held, arm.locked):
        if full.joints[joint].nq == 1:  # a continuous one has cosine and sine
            places[full.joints[joint].idx_q] = angle
    model = pinocchio.buildReducedModel(full, held, places)
    rng, ours, data = np.random.default_rng(1), SerialModel(compile_chain(arm)), model.createData()
    for _ in range(20):
        q, v, a = rng.uniform(-1.5, 1.5, (3, ours.joints))
        expected = pinocchio.rnea(model, data, q, v, a)
        np.testing.assert_allclose(ours.inverse_dynamics(q, v, a), expected, rtol=0, atol=1e-10)


@pytest.fixture
def small(tmp_path):
    """Reads the URDF, changed or with something before its end; the finger is locked."""

    def read(old=END, new=END, locked=LOCKED, tip=None):
        assert old in URDF
        (tmp_path / 'small.urdf').write_text(URDF.replace(old, new))
        return read_urdf_chain(tmp_path / 'small.urdf', locked=locked, tip=tip)

    return read


def test_gripper_is_locked_where_it_was_told_and_axes_point_anywhere(small, tmp_path):
    found, full = small(locked={'finger': 0.03}), pinocchio.buildModelFromXML(URDF)
    assert (found.joint_names, found.locked) == (('a', 'b'), (('finger', 0.03),))
    assert_same_torques(found, END)
    data, q = full.createData(), np.array([0.4, -0.3, 0.03])
    pinocchio.framesForwardKinematics(full, data, q)
    expected = data.oMf[full.getFrameId('left')].translation
    tip = forward_kinematics(compile_chain(found), q[:2])[1]
    np.testing.assert_allclose(tip, expected, atol=1e-12)
    # A file of the arm that names the URDF alone has its joints.
    text = '{name: small, urdf: small.urdf, locked: {finger: 0.03}}'
    (tmp_path / 'arm.yaml').write_text(text)
    arm = load_arm(tmp_path / 'arm.yaml')
    assert (arm.joints, arm.locked) == (found.joints, found.locked)
    # What it says of a limit leaves the others.
    limits = (3.0, '{torque: 20.0}'), (2.0, '{velocity: 2.0}'), (3.0, '{lower: 1.0}')
    for velocity, said in limits:
        joints = f', joints: [{{name: a, limits: {said}}}, {{name: b}}]}}'
        (tmp_path / 'arm.yaml').write_text(text[:-1] + joints)
        limit = load_arm(tmp_path / 'arm.yaml').joints[0].limits
        assert (limit.upper, limit.velocity) == (2.0, velocity)
    (tmp_path / 'arm.yaml').write_text(text[:-1] + joints.replace('1.0', '2.0'))
    with pytest.raises(ConfigError, match=r'limits.lower: must be below 2.0'):
        load_arm(tmp_path / 'arm.yaml')
    # An axis goes with a position: that of the URDF is in another frame.
    (tmp_path / 'arm.yaml').write_text(text[:-1] + ', joints: [{name: a, axis: [0, 0, 1]}]}')
    with pytest.raises(ConfigError, match=r'joints\[0\].position: is missing'):
        load_arm(tmp_path / 'arm.yaml')


@pytest.mark.parametrize(('held', 'unit'), [({'finger': 20.0}, 'mill'), ({'a': 90.0}, 'degrees')])
def test_given_joints_held_in_degrees_or_mm_when_read_then_they_are_refused(small, held, unit):
    with pytest.raises(ConfigError, match=rf'is held at .* beyond its limits: {unit}'):
        small(locked=LOCKED | held)


def test_friction_of_the_urdf_counts_where_the_file_of_the_arm_says_none(small, tmp_path):
    joint = '<joint name="a" type="revolute">'
    found = small(joint, f'{joint}<dynamics damping="0.5" friction="2"/>')
    assert [(j.friction.viscous, j.friction.coulomb) for j in found.joints] == [(0.5, 2.0), (0, 0)]
    for said, viscous in (('', 0.5), (', friction: {viscous: 0.1}', 0.1)):
        text = f'{{name: a, urdf: small.urdf, joints: [{{name: a{said}}}, {{name: b}}], '
        (tmp_path / 'arm.yaml').write_text(f'{text}locked: {{finger: 0.0}}}}')
        assert load_arm(tmp_path / 'arm.yaml').joints[0].friction.viscous == viscous


def test_limits_that_stand_for_none_are_none(small):
    text = 'lower="-1" upper="2"', 'lower="-1e16" upper="1e16"'
    limits = small(*text).joints[0].limits
    assert (limits.lower, limits.upper) == (-np.inf, np.inf)


def test_given_a_urdf_in_place_of_an_arm_file_then_it_is_said_what_makes_one_of_it(small, tmp_path):
    small()
    with pytest.raises(ConfigError, match='small.urdf: arm: is a URDF: lpv init --urdf makes'):
        load_arm(tmp_path / 'small.urdf')


def test_base_on_the_wall_turns_gravity_and_a_fixed_joint_before_the_base_the_arm(small):
    chain = compile_chain(replace(small(), base_orientation=(0.0, np.pi / 2, 0.0)))
    np.testing.assert_allclose(chain.gravity, [9.81, 0.0, 0.0], atol=1e-12)
    world = """<link name="world"/><joint name="bolted" type="fixed"><parent link="world"/>
    <child link="base"/><origin xyz="1 2 3" rpy="0.7 -2.0 1.1"/></joint></robot>"""
    assert_same_torques(small(new=world), world)


DRIVES = """<ros2_control name="driver" type="system">
  <hardware><plugin>ur_robot_driver/URPositionHardwareInterface</plugin></hardware>
  <joint name="a"><command_interface name="position"><param name="min">{-6.28}</param>
    </command_interface><state_interface name="position"/></joint>
  <joint name="b"><state_interface name="effort"/></joint><link name="gpio" value="nan"/>
</ros2_control>
<transmission name="a_trans"><type>transmission_interface/SimpleTransmission</type>
  <joint name="a"><hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>
  </joint><actuator name="motor"><mechanicalReduction>101</mechanicalReduction></actuator>
</transmission><gazebo reference="one"><material>Grey</material></gazebo>
<material name="grey"><color rgba="1 1 1 1"/></material></robot>"""
BRANCH = """<link name="camera"><inertial><mass value="0.7"/><inertia ixx="0.01" ixy="0" ixz="0"
  iyy="0.01" iyz="0" izz="0.01"/></inertial></link><link name="right"/>
<joint name="pan" type="continuous"><parent link="one"/><child link="camera"/>
  <origin xyz="0 0.3 0"/><axis xyz="0 0 1"/></joint>
<link name="far"/><joint name="next" type="continuous"><parent link="right"/><child link="far"/>
  <mimic joint="other" multiplier="3"/></joint>
<joint name="other" type="prismatic"><parent link="tool"/><child link="right"/>
  <axis xyz="0 -1 0"/><mimic joint="finger" multiplier="-2" offset="0.01"/>
  <limit lower="-1" upper="1" velocity="1" effort="5"/></joint></robot>"""
B, MOUNT = '<joint name="b" type="revolute">', '</joint>\n<joint name="mount"'
NO_ARM = {
    r"'b' follows 'a' .*held \(--lock a\)": (MOUNT, f'<mimic joint="a"/>{MOUNT}'),
    "'b': multiplier": (MOUNT, f'<mimic joint="a" offset="1e99"/>{MOUNT}'),
    "'b' is floating": (B, B.replace('revolute', 'floating')),
    "'b' is planar": (B, B.replace('revolute', 'planar')),
    r"'a' has no lower limit below .*\(continuous joints": ('lower="-1" upper="2"', ''),
    "'a' has no lower limit": ('lower="-1" upper="2"', 'lower="2" upper="-1"'),
    "'pan' follows 'a'": (END, BRANCH.replace('<axis', '<mimic joint="a"/><axis'), {}, 'tool'),
    'mass element; .*Link .one': ('<mass value="3"/>', ''),
    r'400\.2 m: .* are these millimetres\?': ('xyz="0.4 0 0"', 'xyz="400 0 0"'),
    r'1\d\d\.\d m: .*centres of mass': ('xyz="0 0.2 0"', 'xyz="0 200 0"'),
    'missing ixy .*Link .one': ('ixy="0.001"', ''),
    'found 2 elements .*Link .two': ('<origin xyz="0 0.2 0"/>', '<origin xyz="0 0.2"/>'),
    "'pan' .* name the link at": (END, BRANCH, {'finger': 0.02}),
    'xacro:hand: expand it first, by xacro FILE': (END, f'<xacro:hand parent="two"/>{END}'),
    "no link 'hand'": (END, BRANCH, {}, 'hand'),
}


def test_drives_are_no_joints_the_tip_names_the_branch_and_locks_hold_what_follows(small):
    plain = small()
    assert replace(small(new=DRIVES), urdf=plain.urdf) == plain
    found = small(new=BRANCH, locked={'finger': 0.02}, tip='tool')
    assert found.joint_names == ('a', 'b')
    held = {'finger': 0.02, 'next': -0.09, 'other': -0.03, 'pan': 0.0}
    assert dict(found.locked) == pytest.approx(held)
    assert_same_torques(found, BRANCH)
    assert small(new=BRANCH, locked={}, tip='camera').joint_names == ('a', 'pan')
    for number in range(12):
        numbered = BRANCH.replace('"pan"', f'"{number}"')
        assert small(new=numbered, locked={}, tip='tool').joint_names == ('a', 'b')


@pytest.mark.parametrize('reason', NO_ARM)
def test_joints_that_no_arm_has_are_refused_by_name(small, reason):
    pytest.raises(ConfigError, small, *NO_ARM[reason]).match(reason)


@pytest.mark.parametrize('mass', [0.0, 0.081])
def test_given_a_joint_that_moves_no_mass_off_its_axis_then_its_file_is_refused(mass):
    point = LinkInertia.from_vector(np.array([mass, *np.zeros(9)]))
    arm = with_joints(shoulder_arm(), 2, link=point, rotor_inertia=0.0)
    with pytest.raises(ConfigError, match=r'joints\[2\].link: joint3 moves no mass'):
        parse_arm(to_mapping(arm))


def torques_of(arm):
    """The arm's torques in a motion; whatever in its description is not finite but a limit."""
    model, n = SerialModel(compile_chain(arm)), len(arm.joints)
    q, v, a = (np.full(n, value) for value in (0.3, 1.0, 2.0))
    torque = model.torque(q, v, a)
    numbers = [[getattr(j, name) for name in vars(j) if name != 'limits'] for j in arm.joints]
    return {'arm': numbers, 'torque': torque, 'parameters': arm.parameter_vector()}


@pytest.mark.fuzz
@pytest.mark.parametrize('kind', ['yaml', 'urdf'])
def test_given_mutated_files_then_torques_are_finite_or_why_not_is_said(tmp_path, kind):
    path = tmp_path / 'arm.yaml'
    save_arm(shoulder_arm(), path)
    torques_of(load_arm(path))  # what compiles takes its time
    text, mutate, read = path.read_text(), mutate_text, load_arm
    if kind == 'urdf':
        path, text, mutate, read = tmp_path / 'arm.urdf', URDF, mutate_xml, read_urdf_chain

    def write(seed):
        path.write_bytes(mutate(text, seed))

    assert fuzz(60, write, lambda: torques_of(read(path))).refused


def deep(count, kind='fixed'):
    links = ''.join(f'<link name="l{i}"/>' for i in range(count + 1))
    joints = ''.join(JOINT.format(i, kind, i + 1, LIMIT) for i in range(count))
    return f'<robot name="r">{links}{joints}</robot>'


HOSTILE = [
    *(('urdf: is not plain XML .a document type', text) for text in (
        BOMB + '<robot name="&i;"><link name="l0"/></robot>',
        BOMB + URDF.replace('name="small"', 'name="&i;"'),
        '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
        '<robot name="r">&x;<link name="l0"/></robot>',
    )),
    ('nested more than 50 deep', f'<robot name="r">{100_000 * "<a>"}{100_000 * "</a>"}</robot>'),
    ('has 20001 links', deep(20_000)),
    ('has 60 joints that move', deep(60, 'revolute')),
    ("'l1' is the child of two", deep(3).replace('<child link="l3"/>', '<child link="l1"/>')),
    ("'l0' is in a loop", deep(1).replace('<child link="l1"/>', '<child link="l0"/>')),
    ("'a' has an axis without", URDF.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>')),
    ("'one': ixx must be", URDF.replace('ixx="0.02"', 'ixx="nan"')),
    ("'a': lower must be", URDF.replace('lower="-1"', 'lower="nan"')),
    ("'one': value must be", URDF.replace('<mass value="3"/>', '<mass value="1e308"/>')),
    ("'one': mass must not be", URDF.replace('<mass value="3"/>', '<mass value="-3"/>')),
    *(("'b': xyz must be", URDF.replace('xyz="0.4 0', f'xyz="{x} 0')) for x in (1e200, 'nan')),
    ("'b': rpy must be at most 6.3", URDF.replace('xyz="0.4 0 0"', 'xyz="0.4 0 0" rpy="90 0 0"')),
]  # fmt: skip
"""Why a URDF is refused, and what is in it."""


@pytest.mark.fuzz
@pytest.mark.parametrize(('reason', 'text'), HOSTILE, ids=[reason for reason, _ in HOSTILE])
def test_given_a_hostile_urdf_when_read_then_it_is_refused_in_one_line(reason, text, tmp_path):
    path = tmp_path / 'hostile.urdf'
    path.write_text(text)
    with bounded_memory(), pytest.raises(ConfigError, match=reason) as refusal:
        torques_of(read_urdf_chain(path))
    assert '\n' not in str(refusal.value) and len(str(refusal.value)) < 1000
