"""Tracker node: torques from estimates and from inverse-kinematics references."""

import sys

import numpy as np
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from lpv_core.control.path import Reference
from lpv_core.control.path_follower import PathFollower
from lpv_core.control.tracking import COMPENSATION, TrackingController, feedback_position
from lpv_core.model.arm import load_arm
from lpv_core.simulation.scenario import load_scenario
from lpv_core.support.timestamps import NANOSECONDS
from lpv_msgs.msg import JointReference, StateEstimate, TorqueCommand
from lpv_node.managed import ManagedNode, run_node
from lpv_node.parameters import Spec, declare_gains, read_gains, required_text
from lpv_node.qos import stream
from lpv_node.stamps import set_stamp, to_nanoseconds

SPECS = (
    Spec('arm_file', '', 'arm file (YAML)', read_only=True),
    Spec('scenario_file', '', 'scenario file (YAML); its path is tracked', read_only=True),
    Spec(
        'compensation',
        'confirmed',
        'position in the loop: as measured (off), with confirmed '
        'faults removed, or as estimated (always)',
        choices=COMPENSATION,
    ),
    Spec(
        'estimate_timeout',
        0.2,
        'real time only: command a safe stop when no estimate came for this long [s]',
        0.01,
        60.0,
        read_only=True,
    ),
    Spec(
        'approach_speed',
        0.5,
        'fastest joint rate on the way to the path, where the arm starts '
        'or goes on elsewhere [rad/s]',
        0.01,
        10.0,
        read_only=True,
    ),
)

_SILENCE = 'no estimates: safe stop'


