"""Recorder node: topics into a rosbag2 directory, byte for byte as received."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rosbags.interfaces import Qos

from lpv.bag.rosbag.live import DEEPEST
from lpv.bag.rosbag.message_loss import TopicCount
from lpv.bag.rosbag.output_folder import (
    GAINS_NAME,
    SCENARIO_NAME,
    copy_file,
    free_path,
    read_run_file,
)
from lpv.bag.rosbag.writing import PRESETS, BagWriter
from lpv.bag.run.record import ALARMS, CORRECTED, DIAGNOSTICS, STREAMS
from lpv.core.monitoring.message_fields import ERROR, OK, WARN
from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import AT_ONCE
from lpv.core.support.options import Entry
from lpv.core.support.timestamps import NANOSECONDS
from lpv_node.arguments import one_line
from lpv_node.managed import ManagedNode, RCLError
from lpv_node.parameters import named_file, required_path, table
from lpv_node.recorder.input import MOST, Heard, RecorderInput, Selection
from lpv_node.recorder.stamp_sorter import WINDOW, StampSorter
from lpv_node.status import diagnostics

SPECS = table("""
output FOLDER        bag directory to create; if it exists, one with a number behind its name is
                     made
all                  record all topics but hidden and excluded ones, not those of "topics"
split_size=0[0:1048576]  size at which a new file is begun; 0 for never [MiB]
split_duration=0.0[0:1e6]  log time after which a new file is begun; 0 for never [s]
flush_period=0.25[0.02:0.5]  longest time that a message stays in this process; in lockstep chunks
                     are cut by stamps instead [s]
fsync                wait after each chunk until it is on the disk: a power failure then loses no
                     more than a crash
