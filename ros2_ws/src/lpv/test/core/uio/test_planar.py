"""A planar arm in the paper's symbols and as an arm file states it."""

from dataclasses import replace

import numpy as np
import pytest

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
