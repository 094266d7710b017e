"""Web server of the live view: the page, and the WebSocket that keeps it moving."""

import asyncio
import contextlib
import json
import logging
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

from aiohttp import WSMsgType, web
from aiohttp.http import HttpProcessingError
from aiohttp.typedefs import Handler

from lpv.core.support.errors import ConfigError
from lpv.core.support.limits import AT_ONCE, PATIENCE, QUIET
from lpv_node.view.access import MOST_CLIENTS, Access
from lpv_node.view.commands import Command, CommandError, Reply, parse_command

LARGEST_MESSAGE = 4096
"""Largest message of a client [byte]."""
SOCKET: dict[str, Any] = {'max_msg_size': LARGEST_MESSAGE, 'compress': False, 'timeout': 2.0}
"""Of the WebSockets of all ports."""
HEARTBEAT = 2.0 * PATIENCE
"""Interval of pings; a client that answers none for half of it loses its place [s]."""
_MOST_WRONG_TOKENS = 5
"""Wrong tokens after which a client is dropped; each one costs it `QUIET`."""
_BURST = 30.0
"""Messages of one client at once; then one in the time that seems immediate."""
_PAGE = Path(__file__).with_name('static')
MOST_CONNECTIONS = 8 * MOST_CLIENTS
"""Connections of a port, of browsers that load the page as of others; then idle ones are closed."""
MOST_WAITING = 64
"""A client with more messages waiting than this is dropped; frames do not count."""
HEADERS = {
    'Content-Security-Policy': "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    'Cache-Control': 'no-store',
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'X-Frame-Options': 'DENY',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Server': 'lpv_node.view',
}


def encode(message: dict[str, Any]) -> str:
    """One message as JSON; refuses NaN, which JSON does not have."""
    return json.dumps(message, separators=(',', ':'), allow_nan=False)


class Client:
    """One open WebSocket: frames replace each other while it is slow, other messages wait."""

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self._socket = socket
        self._waiting: asyncio.Queue[str | None] = asyncio.Queue()  # None: the newest frame
        self._frame = ''
        self.granted = self.welcomed = self.lost = False
        self.wrong_tokens = 0

    def put(self, text: str) -> None:
        """Queue a message that must arrive, or give the client up."""
        if self._waiting.qsize() >= MOST_WAITING:
            self.close()
        self._waiting.put_nowait(text)

    def welcome(self, text: str) -> None:
        """Queue the first message: others are for who got it."""
        self.put(text)
        self.welcomed = True

    def put_frame(self, text: str) -> None:
        """Put the newest frame in place of one that was not sent yet."""
        if not self._frame:
            self._waiting.put_nowait(None)
        self._frame = text

    def close(self) -> None:
        """Give the client up."""
        self.lost = True
        self.finish()

    def finish(self) -> None:
        """Send what is queued, then no more."""
        self._waiting.put_nowait('')

    async def write(self) -> None:
        """Send what is queued until the client is lost or all is said."""
        while not self.lost and not self._socket.closed:
            text = await self._waiting.get()
            if text is None:
                text, self._frame = self._frame, ''
            if self.lost or not text:
                return
            try:
                await asyncio.wait_for(self._socket.send_str(text), 2.0 * PATIENCE)
            # Python 3.10 has two kinds of time-out.
            except (asyncio.TimeoutError, ConnectionError, RuntimeError):  # noqa: UP041
                self.lost = True


