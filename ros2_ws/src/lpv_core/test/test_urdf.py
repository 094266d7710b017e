"""The URDF of an arm, read by an interpreter of its own, against kinematics and dynamics."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lpv_core.export.urdf import arm_urdf, frame_angles, points, transforms
from lpv_core.model.kinematics import forward
from lpv_core.support.errors import ConfigError

POSES = np.random.default_rng(3).uniform(-4.0, 4.0, (20, 2))


def vector(text):
    return np.array([float(v) for v in text.split()])


def origin(element):
    found = element.find('origin')
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler('xyz', vector(found.get('rpy'))).as_matrix()
    matrix[:3, 3] = vector(found.get('xyz'))
    return matrix


def frames(urdf, positions):
    """Frames of all links for joint positions by name, as URDF defines them."""
    robot = ElementTree.fromstring(urdf)
    placed = {'base_link': np.eye(4)}
    for joint in robot.findall('joint'):
        matrix = placed[joint.find('parent').get('link')] @ origin(joint)
        if joint.get('type') != 'fixed':
            turn = np.eye(4)
            axis = vector(joint.find('axis').get('xyz'))
            turn[:3, :3] = Rotation.from_rotvec(axis * positions[joint.get('name')]).as_matrix()
            matrix = matrix @ turn
        placed[joint.find('child').get('link')] = matrix
    return placed


def test_given_the_urdf_when_its_tip_is_placed_then_it_is_where_kinematics_say(arm):
    urdf = arm_urdf(arm)
    for q in POSES:
        placed = frames(urdf, dict(zip(arm.joint_names, q)))
        tip = placed['tip'][[0, 2], 3]
        # Kinematics count q1 from the x axis; the arm's own zero may be elsewhere.
        offset = np.array([arm.zero_angle + np.pi / 2, 0.0])
        np.testing.assert_allclose(tip, forward(q + offset, arm.lengths), atol=1e-12)
        np.testing.assert_allclose(placed['tip'][1, 3], 0.0, atol=1e-12)
        np.testing.assert_allclose(points(arm, q)[1], tip, atol=1e-12)
        angles = frame_angles(arm, q)
        for name, angle in zip(('link1', 'link2'), angles):
            np.testing.assert_allclose(
                placed[name][[0, 2], 0], [np.cos(angle), np.sin(angle)], atol=1e-12
            )


def test_given_a_configuration_when_transforms_are_made_then_they_are_those_of_the_urdf(arm):
    q = POSES[0]
    placed = frames(arm_urdf(arm), dict(zip(arm.joint_names, q)))
    matrices = {'base_link': np.eye(4)}
    for parent, child, translation, quaternion in transforms(arm, q):
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), translation
        matrices[child] = matrices[parent] @ step
        np.testing.assert_allclose(matrices[child], placed[child], atol=1e-12)
    assert set(matrices) == set(placed)


def test_given_the_urdf_when_masses_are_moved_then_inertia_and_gravity_are_the_models(arm):
    arm = replace(arm, rotor_inertia=0.0)  # a URDF has no place for rotors
    urdf, values = arm_urdf(arm), arm.constants()
    robot = ElementTree.fromstring(urdf)
    q, h = np.array([0.4, -0.9]), 1e-6

    def bodies(pose):
        placed = frames(urdf, dict(zip(arm.joint_names, pose)))
        for link in robot.findall('link'):
            part = link.find('inertial')
            if part is not None:
                yield (
                    float(part.find('mass').get('value')),
                    (placed[link.get('name')] @ origin(part))[:3, 3],
                    float(part.find('inertia').get('iyy')),
                )

    mass_matrix, weight = np.zeros((2, 2)), np.zeros(2)
    for i, (mass, _, inertia) in enumerate(bodies(q)):
        columns = []
        for j in range(2):
            step = h * np.eye(2)[j]
            high, low = list(bodies(q + step))[i][1], list(bodies(q - step))[i][1]
            columns.append((high - low) / (2 * h))
        jacobian, turn = np.stack(columns, 1), np.array([1.0, float(i == 1)])
        mass_matrix += mass * jacobian.T @ jacobian + inertia * np.outer(turn, turn)
        weight += mass * arm.gravity * jacobian[2]
    theta = q[0] + arm.zero_angle, q[0] + q[1] + arm.zero_angle
    coupling = values.coupling * np.cos(theta[0] - theta[1])
    absolute = np.array([[values.inertia[0], coupling], [coupling, values.inertia[1]]])
    to_absolute = np.array([[1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(mass_matrix, to_absolute.T @ absolute @ to_absolute, rtol=1e-7)
    gravity = -values.gravity * np.sin(theta)
    np.testing.assert_allclose(weight, to_absolute.T @ gravity, rtol=1e-7)


def test_given_odd_names_when_written_then_the_urdf_is_still_xml(paper_arm):
    arm = replace(paper_arm, name='a <b> & "c"', joint_names=('x<1>', 'y&2'))
    robot = ElementTree.fromstring(arm_urdf(arm))
    assert robot.get('name') == arm.name
    assert [j.get('name') for j in robot.findall('joint')][:2] == list(arm.joint_names)


def test_given_an_inertia_that_no_body_has_when_written_then_it_is_refused_by_name(real_arm):
    link = replace(real_arm.links[1], inertia=1e-3)
    arm = replace(real_arm, links=(real_arm.links[0], link))
    with pytest.raises(ConfigError, match=r'links\[1\]\.inertia'):
        arm_urdf(arm)
    assert '<inertial>' not in arm_urdf(arm, inertial=False)


def test_given_the_command_when_run_then_it_prints_the_urdf_of_a_file(paper_arm, capsys, tmp_path):
    main = pytest.importorskip('lpv_cli.main').main
    file = 'ros2_ws/src/lpv_bringup/arms/paper.yaml'
    from places import ROOT

    assert main(['urdf', '--arm', str(ROOT / file)]) == 0
    assert capsys.readouterr().out == arm_urdf(paper_arm)
    assert main(['urdf', '--arm', str(ROOT / file), '--out', str(tmp_path / 'a.urdf')]) == 0
    assert (tmp_path / 'a.urdf').read_text() == arm_urdf(paper_arm)
