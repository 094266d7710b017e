"""Arm files of two links, of versions before there was one kind of arm."""

import copy
import math

import pytest
import yaml

from lpv_core.serial_arm.arm_file import load_arm, parse_arm, save_arm
from lpv_core.support.errors import ConfigError
from lpv_core.uio.planar import planar_model

OLD = yaml.safe_load("""
name: paper
inertia_reference: center_of_mass
gravity: 9.8
links:
  - {mass: 10.0, length: 1.0, center_of_mass: 0.5, inertia: 0.83}
  - {mass: 5.0, length: 1.0, center_of_mass: 0.5, inertia: 0.41}
joints: {names: [joint1, joint2], velocity_limit: 20.0, zero_angle: -1.5707963267948966}
sensors:
  names: [link1_angle, link2_angle]
  arrangement: absolute
  position_noise: 0.001
  velocity_noise: 0.01
disturbance: {direction: [0.7, 0.0], mean: 0.2, variance: 0.9}
torque_limit: [1500.0, 600.0]
region: {orientation: upright, cos_min: [0.3, 0.3]}
model_error: 0.05
sample_time: 0.002
""")


def changed(*keys, value):
    data = copy.deepcopy(OLD)
    place = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    return data


def parse(data):
    with pytest.warns(FutureWarning, match='some.yaml is of the form of two-link arms'):
        return parse_arm(data, 'some.yaml')


def test_given_an_old_file_when_read_then_it_is_the_shipped_arm_and_the_new_form_is_asked_for(
    paper_arm, paper_gains, tmp_path
):
    arm = parse(OLD)
    assert planar_model(arm) == planar_model(paper_arm)
    paper_gains.check_arm(planar_model(arm))
    save_arm(arm, tmp_path / 'new.yaml')
    assert load_arm(tmp_path / 'new.yaml') == arm


def test_given_rotors_of_an_old_file_when_read_then_they_are_those_of_the_motors():
    arm = parse({**OLD, 'rotor': {'inertia': 1e-4, 'gear_ratio': 6.0}})
    assert [j.rotor_inertia for j in arm.joints] == pytest.approx([37e-4, 36e-4])
    assert arm.joints[1].rotor_coupling == pytest.approx(-6e-4)


@pytest.mark.parametrize(
    ('keys', 'value', 'named'),
    [
        (('links', 0, 'mass'), 0.0, 'links[0].mass'),
        (('links', 0, 'inertia'), -0.1, 'links[0].inertia'),
        (('links',), [OLD['links'][0]] * 3, 'links'),
        (('joints', 'zero_angle'), 3.2, 'joints.zero_angle'),
        (('region', 'cos_min'), [0.3, 0.0], 'region.cos_min[1]'),
        (('sensors', 'arrangement'), 'polar', 'sensors.arrangement'),
        (('disturbance', 'direction'), [0.7, math.nan], 'disturbance.direction[1]'),
        (('torque_limit',), [100.0, -1.0], 'torque_limit[1]'),
        (('rotor',), {'mass': 1.0}, 'rotor.mass'),
        (('colour',), 'red', 'colour'),
        (('inertia_reference',), 'joint', 'links'),  # 0.83 < 10*0.5^2: no body
    ],
)
def test_given_a_bad_value_in_an_old_file_when_read_then_its_field_is_named(keys, value, named):
    with pytest.raises(ConfigError) as caught, pytest.warns(FutureWarning):
        parse_arm(changed(*keys, value=value), 'some.yaml')
    assert caught.value.field == named


def test_given_an_arm_file_that_states_the_old_kind_when_read_then_it_is_read(paper_arm):
    from lpv_core.serial_arm.arm_file import to_mapping

    data = to_mapping(paper_arm)
    assert parse_arm({**data, 'kind': 'serial_arm'}) == parse_arm(data)
    with pytest.raises(ConfigError, match='kind'):
        parse_arm({**data, 'kind': 'two_link'})
