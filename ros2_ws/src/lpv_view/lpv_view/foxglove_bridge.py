"""The topics of the graph over the Foxglove WebSocket protocol, in the bytes in which they came."""

import importlib.util
import logging
import secrets
from collections import deque
from collections.abc import Callable
from types import ModuleType
from typing import Any

from lpv_bag.rosbag.interfaces import add_type, make_typestore
from lpv_core.support.errors import ConfigError

PROTOCOL = 'foxglove.sdk.v1'
BAND = 'fault_band'
"""A topic made for charts: estimate with its bound, and thresholds with both signs."""
_PAIR = {'type': 'array', 'items': {'type': 'number'}}
_BAND_SCHEMA = {
    'type': 'object',
    'title': 'FaultBand',
    'properties': {name: _PAIR for name in ('lower', 'upper', 'threshold_low', 'threshold_high')},
}
_BACKLOG = 256
"""Messages that wait for one slow client; then the oldest are dropped."""


class FoxgloveBridge:
    """Foxglove server for viewing: clients can neither publish nor call services.

    The SDK's server knows no origins, so that any web page in the operator's browser could read
    it.  It therefore listens on a loopback address that nobody can guess, and what the outside
    sees is the gate in `lpv_view.foxglove_gate`.

    Parameters
    ----------
    name : str
        Shown by the client.
    topics : dict
        Message type and number of messages that a late client still gets, by full topic name.
    band : str
        Full name for the topic `BAND`.

    Attributes
    ----------
    address, port : str, int
        Where the SDK's server listens.

    Raises
    ------
    ConfigError
        If a message type is not installed or no port can be had.
    """

    def __init__(self, name: str, topics: dict[str, Any], band: str) -> None:
        foxglove = _sdk()
        self._context = foxglove.Context()
        typestore = make_typestore()
        self._channels: dict[str, Any] = {}
        self._kept: dict[str, deque[tuple[bytes, int]]] = {}
        self._by_id: dict[int, str] = {}
        self._newest = 0
        for topic, (msgtype, keep) in topics.items():
            add_type(typestore, msgtype)
            text, _ = typestore.generate_msgdef(msgtype, ros_version=2)
            channel = foxglove.Channel(
                topic,
                message_encoding='cdr',
                context=self._context,
                schema=foxglove.Schema(name=msgtype, encoding='ros2msg', data=text.encode()),
            )
            self._channels[topic] = channel
            self._kept[topic] = deque(maxlen=keep)
            self._by_id[channel.id()] = topic
        self._band = foxglove.Channel(band, schema=_BAND_SCHEMA, context=self._context)
        self._server = _start(foxglove, name, self._context, self)

    @property
    def address(self) -> str:
        """Address of the SDK's server."""
        return self._server[1]

    @property
    def port(self) -> int:
        """Port of the SDK's server."""
        return self._server[0].port

    def send(self, topic: str, data: bytes, stamp: int) -> None:
        """Forward one message of a topic's full name: CDR with its header, and its time [ns]."""
        self._newest = max(self._newest, stamp)
        kept = self._kept[topic]
        if kept.maxlen:
            kept.append((data, stamp))
        self._channels[topic].log(data, log_time=stamp)

    def send_band(self, sample: dict[str, Any], stamp: int) -> None:
        """Send estimate -+ bound and -+ threshold of `LiveModel.frame` at a stamp [ns].

        Nothing is sent where values are missing.
        """
        values = [sample[name] for name in ('estimate', 'bound', 'threshold')]
        if not any(None in pair for pair in values):
            estimate, bound, threshold = values
            self._band.log(
                {
                    'lower': [e - b for e, b in zip(estimate, bound)],
                    'upper': [e + b for e, b in zip(estimate, bound)],
                    'threshold_low': [-t for t in threshold],
                    'threshold_high': threshold,
                },
                log_time=stamp,
            )

    def restart(self) -> None:
        """Time restarted: clients forget what they have."""
        for kept in self._kept.values():
            kept.clear()
        self._newest = 0
        self._server[0].clear_session()

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Called by the SDK: a late client gets what was latched."""
        topic = self._by_id.get(channel.id, '')
        for data, stamp in list(self._kept.get(topic, ())):
            # As of now, or the client's time line would begin with the first of them.
            self._channels[topic].log(data, log_time=max(stamp, self._newest), sink_id=client.id)

    def stop(self) -> None:
        """Close all connections."""
        self._server[0].stop()


class _Listener:
    """What the SDK asks of its listener; only one event matters."""

    def __init__(self, on_subscribe: Callable[[Any, Any], None]) -> None:
        self.on_subscribe = on_subscribe

    def __getattr__(self, name: str) -> Callable[..., None]:
        if name.startswith('on_'):
            return lambda *_, **__: None
        raise AttributeError(name)


def sdk_is_installed() -> bool:
    """Whether there is a foxglove-sdk, which not every installation has."""
    return importlib.util.find_spec('foxglove') is not None


def _sdk() -> ModuleType:
    import foxglove

    foxglove.set_log_level(logging.ERROR)
    return foxglove


def _start(
    foxglove: ModuleType, name: str, context: Any, bridge: FoxgloveBridge
) -> tuple[Any, str]:
    # All of 127.0.0.0/8 is loopback on Linux; elsewhere it is one address.
    parts = [secrets.randbelow(254) + 1 for _ in range(3)]
    listener = _Listener(bridge.on_subscribe)
    for address in (f'127.{parts[0]}.{parts[1]}.{parts[2]}', '127.0.0.1'):
        try:
            server = foxglove.start_server(
                name=name,
                host=address,
                port=0,
                context=context,
                server_listener=listener,
                capabilities=[],
                message_backlog_size=_BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            failure = error
            continue
        return server, address
    raise ConfigError('foxglove_port', f'the Foxglove server does not start: {failure}')
