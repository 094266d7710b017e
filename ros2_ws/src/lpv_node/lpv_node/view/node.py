"""Live view node: the page, the Foxglove protocol, markers."""

import os
import socket
import time
from functools import partial
from typing import Any

from rclpy.serialization import serialize_message
from visualization_msgs.msg import MarkerArray

from lpv.bag.rosbag.live import type_name
from lpv.core.monitoring.message_fields import OK, WARN
from lpv.core.serial_arm.arm_file import load_arm
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.limits import AT_ONCE
from lpv.core.support.options import Entry
from lpv_node.input_check import Refusals
from lpv_node.managed import VIEWER, ManagedNode
from lpv_node.parameters import named_file, table
from lpv_node.status import StatusReporter
from lpv_node.view.access import Access
from lpv_node.view.foxglove_bridge import BAND, FoxgloveBridge, gate, sdk_is_installed
from lpv_node.view.model import LiveModel
from lpv_node.view.requests import Requests
from lpv_node.view.scene import Scene
from lpv_node.view.server import ViewServer
from lpv_node.view.topics import TOPICS, Inbox

SPECS = table("""
arm_file FILE       arm file (YAML), or name of a shipped arm
scenario_file FILE  scenario file (YAML) whose path and obstacle are drawn; may be empty
address=127.0.0.1   where to listen; anything but a loopback address lets others see the page, and
                    its buttons then need the token
port=8090[0:65535]  port of the page; 0 takes a free one
foxglove_port=8765[0:65535]  port of the Foxglove WebSocket protocol; 0: off
foxglove_rate=100.0[1:1000]  most messages of a fast topic sent to Foxglove [1/s]
rate=25.0[1:60]     frames and markers [1/s]
""") + (
    Entry('foxglove_origins', 'web origins that may connect to the Foxglove port',
          ['https://app.foxglove.dev', 'file://']),
    Entry('hosts', 'further names of this machine under which the page is called', ['']),
)  # fmt: skip
MARKERS = 'arm_markers'
_TOKEN_VARIABLE = 'LPV_VIEW_TOKEN'


