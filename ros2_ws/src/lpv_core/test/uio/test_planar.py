"""A planar arm in the paper's symbols and as an arm file states it."""

from dataclasses import replace

import numpy as np
import pytest

from lpv_core.serial_arm.chain import compile_chain
from lpv_core.serial_arm.dynamics.model import SerialModel
from lpv_core.support.errors import ConfigError
from lpv_core.uio.model.dynamics import inverse_dynamics
from lpv_core.uio.model.joints import JointMap
from lpv_core.uio.planar import is_planar, planar_links, planar_model, plane_of, serial_from_planar


@pytest.mark.parametrize('name', ['paper', 'real'])
def test_given_a_shipped_arm_when_converted_there_and_back_then_it_is_the_same(request, name):
    arm, model = (request.getfixturevalue(f'{name}_{kind}') for kind in ('arm', 'model'))
    again = planar_model(serial_from_planar(model))
    assert again.joint_names == arm.joint_names and again.sensor_names == arm.sensor_names
    for field in ('links', 'rotor', 'viscous', 'coulomb', 'zero_angle', 'gravity', 'cos_min'):
        one, other = getattr(again, field), getattr(model, field)
        if field == 'links':
            one, other = (np.array([list(vars(b).values()) for b in v]) for v in (one, other))
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12, err_msg=field)
    assert (again.arrangement, again.orientation) == (model.arrangement, model.orientation)


def test_given_a_shipped_arm_when_its_hash_is_taken_then_it_is_that_of_its_gains(gains_of, arm):
    assert arm.sha256() == gains_of[arm.name].arm_sha256


def test_given_any_zero_when_converted_then_torques_are_those_of_the_papers_formulas(arm):
    for zero in (-2.0, 0.3, np.pi):
        model = replace(arm, zero_angle=zero)
        chain, joints = SerialModel(compile_chain(serial_from_planar(model))), JointMap(model)
        q, v, a = np.random.default_rng(3).normal(size=(3, 2))
        motion = (
            joints.absolute_position(q),
            joints.absolute_velocity(v),
            joints.absolute_velocity(a),
        )
        absolute = inverse_dynamics(*np.concatenate(motion), model.constants())
        np.testing.assert_allclose(
            chain.torque(q, v, a), joints.joint_torque(np.array(absolute)), rtol=1e-9, atol=1e-12
        )


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


def test_given_no_region_when_converted_then_only_its_links_are_known(paper_arm, paper_model):
    arm = replace(paper_arm, lpv=None)
    with pytest.raises(ConfigError, match='lpv: is missing'):
        planar_model(arm)
    assert planar_links(arm).links == paper_model.links


def test_given_another_combination_of_sensors_when_converted_then_it_is_refused(paper_arm):
    with pytest.raises(ConfigError, match='sensor_matrix'):
        planar_model(replace(paper_arm, sensor_matrix=((1.0, 0.0), (0.5, 1.0))))
