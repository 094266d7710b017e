"""lpv init, lpv --version, and what is said where something is missing."""

import subprocess

import numpy as np
import pytest
from places import BRINGUP, ROOT

from lpv_cli.initialising.urdf_arm import read_urdf_arm
from lpv_cli.main import main
from lpv_cli.needs import remedy
from lpv_core.export.urdf import arm_urdf
from lpv_core.model.arm import load_arm
from lpv_core.serial_arm.any_arm import load_any_arm
from lpv_core.simulation.any_scenario import load_any_scenario
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.errors import ConfigError
from lpv_design.requirement import load_requirement


@pytest.fixture
def urdf(tmp_path, paper_arm):
    path = tmp_path / 'arm.urdf'
    path.write_text(arm_urdf(paper_arm))
    return path


def test_given_an_empty_folder_when_initialised_then_its_files_are_valid(tmp_path, capsys):
    assert main(['init', str(tmp_path / 'new'), '--name', 'bench']) == 0
    arm = load_arm(tmp_path / 'new' / 'arm.yaml')
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


def test_given_a_urdf_when_initialised_then_the_arm_is_that_of_the_urdf(tmp_path, urdf, paper_arm):
    assert main(['init', str(tmp_path / 'new'), '--urdf', str(urdf)]) == 0
    arm = load_arm(tmp_path / 'new' / 'arm.yaml')
    for found, wanted in zip(arm.links, paper_arm.links):
        assert vars(found) == pytest.approx(vars(wanted))
    assert arm.joint_names == paper_arm.joint_names
    assert arm.zero_angle == pytest.approx(paper_arm.zero_angle)
    assert arm.torque_limit == pytest.approx(paper_arm.torque_limit)


@pytest.mark.parametrize(('name', 'joints'), [('ur10', 6), ('panda', 7)])
def test_given_the_urdf_of_a_serial_arm_when_initialised_then_arm_and_path_fit(
    tmp_path, name, joints, capsys
):
    urdf = BRINGUP / 'urdf' / f'{name}.urdf'
    assert main(['init', str(tmp_path / 'new'), '--urdf', str(urdf), '--name', 'bench']) == 0
    arm = load_any_arm(tmp_path / 'new' / 'arm.yaml')
    assert arm.name == 'bench' and len(arm.joint_names) == joints
    scenario = load_any_scenario(tmp_path / 'new' / 'scenario.yaml', arm)
    assert (
        np.ptp(scenario.path(arm).sample(np.linspace(0.0, 12.0, 50)).position, axis=0).min() > 0.1
    )
    assert 'lpv demo --arm' in capsys.readouterr().out


@pytest.mark.parametrize('zero', [0.0, np.pi / 3, np.pi])
def test_given_another_zero_when_read_from_a_urdf_then_it_is_found(tmp_path, paper_arm, zero):
    from dataclasses import replace

    path = tmp_path / 'arm.urdf'
    path.write_text(arm_urdf(replace(paper_arm, zero_angle=zero)))
    assert np.cos(read_urdf_arm(path).zero_angle - zero) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        ('continuous', 'fixed', 'two revolute joints'),
        ('xyz="0 -1 0"', 'xyz="0 0 1"', 'horizontal'),
        ('xyz="0 -1 0"', 'xyz="0 0 0"', 'no direction'),
        ('<mass value="10.0"', '<mass value="heavy"', 'must be a number'),
        ('<robot', '<!DOCTYPE x [<!ENTITY y "z">]><robot', 'entities'),
        ('</robot>', '', 'cannot be read'),
    ],
)
def test_given_a_urdf_of_another_kind_when_read_then_it_is_refused(urdf, old, new, said):
    text = urdf.read_text()
    assert old in text
    urdf.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=said):
        read_urdf_arm(urdf)


def test_given_files_that_are_there_when_initialised_then_none_is_overwritten(tmp_path, capsys):
    (tmp_path / 'scenario.yaml').write_text('mine')
    assert main(['init', str(tmp_path)]) == 2
    assert 'exists already' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['scenario.yaml']


def test_given_the_version_when_asked_then_it_is_printed(capsys):
    with pytest.raises(SystemExit) as end:
        main(['--version'])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith('lpv ')


@pytest.mark.parametrize(
    ('module', 'said'),
    [
        ('pyarrow.parquet', 'make setup-extras'),
        ('optuna', 'make setup-extras'),
        ('lpv_msgs.msg', 'ROS 2 is needed'),
        ('rclpy', 'ROS 2 is needed'),
        ('rich', 'pip install rich'),
    ],
)
def test_given_a_missing_module_when_explained_then_its_installation_is_named(module, said):
    assert said in remedy(module)


def test_given_an_installation_by_pip_when_a_module_is_missing_then_its_extra_is_named(monkeypatch):
    monkeypatch.setattr('lpv_cli.needs.version', lambda name: '0.1.0')
    assert "pip install 'lpv-arm-fdi[campaign]'" in remedy('pyarrow.parquet')


def test_given_a_checkout_with_a_space_in_its_path_when_set_up_then_it_is_refused_at_once(tmp_path):
    tools = tmp_path / 'my checkout' / 'tools'
    tools.mkdir(parents=True)
    (tools / 'setup.sh').write_text((ROOT / 'tools' / 'setup.sh').read_text())
    done = subprocess.run(['bash', tools / 'setup.sh'], capture_output=True, text=True)
    assert done.returncode == 1
    assert 'contains a space' in done.stderr
    assert not (tmp_path / 'my checkout' / '.venv').exists()
