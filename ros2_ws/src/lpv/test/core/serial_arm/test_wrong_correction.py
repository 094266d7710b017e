"""A correction of a fault that is wrong, or no longer right, does not throw the arm."""

from functools import cache

import numpy as np
import pytest

from lpv.core.control.computed_torque import ComputedTorqueController
from lpv.core.control.estimate_check import FADING, CorrectionLimit
from lpv.core.control.path_follower import PathFollower
from lpv.core.control.watchdog import StopReason, TrackerLimits, TrackerWatchdog
from lpv.core.serial_arm.diagnosis.alarms import Mode
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.files import load_arm, load_scenario

pytestmark = pytest.mark.slow
DT, STEP, JOINT, SIZE = 0.002, 2_000_000, 1, 0.5
ONSET = 2.5  # of the wrong correction, when the shoulder moves [s]
CORRECTIONS = {
    'appears': lambda t: SIZE * (t >= ONSET),
    'disappears': lambda t: SIZE * (t < ONSET),
    'comes and goes': lambda t: SIZE * (t >= ONSET and int((t - ONSET) / 0.02) % 2 == 0),
    'drifts': lambda t: min(SIZE, 0.25 * max(0.0, t - ONSET)),
    'drifts fast': lambda t: min(SIZE, 3.0 * max(0.0, t - ONSET)),
    'swings': lambda t: SIZE * np.sin(4.0 * max(0.0, t - ONSET)),
}


class Loop:
    """The tracking law of the node on a simulated UR10; a correction is put on the true reading."""

    def __init__(self, correction, corrects_rates=False):
        self.arm, scenario = load_arm('ur10'), load_scenario('ur10')
        self.simulator = ArmSimulator(self.arm, scenario)
        self.follower = PathFollower(scenario.path(self.arm))
        self.law, self.limit = ComputedTorqueController(self.arm), CorrectionLimit(self.arm)
        self.watchdog = TrackerWatchdog(self.arm, TrackerLimits())
        self.correction, self.corrects_rates = correction, corrects_rates
        self.reason, self.speeds, self.torques, self.errors = StopReason.NONE, [], [], []

    def step(self, k):
        stamp, sensed = 10**9 + k * STEP, self.simulator.sense()[0]
        measured, rate = np.array(sensed.position), np.array(sensed.velocity)
        position, velocity = measured.copy(), rate.copy()
        now, before = self.correction(k * DT), self.correction((k - 1) * DT)
        position[JOINT] -= now
        if self.corrects_rates and abs(now - before) < 0.02:  # a jump is no rate
            velocity[JOINT] -= (now - before) / DT
        rates = velocity, rate
        self.reason = self.watchdog.check_estimate(stamp, 0, int(Mode.OBSERVING), True, *rates)
        if self.reason is StopReason.NONE:
            reference = self.follower.reference(stamp, position)
            self.reason = self.watchdog.check_motion(stamp, reference.position, position, measured)
        if self.reason is not StopReason.NONE:
            self.simulator.hold()
            return
        self.limit.take(stamp, position, velocity)
        feedback, span = self.limit.position, DT if k else 0.0
        command = self.law.update(reference, feedback, self.limit.velocity, feedback, span)
        self.simulator.step(command.torque)
        self.speeds.append(np.abs(self.simulator.state.motion[1]))
        self.torques.append(command.torque)
        self.errors.append(feedback - position)

    def run(self, seconds):
        for k in range(round(seconds / DT)):
            self.step(k)
            if self.reason is not StopReason.NONE:
                break
        return self


@cache
def loop_with(name, corrects_rates):
    return Loop(CORRECTIONS[name], corrects_rates).run(ONSET + 2.5)


@pytest.mark.parametrize('corrects_rates', [False, True])
@pytest.mark.parametrize('name', CORRECTIONS)
def test_given_a_wrong_correction_when_it_changes_then_no_joint_is_too_fast(name, corrects_rates):
    loop = loop_with(name, corrects_rates)
    limit, fastest = np.array(loop.arm.velocity_limit), np.max(loop.speeds, axis=0)
    # The stop comes 0.02 s after a joint is too fast: until then it stays below its own limit.
    assert np.all(fastest < limit)
    if loop.reason is not StopReason.OVERSPEED:
        assert np.all(fastest < 1.2 * TrackerLimits.speed * limit)
    assert np.abs(np.diff(loop.torques, axis=0)).max() < 0.6 * max(loop.arm.torque_limit)
    if name in ('drifts fast', 'swings') and corrects_rates:
        assert loop.reason is StopReason.OVERSPEED


@pytest.mark.parametrize('name', ['appears', 'disappears'])
def test_given_a_correction_that_jumps_when_followed_then_torques_do_not_and_it_is_faded_in(name):
    loop, onset = loop_with(name, False), round(ONSET / DT)
    jump = np.abs(np.diff(loop.torques, axis=0))
    assert jump[onset - 1 :].max() < 2.0 * jump[10 : onset - 1].max() + 5.0
    errors = np.abs(np.array(loop.errors)[:, JOINT])
    assert errors[onset] == pytest.approx(SIZE, abs=0.01) and errors[: onset - 1].max() == 0.0
    assert np.abs(np.diff(errors[onset:])).max() <= FADING * DT * 1.001
    assert errors[-1] == 0.0


def test_given_true_readings_when_followed_then_the_limit_changes_nothing():
    loop = Loop(lambda t: 0.0).run(3.0)
    assert loop.reason is StopReason.NONE and not np.any(loop.errors)


def test_given_an_arm_that_moves_when_started_then_it_starts_from_rest():
    loop = Loop(lambda t: 0.0)
    loop.simulator.state.motion[1, 3] = 0.5
    loop.step(0)
    assert loop.reason is StopReason.MOVING
    loop.step(1)
    assert loop.reason is StopReason.NONE
