"""Declarations of the nodes' parameters: described, bounded, with units."""

import importlib
import math
import re

import pytest

from lpv_node import managed, parameters
from lpv_node.parameters import Spec

MODULES = ('lpv_arm_sim.node', 'lpv_uio.node', 'lpv_tracker.node', 'lpv_node.recorder.node',
           'lpv_node.view.node')  # fmt: skip
SPECS = {f'common/{spec.name}': spec for spec in managed.COMMON} | {
    f'{name}/{spec.name}': spec for name in MODULES for spec in importlib.import_module(name).SPECS
}
"""Every declaration of every node, by where it is."""


@pytest.mark.parametrize('place', sorted(SPECS))
def test_given_a_parameter_when_declared_then_it_says_what_it_is_and_what_is_allowed(place):
    spec = SPECS[place]
    assert len(spec.description) > 10
    if isinstance(spec.default, bool) or not isinstance(spec.default, (int, float)):
        assert spec.low is None and spec.high is None
    else:
        assert spec.low <= spec.default <= spec.high
        assert math.isfinite(spec.low) and math.isfinite(spec.high)
    if spec.choices:
        assert spec.default in spec.choices
    if isinstance(spec.default, float):
        assert re.search(r'\[[^\]]+\]', spec.description), 'no unit; [1] is that of a ratio'


def test_given_the_gains_when_declared_then_numbers_have_ranges_and_units():
    fields = [
        *parameters.GAIN_FIELDS.values(),
        *(f for fs in parameters.METHOD_FIELDS.values() for f in fs.values()),
    ]
    for field in fields:
        descriptor = field.descriptor()
        assert descriptor.read_only
        assert descriptor.description
        if isinstance(field.default, (int, float)):
            assert field.low < field.high
            assert re.search(r'\[[^\]]+\]', field.description)
            assert len(descriptor.floating_point_range) + len(descriptor.integer_range) == 1
        else:
            assert not descriptor.integer_range


def test_given_a_declaration_when_described_then_ros_gets_the_same():
    descriptor = Spec('wait', 0.5, 'how long [s]', 0.1, 2.0, read_only=True).descriptor()
    assert (descriptor.description, descriptor.read_only) == ('how long [s]', True)
    (limits,) = descriptor.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.1, 2.0)
    descriptor = Spec('kind', 'a', 'which one', choices=('a', 'b')).descriptor()
    assert descriptor.additional_constraints == 'one of a, b'
