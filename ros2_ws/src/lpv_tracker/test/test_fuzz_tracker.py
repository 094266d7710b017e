"""Hostile estimates, parameters and requests for the tracker: its torques stay within limits."""

import numpy as np
import pytest
from hostile import Output, Refused, forge, node_of, run_cases, set_parameters
from places import BRINGUP
from std_srvs.srv import Trigger

from lpv.core.control.watchdog import StopReason
from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand
from lpv_tracker.node import TrackerNode

pytestmark = [pytest.mark.ros, pytest.mark.fuzz]
STEP = 2_000_000
RECOVERY = 1_000_000_000
"""Longest time of data from the last bad input to an arm that is driven again [ns]."""


class Driver:
    """Feeds a tracker; good estimates continue one stream, whatever else comes."""

    def __init__(self, node):
        self.node, self.stamp = node, 10**9
        self.commands = node._command_out = Output(TorqueCommand)
        self.references = node._reference_out = Output(JointReference)
        self.start = node._path.sample(0.0).position

    def good(self):
        """The next estimate of an arm that follows its path."""
        self.stamp += STEP
        position = self.start
        if self.references.last is not None:
            position = np.array(self.references.last.position)
        fields = dict.fromkeys(
            ('position', 'compensated_position', 'measured_position'), position.tolist()
        )
        fields.update(velocity=[0.0, 0.0], measured_velocity=[0.0, 0.0])
        message = StateEstimate(trustworthy=True, **fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.stamp, 10**9)
        return message

    def send(self, message):
        """Torques that answer an estimate; refusals are `Refused`."""
        before = sum(self.node._refusals.counts.values())
        self.node._on_estimate(message)
        found = self.commands.take()
        for torque in (command['TorqueCommand.torque'] for command in found):
            assert np.all(np.abs(torque) <= self.node._arm.torque_limit), torque
        if not found or self.commands.last.safe_stop:
            counted = sum(self.node._refusals.counts.values()) > before
            raise Refused('counted' if counted else self.node._stop_text() or 'not continued')
        return found, self.references.take()

    def recover(self):
        """Time of good data until the arm is driven [ns]."""
        self.node._on_resume(Trigger.Request(), Trigger.Response())
        begin = self.stamp
        while self.stamp - begin < 2 * RECOVERY:
            self.node._on_estimate(self.good())
            if not self.commands.last.safe_stop:
                break
        return self.stamp - begin


@pytest.fixture
def driver():
    with node_of(
        TrackerNode,
        'tracker',
        BRINGUP / 'gains' / 'paper.yaml',
        arm_file=BRINGUP / 'arms' / 'paper.yaml',
        scenario_file=BRINGUP / 'scenarios' / 'two_faults.yaml',
    ) as node:
        yield Driver(node)


def test_given_forged_estimates_when_followed_then_torques_are_within_limits_or_it_stops(driver):
    def case(rng):
        assert driver.recover() <= RECOVERY
        if rng.random() < 0.5:  # a start from anywhere, not a leap on the way
            driver.node._stop(StopReason.SILENCE)
        return driver.send(forge(rng, driver.good()))

    tally = run_cases(250, case)
    assert tally.refused and tally.accepted
    assert driver.recover() <= RECOVERY


JUMPS = (10.0, -10.0, 1e3, 1e6, 1e150, 1e300, 1.7e308)


@pytest.mark.parametrize('size', JUMPS)
@pytest.mark.parametrize('field', ['position', 'velocity', 'compensated_position'])
def test_given_an_estimate_that_leaps_when_repeated_then_the_arm_stops(driver, field, size):
    assert driver.recover() == STEP
    stopped = 0
    for _ in range(100):
        message = driver.good()
        setattr(message, field, [size, -size])
        try:
            driver.send(message)
        except Refused:
            stopped += 1
    believed = field == 'velocity' and abs(size) <= min(driver.node._arm.velocity_limit)
    assert stopped > 50 or believed or field == 'position'  # which the loop is not closed on
    assert driver.recover() <= RECOVERY


def test_given_hostile_parameters_when_set_then_they_are_refused_or_the_loop_goes_on(driver):
    assert run_cases(100, lambda rng: set_parameters(driver.node, rng)).refused
    assert driver.recover() <= RECOVERY
