"""lpv init, lpv --version, and what is said where something is missing."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest
from places import BRINGUP, ROOT

from lpv.cli.main import main
from lpv.cli.needs import remedy
from lpv.core.export.urdf import arm_urdf
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.simulation.scenario import load_scenario
from lpv.core.uio.planar import planar_model, serial_from_planar
from lpv_design.requirement import load_requirement


@pytest.fixture
def init(tmp_path):
    """Calls the command for a new folder, with the text of a URDF; the arm that it writes."""

    def run(*options, urdf=None):
        if urdf:
            (tmp_path / 'arm.urdf').write_text(urdf)
            options = ('--urdf', tmp_path / 'arm.urdf', *options)
        assert main(['init', str(tmp_path / 'new'), *map(str, options)]) == 0
        return load_arm(tmp_path / 'new' / 'arm.yaml')

    return run


def test_given_an_empty_folder_when_initialised_then_its_files_are_valid(tmp_path, init, capsys):
    arm = init('--name', 'bench')
    assert arm.name == 'bench'
    load_requirement(tmp_path / 'new' / 'requirement.yaml')
    load_scenario(tmp_path / 'new' / 'scenario.yaml').path(arm)
    assert 'lpv design --arm' in capsys.readouterr().out


@pytest.mark.slow
def test_given_the_files_as_written_when_designed_then_the_certificate_holds(tmp_path):
    main(['init', str(tmp_path)])
    gains = str(tmp_path / 'gains.yaml')
    arm, requirement = str(tmp_path / 'arm.yaml'), str(tmp_path / 'requirement.yaml')
    assert main(['design', '--arm', arm, '--requirement', requirement, '--out', gains]) == 0
    assert main(['verify', gains, '--arm', arm]) == 0


def test_given_a_urdf_when_initialised_then_the_arm_is_that_of_the_urdf(init, paper_arm):
    arm = init(urdf=arm_urdf(paper_arm))
    found, wanted = planar_model(arm), planar_model(paper_arm)
    for one, other in zip(found.links, wanted.links):
        assert vars(one) == pytest.approx(vars(other))
    assert arm.joint_names == paper_arm.joint_names
    assert found.zero_angle == pytest.approx(wanted.zero_angle)
    assert arm.torque_limit == pytest.approx(paper_arm.torque_limit)


@pytest.mark.parametrize(('name', 'joints'), [('ur10', 6), ('panda', 7)])
def test_given_the_urdf_of_a_serial_arm_when_initialised_then_arm_and_path_fit(
    tmp_path, init, name, joints, capsys
):
    arm = init('--urdf', BRINGUP / 'urdf' / f'{name}.urdf', '--name', 'bench')
    assert arm.name == 'bench' and len(arm.joint_names) == joints
    path = load_scenario(tmp_path / 'new' / 'scenario.yaml').path(arm)
    assert np.ptp(path.sample(np.linspace(0.0, 12.0, 50)).position, axis=0).min() > 0.1
    assert 'lpv demo --arm' in capsys.readouterr().out


@pytest.mark.parametrize('zero', [0.0, np.pi / 3, np.pi])
def test_given_another_zero_when_read_from_a_urdf_then_it_is_found(init, paper_model, zero):
    turned = serial_from_planar(replace(paper_model, zero_angle=zero))
    found = planar_model(init(urdf=arm_urdf(turned)))
    assert np.cos(found.zero_angle - zero) == pytest.approx(1.0)


def test_given_two_links_out_of_a_vertical_plane_when_initialised_then_it_has_no_region(
    init, paper_arm
):
    arm = init(urdf=arm_urdf(paper_arm).replace('xyz="0 -1.0 0"', 'xyz="0 0 1"'))
    assert [joint.axis for joint in arm.joints] == [(0.0, 0.0, 1.0)] * 2
    assert arm.lpv is None


LINK = (
    '<link name="{}"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="0 0 0.3"/>'
    '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="500" velocity="2"/>{}</joint>'
)
JOINTS = (
    ('shoulder', 'revolute', 'base', 'one', '<dynamics damping="0.5" friction="0.25"/>'),
    ('elbow', 'revolute', 'one', 'two', ''),
    ('wrist', 'continuous', 'two', 'hand', ''),
    ('left_finger', 'prismatic', 'hand', 'left', ''),
    ('right_finger', 'prismatic', 'hand', 'right', ''),
    ('flange', 'fixed', 'hand', 'tool', ''),
)
LINKS = ['base', *(child for _, _, _, child, _ in JOINTS)]
GRIPPER = '<robot name="my arm">{}{}</robot>'.format(
    ''.join(map(LINK.format, LINKS)), ''.join(JOINT.format(*joint) for joint in JOINTS)
)
"""Three joints that turn, and two fingers that slide."""


@pytest.mark.parametrize(
    'options',
    [
        ['--lock', 'left_finger=0.02', '--lock', 'right_finger'],
        ['--joints', 'shoulder,elbow,wrist'],
        ['--joints', 'shoulder', 'elbow', 'wrist'],
        ['--tip', 'tool'],
    ],
)
def test_given_a_gripper_when_its_joints_are_held_then_the_arm_has_the_others_and_their_friction(
    init, options
):
    arm = init(*options, urdf=GRIPPER)
    assert (arm.name, arm.joint_names) == ('my_arm', ('shoulder', 'elbow', 'wrist'))
    assert dict(arm.locked).keys() == {'left_finger', 'right_finger'}
    assert dict(arm.locked)['left_finger'] == (0.02 if '--lock' in options else 0.0)
    friction = [(j.friction.viscous, j.friction.coulomb) for j in arm.joints]
    assert friction == [(0.5, 0.25), (0.0, 0.0), (0.0, 0.0)]
    if '--tip' in options:
        assert arm.tip == (0.0, 0.0, 0.3)


HELD = ['--tip', 'tool']


@pytest.mark.parametrize(
    ('old', 'new', 'options', 'said'),
    [
        (
            '',
            '',
            [],
            "'left_finger' is prismatic, 'right_finger' is prismatic: hold it with --lock",
        ),
        ('', '', [], '--joints shoulder,elbow,wrist, or its last link with --tip'),
        ('', '', ['--tip', 'nose'], "'nose' is no link of the URDF: base, one"),
        ('', '', ['--lock', 'left_finger=open'], "'open' is not a number"),
        ('', '', ['--lock', 'thumb', '--joints', 'elbow'], "no moving joint 'thumb'"),
        ('', '', [*HELD, '--joints', 'elbow'], 'give one of them'),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', HELD, 'direction'),
        ('<mass value="2"', '<mass value="heavy"', HELD, 'mass'),
        ('<robot', '<!DOCTYPE x [<!ENTITY y "z">]><robot', HELD, 'document type'),
        ('</robot>', '', HELD, 'no element found'),
        ('damping="0.5"', 'damping="-1"', HELD, 'dynamics.damping: must be'),
    ],
)
def test_given_a_gripper_that_is_not_held_or_a_defect_when_initialised_then_it_is_named(
    tmp_path, refused, old, new, options, said
):
    assert old in GRIPPER
    (tmp_path / 'arm.urdf').write_text(GRIPPER.replace(old, new))
    assert refused(said, 'init', tmp_path / 'new', '--urdf', tmp_path / 'arm.urdf', *options)
    assert not (tmp_path / 'new').exists()


def test_given_files_that_are_there_when_initialised_then_none_is_overwritten(tmp_path, refused):
    (tmp_path / 'scenario.yaml').write_text('mine')
    assert refused('exists already', 'init', tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ['scenario.yaml']


def test_given_the_version_when_asked_then_it_is_printed(capsys):
    with pytest.raises(SystemExit) as end:
        main(['--version'])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith('lpv ')


def test_given_a_missing_module_when_explained_then_its_installation_is_named(monkeypatch):
    for module, said in (
        ('pyarrow.parquet', 'make setup-extras'),
        ('optuna', 'make setup-extras'),
        ('lpv_msgs.msg', 'ROS 2 is needed'),
        ('rclpy', 'ROS 2 is needed'),
        ('rich', 'pip install rich'),
        ('lpv_design.main', 'lpv_design, which designs gains, is not installed'),
    ):
        assert said in remedy(module)
    monkeypatch.setattr('lpv.cli.needs.installed_version', lambda name: '0.1.0')
    assert "pip install 'lpv-arm-fdi[campaign]'" in remedy('pyarrow.parquet')


def test_given_a_checkout_with_a_space_in_its_path_when_set_up_then_it_is_refused_at_once(tmp_path):
    tools = tmp_path / 'my checkout' / 'tools'
    tools.mkdir(parents=True)
    (tools / 'setup.sh').write_text((ROOT / 'tools' / 'setup.sh').read_text())
    done = subprocess.run(['bash', tools / 'setup.sh'], capture_output=True, text=True)
    assert done.returncode == 1
    assert 'contains a space' in done.stderr
    assert not (tmp_path / 'my checkout' / '.venv').exists()
