"""The topics of the graph over the Foxglove WebSocket protocol, in the bytes in which they came.

The SDK's server knows no origins, so that any web page in the operator's browser could read it.  It
therefore listens on a loopback address that nobody can guess; what the outside sees is `gate`,
which checks origins and then passes bytes on.
"""

import asyncio
import contextlib
import importlib.util
import logging
import secrets
from collections import deque
from collections.abc import Callable
from typing import Any

import aiohttp
from aiohttp import WSMsgType, web

from lpv.bag.rosbag.interfaces import add_type, standard_types
from lpv.core.support.config import MAX_BYTES
from lpv.core.support.errors import ConfigError
from lpv.core.support.timestamps import NANOSECONDS, leading_stamp
from lpv_node.view.access import MOST_CLIENTS, Access
from lpv_node.view.server import HEARTBEAT, MOST_WAITING, SOCKET, guarded

Socket = web.WebSocketResponse | aiohttp.ClientWebSocketResponse
PROTOCOL = 'foxglove.sdk.v1'
BAND = 'fault_band'
"""A topic made for charts: estimate with its bound, and thresholds with both signs."""
_ROWS = {'type': 'array', 'items': {'type': 'number'}}
_BAND_SCHEMA = {
    'type': 'object',
    'title': 'FaultBand',
    'properties': {name: _ROWS for name in ('lower', 'upper', 'threshold_low', 'threshold_high')},
}


class FoxgloveBridge:
    """Foxglove server for viewing: clients can neither publish nor call services."""

    def __init__(self, name: str, topics: dict[str, Any], band: str) -> None:
        import foxglove  # which not every installation has

        foxglove.set_log_level(logging.ERROR)
        self._context = foxglove.Context()
        typestore = standard_types()
        self._channels: dict[str, Any] = {}
        self._kept: dict[str, deque[tuple[bytes, int]]] = {}
        self._newest = self._time = 0  # of all that was sent, and of what came [ns]
        for topic, (msgtype, keep) in topics.items():
            add_type(typestore, msgtype)
            text, _ = typestore.generate_msgdef(msgtype, ros_version=2)
            schema = foxglove.Schema(name=msgtype, encoding='ros2msg', data=text.encode())
            self._channels[topic] = foxglove.Channel(
                topic, message_encoding='cdr', context=self._context, schema=schema
            )
            self._kept[topic] = deque(maxlen=keep)
        self._band = foxglove.Channel(band, schema=_BAND_SCHEMA, context=self._context)
        self._server, self.address = _start(name, self._context, self.on_subscribe)
        self.port: int = self._server.port

    def forward(self, topic: str, every: bool, data: bytes) -> None:
        """Send a message in the bytes in which it came.

        Time restarts where it is old, but for those of which ``every`` one counts: they are
        latched, and sent as of now.
        """
        stamp = max(0, leading_stamp(data) or 0)
        if every:
            stamp = max(stamp, self._time)
        elif stamp < self._time - NANOSECONDS:
            self.restart()
        self._time = max(stamp, self._time)
        self.send(topic, data, stamp)

    def send(self, topic: str, data: bytes, stamp: int) -> None:
        """Forward one message of a topic's full name: CDR with its header, and its time [ns]."""
        self._newest = max(self._newest, stamp)
        kept = self._kept[topic]
        if kept.maxlen:
            kept.append((data, stamp))
        self._channels[topic].log(data, log_time=stamp)

    def send_band(self, sample: dict[str, Any], stamp: int) -> None:
        """Send estimate -+ bound and -+ threshold of `LiveModel.frame`, if known, at a stamp."""
        values = [sample[name] for name in ('estimate', 'bound', 'threshold')]
        if not any(None in row for row in values):
            estimate, bound, threshold = values
            band = {
                'lower': [e - b for e, b in zip(estimate, bound)],
                'upper': [e + b for e, b in zip(estimate, bound)],
                'threshold_low': [-t for t in threshold],
                'threshold_high': threshold,
            }
            self._band.log(band, log_time=stamp)

    def restart(self) -> None:
        """Time restarted: clients forget what they have."""
        for kept in self._kept.values():
            kept.clear()
        self._newest = self._time = 0
        self._server.clear_session()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Called by the SDK: a late client gets what was latched."""
        for data, stamp in list(self._kept.get(channel.topic, ())):
            # As of now, or the client's time line would begin with the first of them.
            time = max(stamp, self._newest)
            self._channels[channel.topic].log(data, log_time=time, sink_id=client.id)

    def stop(self) -> None:
        self._server.stop()


def sdk_is_installed() -> bool:
    """Whether there is a foxglove-sdk, which not every installation has."""
    return importlib.util.find_spec('foxglove') is not None


def _start(name: str, context: Any, on_subscribe: Callable[[Any, Any], None]) -> tuple[Any, str]:
    import foxglove

    class Listener(foxglove.websocket.ServerListener):
        """Of the SDK's events only one matters."""

        def on_subscribe(self, client: Any, channel: Any) -> None:
            on_subscribe(client, channel)

    # All of 127.0.0.0/8 is loopback on Linux; elsewhere it is one address.
    parts = '.'.join(str(secrets.randbelow(254) + 1) for _ in range(3))
    options = {'name': name, 'port': 0, 'context': context, 'server_listener': Listener()}
    options |= {'capabilities': [], 'message_backlog_size': MOST_WAITING}
    for address in (f'127.{parts}', '127.0.0.1'):
        try:
            return foxglove.start_server(host=address, **options), address
        except (OSError, RuntimeError) as error:
            failure = error
    raise ConfigError('foxglove_port', f'the Foxglove server does not start: {failure}')


def gate(access: Access, address: str, port: int) -> web.Application:
    """Application that lets accepted WebSockets through to the SDK's server at an address."""
    places = asyncio.Semaphore(MOST_CLIENTS)

    async def on_socket(request: web.Request) -> web.WebSocketResponse:
        offered = request.headers.get('Sec-WebSocket-Protocol', '')
        if PROTOCOL not in [p.strip() for p in offered.split(',')]:
            raise web.HTTPBadRequest(text=f'WebSocket with subprotocol {PROTOCOL} expected\n')
        if places.locked():
            raise web.HTTPServiceUnavailable(text='too many clients')
        async with places:
            return await _pass_on(request, f'http://{address}:{port}')

    application = guarded(access)
    application.router.add_get('/', on_socket)
    return application


async def _pass_on(request: web.Request, url: str) -> web.WebSocketResponse:
    outside = web.WebSocketResponse(protocols=[PROTOCOL], heartbeat=HEARTBEAT, **SOCKET)
    try:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(url, protocols=[PROTOCOL], max_msg_size=MAX_BYTES) as inside,
        ):
            await outside.prepare(request)
            ways = ((inside, outside), (outside, inside))
            pumps = [asyncio.ensure_future(_pump(*way)) for way in ways]
            try:
                await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for pump in pumps:
                    pump.cancel()
                await asyncio.gather(*pumps, return_exceptions=True)
    except aiohttp.ClientError:
        if not outside.prepared:
            raise web.HTTPBadGateway(text='the Foxglove server is not there\n') from None
    with contextlib.suppress(ConnectionError, asyncio.TimeoutError):
        await asyncio.wait_for(outside.close(), 3.0)
    return outside


async def _pump(source: Socket, sink: Socket) -> None:
    """Pass messages on; a slow sink makes the source wait, whose SDK then drops old messages."""
    async for message in source:
        if message.type == WSMsgType.TEXT:
            await sink.send_str(message.data)
        elif message.type == WSMsgType.BINARY:
            await sink.send_bytes(message.data)
