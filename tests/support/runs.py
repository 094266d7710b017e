"""Small recorded runs, and reading of the pages that reports make of them."""

import html
import re

import numpy as np

from lpv_bag.rosbag.messages import BagMessages
from lpv_bag.rosbag.writing import BagWriter
from lpv_core.control.tracking import TrackingController
from lpv_core.monitoring.serial_monitor import SerialSensorMonitor
from lpv_core.simulation.arm_simulator import ArmSimulator
from lpv_core.support.timestamps import NANOSECONDS

MEASURED = {'joint_states', 'torque_command', 'state_estimate', 'fault_estimate', 'fault_alarm'}
ALL = MEASURED | {'ground_truth', 'reference'}


class Recorder:
    """Writes chosen streams below /lpv."""

    TYPES = {
        'joint_states': 'sensor_msgs/msg/JointState',
        'reference': 'JointReference',
        'ground_truth': 'GroundTruth',
        'torque_command': 'TorqueCommand',
        'state_estimate': 'StateEstimate',
        'fault_estimate': 'FaultEstimate',
        'fault_alarm': 'FaultAlarm',
    }

    def __init__(self, path, streams):
        self._writer, self._streams = BagWriter(path), streams
        self._messages = BagMessages(self._writer.typestore, 'paper')
        for name in sorted(streams):
            self._writer.add_topic(f'/lpv/{name}', self._type(name))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._writer.close()

    def _type(self, name):
        kind = self.TYPES[name]
        return kind if '/' in kind else f'lpv_msgs/msg/{kind}'

    def measure(self, stamp, *values):
        message = self._messages.joint_state(stamp, ('joint1', 'joint2'), *values)
        self._writer.write('/lpv/joint_states', stamp, message)
        return message

    def stream(self, name, stamp, **fields):
        if name in self._streams:
            self._writer.write(
                f'/lpv/{name}', stamp, self._messages.make(self._type(name), stamp, fields)
            )


def record(path, arm, gains, scenario, streams=ALL):
    """Bag of a simulated closed loop."""
    plant, controller = ArmSimulator(arm, scenario), TrackingController(arm, gains)
    monitor = SerialSensorMonitor('/lpv/uio', arm, gains=gains)
    course = scenario.path(arm)
    with Recorder(path, streams) as bag:
        for k in range(int(round(scenario.duration / arm.sample_time)) + 1):
            stamp = round(plant.time * NANOSECONDS)
            sense, truth = plant.sense()
            answer = monitor.take(
                stamp, bag.measure(stamp, sense.position, sense.velocity, sense.effort)
            )
            bag.stream(
                'ground_truth',
                stamp,
                position=truth.position,
                velocity=truth.velocity,
                torque=sense.effort,
                fault=truth.fault,
                disturbance=truth.disturbance,
            )
            bag.stream('state_estimate', stamp, **answer.state)
            bag.stream('fault_estimate', stamp, **answer.fault)
            for fields in answer.alarms:
                bag.stream('fault_alarm', stamp, **fields)
            reference = course.sample(stamp / NANOSECONDS)
            position = np.array(answer.state['compensated_position'])
            torque = controller.update(
                reference,
                position,
                np.array(answer.state['velocity']),
                position,
                arm.sample_time if k else 0.0,
            ).torque
            bag.stream(
                'reference',
                stamp,
                position=reference.position,
                velocity=reference.velocity,
                acceleration=reference.acceleration,
                tip_position=reference.tip,
            )
            bag.stream('torque_command', stamp, torque=torque, safe_stop=False)
            plant.step(torque)
    return path


def rows(page):
    """Cells of all table rows of a page, as text."""
    return [
        [
            html.unescape(re.sub('<[^>]*>', '', cell)).strip()
            for cell in re.findall(r'<t[dh][^>]*>(.*?)</t[dh]>', row, re.DOTALL)
        ]
        for row in re.findall(r'<tr>(.*?)</tr>', page, re.DOTALL)
    ]


def text(page):
    """What a reader sees of a page, on one line."""
    return ' '.join(html.unescape(re.sub('<[^>]*>', ' ', page)).split())