class TrackerNode(ManagedNode):
    """Tracking controller.

    Topics: subscribes ``state_estimate``; publishes ``torque_command`` and ``reference``.  The
    path starts at the stamp of the first estimate; its clock stands still during a safe stop, and
    an arm that is found elsewhere is led to the path first (`lpv_core.control.path_follower`).

    Safe stops: when an estimate is not to be trusted, when estimates stay away, and when the node
    is deactivated or ends.
    """

    def __init__(self) -> None:
        super().__init__('tracker', SPECS)
        declare_gains(self)
        self._estimate_in: Subscription | None = None
        self._watch: Timer | None = None
        self._stopped = True

    def setup(self) -> None:
        """Read arm, gains and path, create publishers."""
        self._arm = load_arm(required_text(self, 'arm_file'))
        gains = read_gains(self, self._arm)
        self._controller = TrackingController(self._arm, gains)
        self._integrates_measurement = gains.controller.method == 'paper'
        self._path = load_scenario(required_text(self, 'scenario_file')).path(self._arm)
        self._follower = PathFollower(
            self._arm, self._path, self.get_parameter('approach_speed').value
        )
        # Compile before the first estimate, not on it.
        self._controller.update(self._path.sample(0.0), [0.0, 0.1], [0.0, 0.0], [0.0, 0.1], 0.0)
        self._controller.reset()
        self._last: int | None = None  # stamp of the last estimate [ns]
        self._previous: int | None = None  # stamp of the last estimate that was followed [ns]
        self._received = 0  # time at which the last estimate came [ns]
        qos = stream(self.lockstep)
        self._command_out = self.create_publisher(TorqueCommand, 'torque_command', qos)
        self._reference_out = self.create_publisher(JointReference, 'reference', qos)
        self._command, self._reference = TorqueCommand(), JointReference()
        self._command.header.frame_id = self._reference.header.frame_id = self._arm.name

    def outputs(self) -> dict[Publisher, int]:
        """Publishers to be matched before estimates are taken."""
        return {self._command_out: 1, self._reference_out: 0}

    def begin(self) -> None:
        """Subscribe."""
        self._estimate_in = self.create_subscription(
            StateEstimate, 'state_estimate', self._on_estimate, stream(self.lockstep)
        )
        if not self.lockstep:
            self._watch = self.steady_timer(0.05, self._check_silence)
        self.get_logger().info(f'tracking a path of {self._path.end:.1f} s')

    def end(self) -> None:
        """Unsubscribe, and leave the arm braked."""
        if self._estimate_in is not None:
            self.destroy_subscription(self._estimate_in)
            self._estimate_in = None
        if self._watch is not None:
            self.destroy_timer(self._watch)
            self._watch = None
        if not (self._stopped or self.lockstep):
            self._stop_safely(self.get_clock().now().nanoseconds)

    def _on_estimate(self, message: StateEstimate) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self._received = self.get_clock().now().nanoseconds
        if self._last is not None and stamp <= self._last:
            if self.lockstep and stamp == self._last:
                self._answer_again()
                return
            if not self.lockstep and self._last - stamp < NANOSECONDS:
                return  # duplicate or out of order
            self._stop()
            self._follower.reset()  # time restarted, and so does the path
        self._last = stamp
        # A node that was held up itself has seen no silence: the drives have braked meanwhile.
        silent = self._previous is not None and self._is_silence(stamp - self._previous)
        if silent:
            self.get_logger().error(_SILENCE)
        if silent or not message.trustworthy:
            self._stop_safely(stamp)
            return
        position = feedback_position(self.get_parameter('compensation').value, message)
        reference = self._follower.reference(stamp, position)
        if not self.lockstep and self._follower.arm_not_following(reference):
            self.get_logger().warning(
                'the arm does not move: commands do not reach it, or its drives brake',
                throttle_duration_sec=5.0,
            )
            self._follower.stop()
            self._controller.reset()
            reference = self._follower.reference(stamp, position)
        if self._stopped:
            self._stopped = False
            self.get_logger().info('following the path')
        self._publish_command(message, position, stamp, reference)
        self._publish_reference(stamp, reference)
        self._previous = stamp

    def _stop(self) -> None:
        """Nothing is followed until the next estimate that can be trusted."""
        self._controller.reset()
        self._follower.stop()
        self._previous = None
        self._stopped = True

    def _answer_again(self) -> None:
        """The same estimate again: a restarted node missed the answer."""
        self._command_out.publish(self._command)
        if not self._command.safe_stop:
            self._reference_out.publish(self._reference)

    def _publish_command(
        self, message: StateEstimate, position: np.ndarray, stamp: int, reference: Reference
    ) -> None:
        integrated = message.measured_position if self._integrates_measurement else position
        interval = 0.0 if self._previous is None else (stamp - self._previous) / NANOSECONDS
        command = self._controller.update(
            reference, position, message.velocity, integrated, interval
        )
        set_stamp(self._command.header.stamp, stamp)
        self._command.torque, self._command.safe_stop = command.torque, False
        self._command_out.publish(self._command)

    def _publish_reference(self, stamp: int, reference: Reference) -> None:
        message = self._reference
        set_stamp(message.header.stamp, stamp)
        message.position, message.velocity = reference.position, reference.velocity
        message.acceleration, message.tip_position = reference.acceleration, reference.tip
        self._reference_out.publish(message)

    def _check_silence(self) -> None:
        """Stop safely when the observer is silent: the drives then brake."""
        if self._stopped:
            return
        now = self.get_clock().now().nanoseconds
        if self._is_silence(now - self._received):
            self.get_logger().error(_SILENCE)
            self._stop_safely(now)

    def _is_silence(self, interval: int) -> bool:
        if self.lockstep:
            return False
        return interval > self.get_parameter('estimate_timeout').value * NANOSECONDS

    def _stop_safely(self, stamp: int) -> None:
        self._stop()
        set_stamp(self._command.header.stamp, stamp)
        self._command.torque, self._command.safe_stop = [0.0, 0.0], True
        self._command_out.publish(self._command)


def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run lpv_tracker tracker``."""
    sys.exit(run_node(TrackerNode, argv))


if __name__ == '__main__':
    main()
