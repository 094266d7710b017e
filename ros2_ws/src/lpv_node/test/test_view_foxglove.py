import asyncio
import json
import re
import socket
from contextlib import contextmanager, suppress

import pytest
from places import PACKAGES
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from test_view_server import GUARD, aiohttp, connected, get, send

from lpv_node.view.access import Access
from lpv_node.view.foxglove_bridge import FoxgloveBridge, gate
from lpv_node.view.scene import Scene
from lpv_node.view.server import ViewServer
from lpv_node.view.topics import TOPICS as LISTENED

pytest.importorskip('foxglove', reason='foxglove-sdk is not installed')
APP = 'https://app.foxglove.dev'
TOPICS = {
    '/lpv/arm_markers': ('visualization_msgs/msg/MarkerArray', 0),
    '/lpv/text': ('std_msgs/msg/String', 1),
    '/lpv/fault_alarm': ('lpv_msgs/msg/FaultAlarm', 2),
}  # fmt: skip

HOSTILE = (
    '', '{', b'\x00\xff', '[' * 1500, '{"op": "subscribe", "subscriptions": [{"id": -1}]}',
    '{"op": "fetchAsset", "uri": "file:///etc/passwd", "requestId": 1}',
    '{"op": "setParameters", "parameters": [{"name": "x", "value": 1e400}]}',
    '{"op": "advertise", "channels": [{"id": 1, "topic": "/x", "encoding": "json"}]}',
)  # fmt: skip


@contextmanager
def bridge(arm):
    running = FoxgloveBridge('test', TOPICS, '/lpv/fault_band')
    access = Access('127.0.0.1', '', (), (APP,))
    server = ViewServer(access, arm.sensor_names, lambda *_: True)
    try:
        (port,) = server.start([(gate(access, running.address, running.port), '127.0.0.1', 0)])
        yield running, port
    finally:
        server.stop()
        running.stop()


class Viewer:
    def __init__(self, ws):
        self.ws, self.channels = ws, {}

    async def start(self, count=4):  # TOPICS and the band
        info = await self.ws.receive_json(timeout=GUARD)
        assert info['op'] == 'serverInfo'
        while len(self.channels) < count:
            message = await self.ws.receive_json(timeout=GUARD)
            assert message['op'] == 'advertise'
            self.channels.update({c['id']: c for c in message['channels']})
        wanted = [{'id': 100 + i, 'channelId': i} for i in self.channels]
        await self.ws.send_json({'op': 'subscribe', 'subscriptions': wanted})
        return info

    async def next(self, timeout=GUARD):
        """Topic, time [ns] and bytes of the next message."""
        message = await self.ws.receive(timeout=timeout)
        assert message.type == aiohttp.WSMsgType.BINARY and message.data[0] == 1, message
        channel = self.channels[int.from_bytes(message.data[1:5], 'little') - 100]
        return channel['topic'], int.from_bytes(message.data[5:13], 'little'), message.data[13:]


def connect(port, **headers):
    return connected(f'http://127.0.0.1:{port}/', protocols=['foxglove.sdk.v1'], headers=headers)


def decode(channel, data):
    """A message read with nothing but what the channel advertises, as Foxglove reads it."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel['schema'], channel['schemaName']))
    return store.deserialize_cdr(data, channel['schemaName'])


def test_given_a_client_when_it_subscribes_then_it_can_read_messages_by_the_schema_alone(paper_arm):
    scene = Scene(paper_arm)
    arms = {'true': [1.0, 0.5], 'estimated': [1.1, 0.4], 'measured': None}
    stamp = 12_000_000_034

    async def session(running, port):
        async with connect(port, Origin=APP) as ws:
            viewer = Viewer(ws)
            info = await viewer.start()
            assert info['capabilities'] == [], 'clients can only look'
            data, messages = serialize_message(scene.markers(arms, stamp)), {}
            band = {'estimate': [0.1, 0.2], 'bound': [0.3, 0.3], 'threshold': [0.4, 0.5]}
            for _ in range(300):  # until the server has heard of the subscriptions
                running.send('/lpv/arm_markers', data, stamp)
                running.send_band(band, stamp)
                with suppress(asyncio.TimeoutError):
                    topic, *messages[topic] = await viewer.next(timeout=0.2)
                if len(messages) == 2:
                    break
            return viewer.channels, messages

    with bridge(paper_arm) as (running, port):
        channels, messages = asyncio.run(session(running, port))
    by_topic = {c['topic']: c for c in channels.values()}
    for topic, (msgtype, _) in TOPICS.items():
        told = {'schemaName': msgtype, 'encoding': 'cdr', 'schemaEncoding': 'ros2msg'}
        assert told.items() <= by_topic[topic].items()
    assert {time for time, _ in messages.values()} == {stamp}
    markers = decode(by_topic['/lpv/arm_markers'], messages['/lpv/arm_markers'][1]).markers
    assert {m.ns for m in markers} == {'true', 'estimated'}
    assert [(m.header.stamp.sec, m.header.stamp.nanosec) for m in markers] == [(12, 34)] * 4
    band = json.loads(messages['/lpv/fault_band'][1])
    assert band['upper'] == pytest.approx([0.4, 0.5]) and band['threshold_low'] == [-0.4, -0.5]


def test_given_latched_messages_when_a_client_comes_late_then_it_alone_gets_the_last(paper_arm):
    async def late_ones(port):
        async with connect(port) as hostile:  # nobody minds
            for message in HOSTILE:
                await send(hostile, message)
        async with connect(port) as early, connect(port) as late:
            viewers, got = (Viewer(early), Viewer(late)), []
            for viewer in viewers:
                await viewer.start()
                got.append([await viewer.next() for _ in range(3)])
            for viewer in viewers:
                with pytest.raises(asyncio.TimeoutError):
                    await viewer.next(timeout=0.3)
            return got

    with bridge(paper_arm) as (running, port):
        for k in range(5):
            running.send('/lpv/fault_alarm', b'\0\1\0\0%d' % k, 10 + k)
        running.send('/lpv/text', b'\0\1\0\0text', 5)
        got = asyncio.run(late_ones(port))
    for received in got:
        alarms = [data for topic, _, data in received if topic == '/lpv/fault_alarm']
        assert alarms == [b'\0\1\0\0%d' % k for k in (3, 4)]
        # Not before the present, or the client's time line would begin there.
        assert min(time for _, time, _ in received) >= 13


def test_given_the_bridge_when_it_listens_then_only_this_machine_and_origin_can_reach_it(paper_arm):
    async def attempt(port, headers):
        async with connect(port, **headers):
            pass

    with bridge(paper_arm) as (running, port):
        for headers in {'Origin': f'{APP}.evil.example'}, {'Host': 'evil.example'}:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                asyncio.run(attempt(port, headers))
            assert refused.value.status == 403
        assert running.address.startswith('127.')
        assert running.address != '127.0.0.1', 'nobody can guess it'
        pytest.raises(OSError, socket.create_connection, ('127.0.0.1', running.port), 1.0)
        assert get(f'http://127.0.0.1:{port}')[0] == 400


def test_given_the_layout_when_read_then_every_topic_in_it_is_forwarded():
    made = {'arm_markers', 'fault_band'}
    known = {'/lpv/' + name for name in made | {t.name for t in LISTENED}} | {'/diagnostics'}
    text = (PACKAGES / 'lpv_node' / 'layout' / 'lpv_foxglove.json').read_text()
    named = {name.split('.')[0] for name in re.findall(r'"(/[^" ]*)"', text)}
    assert len(named) >= 8 and named <= known
