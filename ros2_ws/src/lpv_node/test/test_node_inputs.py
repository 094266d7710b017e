import importlib
import math
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
import ros
from builtin_interfaces.msg import Time
from hostile import answers_to
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rclpy.parameter import Parameter

from lpv import ConfigError, Gains
from lpv.core.support.limits import PATIENCE
from lpv.core.support.options import Entry
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp, to_nanoseconds
from lpv_node import input_check, managed, parameters

MODULES = ('lpv_arm_sim.node', 'lpv_uio.node', 'lpv_tracker.node', 'lpv_node.recorder.node',
           'lpv_node.view.node')  # fmt: skip
SPECS = {f'common/{spec.name}': (spec, True) for spec in managed.COMMON} | {
    f'{name}/{spec.name}': (spec, part == 'SPECS') for name in MODULES
    for part in ('SPECS', 'TUNABLE') for spec in getattr(importlib.import_module(name), part, ())
}  # fmt: skip
"""Every declaration of every node, and whether it is fixed, by where it is."""


@pytest.mark.parametrize('place', sorted(SPECS))
def test_given_a_parameter_when_declared_then_it_says_what_it_is_and_what_is_allowed(place, node):
    spec, read_only = SPECS[place]
    parameters.declare(node, [spec], read_only)
    (descriptor,) = node.describe_parameters([spec.name])
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    assert len(descriptor.description) > 10
    if isinstance(spec.default, bool) or not isinstance(spec.default, (int, float)):
        assert (spec.limits, ranges) == (None, [])
    else:
        (limits,), (low, high) = ranges, spec.limits
        assert low <= spec.default <= high and low < high
        assert math.isfinite(low) and math.isfinite(high)
        assert (limits.from_value, limits.to_value) == (low, high)
    if spec.choices:
        assert spec.default in spec.choices
        assert descriptor.additional_constraints == 'one of ' + ', '.join(spec.choices)
    if isinstance(spec.default, float):
        assert re.search(r'\[[^\]]+\]', spec.text), 'no unit; [1] is that of a ratio'
    assert descriptor.read_only == read_only


@pytest.fixture
def node(request):
    context, words = rclpy.Context(), getattr(request, 'param', [])
    rclpy.init(context=context)
    options = {'context': context, 'start_parameter_services': False}
    node = rclpy.create_node('probe', cli_args=words, **options)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)


FILE = ['--ros-args', '--params-file', str(bringup_file('gains', 'paper'))]


@pytest.mark.parametrize(('node', 'given'), [(FILE, True), ([], False)], indirect=['node'])
def test_given_gains_or_none_when_declared_then_those_of_a_file_are_fixed(node, paper_arm, given):
    parameters.declare_given(node, 'gains', 'loop')
    # All at once, as `ros2 param dump` asks for them.
    names = [n for n in node._parameters if n.startswith('gains.')]
    assert all(one.description for one in node.describe_parameters(names))
    assert Parameter.Type.NOT_SET not in [p.type_ for p in node.get_parameters(names)]
    assert ('gains.observer.kappa' in names and len(names) >= 20) is given
    assert not any('certificate' in name for name in names), 'nothing is computed from it'
    gains = parameters.read_gains(node, paper_arm, Gains)
    if given:
        assert gains.observer.method == 'exact'
        changed = node.set_parameters([Parameter('gains.arm_name', value='other')])
        assert not changed[0].successful, 'gains are read-only'
    else:
        assert gains is None


@pytest.mark.parametrize(('node', 'told'), [
    ([*FILE, '-p', 'gains.observer.kapa:=1.0'], 'gains.observer.kapa: is not a known field'),
    ([*FILE, '-p', 'gains.observer.kappa:=x'], 'gains.observer.kappa: must be a flat list'),
    (['--ros-args', '-p', 'gains.arm_name:=paper'], 'gains.format: is missing'),
], indirect=['node'])  # fmt: skip
def test_given_gains_misspelt_or_not_whole_when_read_then_it_says_so(node, paper_arm, told):
    parameters.declare_given(node, 'gains')
    pytest.raises(ConfigError, parameters.read_gains, node, paper_arm, Gains).match(told)


def test_given_parameters_that_make_no_sense_when_set_then_each_is_refused_with_its_reason(node):
    node.declare_parameter('wait', 1.0)
    node.declare_parameter('choice', 'confirmed')
    service = parameters.CheckedParameterService(node)
    for name, kind, reason in (
        ('x', 11, '.*ValueError'),  # there is no such type
        ('', ParameterType.PARAMETER_DOUBLE, '.*needs a name'),
        ('wait', ParameterType.PARAMETER_NOT_SET, '.*cannot be deleted'),
        ('wiat', ParameterType.PARAMETER_DOUBLE, 'probe has no parameter wiat'),
        ('wait', ParameterType.PARAMETER_STRING, 'wait is of type DOUBLE, not STRING'),
        ('choice', ParameterType.PARAMETER_BOOL, 'choice is of type STRING, not BOOL; in YAML'),
    ):
        wanted = [ParameterMessage(name=name, value=ParameterValue(type=kind))]
        for together in (True, False):
            (result,) = answers_to(service, wanted, together)
            assert not result.successful and re.match(reason, result.reason), result.reason
    assert node.get_parameter('wait').value == 1.0


@pytest.mark.parametrize('node', [['--ros-args', '-p', 'choice:=off']], indirect=True)
def test_given_a_word_that_yaml_takes_for_false_when_declared_then_it_says_to_quote_it(node):
    choice = Entry('choice', 'of two', 'confirmed', choices=('off', 'confirmed'))
    with pytest.raises(ConfigError, match="'False' of type 'BOOL'.*off, yes and no are truth"):
        parameters.declare(node, [choice])


