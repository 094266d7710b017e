"""A planar arm in the paper's symbols and as an arm file states it; files of older versions."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from nested import changed

from lpv.core.serial_arm.arm_file import load_arm, parse_arm, save_arm, to_mapping
from lpv.core.support.errors import ConfigError
from lpv.core.uio.planar import is_planar, planar_links, planar_model, plane_of, serial_from_planar


def test_given_a_shipped_arm_when_converted_there_and_back_then_it_is_the_same(
    paper_arm, real_arm, arm, gains_of
):
    again, shipped = planar_model(serial_from_planar(arm)), (paper_arm, real_arm)
    (serial,) = (one for one in shipped if one.name == arm.name)
    assert arm.sha256() == gains_of[arm.name].arm_sha256
    assert again.joint_names == serial.joint_names and again.sensor_names == serial.sensor_names
    for field in ('rotor', 'viscous', 'coulomb', 'zero_angle', 'gravity', 'cos_min'):
        one, other = getattr(again, field), getattr(arm, field)
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12, err_msg=field)
    links = [[list(vars(link).values()) for link in one.links] for one in (again, arm)]
    np.testing.assert_allclose(*links, rtol=1e-12, atol=1e-12)
    assert (again.arrangement, again.orientation) == (arm.arrangement, arm.orientation)


def test_given_an_arm_turned_about_the_vertical_when_converted_then_it_is_the_same(paper_arm):
    turned = replace(paper_arm, base_orientation=(0.0, 0.0, 0.7))
    assert planar_model(turned) == planar_model(paper_arm)
    origin, plane = plane_of(paper_arm)
    np.testing.assert_allclose(plane, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-12)
    np.testing.assert_array_equal(origin, 0.0)


def joint(arm, index, **change):
    joints = list(arm.joints)
    joints[index] = replace(joints[index], **change)
    return replace(arm, joints=tuple(joints))


REFUSED = {
    'a third joint': lambda a: replace(a, joints=(*a.joints, replace(a.joints[1], name='x'))),
    'skew axes': lambda a: joint(a, 1, orientation=(0.3, 0.0, 0.0)),
    'no length': lambda a: replace(a, tip=(0.0, 0.0, 0.0)),
    'a mass beside its link': lambda a: joint(
        a, 0, link=replace(a.joints[0].link, first_moment=(5.0, 0.0, 0.5))
    ),
    'no vertical plane': lambda a: replace(a, base_orientation=(np.pi / 2, 0.0, 0.0)),
}


@pytest.mark.parametrize('change', REFUSED.values(), ids=REFUSED)
def test_given_an_arm_that_is_not_planar_when_converted_then_the_reason_is_said(paper_arm, change):
    arm = change(paper_arm)
    assert is_planar(paper_arm) and not is_planar(arm)
    with pytest.raises(ConfigError, match='lpv: is for planar arms of two links: '):
        planar_model(arm)


def test_given_no_region_or_other_sensors_when_converted_then_it_is_refused(paper_arm, paper_model):
    arm = replace(paper_arm, lpv=None)
    with pytest.raises(ConfigError, match='lpv: is missing'):
        planar_model(arm)
    assert planar_links(arm).links == paper_model.links
    with pytest.raises(ConfigError, match='sensor_matrix'):
        planar_model(replace(paper_arm, sensor_matrix=((1.0, 0.0), (0.5, 1.0))))


OLD = yaml.safe_load("""
name: paper
inertia_reference: center_of_mass
gravity: 9.8
links:
  - {mass: 10.0, length: 1.0, center_of_mass: 0.5, inertia: 0.83}
  - {mass: 5.0, length: 1.0, center_of_mass: 0.5, inertia: 0.41}
joints: {names: [joint1, joint2], velocity_limit: 20.0, zero_angle: -1.5707963267948966}
sensors: {names: [link1_angle, link2_angle], arrangement: absolute, position_noise: 0.001,
          velocity_noise: 0.01}
disturbance: {direction: [0.7, 0.0], mean: 0.2, variance: 0.9}
torque_limit: [1500.0, 600.0]
region: {orientation: upright, cos_min: [0.3, 0.3]}
model_error: 0.05
sample_time: 0.002
""")


def parse_old(data):
    with pytest.warns(FutureWarning, match='some.yaml is of the form of two-link arms'):
        return parse_arm(data, 'some.yaml')


def test_given_an_old_file_when_read_then_it_is_the_shipped_arm_and_the_new_form_is_asked_for(
    paper_arm, paper_gains, tmp_path
):
    arm = parse_old(OLD)
    assert planar_model(arm) == planar_model(paper_arm)
    paper_gains.check_arm(planar_model(arm))
    save_arm(arm, tmp_path / 'new.yaml')
    assert load_arm(tmp_path / 'new.yaml') == arm
    # Rotors are those of the motors.
    arm = parse_old({**OLD, 'rotor': {'inertia': 1e-4, 'gear_ratio': 6.0}})
    assert [j.rotor_inertia for j in arm.joints] == pytest.approx([37e-4, 36e-4])
    assert arm.joints[1].rotor_coupling == pytest.approx(-6e-4)


BAD = {
    'links[0].mass': 0.0, 'links[0].inertia': -0.1, 'links': [OLD['links'][0]] * 3,
    'joints.zero_angle': 3.2, 'region.cos_min > region.cos_min[1]': [0.3, 0.0],
    'sensors.arrangement': 'polar',
    'disturbance.direction > disturbance.direction[1]': [0.7, math.nan],
    'torque_limit > torque_limit[1]': [100.0, -1.0], 'rotor > rotor.mass': {'mass': 1.0},
    'colour': 'red', 'inertia_reference > links': 'joint',  # 0.83 < 10*0.5^2: no body
}  # fmt: skip
"""Bad values of fields; after > the field that the error names instead."""


@pytest.mark.parametrize('field', BAD)
def test_given_a_bad_value_in_an_old_file_when_read_then_its_field_is_named(field):
    data = changed(OLD, field.split(' > ')[0], BAD[field])
    with pytest.raises(ConfigError) as caught, pytest.warns(FutureWarning):
        parse_arm(data, 'some.yaml')
    assert caught.value.field == field.split(' > ')[-1]


def test_given_an_arm_file_that_states_the_old_kind_when_read_then_it_is_read(paper_arm):
    data = to_mapping(paper_arm)
    assert parse_arm({**data, 'kind': 'serial_arm'}) == parse_arm(data)
    with pytest.raises(ConfigError, match='kind'):
        parse_arm({**data, 'kind': 'two_link'})
