"""Recordings of real arms."""

import numpy as np
import pytest
from places import RECORDINGS as DATA
from simulated_recordings import is_physical

from lpv.bag.run.csv_import import load_column_map
from lpv.core.serial_arm.arm_file import load_arm, save_arm
from lpv.core.serial_arm.urdf_chain import read_urdf_chain
from lpv.core.support.resources import bringup_file
from lpv.identify.estimation.identification import identify
from lpv.identify.recordings.recording import read_recording

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not DATA.is_dir(), reason='the recordings are not part of the repository'),
]


def identified(folder, urdf):
    arm = read_urdf_chain(DATA / folder / urdf)
    return identify(arm, [read_recording(DATA / folder / 'exciting.db3', arm.joint_names)])


def test_given_a_ur10_when_identified_then_torques_held_back_are_predicted():
    result = identified('ur10', 'ur10.urdf')
    assert np.all(result.figures.rms <= [1.3, 1.25, 1.3, 0.4, 0.4, 2.4])
    assert all(is_physical(joint.link) for joint in result.arm.joints)


def test_given_a_panda_when_identified_then_torques_held_back_are_predicted():
    result = identified('panda', 'fer.urdf')
    assert np.all(result.figures.rms_band <= [0.41, 0.46, 0.62, 0.14, 0.10, 0.07, 0.06])


RUNS = ('run_143601.csv', 'run_144115.csv')


@pytest.mark.parametrize('train, test', [RUNS, RUNS[::-1]])
def test_given_a_two_link_arm_when_identified_then_it_is_no_worse_than_published(
    train, test, tmp_path
):
    arm = load_arm(bringup_file('arms', 'real_arm'))
    columns = load_column_map(bringup_file('columns', 'real_arm'))
    one, other = (
        read_recording(DATA / 'real_arm' / name, arm.joint_names, None, columns)
        for name in (train, test)
    )
    result = identify(arm, [one], tests=[other])
    assert np.all(result.figures.rms <= 1.01 * result.prior_figures.rms)
    assert {joint.sensors.rates for joint in result.arm.joints} == {'derived'}
    save_arm(result.arm, tmp_path / 'arm.yaml')
    assert load_arm(tmp_path / 'arm.yaml') == result.arm
