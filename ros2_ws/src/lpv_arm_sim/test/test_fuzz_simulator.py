"""Hostile commands, parameters and requests for the simulator: its measurements stay finite."""

import numpy as np
import pytest
from hostile import Output, Refused, forge, node_of, request_service, run_cases, set_parameters
from places import BRINGUP
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from lpv.core.simulation.faults import MAX_FAULTS
from lpv_arm_sim.node import SimulatorNode
from lpv_msgs.msg import GroundTruth, TorqueCommand
from lpv_msgs.srv import ClearFaults, InjectFault

pytestmark = [pytest.mark.ros, pytest.mark.fuzz]
RECOVERY = 1_000_000_000
"""Longest time of data from the last bad input to an arm that is driven again [ns]."""


class Drives:
    """Commands a simulator that makes one step for each command, as in lockstep."""

    def __init__(self, node):
        self.node = node
        self.states = node._joint_states_out = Output(JointState)
        node._truth_out, node._clock_out = Output(GroundTruth), Output(Clock)
        node._begun, node._newcomers, node._peers = True, False, (1, 1)
        node._count_peers = lambda: (1, 1)
        node._publish()

    def good(self):
        """A command that answers the present sample."""
        command = TorqueCommand(torque=[0.0, 0.0])
        stamp = self.states.last.header.stamp
        command.header.stamp.sec, command.header.stamp.nanosec = stamp.sec, stamp.nanosec
        return command

    def send(self, command):
        """Measurements that follow a command; refusals are `Refused`."""
        self.states.take()
        self.node._on_command(command)
        found = self.states.take()
        if not found:
            raise Refused('answers no sample, or is not finite')
        truth = self.node._plant.state
        return found, np.array(truth.position), np.array(truth.velocity)

    def recover(self):
        """Time of good commands until the arm is driven [ns]."""
        self.node._on_release(Trigger.Request(), Trigger.Response())
        begin = self.node._stamp
        while self.node._stamp - begin < 2 * RECOVERY:
            self.node._on_command(self.good())
            if self.node._reason is None:
                break
        return self.node._stamp - begin


@pytest.fixture
def drives():
    with node_of(
        SimulatorNode,
        'arm_sim',
        arm_file=BRINGUP / 'arms' / 'paper.yaml',
        scenario_file=BRINGUP / 'scenarios' / 'two_faults.yaml',
        lockstep='true',
    ) as node:
        yield Drives(node)


def test_given_forged_commands_when_obeyed_then_measurements_are_finite_and_it_recovers(drives):
    def case(rng):
        drives.send(drives.good())
        return drives.send(forge(rng, drives.good()))

    tally = run_cases(200, case)
    assert tally.refused and tally.accepted
    assert drives.recover() <= RECOVERY


def test_given_forged_requests_when_faults_are_injected_then_measurements_are_finite(drives):
    services, good = drives.node._faults, {'sensor': 'link1_angle', 'kind': 'bias', 'size': 0.1}

    def case(rng):
        if rng.random() < 0.9:
            text = request_service(services.inject, InjectFault, rng, good)
        else:
            text = request_service(services.clear, ClearFaults, rng, {})
        found, *truth = drives.send(drives.good())
        # Readings that are missing are NaN, as in any JointState.
        return text, truth, [] if 'dropout' in str(drives.node._plant.injector.faults) else found

    tally = run_cases(200, case)
    assert tally.refused and tally.accepted
    assert len(drives.node._plant.injector.faults) <= MAX_FAULTS
    assert drives.recover() <= RECOVERY


def test_given_hostile_parameters_when_set_then_the_simulation_goes_on(drives):
    def case(rng):
        set_parameters(drives.node, rng)
        return drives.send(drives.good())

    assert run_cases(100, case).refused
    assert drives.recover() <= RECOVERY
