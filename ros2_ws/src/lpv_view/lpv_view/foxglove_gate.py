"""The door in front of the Foxglove SDK's server: checks origins, then passes bytes on."""

import asyncio
import contextlib

import aiohttp
from aiohttp import WSMsgType, web

from lpv_view.access import Access
from lpv_view.foxglove_bridge import PROTOCOL
from lpv_view.server import guard

Socket = web.WebSocketResponse | aiohttp.ClientWebSocketResponse
_LARGEST_REQUEST, _LARGEST_MESSAGE = 1 << 16, 1 << 22


def gate(access: Access, address: str, port: int, max_clients: int = 8) -> web.Application:
    """Application that lets accepted WebSockets through to the SDK's server.

    Parameters
    ----------
    access : Access
        Decides who is accepted.
    address, port : str, int
        Where the SDK's server listens.
    max_clients : int, optional
        More are refused.

    Returns
    -------
    aiohttp.web.Application
        For `ViewServer.start`.
    """
    count = 0

    async def on_socket(request: web.Request) -> web.WebSocketResponse:
        nonlocal count
        offered = request.headers.get('Sec-WebSocket-Protocol', '')
        if PROTOCOL not in [p.strip() for p in offered.split(',')]:
            raise web.HTTPBadRequest(text=f'WebSocket with subprotocol {PROTOCOL} expected\n')
        if count >= max_clients:
            raise web.HTTPServiceUnavailable(text='too many clients')
        count += 1
        try:
            return await _pass_on(request, f'http://{address}:{port}')
        finally:
            count -= 1

    application = web.Application(middlewares=[guard(access)])
    application.router.add_get('/', on_socket)
    return application


async def _pass_on(request: web.Request, url: str) -> web.WebSocketResponse:
    outside = web.WebSocketResponse(
        protocols=[PROTOCOL],
        max_msg_size=_LARGEST_REQUEST,
        compress=False,
        heartbeat=20.0,
        timeout=2.0,
    )
    try:
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(url, protocols=[PROTOCOL], max_msg_size=_LARGEST_MESSAGE) as inside,
        ):
            await outside.prepare(request)
            pumps = [
                asyncio.ensure_future(_pump(*pair))
                for pair in ((inside, outside), (outside, inside))
            ]
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