class ViewNode(ManagedNode):
    """Live view of the running graph.

    Topics: subscribes all that the graph publishes, the ground truth included, but only looks;
    publishes ``arm_markers`` (visualization_msgs/MarkerArray) and ``/diagnostics``.  Calls
    ``arm_sim/inject_fault``, ``arm_sim/clear_faults`` and ``uio/reset`` for the buttons.
    """

    # What a start that fails leaves behind; the parameters are checked before anything is made.
    _server: ViewServer | None = None
    _foxglove: FoxgloveBridge | None = None
    _requests: Requests | None = None

    def __init__(self) -> None:
        super().__init__(VIEWER, SPECS)

    def setup(self) -> None:
        """Read the files, open the ports, create publishers."""
        arm = load_arm(named_file(self, 'arm_file', 'arms'))
        scenario = self.get_parameter('scenario_file').value
        path = None
        if scenario:
            path = load_scenario(named_file(self, 'scenario_file', 'scenarios')).path(arm)
        self._model = LiveModel(arm, path)
        self._scene = Scene(arm, path)
        self._ticks, self._alarms_due, self._inboxes = 0, 0.0, list[Inbox]()
        self._requests, self._refusals = Requests(self), Refusals(self)
        self._status = StatusReporter(self, 'page', arm.name)
        self._markers_out = self.create_publisher(MarkerArray, MARKERS, 1)
        self._open(arm, self._requests)
        bridge = self._foxglove
        period = 1.0 / self.get_parameter('foxglove_rate').value
        for topic in TOPICS:
            name = self.resolve_topic_name(topic.name)
            forward = partial(bridge.forward, name, topic.every) if bridge else None
            self._inboxes.append(Inbox(topic, forward, period, self._refusals.add))
        self.steady_timer(1.0 / self.get_parameter('rate').value, self._tick)

    def _open(self, arm: SerialArm, requests: Requests) -> None:
        """Open the ports; says once where they are."""
        value = {spec.name: self.get_parameter(spec.name).value for spec in SPECS}
        address = value['address']
        access = Access(address, os.environ.get(_TOKEN_VARIABLE, ''), value['hosts'])
        self._server = ViewServer(access, arm.sensor_names, requests.submit)
        sites = [(self._server.application(), address, value['port'])]
        if value['foxglove_port'] and not sdk_is_installed():
            self.get_logger().info('Foxglove: off, as foxglove-sdk is not installed')
        elif value['foxglove_port']:
            # Of each topic its type and the number of messages kept for late clients.
            kinds = {one.name: one.kind for one in TOPICS} | {MARKERS: MarkerArray}
            topics = {
                self.resolve_topic_name(name): (type_name(kind), 50 if name == 'fault_alarm' else 0)
                for name, kind in kinds.items()
            }
            band = self.resolve_topic_name(BAND)
            self._foxglove = FoxgloveBridge(f'lpv {self.get_namespace()}', topics, band)
            origins = Access(address, '', value['hosts'], value['foxglove_origins'])
            door = gate(origins, self._foxglove.address, self._foxglove.port)
            sites.append((door, address, value['foxglove_port']))
        ports = self._server.start(sites)
        shown = socket.gethostname() if address in ('0.0.0.0', '::') else address
        shown = f'[{shown}]' if ':' in shown else shown
        self.get_logger().info(f'page: http://{shown}:{ports[0]}/')
        if access.token:
            # Printed, not logged: logs are published on /rosout and kept in files.
            print(
                f'buttons of the page need the token {access.token}\n'
                f'  http://{shown}:{ports[0]}/#token={access.token}',
                flush=True,
            )
        if len(ports) > 1:
            self.get_logger().info(f'Foxglove: ws://{shown}:{ports[1]}')

    def begin(self) -> None:
        """Subscribe, take commands."""
        for inbox in self._inboxes:
            topic = inbox.topic
            self.create_subscription(topic.kind, topic.name, inbox.store, topic.qos, raw=True)
        if self._requests is not None:
            self._requests.open(True)

    def end(self) -> None:
        """Take no commands."""
        if self._requests is not None:
            self._requests.open(False)

    def teardown(self) -> None:
        """Close the ports."""
        if self._server is not None:
            self._server.stop()
        if self._foxglove is not None:
            self._foxglove.stop()
        if self._requests is not None:
            self._requests.close()
        self._server = self._foxglove = self._requests = None

    def destroy_node(self) -> None:
        """Close the ports, however the node ends."""
        self.teardown()
        super().destroy_node()

    def _tick(self) -> None:
        if self._requests is None or self._server is None:
            return
        self._requests.work()
        for inbox in self._inboxes:
            source = inbox.topic.name.lstrip('/')
            for received, message in inbox.take():
                if not self._model.take(source, message, received):
                    self._refusals.add(f'messages on {inbox.topic.name} that are of another arm')
        now = time.monotonic()
        every_second = self._ticks % round(self.get_parameter('rate').value) == 0
        self._ticks += 1
        if every_second:
            self._model.services = self._requests.available()
        frame = self._model.frame(now)
        self._report()
        # In a storm of alarms, no client is to drown in lists.
        if self._model.alarms.changed and now >= self._alarms_due:
            self._model.alarms.changed, self._alarms_due = False, now + AT_ONCE
            self._server.tell({'type': 'alarms', 'alarms': self._model.alarms.rows()})
        if self._server.newcomers:
            self._server.welcome(self._model.hello())
        self._server.frame(frame)
        self._publish_arms(self._model.arms(now), frame['sample'], every_second)

    def _report(self) -> None:
        """The node's own status, once a second of the graph's time, which may be simulated."""
        clients = len(self._server.clients) if self._server is not None else 0
        count, refused = sum(self._refusals.counts.values()), self._refusals.is_recent
        status = (WARN, f'{count} messages refused') if refused else (OK, 'page is served')
        values = {'pages': clients, **self._refusals.counts}
        self._status.report(self._model.stamp() or 0, *status, lambda: values)

    def _publish_arms(self, arms: dict[str, Any], sample: dict[str, Any], with_path: bool) -> None:
        stamp = self._model.stamp()
        if stamp is None or not any(arms.values()):
            return
        data = serialize_message(self._scene.markers(arms, stamp, with_path))
        self._markers_out.publish(data)
        if self._foxglove is not None:
            self._foxglove.send_band(sample, stamp)
            self._foxglove.send(self._markers_out.topic_name, data, stamp)
