"""The clients of the live view: what each still has to be sent, and who may give commands."""

import asyncio
import json
from collections import deque
from typing import Any

from aiohttp import web

_MOST_WAITING = 64
"""A client with more messages waiting than this is dropped; frames do not count."""
_LONGEST_SEND = 10.0
"""A client that takes no data for this long is dropped [s]."""


def encode(message: dict[str, Any]) -> str:
    """One message as JSON; refuses NaN, which JSON does not have."""
    return json.dumps(message, separators=(',', ':'), allow_nan=False)


class Client:
    """One open WebSocket.

    Frames replace each other while the client is slow; other messages wait in a bounded queue.
    """

    def __init__(self, socket: web.WebSocketResponse) -> None:
        self._socket = socket
        self._waiting: deque[str] = deque()
        self._frame: str | None = None
        self._wake = asyncio.Event()
        self.granted = self.welcomed = self.lost = self._ending = False
        self.wrong_tokens = 0

    def put(self, text: str) -> None:
        """Queue a message that must arrive, or give the client up."""
        if len(self._waiting) >= _MOST_WAITING:
            self.close()
        self._waiting.append(text)
        self._wake.set()

    def put_frame(self, text: str) -> None:
        """Put the newest frame in place of one that was not sent yet."""
        if self.welcomed:
            self._frame = text
            self._wake.set()

    def close(self) -> None:
        """Give the client up."""
        self.lost = True
        self._wake.set()

    def finish(self) -> None:
        """Send what must arrive, then no more."""
        self._ending, self._frame = True, None
        self._wake.set()

    async def write(self) -> None:
        """Send what is queued until the client is lost or all is said."""
        while not self.lost and not self._socket.closed:
            if self._ending and not self._waiting:
                return
            await self._wake.wait()
            self._wake.clear()
            while not self.lost and (self._waiting or self._frame):
                if self._waiting:
                    text = self._waiting.popleft()
                else:
                    text, self._frame = self._frame or '', None
                try:
                    await asyncio.wait_for(self._socket.send_str(text), _LONGEST_SEND)
                # Python 3.10 has two kinds of time-out.
                except (asyncio.TimeoutError, ConnectionError, RuntimeError):  # noqa: UP041
                    self.lost = True


class Hub:
    """All clients; lives in the server's thread."""

    def __init__(self) -> None:
        self.clients: set[Client] = set()

    def welcome(self, hello: dict[str, Any]) -> None:
        """Send the first message, of `LiveModel.hello`, to clients that have not had it."""
        text = encode(hello)
        for client in self.clients:
            if not client.welcomed:
                client.put(text)
                client.welcomed = True

    def frame(self, message: dict[str, Any]) -> None:
        """Send a frame to all; a slow client skips some."""
        if self.clients:
            text = encode(message)
            for client in self.clients:
                client.put_frame(text)

    def tell(self, message: dict[str, Any]) -> None:
        """Send a message to all that must arrive."""
        text = encode(message)
        for client in self.clients:
            if client.welcomed:
                client.put(text)

    @property
    def newcomers(self) -> bool:
        """Whether some client has had no first message yet."""
        return any(not client.welcomed for client in self.clients)
