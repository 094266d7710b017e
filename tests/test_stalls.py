"""Processes of the real graph that are held up again and again: the arm never runs away."""

import os

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='no ROS 2: neither wheels nor a sourced one')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from test_restart import files, rig_on  # noqa: E402, F401

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

DEFAULTS = {
    name: tuple(f'{limit}:=0.0' for limit in limits)
    for name, limits in {
        'simulator': ('command_timeout', 'max_mean_latency'),
        'tracker': ('estimate_timeout', 'max_latency'),
    }.items()
}
"""In place of the rig's: 0 is what the gains allow, or what drives take that are given none."""
STALLS = int(os.environ.get('LPV_STALLS', '8'))
"""Random stalls of the long mode."""


def statuses(messages, part):
    """Messages of one part on /diagnostics."""
    return [s.message for m in messages for s in m.status if s.name.endswith(part)]


def assert_slow(rig):
    """No joint is ever near its speed limit, 20 rad/s: the path needs 0.35 rad/s."""
    assert max(np.abs(m.velocity).max() for m in rig.heard['ground_truth']) < 2.0


def assert_goes_on(rig):
    """The brakes are released again; a busy machine may engage them at any time."""
    assert rig.client.wait(lambda: not rig.is_braked(), 150.0), 'braked for ever'


def test_given_a_tracker_that_is_held_up_when_it_goes_on_then_the_arm_never_runs_away(
    tmp_path,
    files,  # noqa: F811
):
    with rig_on(tmp_path, files) as rig:
        reports = rig.client.listen(DiagnosticArray, '/diagnostics', QoSProfile(depth=100))
        for name in ('uio', 'tracker', 'simulator'):
            rig.start(name, *DEFAULTS.get(name, ()))
        rig.logged('simulator', 'brakes released', 0)
        rig.spin(1.0)
        for _ in range(8):
            rig.hold('tracker', 0.15)
            rig.spin(0.15)
        assert_goes_on(rig)
        rig.spin(1.0)
    assert_slow(rig)
    assert any('braked: commands' in text for text in statuses(reports, 'drives'))
    assert any('safe stop: ' in text for text in statuses(reports, 'tracking'))
    assert 'driven' in statuses(reports, 'drives')


def test_given_random_stalls_of_any_process_when_it_goes_on_then_the_arm_never_runs_away(
    tmp_path,
    files,  # noqa: F811
):
    rng = np.random.default_rng(7)
    with rig_on(tmp_path, files) as rig:
        for name in ('uio', 'tracker', 'simulator'):
            rig.start(name, *DEFAULTS.get(name, ()))
        rig.logged('simulator', 'brakes released', 0)
        for _ in range(STALLS):
            rig.spin(rng.uniform(0.0, 1.0))
            rig.hold(('uio', 'tracker', 'simulator')[rng.integers(3)], 0.02 * 50 ** rng.random())
        assert_goes_on(rig)
        assert (codes := rig.running.stop()) and set(codes.values()) == {0}, codes
    assert_slow(rig)