class _Refusal(asyncio.Protocol):
    """A connection that is one too many."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        cast('asyncio.Transport', transport).abort()


class ViewServer:
    """Serves the live view from a thread of its own; no method waits for a client."""

    def __init__(
        self,
        access: Access,
        sensors: Sequence[str],
        submit: Callable[[Command, Reply], bool],
        max_clients: int = MOST_CLIENTS,
        heartbeat: float = HEARTBEAT,
        patience: float = PATIENCE,
    ) -> None:
        self._access, self._sensors, self._submit = access, tuple(sensors), submit
        self._max_clients, self._heartbeat, self._patience = max_clients, heartbeat, patience
        self.clients: set[Client] = set()  # changed in the server's thread
        self._loop = asyncio.new_event_loop()
        self._runners: list[web.AppRunner] = []
        self._listeners: list[asyncio.Server] = []
        self._thread: threading.Thread | None = None

    def start(self, sites: Sequence[tuple[Any, ...]]) -> list[int]:
        """Open sites of ``(application, address, port)``; the ports, or ConfigError."""
        try:
            ports = [self._loop.run_until_complete(self._open(*site)) for site in sites]
        except ConfigError:
            self._loop.run_until_complete(self._close())
            self._loop.close()
            raise
        self._thread = threading.Thread(target=self._run, name='view server', daemon=True)
        self._thread.start()
        return ports

    async def _open(self, application: web.Application, address: str, port: int) -> int:
        options: dict[str, Any] = {'access_log': None, 'handle_signals': False}
        options |= {'shutdown_timeout': 1.0, 'keepalive_timeout': self._patience}
        # What is sent here that is no HTTP, aiohttp would log with a traceback.
        logger = logging.getLogger('lpv_node.view.requests')
        wrong = HttpProcessingError
        logger.filters = [lambda one: not (one.exc_info and isinstance(one.exc_info[1], wrong))]
        busy = set[asyncio.BaseProtocol]()

        @web.middleware
        async def note(request: web.Request, handler: Handler) -> web.StreamResponse:
            busy.add(request.protocol)
            try:
                return await handler(request)
            finally:
                busy.discard(request.protocol)

        application.middlewares.insert(0, note)
        runner = web.AppRunner(application, logger=logger, **options)
        await runner.setup()
        self._runners.append(runner)

        def admit() -> asyncio.Protocol:
            # Without a limit, whoever connects and says nothing takes all files of the process.
            served = runner.server
            there = [one for one in served.connections if one.transport] if served else []
            if len(there) >= MOST_CONNECTIONS:
                # The oldest that asks for nothing makes room: others must get in.
                idle = next((one for one in there if one not in busy), None)
                if idle is None:
                    return _Refusal()
                idle.force_close()
            return served() if served else _Refusal()

        try:
            host = '127.0.0.1' if address == 'localhost' else address
            listener = await self._loop.create_server(admit, host, port)
        except (OSError, OverflowError) as error:
            reason = getattr(error, 'strerror', None) or error
            text = f'cannot listen on {address}, port {port}: {reason}'
            raise ConfigError('port', text) from error
        self._listeners.append(listener)
        return int(listener.sockets[0].getsockname()[1])

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()
        self._loop.run_until_complete(self._close())
        self._loop.close()

    async def _close(self) -> None:
        for client in self.clients:
            client.close()
        for listener in self._listeners:
            listener.close()
        for runner in self._runners:
            await runner.cleanup()

    def stop(self) -> None:
        """Close all connections and ports; may be called twice."""
        if self._thread is not None:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(5.0)
            self._thread = None

    def application(self) -> web.Application:
        """The page and its WebSocket, for `start`."""
        application = guarded(self._access)
        application.router.add_get('/ws', self._on_socket)
        application.router.add_get('/', _on_page)
        application.router.add_static('/', _PAGE)
        return application

    @property
    def newcomers(self) -> bool:
        """Whether a client waits for its first message; see `welcome`."""
        return any(not client.welcomed for client in tuple(self.clients))

    def welcome(self, hello: dict[str, Any]) -> None:
        """Send new clients their first message: they get frames from then on."""
        hello = {**hello, 'token_needed': bool(self._access.token)}
        self._send(Client.welcome, hello, to_new=True)

    def frame(self, message: dict[str, Any]) -> None:
        """Send a frame to all clients; those that are slow skip some."""
        self._send(Client.put_frame, message)

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to all clients that none of them may miss."""
        self._send(Client.put, message)

    def _send(
        self, put: Callable[[Client, str], None], message: dict[str, Any], to_new: bool = False
    ) -> None:
        def send(text: str) -> None:
            for client in self.clients:
                if client.welcomed != to_new:
                    put(client, text)

        if self.clients:
            self._call(send, encode(message))

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        with contextlib.suppress(RuntimeError):  # closed meanwhile
            self._loop.call_soon_threadsafe(function, *arguments)

    async def _on_socket(self, request: web.Request) -> web.WebSocketResponse:
        if len(self.clients) >= self._max_clients:
            raise web.HTTPServiceUnavailable(text='too many clients')
        socket = web.WebSocketResponse(heartbeat=self._heartbeat, **SOCKET)
        await socket.prepare(request)
        client = Client(socket)
        client.granted = not self._access.token
        self.clients.add(client)
        writer = asyncio.ensure_future(client.write())
        reader = asyncio.ensure_future(self._read(socket, client))
        try:
            await asyncio.wait((writer, reader), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.clients.discard(client)
            client.finish()
            await asyncio.wait((writer,), timeout=1.0)
            # Until Python 3.12 a cancelled wait_for may go on: the flag ends it in any case.
            client.close()
            for task in (writer, reader):
                task.cancel()
            await asyncio.gather(writer, reader, return_exceptions=True)
            with contextlib.suppress(asyncio.TimeoutError, ConnectionError):
                await asyncio.wait_for(socket.close(), 3.0)
        return socket

    async def _read(self, socket: web.WebSocketResponse, client: Client) -> None:
        allowance, last, refusal = _BURST, time.monotonic(), ''
        async for message in socket:
            now = time.monotonic()
            allowance, last = min(_BURST, allowance + (now - last) / AT_ONCE) - 1.0, now
            try:
                if allowance < 0.0:
                    refusal = 'too many messages'
                    raise CommandError(refusal)
                if message.type != WSMsgType.TEXT:
                    raise CommandError('text messages only')
                command = parse_command(message.data, self._sensors)
            except CommandError as error:
                client.put(encode({'type': 'error', 'message': str(error)}))
                if refusal:
                    return
                continue
            if not await self._obey(client, command):
                return

    async def _obey(self, client: Client, command: Command) -> bool:
        """Carry a command out; False ends the connection."""
        answer = {'type': 'reply', 'id': command.number, 'command': command.name}

        def reply(ok: bool, text: str) -> None:
            self._call(client.put, encode({**answer, 'ok': ok, 'message': text}))

        if command.name == 'token':
            client.granted = self._access.accepts(command.fields['token'])
            if not client.granted:
                client.wrong_tokens += 1
                await asyncio.sleep(QUIET)
            reply(client.granted, 'token accepted' if client.granted else 'this is not the token')
            return client.wrong_tokens < _MOST_WRONG_TOKENS
        if not client.granted:
            reply(False, 'the token is needed for this')
        elif not self._submit(command, reply):
            reply(False, 'busy with earlier commands: try again')
        return True


async def _on_page(_request: web.Request) -> web.FileResponse:
    return web.FileResponse(_PAGE / 'index.html')


def guarded(access: Access) -> web.Application:
    """Application that refuses requests from elsewhere and adds security headers."""

    @web.middleware
    async def refuse(request: web.Request, handler: Handler) -> web.StreamResponse:
        if refusal := access.refusal(request.headers):
            raise web.HTTPForbidden(text=f'refused: {refusal}\n')
        return await handler(request)

    async def add_headers(_request: web.Request, response: web.StreamResponse) -> None:
        response.headers.update(HEADERS)

    application = web.Application(middlewares=[refuse])
    application.on_response_prepare.append(add_headers)
    return application
