"""Estimates and decisions as messages."""

from lpv_core.observer import Mode
from lpv_msgs.msg import FaultAlarm, FaultEstimate, StateEstimate
from lpv_node.stamps import set_stamp


class OutputMessages:
    """Reusable output messages of one arm.

    Parameters
    ----------
    arm : ArmParameters
        Names.
    joints : JointMap
        Conversions.
    """

    def __init__(self, arm, joints):
        self._arm, self._joints = arm, joints
        self._state, self._fault = StateEstimate(), FaultEstimate()
        for message in (self._state, self._fault):
            message.header.frame_id = arm.name
        self._fault.sensor_names = list(arm.sensor_names)

    def state(self, estimate, diagnosis, mode, stamp):
        """lpv_msgs/StateEstimate of an estimate.

        Parameters
        ----------
        estimate : Estimate
            The estimate.
        diagnosis : Diagnosis
            Supplies the confirmed faults.
        mode : Mode
            State of the observer.
        stamp : int
            [ns].

        Returns
        -------
        lpv_msgs.msg.StateEstimate
            The same object at every call.
        """
        message = self._state
        set_stamp(message.header.stamp, stamp)
        message.position, message.velocity = estimate.position, estimate.velocity
        message.compensated_position = self._joints.joint_from_sensor(
            estimate.sensor_position - diagnosis.confirmed_fault)
        message.measured_position = estimate.measured_position
        message.measured_velocity = estimate.measured_velocity
        message.mode = int(mode)
        return message

    def no_estimate(self, stamp):
        """lpv_msgs/StateEstimate that says that there is none.

        Parameters
        ----------
        stamp : int
            [ns].

        Returns
        -------
        lpv_msgs.msg.StateEstimate
            Of mode NO_ESTIMATE.
        """
        message = StateEstimate(mode=int(Mode.NO_ESTIMATE))
        message.header.frame_id = self._arm.name
        set_stamp(message.header.stamp, stamp)
        return message

    def fault(self, estimate, diagnosis, states, stamp):
        """lpv_msgs/FaultEstimate of an estimate.

        Parameters
        ----------
        estimate : Estimate
            The estimate.
        diagnosis : Diagnosis
            Bounds and alarms.
        states : sequence of SensorState
            State per sensor.
        stamp : int
            [ns].

        Returns
        -------
        lpv_msgs.msg.FaultEstimate
            The same object at every call.
        """
        message = self._fault
        set_stamp(message.header.stamp, stamp)
        message.estimate, message.bound = estimate.fault, diagnosis.bound
        message.threshold = diagnosis.threshold
        message.state = [int(s) for s in states]
        message.alarm = [bool(a) for a in diagnosis.alarm]
        return message

    def alarm(self, alarm, stamp):
        """lpv_msgs/FaultAlarm of an event.

        Parameters
        ----------
        alarm : Alarm
            The event.
        stamp : int
            [ns].

        Returns
        -------
        lpv_msgs.msg.FaultAlarm
            A new message.
        """
        message = FaultAlarm(
            sensor=alarm.sensor, sensor_index=alarm.sensor_index, event=int(alarm.event),
            size=alarm.size, bound=alarm.bound, kind=alarm.kind, confidence=alarm.confidence)
        message.header.frame_id = self._arm.name
        set_stamp(message.header.stamp, stamp)
        set_stamp(message.onset, alarm.onset)
        set_stamp(message.detected, alarm.detected)
        return message
