from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
from hostile import RECOVERY, Output, Refused, forge, node_of, request, run_cases, set_parameters
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from lpv.core.simulation.faults import MAX_FAULTS
from lpv.core.support.resources import bringup_file
from lpv.core.support.timestamps import set_stamp, to_nanoseconds
from lpv_arm_sim.node import SimulatorNode
from lpv_msgs.msg import GroundTruth, TorqueCommand
from lpv_msgs.srv import ClearFaults, InjectFault

pytestmark = pytest.mark.ros
FAULT = {'sensor': 'link1_angle', 'kind': 'bias', 'size': 0.3}


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
        command.header.stamp = deepcopy(self.states.last.header.stamp)
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
        begin, stopped = self.node._stamp, True
        while stopped and self.node._stamp - begin < 2 * RECOVERY:
            self.node._on_command(self.good())
            stopped = self.node._reason is not None
        return self.node._stamp - begin

    def inject(self, **fields):
        request = InjectFault.Request(**{**FAULT, **fields})
        return self.node._on_inject(request, InjectFault.Response())

    def clear(self, sensor):
        return self.node._on_clear(ClearFaults.Request(sensor=sensor), ClearFaults.Response())


@pytest.fixture
def drives():
    given = {'arm_file': 'paper', 'scenario_file': 'two_faults', 'lockstep': 'true'}
    with node_of(SimulatorNode, **given) as node:
        yield Drives(node)


def test_given_faults_when_injected_and_one_is_cleared_then_the_other_stays(drives):
    for name, value in (('sensor', 'c'), ('kind', 'x'), ('size', 0.0), ('size', float('nan'))):
        response = drives.inject(**{name: value})
        assert not response.success and f'fault.{name}' in response.message, 'it makes no sense'
    assert not drives.clear('c').success
    assert drives.clear('').cleared == 2, 'those of the scenario'
    for _ in range(5):
        drives.send(drives.good())
    response = drives.inject()
    assert response.success and response.message == 'bias on link1_angle from 0.010 s on'
    drives.inject(sensor='link2_angle')
    assert [drives.clear(sensor).cleared for sensor in ('link1_angle', '', '')] == [1, 1, 0]


def test_given_a_simulator_that_is_not_active_when_faults_are_injected_then_none_waits(drives):
    drives.clear('')
    drives.node._leave()
    response = drives.inject()
    assert not response.success and response.message == 'arm_sim is not active: nothing was done'
    drives.node._taking_part = True
    assert drives.clear('').cleared == 0


def test_given_no_clock_yet_when_simulated_time_is_used_then_no_sample_is_left_out(monkeypatch):
    files = {'arm_file': 'paper', 'scenario_file': 'two_faults'}
    with node_of(SimulatorNode, use_sim_time='true', **files) as node:
        states, now = Output(JointState), SimpleNamespace(nanoseconds=0)
        node._joint_states_out, node._truth_out = states, Output(GroundTruth)
        monkeypatch.setattr(node, 'get_clock', lambda: SimpleNamespace(now=lambda: now))
        node.begin()
        for now.nanoseconds in (0, 0, 10**18, 10**18 + node._period):
            node._tick()
        assert [to_nanoseconds(one.header.stamp) for one in states.sent] == [10**18 + node._period]
        assert node._slips == 0


def test_given_an_answer_when_repeated_then_each_sample_is_left_by_one_step(drives):
    first = drives.good()
    drives.send(first)
    for _ in range(2):
        pytest.raises(Refused, drives.send, first).match('answers no sample')
        drives.send(drives.good())
    stamps = [to_nanoseconds(m.header.stamp) for m in drives.states.sent]
    assert np.diff(stamps).tolist() == [drives.node._period] * 3
    assert len(drives.node._clock_out.sent) == len(stamps)


def test_given_efforts_in_another_unit_when_simulated_then_the_truth_has_torques(tmp_path):
    text = bringup_file('arms', 'paper').read_text().replace('torque_gain: 1.0', 'torque_gain: 2.0')
    (tmp_path / 'arm.yaml').write_text(text)
    given = {'arm_file': tmp_path / 'arm.yaml', 'scenario_file': 'two_faults', 'lockstep': 'true'}
    with node_of(SimulatorNode, **given) as node:
        drives = Drives(node)
        command = drives.good()
        command.torque = [30.0, -4.0]
        node._on_command(command)
        assert list(node._truth_out.last.torque) == [30.0, -4.0]
        assert list(drives.states.last.effort) == [15.0, -2.0]


def test_given_a_clock_that_is_set_back_when_in_real_time_then_the_arm_goes_on(monkeypatch):
    now = SimpleNamespace(nanoseconds=10**18)
    with node_of(SimulatorNode, arm_file='paper', scenario_file='two_faults') as node:
        states = node._joint_states_out = Output(JointState)
        monkeypatch.setattr(node, 'get_clock', lambda: SimpleNamespace(now=lambda: now))
        node.begin()
        # Commands, none, and commands after the clock was set back.
        for set_back, is_answered in ((0, True), (0, False), (3600 * 10**9, True)):
            now.nanoseconds -= set_back
            for _ in range(200):
                now.nanoseconds += node._period
                node._tick()
                command = TorqueCommand(torque=[0.0, 0.0])
                set_stamp(command.header.stamp, node._stamp)
                if is_answered:
                    node._on_command(command)
            assert (node._reason is None) == is_answered
        assert to_nanoseconds(states.last.header.stamp) == now.nanoseconds


@pytest.mark.fuzz
def test_given_hostile_input_when_obeyed_then_measurements_are_finite_and_it_recovers(drives):
    def forged(rng):
        drives.send(drives.good())
        return drives.send(forge(rng, drives.good()))

    def configured(rng):
        set_parameters(drives.node, rng)
        return drives.send(drives.good())

    assert run_cases(200, forged).refused and drives.recover() <= RECOVERY
    assert run_cases(100, configured).refused and drives.recover() <= RECOVERY


@pytest.mark.fuzz
def test_given_forged_requests_when_faults_are_injected_then_measurements_are_finite(drives):
    node = drives.node

    def case(rng):
        if rng.random() < 0.9:
            text = request(node._on_inject, InjectFault, rng, FAULT)
        else:
            text = request(node._on_clear, ClearFaults, rng, {})
        found, *truth = drives.send(drives.good())
        # Readings that are missing are NaN, as in any JointState.
        return text, truth, [] if 'dropout' in str(drives.node._plant.injector.faults) else found

    assert run_cases(200, case).refused
    assert len(drives.node._plant.injector.faults) <= MAX_FAULTS
    assert drives.recover() <= RECOVERY