def test_given_nanoseconds_beyond_a_second_when_written_back_then_it_is_a_stamp():
    stamp = Time()
    set_stamp(stamp, to_nanoseconds(Time(sec=2**31 - 1, nanosec=2**32 - 1)))
    assert (stamp.sec, stamp.nanosec) == (2**31 - 1, 999_999_999)


def stream_of(sender, stamps, position, several=True, names=('joint1', 'joint2')):
    """Which measurements of a stream are accepted; it comes as it is stamped."""
    return [sender.accept(round(s * 1e9), names, position, 1 + several, s) for s in stamps]


def test_given_huge_readings_when_they_come_at_once_then_rates_stay_numbers(paper_arm):
    sender, stamps = input_check.OneSender(paper_arm), [0.0, 1e-9, 2e-9, 0.002]
    with np.errstate(all='raise'):
        for sign, stamp in enumerate(stamps):
            huge = [1e300 * (-1.0) ** sign, 0.0]
            assert all(stream_of(sender, [stamp], huge, False))
        assert all(stream_of(sender, [0.0021, 0.0022], [1.0, 0.5], False))
    assert (np.abs(sender._rate) <= sender._limit).all()


@pytest.mark.parametrize('later', [0.0, 0.001, -0.001, -0.5, 10.0])
def test_given_two_senders_when_they_alternate_then_only_the_first_is_used(paper_arm, later):
    sender = input_check.OneSender(paper_arm)
    assert all(stream_of(sender, [0.0, 0.002], [1.0, 0.5]))
    for k in range(2, 50):
        other = round((0.002 * k + later) * 1e9)
        assert not sender.accept(other, ('joint2', 'joint1'), [0.5, 1.3], 2, 0.002 * k)
        assert all(stream_of(sender, [0.002 * k + 0.0015], [1.0, 0.5]))
    # A loaded machine holds the first one up.
    assert not any(stream_of(sender, 0.16 + 0.002 * np.arange(15), [1.3, 0.8]))
    assert all(stream_of(sender, [0.195], [1.0, 0.5]))


def test_given_a_fast_arm_when_another_sender_comes_then_it_goes_on_at_its_rate(paper_arm):
    sender = input_check.OneSender(paper_arm)
    for k in range(20):
        assert all(stream_of(sender, [0.05 * k], [0.8 * k, 0.5], several=k > 1))  # 16 of 20 rad/s
        assert k < 2 or not any(stream_of(sender, [0.05 * k + 0.01], [-1.0, 0.5]))


def test_given_a_jump_that_nobody_contradicts_or_a_gripper_when_heard_then_it_is_used(paper_arm):
    times = 0.002 * np.arange(250)
    for several in (False, True):
        sender = input_check.OneSender(paper_arm)
        assert all(stream_of(sender, times, [1.0, 0.5], several))
        used = stream_of(sender, 0.5 + times, [3.0, 0.5], several)
        assert all(used[151:]) and any(used[:148]) != several
        assert all(stream_of(sender, 1.0 + times, [float('nan'), 0.5], several)), 'a dropout'
    sender = input_check.OneSender(paper_arm)
    for k in range(20):
        assert all(stream_of(sender, [0.002 * k], [1.0, 0.5]))
        assert all(stream_of(sender, [0.002 * k], [0.01 * k], names=('finger',)))
    assert sender.others(0.04) == 1, 'the second publisher is the gripper'
    assert all(stream_of(sender, [0.042], [3.0, 0.5])), 'a jump that no other sender makes'
    assert sender.others(10.0) == 0
    assert all(stream_of(sender, [10.0], [3.0, 0.5]))
    assert not any(stream_of(sender, [10.002], [1.0, 0.5]))


def test_given_a_remapped_topic_when_publishers_are_counted_then_those_that_are_heard_are():
    remap = ['--ros-args', '-r', 'joint_states:=/robot/joint_states']
    rclpy.init(args=remap, domain_id=ros.next_domain())
    node = managed.ManagedNode('probe', ())
    node.create_publisher(Time, '/robot/joint_states', 1)
    counts = [node.count_publishers(name) for name in ('joint_states', '/robot/joint_states')]
    node.destroy_node()
    rclpy.shutdown()
    assert counts == [1, 1]


@pytest.mark.parametrize('name', ['SimulatorNode', 'UioNode', 'TrackerNode'])
def test_given_a_node_in_lockstep_when_stopped_before_it_is_configured_then_the_code_is_0(name):
    (kind,) = (one for module in MODULES for one in [getattr(sys.modules[module], name, 0)] if one)
    rclpy.init(args=ros.words('lockstep:=true', 'autostart:=false'), domain_id=ros.next_domain())
    node, told = kind(), SimpleNamespace(is_set=True, defer=lambda: None)
    code = managed._spin(node, told)
    node.destroy_node()
    rclpy.shutdown()
    assert code == 0


def test_given_readers_that_died_when_told_to_stop_then_the_node_ends_before_it_is_killed(
    monkeypatch,
):
    clock = [0.0]

    def wait(duration):
        clock[0] += duration.nanoseconds * 1e-9

    monkeypatch.setattr(managed.time, 'monotonic', lambda: clock[0])
    managed.wait_for_readers(4 * [SimpleNamespace(wait_for_all_acked=wait)])
    assert clock[0] == 2.0 * PATIENCE