gains_file FILE      gains file of this run, copied into the bag as gains.yaml; may be empty
scenario_file FILE   scenario file of this run, copied into the bag as scenario.yaml; may be empty
""") + (
    Entry('topics', "topics to record; relative names are resolved in the node's namespace",
          [*STREAMS, CORRECTED, ALARMS, DIAGNOSTICS]),
    Entry('preset', 'compression', 'zstd_fast', choices=tuple(PRESETS)),
    Entry('exclude', 'patterns of topics that "all" leaves out, as of a shell, against full names',
          ['/rosout', '/parameter_events']),
)  # fmt: skip
_RUN_FILES = ((GAINS_NAME, 'gains_file', 'gains'), (SCENARIO_NAME, 'scenario_file', 'scenarios'))
"""Of each file that is copied into a bag the copy, the parameter, and the kind of shipped ones."""
_POLL = 0.1 * AT_ONCE
"""Between two looks at what has come, ten in what seems immediate [s]."""
_SPARE = PRESETS['none'][1]
"""Free space that is left alone, a chunk: what is to be written at the end needs some [bytes]."""


class RecorderNode(ManagedNode):
    """Records topics as soon as they have a publisher, with its QoS.

    Messages are stored as they came, and the log time is the time of reception.  In lockstep it is
    the message's own stamp, messages are sorted, and the padding between their fields is zeroed, so
    that runs with the same seed give the same bag byte by byte.
    """

    drain_time = WINDOW / NANOSECONDS

    def __init__(self) -> None:
        super().__init__('recorder', SPECS)
        self._writer: BagWriter | None = None
        self._input: RecorderInput | None = None
        self._forget()
        self._taken, self._flushed = 0, 0.0
        self._stopping: int | None = None  # when the node was told to stop, monotonic [ns]
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._label = f'{self.get_fully_qualified_name()}: recording'
        # Nobody wants to read in a bag how it was written; and it would differ between runs.
        self._own_mark = self._label.encode() + b'\0'

    def _forget(self) -> None:
        """Forget the recording before this one."""
        self._announced: dict[str, Qos] = {}  # topics that the bag does not have yet
        self._types: dict[str, str] = {}
        self._counts: dict[str, TopicCount] = {}
        self._failure = ''
        self._order = StampSorter(self._write_sorted)

    def setup(self) -> None:
        """Open the bag."""
        self._forget()
        value = {spec.name: self.get_parameter(spec.name).value for spec in SPECS}
        names = frozenset(map(self._topic, value['topics']))
        if not names and not value['all']:
            raise ConfigError('topics', 'names no topic, and "all" is not set', self.get_name())
        self._selection = Selection(frozenset() if value['all'] else names, tuple(value['exclude']))
        self._flush_period = value['flush_period']
        files = {
            copy: read_run_file(named_file(self, name, kind), copy)
            for copy, name, kind in _RUN_FILES
            if value[name]
        }
        output = required_path(self, 'output')
        path = free_path(output)
        if str(path) != str(Path(output)):
            self.get_logger().warning(f'{output} exists already: recording into {path}')
        self._writer = BagWriter(
            *(path, value['preset'], value['split_size'] << 20),
            *(round(value['split_duration'] * 1e9), WINDOW if self.lockstep else 0),
            value['fsync'],
        )
        for name, content in files.items():
            copy_file(content, path, name)

    def _topic(self, name: str) -> str:
        """Full name of a topic; ConfigError for what cannot be one."""
        try:
            return self.resolve_topic_name(name)
        except RCLError as error:
            raise ConfigError('topics', f'{name!r}: {one_line(error)}', self.get_name()) from error

    def listen(self) -> None:
        """Open another bag if that of `setup` is closed: the node was active before."""
        if self._writer is None:
            self.setup()

    def begin(self) -> None:
        """Listen to the wanted topics."""
        assert self._writer is not None  # `listen` has opened one, or activation has failed
        self._input = RecorderInput(self, self._selection, partial(self._writer.describe, ''))
        self.steady_timer(0.05, self._search)
        self.steady_timer(_POLL, self._poll_in_time)
        self.steady_timer(1.0, self._report)
        what = f'{len(self._selection.names)} topics' if self._selection.names else 'all topics'
        self.get_logger().info(f'recording {what} into {self._writer.path}')

    def stopping(self) -> None:
        """Note the time: what was published until now is still recorded."""
        self._stopping = time.monotonic_ns()

    def progress(self) -> int:
        """Messages taken so far that were published before the node was told to stop."""
        return self._taken

    def end(self) -> None:
        """Take what is left, and close the bag."""
        for _ in range(DEEPEST // MOST):  # no queue holds more
            self._poll()
        self._order.flush()
        if self._writer is not None:
            self._close(self._writer)
            self._report()

    def teardown(self) -> None:
        """Close the bag of a recording that never began."""
        self.end()

    def _search(self) -> None:
        if self._input is None:
            return
        for topic, msgtype, offered in self._input.search():
            self._announced[topic], self._types[topic] = offered, msgtype
            self._counts[topic] = TopicCount()

    def _poll_in_time(self) -> None:
        """Take what has come, once there is a time to log it with; queues hold it until then."""
        if self.lockstep or self.has_time():
            self._poll()

    def _poll(self) -> None:
        found = self._input.poll() if self._input is not None else []
        # The system's clock may be set meanwhile: it only tells how old a message is now.
        since = 0 if self._stopping is None else time.monotonic_ns() - self._stopping
        newest = time.time_ns() - since
        for heard in found:
            self._taken += self._stopping is None or heard.sent < newest
            own = heard.topic == '/diagnostics' and self._own_mark in heard.data
            if self._writer is not None and not own:
                self._take(self._writer, heard)
        if self._writer is not None and time.monotonic() - self._flushed >= self._flush_period:
            self._flush(self._writer)

    def _take(self, writer: BagWriter, heard: Heard) -> None:
        count = self._counts[heard.topic]
        count.take(heard.publisher, heard.sequence)
        if not self.lockstep:
            if heard.stamp is not None:
                count.stamp(heard.stamp)
            use_clock = self.get_parameter('use_sim_time').value or not heard.received
            now = self.get_clock().now().nanoseconds if use_clock else heard.received
            self._write(heard.topic, now, heard.data, heard.sent or now)
        elif heard.stamp is not None:
            # Runs with one seed are to give the same bytes, garbage between fields included.
            data = writer.without_garbage(self._types[heard.topic], heard.data)
            self._order.add(heard.topic, heard.stamp, data, heard.publisher)
        else:
            self._write(heard.topic, self.get_clock().now().nanoseconds, heard.data)

    def _write_sorted(self, topic: str, stamp: int, data: bytes) -> None:
        self._counts[topic].stamp(stamp)  # in the order of the bag: that of arrival is any
        self._write(topic, stamp, data)

    def _write(self, topic: str, stamp: int, data: bytes, sent: int | None = None) -> None:
        if self._writer is None:
            return
        try:
            # New topics are announced in the order of their names, not of their discovery.
            for name in sorted(self._announced):
                self._writer.add_topic(name, self._types[name], [self._announced.pop(name)])
            # A driver that does not know the time may stamp with anything; a bag cannot.
            published = None if sent is None else max(0, sent)
            self._writer.write_raw(topic, max(0, stamp), data, published)
        except OSError as error:
            self._fail(error.strerror or str(error))

    def _flush(self, writer: BagWriter) -> None:
        self._flushed = time.monotonic()
        try:
            if writer.room() < _SPARE:
                self._fail('no space left on device')
            elif not self.lockstep:
                writer.flush()
        except OSError as error:
            self._fail(error.strerror or str(error))

    def _fail(self, reason: str) -> None:
        """Stop recording; the node continues and reports it."""
        if self._failure:
            return
        self._failure, self.exit_code = reason, 1
        if self._writer is not None:
            self._close(self._writer)
        self.get_logger().fatal(f'recording stopped: {reason}; {self._kept}')
        self._report()

    def _close(self, writer: BagWriter) -> None:
        self._writer = None
        if self._input is not None:
            self._input.close()
            self._input = None
        total = sum(writer.counts.values())
        missing = writer.close({t: count.known() for t, count in sorted(self._counts.items())})
        self._kept = f'bag closed with {total} messages, {writer.size} bytes'
        if silent := sorted(self._selection.names - {t for t, n in writer.counts.items() if n}):
            self._kept += f', nothing of {", ".join(silent)}'
        if missing:
            self._kept += f', without {missing}: lpv recover repairs it'
        self.get_logger().info(self._kept)

    def _report(self) -> None:
        """State of the recording on /diagnostics."""
        lost = sum(count.lost for count in self._counts.values())
        refused = {} if self._input is None else self._input.refused
        level, text = OK, 'recording' if self._writer is not None else 'bag closed'
        if self._failure:
            level, text = ERROR, f'recording stopped: {self._failure}'
        elif lost or refused:
            text = f'{lost} messages lost' if lost else 'some topics are not recorded'
            level = WARN
        values: dict[str, object] = {} if self._writer is None else {
            'bytes': self._writer.size, 'files': self._writer.files}  # fmt: skip
        values |= {f'{topic} not recorded': why for topic, why in refused.items()}
        for topic, count in sorted(self._counts.items()):
            values |= {f'{topic} {name}': value for name, value in count.known().items()}
        now = self.get_clock().now().nanoseconds
        status = {'level': level, 'name': self._label, 'message': text, 'hardware_id': ''}
        self._diagnostics.publish(diagnostics(now, [{**status, 'values': values}]))
