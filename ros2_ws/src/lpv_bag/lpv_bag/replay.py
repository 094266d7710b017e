"""Offline run of the diagnosis over a recorded bag, with the node's own code."""

from collections import Counter
from dataclasses import dataclass, field

from lpv_bag.messages import BagMessages
from lpv_bag.run_record import find_topic, open_bag, stamp_of
from lpv_bag.writing import BagWriter, qos_profile
from lpv_core.errors import SampleError
from lpv_core.joints import JointMap

_OUTPUTS = {'state': ('state_estimate', 'lpv_msgs/msg/StateEstimate'),
            'fault': ('fault_estimate', 'lpv_msgs/msg/FaultEstimate'),
            'alarm': ('fault_alarm', 'lpv_msgs/msg/FaultAlarm')}
_DIAGNOSTICS = ('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray')
_COMMAND = ('torque_command', 'lpv_msgs/msg/TorqueCommand')


@dataclass
class ReplayResult:
    """What a replay found.

    Attributes
    ----------
    measurements : int
        Samples read.
    rejected : collections.Counter
        Reasons of samples that could not be used, with how often.
    events : list of Alarm
        Alarm events.
    """

    measurements: int = 0
    rejected: Counter = field(default_factory=Counter)
    events: list = field(default_factory=list)


class Replay:
    """Runs a monitor over a bag and writes a bag with what it answers.

    Parameters
    ----------
    monitor : SensorMonitor
        Fresh observer and diagnosis.
    topic : str, optional
        Topic of the measurements, where the bag has several of type JointState.
    torque_from_command : bool, optional
        Take torques from the recorded commands in place of the measured effort.
    injector : FaultInjector, optional
        Faults to add to the measurements, to see what the diagnosis makes of them.
    on_event : callable, optional
        Called with every alarm event.
    """

    def __init__(self, monitor, topic=None, torque_from_command=False, injector=None,
                 on_event=None):
        self._monitor, self._topic, self._injector = monitor, topic, injector
        self._torque_from_command = torque_from_command
        self._on_event = on_event or (lambda event: None)
        self._torque = [float('nan')] * 2
        self._start = None

    def run(self, bag, out):
        """Replay one bag.

        All topics are copied, except earlier answers of the same monitor, which are replaced.

        Parameters
        ----------
        bag, out : str or pathlib.Path
            Bag to read, bag to create.

        Returns
        -------
        ReplayResult
            What was found.

        Raises
        ------
        BagError
            If the bag cannot be read or lacks measurements.
        ConfigError
            If the new bag cannot be made.
        """
        result = ReplayResult()
        with open_bag(bag) as reader:
            measured = find_topic(reader, 'sensor_msgs/msg/JointState', 'joint_states',
                                  self._topic)
            self._prefix = measured.topic.rsplit('/', 1)[0]
            self._monitor.name = f'{self._prefix}/uio'
            commands = self._commands(reader)
            with BagWriter(out) as writer:
                self._announce(reader, writer)
                for connection, time, data in reader.messages():
                    if connection.topic == measured.topic:
                        message = reader.deserialize(data, connection.msgtype)
                        self._measure(writer, connection, time, message, data, result)
                        continue
                    if commands is not None and connection.topic == commands.topic:
                        self._torque = reader.deserialize(data, connection.msgtype).torque
                    if self._is_kept(reader, connection, data):
                        writer.write_raw(connection.topic, time, data)
        return result

    def _commands(self, reader):
        if not self._torque_from_command:
            return None
        return find_topic(reader, _COMMAND[1], _COMMAND[0], f'{self._prefix}/{_COMMAND[0]}')

    def _announce(self, reader, writer):
        own = {f'{self._prefix}/{name}': msgtype for name, msgtype in _OUTPUTS.values()}
        for connection in reader.connections:
            if connection.topic not in own:
                writer.copy_topic(connection)
        for topic, msgtype in (*own.items(), _DIAGNOSTICS):
            if topic not in writer.counts:
                latched = topic.endswith('/fault_alarm')
                writer.add_topic(topic, msgtype, [qos_profile(True, latched, 50)])
        self._messages = BagMessages(writer.typestore, self._monitor.arm.name)
        self._own = own

    def _is_kept(self, reader, connection, data):
        if connection.topic in self._own:
            return False
        if connection.topic != _DIAGNOSTICS[0]:
            return True
        status = reader.deserialize(data, connection.msgtype).status
        return not (status and status[0].name.startswith(f'{self._monitor.name}: '))

    def _measure(self, writer, connection, time, message, data, result):
        result.measurements += 1
        stamp = stamp_of(message.header.stamp)
        if self._injector is not None:
            self._inject(message, stamp)
            writer.write(connection.topic, time, message)
        else:
            writer.write_raw(connection.topic, time, data)
        try:
            answer = self._monitor.take(stamp, message,
                                        self._torque if self._torque_from_command else None)
        except SampleError as error:
            result.rejected[str(error)] += 1
            return
        if answer is not None:
            self._write(writer, time, answer)
            for event in answer.events:
                result.events.append(event)
                self._on_event(event)

    def _inject(self, message, stamp):
        if self._start is None:
            self._start = stamp
        arm = self._monitor.arm
        joints = JointMap(arm)
        try:
            columns = [list(message.name).index(name) for name in arm.joint_names]
            reading = joints.sensor_position(message.position[columns])
        except (ValueError, IndexError):
            return  # the monitor will say what is wrong with this message
        faulty = self._injector.apply((stamp - self._start) / 1e9, reading, arm.sample_time)
        message.position = message.position.copy()  # what is read from a bag is read-only
        message.position[columns] = joints.joint_from_sensor(faulty)

    def _write(self, writer, time, answer):
        entries = [('state', answer.state), ('fault', answer.fault),
                   *(('alarm', fields) for fields in answer.alarms)]
        for kind, fields in entries:
            if fields is not None:
                name, msgtype = _OUTPUTS[kind]
                writer.write(f'{self._prefix}/{name}', time,
                             self._messages.make(msgtype, answer.stamp, fields))
        if answer.status is not None:
            writer.write(_DIAGNOSTICS[0], time,
                         self._messages.diagnostics(answer.stamp, answer.status))
