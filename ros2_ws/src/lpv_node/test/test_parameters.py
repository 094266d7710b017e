"""Declarations of the nodes' parameters: described, bounded, with units."""

import importlib
import math
import re

import pytest

from lpv_node import managed, parameters

MODULES = ('lpv_arm_sim.node', 'lpv_uio.node', 'lpv_tracker.node', 'lpv_node.recorder.node',
           'lpv_node.view.node')  # fmt: skip
GAINS = {
    f'gains/{method}{name}': spec
    for method, fields in {'': parameters.GAIN_FIELDS, **parameters.METHOD_FIELDS}.items()
    for name, spec in fields.items()
}
SPECS = {f'common/{spec.name}': spec for spec in managed.COMMON} | {
    f'{name}/{spec.name}': spec for name in MODULES for spec in importlib.import_module(name).SPECS
}
"""Every declaration of every node, by where it is."""


@pytest.mark.parametrize('place', [*sorted(SPECS), *GAINS])
def test_given_a_parameter_when_declared_then_it_says_what_it_is_and_what_is_allowed(place):
    spec = (SPECS | GAINS)[place]
    descriptor = spec.descriptor()
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    assert len(descriptor.description) > 10
    if isinstance(spec.default, bool) or not isinstance(spec.default, (int, float)):
        assert spec.low is None and spec.high is None and ranges == []
    else:
        (limits,) = ranges
        assert spec.low <= spec.default <= spec.high and spec.low < spec.high
        assert math.isfinite(spec.low) and math.isfinite(spec.high)
        assert (limits.from_value, limits.to_value) == (spec.low, spec.high)
    if spec.choices:
        assert spec.default in spec.choices
        assert descriptor.additional_constraints == 'one of ' + ', '.join(spec.choices)
    if isinstance(spec.default, float) or (ranges and place in GAINS):
        assert re.search(r'\[[^\]]+\]', spec.description), 'no unit; [1] is that of a ratio'
    assert descriptor.read_only == spec.read_only
    assert spec.read_only or place not in GAINS
