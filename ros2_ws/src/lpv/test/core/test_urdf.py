"""URDF of an arm as a file: names, refusals, and the command."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from places import BRINGUP

from lpv.cli.main import main
from lpv.core.export.urdf import arm_urdf
from lpv.core.support.errors import ConfigError


def test_given_odd_names_when_written_then_the_urdf_is_still_xml(paper_arm):
    joints = [replace(j, name=n) for j, n in zip(paper_arm.joints, ('x<1>', 'y&2'))]
    arm = replace(paper_arm, name='a <b> & "c"', joints=tuple(joints))
    robot = ElementTree.fromstring(arm_urdf(arm))
    assert robot.get('name') == arm.name
    assert [j.get('name') for j in robot.findall('joint')][:2] == list(arm.joint_names)


def test_given_an_inertia_that_no_body_has_when_written_then_it_is_refused_by_name(paper_arm):
    link = replace(paper_arm.joints[1].link, inertia=tuple(1e-3 * np.array([1, 0, 1, 0, 0, 1])))
    joints = paper_arm.joints[0], replace(paper_arm.joints[1], link=link)
    arm = replace(paper_arm, joints=joints)
    with pytest.raises(ConfigError, match=r'joints\[1\]\.link\.inertia'):
        arm_urdf(arm)
    assert '<inertial>' not in arm_urdf(arm, inertial=False)


def test_given_the_command_when_run_then_it_prints_the_urdf_of_a_file(paper_arm, capsys, tmp_path):
    file = str(BRINGUP / 'arms' / 'paper.yaml')
    assert main(['urdf', '--arm', file]) == 0
    assert capsys.readouterr().out == arm_urdf(paper_arm)
    assert main(['urdf', '--arm', file, '--out', str(tmp_path / 'a.urdf')]) == 0
    assert (tmp_path / 'a.urdf').read_text() == arm_urdf(paper_arm)
