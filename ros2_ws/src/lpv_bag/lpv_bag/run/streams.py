"""Streams of a recorded run: which messages they are made of, and what an alarm is."""

from dataclasses import dataclass

from lpv_core.decision.diagnosis import Alarm
from lpv_core.observer.sampled_observer import NANOSECONDS

# Stream: (message type, array fields); the name is the last part of the topic's usual name.
STREAMS = {
    'joint_states': ('sensor_msgs/msg/JointState', ('position', 'velocity', 'effort')),
    'torque_command': ('lpv_msgs/msg/TorqueCommand', ('torque', 'safe_stop')),
    'state_estimate': (
        'lpv_msgs/msg/StateEstimate',
        (
            'position',
            'velocity',
            'compensated_position',
            'measured_position',
            'measured_velocity',
            'mode',
        ),
    ),
    'fault_estimate': (
        'lpv_msgs/msg/FaultEstimate',
        ('estimate', 'bound', 'threshold', 'state', 'alarm'),
    ),
    'reference': (
        'lpv_msgs/msg/JointReference',
        ('position', 'velocity', 'acceleration', 'tip_position'),
    ),
    'ground_truth': (
        'lpv_msgs/msg/GroundTruth',
        ('position', 'velocity', 'torque', 'fault', 'disturbance'),
    ),
}
"""Streams of arrays; ground_truth and reference are absent in recordings of a real arm."""

ALARMS = 'fault_alarm'
ALARM_TYPE = 'lpv_msgs/msg/FaultAlarm'


@dataclass(frozen=True)
class RecordedAlarm(Alarm):
    """An alarm event with the stamp of the measurement that decided."""

    stamp: int = 0  # [ns]


def stamp_of(stamp: object) -> int:
    """Nanoseconds of a builtin_interfaces/Time as rosbags gives it."""
    return stamp.sec * NANOSECONDS + stamp.nanosec
