"""Small recorded runs, and reading of the pages that reports make of them."""

import html
import re

import numpy as np

from lpv.bag.rosbag.messages import BagMessages
from lpv.bag.rosbag.reading import open_bag
from lpv.bag.rosbag.writing import BagWriter
from lpv.core.control.tracking import TrackingController
from lpv.core.monitoring.serial_monitor import SerialSensorMonitor
from lpv.core.simulation.arm_simulator import ArmSimulator
from lpv.core.support.timestamps import NANOSECONDS

MEASURED = {'joint_states', 'torque_command', 'state_estimate', 'fault_estimate', 'fault_alarm'}
ALL = MEASURED | {'ground_truth', 'reference'}
TRUTH = ('position', 'velocity', 'fault', 'disturbance')
MOTION = ('position', 'velocity', 'acceleration')


class Recorder:
    """Writes chosen streams below /lpv."""

    TYPES = {
        'joint_states': 'sensor_msgs/msg/JointState',
        'reference': 'lpv_msgs/msg/JointReference',
        **{
            f'{a}_{b}': f'lpv_msgs/msg/{a.title()}{b.title()}'
            for a, b in (('ground', 'truth'), ('torque', 'command'), ('state', 'estimate'),
                         ('fault', 'estimate'), ('fault', 'alarm'))
        },
    }  # fmt: skip

    def __init__(self, path, streams):
        self._writer, self._streams = BagWriter(path), streams
        self._messages = BagMessages(self._writer.typestore, 'paper')
        for name in sorted(streams):
            self._writer.add_topic(f'/lpv/{name}', self.TYPES[name])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._writer.close()

    def measure(self, stamp, *values):
        message = self._messages.joint_state(stamp, ('joint1', 'joint2'), *values)
        self._writer.write('/lpv/joint_states', stamp, message)
        return message

    def stream(self, name, stamp, **fields):
        if name in self._streams:
            message = self._messages.make(self.TYPES[name], stamp, fields)
            self._writer.write(f'/lpv/{name}', stamp, message)


def record(path, arm, gains, scenario, streams=ALL):
    """Bag of a simulated closed loop."""
    plant, controller = ArmSimulator(arm, scenario), TrackingController(arm, gains)
    monitor = SerialSensorMonitor('/lpv/uio', arm, gains=gains)
    course = scenario.path(arm)
    with Recorder(path, streams) as bag:
        for k in range(int(round(scenario.duration / arm.sample_time)) + 1):
            stamp = round(plant.time * NANOSECONDS)
            sense, truth = plant.sense()
            message = bag.measure(stamp, sense.position, sense.velocity, sense.effort)
            answer = monitor.take(stamp, message)
            fields = {name: getattr(truth, name) for name in TRUTH}
            bag.stream('ground_truth', stamp, torque=sense.effort, **fields)
            bag.stream('state_estimate', stamp, **answer.state)
            bag.stream('fault_estimate', stamp, **answer.fault)
            for fields in answer.alarms:
                bag.stream('fault_alarm', stamp, **fields)
            reference = course.sample(stamp / NANOSECONDS)
            position = np.array(answer.state['compensated_position'])
            rate, dt = np.array(answer.state['velocity']), arm.sample_time if k else 0.0
            torque = controller.update(reference, position, rate, position, dt).torque
            fields = {name: getattr(reference, name) for name in MOTION}
            bag.stream('reference', stamp, tip_position=reference.tip, **fields)
            bag.stream('torque_command', stamp, torque=torque, safe_stop=False)
            plant.step(torque)
    return path


def copied(bag, out, keep=lambda topic: True, change=lambda topic, data: data):
    """A bag with the topics that are kept, and with other bytes; None leaves a message out."""
    with open_bag(bag) as reader, BagWriter(out) as writer:
        kept = [c for c in reader.connections if keep(c.topic)]
        for connection in kept:
            writer.copy_topic(connection)
        for connection, time, data in reader.messages(kept):
            if (data := change(connection.topic, bytes(data))) is not None:
                writer.write_raw(connection.topic, time, data)
    return out


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
